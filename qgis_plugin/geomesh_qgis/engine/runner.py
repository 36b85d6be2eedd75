"""Run one geomesh command as a child process and hear what it tells as JSON lines. No Qt.

The command runs in a Python of its own: inside QGIS, the libraries that geomesh needs
would meet QGIS's own builds of them. `geomesh/cli/console.py` describes the protocol.
"""

from __future__ import annotations

import json
import os
import shutil
import signal
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from . import OPTIONS
from .child import Cancelled, Child, clean_environment

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

__all__ = ["PROTOCOL", "Cancelled", "Outcome", "RunError", "clean_environment", "run"]

PROTOCOL = 1

# A shorter beginning of a hidden folder's name might be that of somebody else's.
_SHORTEST_PREFIX = 8


class RunError(Exception):
    """A command failed; its text is one line.

    Parameters
    ----------
    code : str
        geomesh's own word for what went wrong, or "environment" (it could not be
        started), "protocol" (it speaks another one) or "crash".
    message : str
    details : tuple of str
        The last lines that it wrote on standard error.
    """

    def __init__(self, code: str, message: str, details: tuple[str, ...] = ()) -> None:
        super().__init__(message)
        self.code = code
        self.message = message
        self.details = details


@dataclass(frozen=True)
class Outcome:
    """What a command made.

    Parameters
    ----------
    outputs : tuple of str
        Paths of the files.
    figures : dict
        Numbers that tell about them, such as "triangles".
    """

    outputs: tuple[str, ...]
    figures: dict[str, Any]


def run(
    command: Sequence[str],
    *,
    progress: Callable[[float, str], None],
    warn: Callable[[str], None],
    cancelled: Callable[[], bool],
    places: Sequence[Path] = (),
) -> Outcome:
    """Run a geomesh command and return what it made.

    All callables are called from the thread that calls this function. An exception that
    one of them raises ends the command, and is passed on.

    Parameters
    ----------
    command : sequence of str
        Complete, with `--progress jsonl --until-eof`.
    progress : callable
        Gets a fraction (0..1) and a message.
    warn : callable
        Gets what the user should know.
    cancelled : callable
        Whether to stop; asked every 0.1 s.
    places : sequence of Path
        Folders of the outputs: what a command that had to be killed has left there
        unfinished is removed.

    Raises
    ------
    Cancelled
        If it was stopped by `cancelled`, and made nothing.
    RunError
        If it failed.
    """
    heard = _Heard()
    try:
        started = Child(command, clean_environment(os.environ))
    except (OSError, ValueError) as error:
        raise RunError("environment", _not_started(command[0], error)) from error
    with started as child:
        try:
            for line in child.lines(cancelled):
                _hear(heard, _parse(line), progress, warn)
        except Cancelled:
            child.stop()
            # The result may have been on its way.
            for line in child.rest():
                _hear(heard, _parse(line), _ignore, _ignore)
            if not heard.finished:
                raise
        finally:
            child.stop()
            if heard.unfinished and not heard.conclusive:
                _sweep(places, heard.unfinished)
    details = tuple(child.errors)
    if heard.errors:
        code, message = heard.errors[0]
        raise RunError(code, message, details)
    if not heard.finished:
        raise RunError("crash", _crashed(child.exit_code, details), details)
    return Outcome(tuple(heard.outputs), dict(heard.figures))


@dataclass
class _Heard:
    """What a command has told so far."""

    unfinished: str = ""
    starts: int = 0
    results: int = 0
    outputs: list[str] = field(default_factory=list)
    figures: dict[str, Any] = field(default_factory=dict)
    errors: list[tuple[str, str]] = field(default_factory=list)

    @property
    def conclusive(self) -> bool:
        """Whether it told how everything that it started has ended."""
        return self.results + len(self.errors) >= max(self.starts, 1)

    @property
    def finished(self) -> bool:
        return self.conclusive and not self.errors


def _parse(line: str) -> Mapping[str, Any]:
    """Return the event of a line; libraries may print other things, which are none."""
    try:
        event = json.loads(line)
    except (ValueError, RecursionError):
        return {}
    return event if isinstance(event, dict) and "event" in event else {}


def _hear(
    heard: _Heard,
    event: Mapping[str, Any],
    progress: Callable[[float, str], None],
    warn: Callable[[str], None],
) -> None:
    kind = event.get("event")
    message = str(event.get("message", ""))
    if kind == "start":
        heard.starts += 1
        heard.unfinished = _folder_prefix(event.get("unfinished"))
        _check_protocol(event.get("protocol"))
    elif kind == "progress":
        fraction = event.get("fraction")
        if isinstance(fraction, (int, float)):
            progress(float(fraction), message)
    elif kind == "log":
        warn(message)
    elif kind == "error":
        heard.errors.append((str(event.get("code", "error")), message))
    elif kind == "result":
        heard.results += 1
        heard.outputs += [str(path) for path in event.get("outputs", ())]
        heard.figures.update(event.get("figures", {}))


def _check_protocol(version: object) -> None:
    if version == PROTOCOL:
        return
    newer = isinstance(version, int) and version > PROTOCOL
    way_out = (
        "upgrade the plugin in Plugins > Manage and Install Plugins"
        if newer
        else f"upgrade geomesh in {OPTIONS}"
    )
    raise RunError(
        "protocol",
        f"geomesh uses protocol {version}, the plugin uses protocol {PROTOCOL}: {way_out}",
    )


def _not_started(program: str, error: Exception) -> str:
    reason = getattr(error, "strerror", None) or str(error)
    return f"{program} cannot be started: {reason}; choose or install geomesh in {OPTIONS}"


def _crashed(code: int | None, errors: Sequence[str]) -> str:
    end = describe_end(code)
    said = errors[-1].strip() if errors else "no message"
    way_out = (
        "there may not have been enough memory: mesh a smaller part"
        if end == "SIGKILL"
        else f"check it with Verify in {OPTIONS}"
    )
    return f"geomesh ended unexpectedly ({end}: {said}); {way_out}"


def describe_end(code: int | None) -> str:
    """Return in words how a process ended.

    Parameters
    ----------
    code : int or None
        As `subprocess` gives it: negative for a signal.
    """
    if code is None:
        return "it does not respond"
    if code < 0:
        try:
            return signal.Signals(-code).name
        except ValueError:
            return f"signal {-code}"
    # Windows tells a crash by a large number, known by its hexadecimal form.
    return f"exit code {hex(code)}" if code > 0xFFFF else f"exit code {code}"


def _folder_prefix(value: object) -> str:
    """Return how the names of unfinished folders begin, if no other file could be meant."""
    if not isinstance(value, str) or len(value) < _SHORTEST_PREFIX or not value.startswith("."):
        return ""
    return "" if set(value) & set("/\\*?[]") else value


def _sweep(places: Iterable[Path], prefix: str) -> None:
    for place in places:
        for folder in Path(place).glob(f"{prefix}*"):
            for _ in range(10):
                shutil.rmtree(folder, ignore_errors=True)
                if not folder.exists():
                    break
                time.sleep(0.1)  # Windows lets go of a killed process's files a little later


def _ignore(*_: Any) -> None:
    """Take what no one asked for."""
