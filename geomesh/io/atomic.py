"""Atomic output: write to a temporary file, then move it to its final place.

So an output file is either complete or does not exist.
"""

from __future__ import annotations

import errno
import os
import re
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

# Where GDAL keeps what a file itself cannot hold, such as the CRS of a rotated pole in a GeoTIFF.
_ASIDE = ".aux.xml"

# Files next to one that is replaced, which would spoil the new one. SQLite would apply its own
# to a new database with the same name; GDAL would take the old CRS for that of the new file.
_COMPANIONS = ("-wal", "-shm", "-journal", _ASIDE)

# Characters that pyogrio does not accept in the name of a folder.
_REFUSED = {
    "!": "the start of a name in an archive",
    **dict.fromkeys("\t\n\r", "a character to leave out"),
}

_WAYS_OUT = {
    **dict.fromkeys(
        (errno.ENOSPC, errno.EDQUOT, errno.EFBIG), "free some space or choose another folder"
    ),
    errno.ENAMETOOLONG: "give it a shorter name",
    **dict.fromkeys((errno.EMFILE, errno.ENFILE), "allow more open files, as with ulimit -n 4096"),
}

# Words of libraries when a disk is full or broken.
_ABOUT_DISK = re.compile(r"\b(disk|space|quota|i/o)\b", re.IGNORECASE)

# Size of a trial file, of which most is a hole, and the bytes that are written to it.
_TRIAL_SIZE = 100_000_000
_TRIAL_BYTES = 1_000_000


def check_place(target: Path, *, overwrite: bool) -> None:
    """Raise OutputError if `target` cannot be written; call this before any work is done.

    Raises
    ------
    OutputError
        If `target` exists (unless `overwrite`), is not a regular file, or its folder does
        not exist or cannot be written to.
    """
    place = _place(target)
    _check_name(target, place)
    try:
        if place.exists():
            _check_existing(target, place.stat().st_mode, overwrite=overwrite)
        if not place.parent.is_dir():
            raise OutputError(f"the folder of {target} does not exist; create it first")
        # Make a folder to find out. The permission bits do not say enough: a superuser
        # ignores them, and a read-only or full file system refuses all the same.
        Path(tempfile.mkdtemp(prefix=leftovers_prefix(os.getpid()), dir=place.parent)).rmdir()
    except OSError as error:
        raise OutputError(
            f"{target} cannot be written: {_reason(error)}; {_way_out(error)}"
        ) from error


def _place(target: Path) -> Path:
    """Return where the file is to be, without links."""
    place = os.path.realpath(target)
    # POSIX keeps two slashes at the start; then pyogrio would take a folder for a host.
    return Path(re.sub("^//+", "/", place) if os.name == "posix" else place)


def _check_name(target: Path, place: Path) -> None:
    for character, meaning in _REFUSED.items():
        if character in str(place.parent):
            raise OutputError(
                f"{target} cannot be written: pyogrio would take {character!r} in the name of a "
                f"folder for {meaning}; choose a folder without {character!r}"
            )
    try:
        str(place).encode()
    except UnicodeEncodeError as error:
        raise OutputError(
            f"{target} cannot be written: its path is not valid UTF-8; choose another name, or set "
            "PYTHONUTF8=1"
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
    """Yield a temporary path to write to; at the end of the block, move it to `target`.

    The path is in a hidden folder next to `target`. So the move is one rename in the same
    file system, and a reader sees either the old file or the new one. After any exception
    the folder is removed, and `target` does not change.

    Parameters
    ----------
    target : Path
        A symbolic link is followed and stays a link.
    suffix : str
        Extension of the file to write, with the dot.
    overwrite : bool
        Whether to replace a file that another program has created at `target` in the
        meantime.

    Raises
    ------
    OutputError
        If the file cannot be moved to `target`.
    """
    place = _place(target)
    folder: Path | None = None
    try:
        with writing_to(target), undisturbed():
            folder = Path(tempfile.mkdtemp(prefix=leftovers_prefix(os.getpid()), dir=place.parent))
        finished = folder / f"output{suffix}"
        yield finished
        with writing_to(target):
            _flush(finished)
            if place.exists() and not overwrite:
                raise OutputError(
                    f"{target} was created by another program in the meantime and was kept; use "
                    "`overwrite=True` to replace it"
                )
            _replace(finished, place)
    finally:
        if folder is not None:
            with undisturbed():
                shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def undisturbed() -> Iterator[None]:
    """Delay Ctrl-C and a request to end until the block, which must be short, is finished.

    Both raise exceptions anywhere in the main thread. In the middle of cleaning up they would
    leave temporary files behind.
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
def writing_to(
    target: str | Path, *libraries: str, way_out: str = "choose another folder"
) -> Iterator[None]:
    """Turn errors of failed writing into OutputError with a message of one line.

    Parameters
    ----------
    target : path
        The name of the file in the message.
    *libraries : str
        Names of packages whose errors mean, like OSError, that writing failed. The packages
        need not be imported.
    way_out : str
        What to do if neither the disk nor the name of the file is the cause.
    """
    try:
        yield
    except Exception as error:
        if not isinstance(error, OSError) and _package(error) not in libraries:
            raise
        known = isinstance(error, OSError) and error.errno
        cause = error if known else _try_folder(_place(Path(target)).parent)
        if cause is not None:
            way_out = _way_out(cause)
        elif _ABOUT_DISK.search(str(error)):  # the library has removed what filled it
            way_out = _WAYS_OUT[errno.ENOSPC]
        raise OutputError(f"{target} could not be written: {_reason(error)}; {way_out}") from error


def _package(error: Exception) -> str:
    return type(error).__module__.partition(".")[0]


def _try_folder(folder: Path) -> OSError | None:
    """Return the error of writing a file to the folder, or None: libraries do not tell it."""
    try:
        with tempfile.TemporaryFile(prefix=leftovers_prefix(os.getpid()), dir=folder) as file:
            file.truncate(_TRIAL_SIZE)  # is there a limit for the size of a file?
            file.seek(0)
            file.write(bytes(_TRIAL_BYTES))
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        return error
    return None


def _way_out(error: Exception) -> str:
    return _WAYS_OUT.get(getattr(error, "errno", None) or 0, "choose another folder")


def leftovers_prefix(pid: int) -> str:
    """Return the prefix of the names of temporary folders in which a process writes.

    With it, a program that had to kill the process finds the folders that are left.
    """
    return f".geomesh-{pid}-"


def remove_leftovers(folder: Path, pid: int) -> None:
    """Remove the temporary folders that a killed process has left in a folder."""
    for unfinished in folder.glob(f"{leftovers_prefix(pid)}*"):
        shutil.rmtree(unfinished, ignore_errors=True)


def _flush(path: Path) -> None:
    """Wait until the file is on the disk: a full disk may raise an error only now."""
    with path.open("r+b") as file:
        os.fsync(file.fileno())


def _replace(finished: Path, place: Path) -> None:
    moved: list[tuple[Path, Path]] = []
    try:
        for suffix in _COMPANIONS:
            companion = place.with_name(place.name + suffix)
            if os.path.exists(companion):  # noqa: PTH110  (its name may be too long)
                aside = finished.with_name(companion.name)
                companion.replace(aside)
                moved.append((aside, companion))
        own = finished.with_name(finished.name + _ASIDE)
        if own.exists():
            own.replace(place.with_name(place.name + _ASIDE))
        finished.replace(place)
    except BaseException:
        for aside, companion in moved:
            aside.replace(companion)
        raise
    _flush_folder(place.parent)


def _flush_folder(folder: Path) -> None:
    """Make the rename survive a power failure, if the system supports that."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)


def _reason(error: Exception) -> str:
    strerror = error.strerror if isinstance(error, OSError) else None
    return strerror.lower() if strerror else one_line(error)
