"""Create the plugin's own environment beside the old one, test it, then replace it. No Qt."""

from __future__ import annotations

import errno
import os
import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import TYPE_CHECKING

from . import OPTIONS
from .child import Child, clean_environment
from .environment import (
    MANAGED,
    EnvironmentProblem,
    Installation,
    forget_versions,
    installation_at,
    python_in,
)
from .managed import beside, locked, move_folder, remove_folder, wheel_version
from .pythons import find_base_python
from .runner import describe_end
from .trial import self_test

if TYPE_CHECKING:
    from pathlib import Path

Report = Callable[[float, str], None]
Cancel = Callable[[], bool]

# The progress at the end of each step.
_MADE, _FILLED, _TESTED = 0.05, 0.9, 0.99

# The approximate size of the download of an installation. Only the progress depends on it.
_PACKAGES = 35
_MEGABYTES = 350.0
_UNITS = {"bytes": 1e-6, "kB": 1e-3, "MB": 1.0, "GB": 1e3}

_FETCHED = re.compile(r"\s*(?:Downloading|Using cached) (\S+) \(([\d.]+) (bytes|kB|MB|GB)\)")
_NETWORK = re.compile(
    r"NewConnectionError|ConnectTimeoutError|ReadTimeoutError|ProxyError|ProtocolError|"
    r"SSLError|CERTIFICATE_VERIFY_FAILED|IncompleteRead|Could not fetch URL|"
    r"Connection (?:refused|reset|aborted)|Network is unreachable|not a trusted or secure host|"
    r"name resolution|getaddrinfo|HTTP error|HTTPError"
)
_DISK_FULL = re.compile(
    r"No space left on device|Errno 28\b|Disk quota exceeded|WinError 112\b|"
    r"not enough space on the disk"
)
_NO_WHEEL = re.compile(r"No matching distribution found for ([\w.-]+)")


def install(
    managed: Path,
    wheel: Path,
    *,
    progress: Report,
    cancelled: Cancel,
    python: Path | None = None,
) -> Installation:
    """Create the plugin's own environment, or create it again, and return its geomesh.

    The old environment stays in place and works until the new one has made a test mesh.

    Parameters
    ----------
    managed : Path
        Folder of the environment.
    wheel : Path
        Wheel of geomesh. Its dependencies are downloaded.
    progress : callable
        Receives a fraction (0..1, which never decreases) and a description of the current step.
    cancelled : callable
        Returns whether to stop. It is called every 0.1 s.
    python : Path, optional
        Python from which the environment is created. Default: `find_base_python()`.

    Raises
    ------
    Cancelled
        If the installation was cancelled. Nothing has changed.
    EnvironmentProblem
        If the installation failed. Nothing has changed.
    """
    wheel_version(wheel)
    new = beside(managed, "new")
    try:
        with locked(managed):
            _recover(managed)
            progress(0.0, "Looking for Python ...")
            base = python or find_base_python()
            new.mkdir(parents=True)
            try:
                _fill(new, base, wheel, progress, cancelled)
                _swap(new, managed)
            finally:
                with suppress(EnvironmentProblem):  # the next installation tries again
                    remove_folder(new)
    except OSError as error:
        raise EnvironmentProblem(_system_error(managed, error)) from error
    finally:
        forget_versions()
    progress(1.0, f"geomesh {wheel_version(wheel)} is installed")
    return _answering(managed)


def pip_fraction(lines: Sequence[str]) -> float:
    """Return the progress of pip (0..1) from the lines that it has written so far."""
    packages, megabytes, coming = 0, 0.0, 0.0
    for line in lines:
        if line.startswith("Installing collected packages"):
            return 0.8  # the last line of pip before it reports success
        if line.startswith(("Collecting", "Processing")):
            packages += 1
        fetched = _FETCHED.match(line)
        if fetched:
            # pip writes this line before the download.
            megabytes, coming = megabytes + coming, float(fetched[2]) * _UNITS[fetched[3]]
    return 0.2 * min(packages / _PACKAGES, 1.0) + 0.6 * min(megabytes / _MEGABYTES, 1.0)


def explain(lines: Sequence[str], wheel: Path) -> str:
    """Return one line that says why pip failed and what to do."""
    text = "\n".join(lines)
    if _DISK_FULL.search(text):
        return (
            "the disk is full: the installation needs about 1.5 GB; free some space and press "
            "Install again"
        )
    missing = _NO_WHEEL.search(text)
    none_came = "(from versions: none)" in text and not _FETCHED.search(text)
    if none_came or _NETWORK.search(text):
        return (
            "the packages that geomesh needs cannot be downloaded: connect to the internet (or "
            f'set pip\'s proxy) and press Install again, or run `pip install "{wheel}"` in an '
            f"environment of your own (Python 3.11 or newer) and choose it in {OPTIONS}"
        )
    if missing:
        return (
            f"there is no wheel of {missing[1]} for this Python and system: install Python 3.12 "
            "and press Install again"
        )
    errors = [line for line in lines if line.startswith("ERROR")] or [
        line for line in lines if line.strip()
    ]
    return (
        f"pip failed ({errors[-1].strip() if errors else 'no message'}); see the details, or "
        f"choose an environment that has geomesh in {OPTIONS}"
    )


def _fill(new: Path, base: Path, wheel: Path, progress: Report, cancelled: Cancel) -> None:
    progress(0.01, f"Creating an environment with {base} ...")
    code, lines = _listen([str(base), "-m", "venv", str(new)], new, lambda _: None, cancelled)
    python = python_in(new)
    if code != 0 or python is None:
        last = next((line for line in reversed(lines) if line.strip()), describe_end(code))
        full = _DISK_FULL.search("\n".join(lines))
        raise EnvironmentProblem(
            explain(lines, wheel)
            if full
            else f"{base} cannot create an environment ({last.strip()}); install another Python",
            tuple(lines),
        )
    progress(_MADE, f"Installing {wheel.name} ...")
    said: list[str] = []

    def hear(line: str) -> None:
        said.append(line)
        progress(_MADE + (_FILLED - _MADE) * pip_fraction(said), line.strip())

    code, lines = _listen(
        [
            *(str(python), "-m", "pip", "install", "--no-input", "--disable-pip-version-check"),
            *("--no-user", "--progress-bar=off", "--only-binary=:all:"),
            # A URL, because a path may contain brackets, and pip would read them as an extra.
            f"geomesh-toolkit[figures,terrain] @ {wheel.resolve().as_uri()}",
        ],
        new,
        hear,
        cancelled,
    )
    if code != 0:
        raise EnvironmentProblem(explain(lines, wheel), tuple(lines[-40:]))
    remove_folder(_scratch(new))

    def hear_test(fraction: float, message: str) -> None:
        progress(_FILLED + (_TESTED - _FILLED) * fraction, message)

    self_test(_answering(new), progress=hear_test, cancelled=cancelled)


def _answering(folder: Path) -> Installation:
    try:
        return installation_at(str(folder), MANAGED)
    except EnvironmentProblem as problem:
        raise EnvironmentProblem(
            f"{problem.message}, although it was just installed; see the details, or choose an "
            f"environment that has geomesh in {OPTIONS}",
            problem.details,
        ) from problem


def _listen(
    command: Sequence[str], new: Path, hear: Callable[[str], None], cancelled: Cancel
) -> tuple[int | None, list[str]]:
    """Run a step; return its exit code and its lines."""
    # pip unpacks its files in the new folder, because /tmp may be too small.
    scratch = _scratch(new)
    scratch.mkdir(exist_ok=True)
    environ = clean_environment(os.environ)
    environ.update(dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(scratch)))
    lines: list[str] = []
    with Child(command, environ, merge=True, patience=0.0) as child:
        for line in child.lines(cancelled):
            lines.append(line)
            hear(line)
    return child.exit_code, lines


def _scratch(new: Path) -> Path:
    return new / "tmp"


def _recover(managed: Path) -> None:
    """Clean up after an interrupted installation, for example after a power failure."""
    new, old = beside(managed, "new"), beside(managed, "old")
    if old.exists() and not managed.exists():
        move_folder(old, managed)
    remove_folder(old)
    remove_folder(new)


def _swap(new: Path, managed: Path) -> None:
    """Replace the old environment by the new one. If this fails, keep the old one.

    The first line of the new scripts contains a path that is no longer valid. This does not
    matter, because geomesh is run as `python -m geomesh`.
    """
    old = beside(managed, "old")
    if managed.exists():
        move_folder(managed, old)
    try:
        move_folder(new, managed)
        forget_versions()
        _answering(managed)
    except BaseException:
        if old.exists():
            remove_folder(managed)
            move_folder(old, managed)
        raise
    with suppress(EnvironmentProblem):  # the next installation tries again
        remove_folder(old)


def _system_error(managed: Path, error: OSError) -> str:
    if error.errno in (errno.ENOSPC, errno.EDQUOT):
        return explain([f"Errno {errno.ENOSPC}"], managed)
    reason = error.strerror or str(error)
    return (
        f"geomesh cannot be installed into {managed} ({reason}); close other QGIS windows that use "
        f"it, or choose an environment of your own in {OPTIONS}"
    )
