"""Run a geomesh command as a child process and read its messages, which are JSON lines. No Qt.

The command runs in its own Python. Inside QGIS, the libraries that geomesh needs would conflict
with the builds of them in QGIS. `geomesh/cli/console.py` describes the protocol.
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

# A shorter prefix of a hidden folder's name might match a folder of another program.
_SHORTEST_PREFIX = 8


class RunError(Exception):
    """A command failed. The text of the error is one line.

    Parameters
    ----------
    code : str
        Error code from geomesh, or "environment" (the command could not be started),
        "protocol" (it uses another protocol) or "crash".
    message : str
    details : tuple of str
        The last lines that the command wrote to standard error.
    """

    def __init__(self, code: str, message: str, details: tuple[str, ...] = ()) -> None:
        super().__init__(message)
        self.code = code
        self.message = message
        self.details = details


@dataclass(frozen=True)
class Outcome:
    """The result of a command.

    Parameters
    ----------
    outputs : tuple of str
        Paths of the output files.
    figures : dict
        Numbers about the outputs, such as "triangles".
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
    """Run a geomesh command and return its result.

    All callables are called in the thread that calls this function. If one of them raises an
    exception, the command is ended and the exception is raised here.

    Parameters
    ----------
    command : sequence of str
        The complete command, with `--progress jsonl --until-eof`.
    progress : callable
        Receives a fraction (0..1, which never decreases) and a message.
    warn : callable
        Receives messages that the user should read.
    cancelled : callable
        Returns whether to stop. It is called every 0.1 s.
    places : sequence of Path
        Folders of the outputs. If the command had to be killed, its unfinished files there are
        removed.

    Raises
    ------
    Cancelled
        If `cancelled` returned True before the command made its result.
    RunError
        If the command failed.
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
            # The result may already be in the pipe.
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
    """The messages that a command has sent so far."""

    unfinished: str = ""
    starts: int = 0
    fraction: float = 0.0
    results: int = 0
    outputs: list[str] = field(default_factory=list)
    figures: dict[str, Any] = field(default_factory=dict)
    errors: list[tuple[str, str]] = field(default_factory=list)

    @property
    def conclusive(self) -> bool:
        """Whether it reported the end of everything that it started."""
        return self.results + len(self.errors) >= max(self.starts, 1)

    @property
    def finished(self) -> bool:
        return self.conclusive and not self.errors


def _parse(line: str) -> Mapping[str, Any]:
    """Return the event of a line. Libraries may print other lines, which contain no event."""
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
            heard.fraction = max(heard.fraction, float(fraction))
            progress(heard.fraction, message)
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
    """Return a description of how a process ended.

    Parameters
    ----------
    code : int or None
        Exit code as in `subprocess`: negative for a signal.
    """
    if code is None:
        return "it does not respond"
    if code < 0:
        try:
            return signal.Signals(-code).name
        except ValueError:
            return f"signal {-code}"
    # On Windows, the exit code of a crash is a large number, usually written as hexadecimal.
    return f"exit code {hex(code)}" if code > 0xFFFF else f"exit code {code}"


def _folder_prefix(value: object) -> str:
    """Return the prefix of unfinished folders' names, if it cannot match any other file."""
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
                time.sleep(0.1)  # Windows locks the files of a killed process for a moment


def _ignore(*_: Any) -> None:
    """Do nothing: the value is not needed."""
