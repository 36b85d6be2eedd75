"""Output that is there as a whole or not at all: written aside, then moved into place."""

from __future__ import annotations

import os
import shutil
import signal
import stat
import tempfile
import threading
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING

from geomesh.errors import OutputError, one_line

if TYPE_CHECKING:
    from collections.abc import Iterator

# What SQLite keeps beside a database. Left there, it would be replayed into the
# database that takes the old one's name, and corrupt it.
_COMPANIONS = ("-wal", "-shm", "-journal")


def check_place(target: Path, *, overwrite: bool) -> None:
    """Refuse a place that cannot be written to, before any work is done.

    Raises
    ------
    OutputError
        If `target` exists (unless `overwrite`), is no regular file, or its
        folder is missing or cannot be written to.
    """
    place = Path(os.path.realpath(target))
    if "!" in str(place.parent):
        raise OutputError(
            f"{target} cannot be written: pyogrio takes what follows a '!' for a file in an "
            "archive; choose a folder without it"
        )
    try:
        if place.exists():
            _check_existing(target, place.stat().st_mode, overwrite=overwrite)
        if not place.parent.is_dir():
            raise OutputError(f"the folder of {target} does not exist; create it first")
        # The mode bits do not tell: a superuser passes them, and a read-only or
        # full file system may still refuse.
        Path(tempfile.mkdtemp(prefix=leftovers_prefix(os.getpid()), dir=place.parent)).rmdir()
    except OSError as error:
        raise OutputError(
            f"{target} cannot be written: {_reason(error)}; choose another folder"
        ) from error


def _check_existing(target: Path, mode: int, *, overwrite: bool) -> None:
    if stat.S_ISDIR(mode):
        raise OutputError(f"{target} is a folder; name a file inside it")
    if not stat.S_ISREG(mode):
        raise OutputError(f"{target} is not a regular file; choose another name")
    if not overwrite:
        raise OutputError(f"{target} exists; use `overwrite=True` to replace it")


@contextmanager
def staged(target: Path, suffix: str, *, overwrite: bool) -> Iterator[Path]:
    """Yield the path to write to; on leaving, move that file to `target`.

    The path lies in a hidden folder beside `target`, so that the move is one
    rename within a file system: a reader sees the old file or the new one. On any
    exception the folder is removed and `target` stays as it was.

    Parameters
    ----------
    target : Path
        A symbolic link is followed, and stays a link.
    suffix : str
        Extension of the file to write, with its dot.
    overwrite : bool
        Whether a file that has appeared at `target` meanwhile may be replaced.

    Raises
    ------
    OutputError
        If the file cannot be put in place.
    """
    place = Path(os.path.realpath(target))
    folder: Path | None = None
    try:
        with writing_to(target), undisturbed():
            folder = Path(tempfile.mkdtemp(prefix=leftovers_prefix(os.getpid()), dir=place.parent))
        finished = folder / f"output{suffix}"
        yield finished
        with writing_to(target):
            _flush(finished)
            if place.exists() and not overwrite:
                raise OutputError(f"{target} was made by another program meanwhile; it was kept")
            _replace(finished, place)
    finally:
        if folder is not None:
            with undisturbed():
                shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def undisturbed() -> Iterator[None]:
    """Let Ctrl-C and a request to end wait until the block, which must be short, is done.

    They come as exceptions in the main thread, anywhere: in the middle of cleaning up after
    another one, they would leave the rest of it lying about.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    waiting: list[int] = []

    def note(number: int, _: object) -> None:
        waiting.append(number)

    handlers = {
        number: signal.signal(number, note)
        for number in (signal.SIGINT, signal.SIGTERM)
        if callable(signal.getsignal(number))
    }
    try:
        yield
    finally:
        for kind, handler in handlers.items():
            signal.signal(kind, handler)
        for first in waiting[:1]:
            signal.raise_signal(first)


@contextmanager
def writing_to(target: str | Path, *libraries: str) -> Iterator[None]:
    """Raise OutputError, in one line, for what says that a file could not be written.

    Parameters
    ----------
    target : path
        What the message calls the file.
    *libraries : str
        Whose errors say so, beside OSError: names of packages, which need not be imported.
    """
    try:
        yield
    except Exception as error:
        if not isinstance(error, OSError) and _package(error) not in libraries:
            raise
        raise OutputError(
            f"{target} could not be written: {_reason(error)}; free some space or choose another "
            "folder"
        ) from error


def _package(error: Exception) -> str:
    return type(error).__module__.partition(".")[0]


def leftovers_prefix(pid: int) -> str:
    """Return how the names of the folders begin in which a process writes its output.

    A program that had to kill the process finds by it what was left behind.
    """
    return f".geomesh-{pid}-"


def remove_leftovers(folder: Path, pid: int) -> None:
    """Remove what a process that was killed has left unfinished in a folder."""
    for unfinished in folder.glob(f"{leftovers_prefix(pid)}*"):
        shutil.rmtree(unfinished, ignore_errors=True)


def _flush(path: Path) -> None:
    """Wait until the file is on the disk; a full one may tell only now."""
    with path.open("r+b") as file:
        os.fsync(file.fileno())


def _replace(finished: Path, place: Path) -> None:
    moved: list[tuple[Path, Path]] = []
    try:
        for suffix in _COMPANIONS:
            companion = place.with_name(place.name + suffix)
            if companion.exists():
                aside = finished.with_name(companion.name)
                companion.replace(aside)
                moved.append((aside, companion))
        finished.replace(place)
    except BaseException:
        for aside, companion in moved:
            aside.replace(companion)
        raise
    _flush_folder(place.parent)


def _flush_folder(folder: Path) -> None:
    """Make the rename survive a power cut, where the system offers that."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def _reason(error: Exception) -> str:
    strerror = error.strerror if isinstance(error, OSError) else None
    return strerror.lower() if strerror else one_line(error)
