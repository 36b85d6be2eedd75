"""Find and check the geomesh that the plugin runs. Needs no Qt.

The search order is: the plugin's setting, GEOMESH_PYTHON, `geomesh` on PATH, the environment
that the plugin created (`installing.py`). If the user specified a geomesh and it does not work,
this is an error: the plugin does not use another one instead.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from . import OPTIONS
from .child import ask
from .runner import describe_end

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

MINIMUM = "0.1.0"

SETTING = "the plugin's setting"
VARIABLE = "GEOMESH_PYTHON"
PATH = "PATH"
MANAGED = "the plugin's own environment"

# Enough for the first start from a slow disk while a virus scanner checks every file.
_TIMEOUT = 60.0

_VERSION = re.compile(r"geomesh, version (\S+)")


class EnvironmentProblem(Exception):  # noqa: N818
    """No geomesh works, or it cannot be installed. The text of the error is one line.

    Parameters
    ----------
    message : str
    details : tuple of str
        Output of the programs that were run.
    """

    def __init__(self, message: str, details: tuple[str, ...] = ()) -> None:
        super().__init__(message)
        self.message = message
        self.details = details


@dataclass(frozen=True)
class Installation:
    """A geomesh that works.

    Parameters
    ----------
    command : tuple of str
        Start of the command line, before the arguments.
    origin : str
        Where it was found: `SETTING`, `VARIABLE`, `PATH` or `MANAGED`.
    version : str
    """

    command: tuple[str, ...]
    origin: str
    version: str


def find(setting: str, managed: Path) -> Installation:
    """Return the geomesh to run.

    Parameters
    ----------
    setting : str
        A Python, a geomesh command or the folder of an environment; "" if not set.
    managed : Path
        Folder of the plugin's own environment.

    Raises
    ------
    EnvironmentProblem
        If the geomesh that the user specified does not work, or if there is none.
    """
    for origin, named in ((SETTING, setting.strip()), (VARIABLE, os.environ.get(VARIABLE, ""))):
        if named:
            try:
                return installation_at(named, origin)
            except EnvironmentProblem as problem:
                raise EnvironmentProblem(
                    f"{problem.message} (specified by {origin}); correct or clear it, or see "
                    f"{OPTIONS}",
                    problem.details,
                ) from problem
    passed_over = ""
    on_path = shutil.which("geomesh")
    if on_path:
        try:
            return installation_at(on_path, PATH)
        except EnvironmentProblem as problem:
            passed_over = f" ({problem.message})"
    if managed.exists():
        try:
            return installation_at(str(managed), MANAGED)
        except EnvironmentProblem as problem:
            raise EnvironmentProblem(
                f"{problem.message}; press Reinstall in {OPTIONS} to repair it", problem.details
            ) from problem
    raise EnvironmentProblem(
        f"geomesh is not installed yet{passed_over}: press Install geomesh in {OPTIONS}"
    )


def installation_at(place: str, origin: str) -> Installation:
    """Return the geomesh at a path, if it works and is not too old.

    Raises
    ------
    EnvironmentProblem
        If not. The message does not say how to solve it, because this depends on the origin.
    """
    command = command_at(place)
    version = _ask_version(command)
    if order(version) < order(MINIMUM):
        raise EnvironmentProblem(f"{place} is geomesh {version}, older than {MINIMUM}")
    return Installation(command, origin, version)


def command_at(place: str) -> tuple[str, ...]:
    """Return the command for a Python, a geomesh executable or the folder of an environment.

    Raises
    ------
    EnvironmentProblem
        If the path is none of them.
    """
    path = Path(place).expanduser()
    if path.is_dir():
        python = python_in(path)
        if python is None:
            raise EnvironmentProblem(f"there is no Python in {place}")
        path = python
    elif not path.is_file():
        raise EnvironmentProblem(f"{place} does not exist")
    # Links are not resolved: the location of a Python tells to which environment it belongs.
    path = Path(os.path.abspath(path))  # noqa: PTH100
    if path.name.lower().startswith("geomesh"):
        return (str(path),)
    return (str(path), "-m", "geomesh")


def python_in(folder: Path) -> Path | None:
    """Return the Python of an environment, or None."""
    for place in ("bin/python", "bin/python3", "Scripts/python.exe", "python.exe", "python"):
        path = folder / place
        if path.is_file():
            return path
    return None


_answers: dict[tuple[object, ...], str] = {}


def forget_versions() -> None:
    """Clear the cache of versions, because something was installed or removed."""
    _answers.clear()


def _ask_version(command: Sequence[str]) -> str:
    """Return the version of a geomesh. The result is cached until its files change."""
    key = (*command, *_times(Path(command[0])))
    if key not in _answers:
        _answers[key] = _ask(command)
    return _answers[key]


def _times(program: Path) -> Iterable[int]:
    """Return when the program and the packages of its environment were last changed."""
    root = program.parent.parent
    folders = [*sorted(root.glob("lib/python*/site-packages")), root / "Lib" / "site-packages"]
    return (path.stat().st_mtime_ns for path in (program, *folders) if path.exists())


def _ask(command: Sequence[str]) -> str:
    try:
        done = ask([*command, "--version"], _TIMEOUT)
    except subprocess.TimeoutExpired as error:
        raise EnvironmentProblem(
            f"{command[0]} does not report its version within {_TIMEOUT:.0f} s"
        ) from error
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise EnvironmentProblem(f"{command[0]} cannot be started: {reason}") from error
    said = (done.stderr + done.stdout).decode("utf-8", "replace").strip().splitlines()
    match = _VERSION.search(done.stdout.decode("utf-8", "replace"))
    if done.returncode == 0 and match:
        return match[1]
    last = said[-1].strip() if said else describe_end(done.returncode)
    raise EnvironmentProblem(f"{command[0]} has no working geomesh ({last})", tuple(said[-40:]))


def order(version: str) -> tuple[int, ...]:
    """Return the numbers of a version, for comparisons. "0.2.0.dev1" counts as 0.2.0."""
    match = re.match(r"\d+(?:\.\d+)*", version)
    numbers = [int(part) for part in match[0].split(".")] if match else []
    return tuple([*numbers, 0, 0, 0][:3])
