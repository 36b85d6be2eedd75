"""The plugin's own environment and the wheel from which it is created. Needs no Qt."""

from __future__ import annotations

import hashlib
import re
import shutil
import sys
import tempfile
import time
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from .environment import (
    MANAGED,
    EnvironmentProblem,
    Installation,
    find,
    forget_versions,
    installation_at,
    order,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

# The place of the wheel in the plugin's zip file.
WHEELS = Path(__file__).parents[1] / "wheel"

_WHEEL = re.compile(r"geomesh_toolkit-([^-]+)-.*\.whl")

_ATTEMPTS = 20


@dataclass(frozen=True)
class Survey:
    """What is installed, for display on the options page.

    Parameters
    ----------
    used : Installation or None
        The geomesh that the plugin runs. None if there is a `problem`.
    problem : str
    managed : bool
        Whether the plugin's own environment exists, even if it does not work.
    managed_version : str
        Version of geomesh in that environment; "" if it does not work.
    offered : str
        Version of the wheel in the plugin; "" if there is none.
    """

    used: Installation | None
    problem: str
    managed: bool
    managed_version: str
    offered: str


def bundled_wheel() -> Path:
    """Return the wheel of geomesh that is included in the plugin.

    Raises
    ------
    EnvironmentProblem
        If this copy of the plugin contains no wheel.
    """
    wheels = [path for path in WHEELS.glob("*.whl") if _WHEEL.fullmatch(path.name)]
    if not wheels:
        raise EnvironmentProblem(
            f"there is no geomesh wheel in {WHEELS}: install the plugin from its zip file, or run "
            "`make plugin` in a checkout"
        )
    return max(wheels, key=lambda path: order(wheel_version(path)))


def wheel_version(wheel: Path) -> str:
    """Return the version in the file name of a wheel.

    Raises
    ------
    EnvironmentProblem
        If the file is not a wheel of geomesh.
    """
    match = _WHEEL.fullmatch(wheel.name)
    if match is None:
        raise EnvironmentProblem(
            f"{wheel.name} is not a wheel of geomesh; its name must look like "
            "geomesh_toolkit-0.1.0-py3-none-any.whl"
        )
    return match[1]


def survey(setting: str, managed: Path) -> Survey:
    """Return what is installed. Problems are part of the result, not exceptions."""
    used, problem = None, ""
    try:
        used = find(setting, managed)
    except EnvironmentProblem as error:
        problem = error.message
    managed_version = offered = ""
    with suppress(EnvironmentProblem):
        managed_version = installation_at(str(managed), MANAGED).version
    with suppress(EnvironmentProblem):
        offered = wheel_version(bundled_wheel())
    return Survey(used, problem, managed.exists(), managed_version, offered)


def remove(managed: Path) -> None:
    """Remove the plugin's own environment, and the remains of interrupted installations.

    Raises
    ------
    EnvironmentProblem
        If the folder cannot be removed, or is not such an environment.
    """
    if managed.exists() and not (managed / "pyvenv.cfg").is_file() and any(managed.iterdir()):
        raise EnvironmentProblem(
            f"{managed} is not a Python environment, so it was not removed; check what it is and "
            "move it"
        )
    with locked(managed):
        for folder in (managed, beside(managed, "new"), beside(managed, "old")):
            remove_folder(folder)
    forget_versions()


@contextmanager
def locked(managed: Path) -> Iterator[None]:
    """Prevent other QGIS windows from installing or removing at the same time.

    Raises
    ------
    EnvironmentProblem
        If another window does so already. The lock ends with its process, even after a crash.
    """
    # The lock file is not in the profile, because it would stay there.
    name = hashlib.sha256(str(managed).encode()).hexdigest()[:16]
    with (Path(tempfile.gettempdir()) / f"geomesh-{name}.lock").open("a+b") as file:
        try:
            if sys.platform == "win32":
                import msvcrt

                msvcrt.locking(file.fileno(), msvcrt.LK_NBLCK, 1)
            else:
                import fcntl

                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError as error:
            raise EnvironmentProblem(
                "another QGIS window is installing or removing geomesh: wait until it has finished"
            ) from error
        yield


def beside(managed: Path, what: str) -> Path:
    """Return the folder for an environment that is being created ("new") or replaced ("old")."""
    return managed.with_name(f"{managed.name}.{what}")


def remove_folder(folder: Path) -> None:
    """Remove a folder, if it exists.

    Raises
    ------
    EnvironmentProblem
        If a part of it cannot be removed.
    """
    if folder.exists():
        _insist(lambda: shutil.rmtree(folder), f"{folder} cannot be removed")


def move_folder(folder: Path, place: Path) -> None:
    """Move a folder within its file system.

    Raises
    ------
    EnvironmentProblem
        If it cannot be moved.
    """
    _insist(lambda: folder.rename(place), f"{folder} cannot be moved to {place}")


def _insist(act: Callable[[], object], otherwise: str) -> None:
    """Repeat for two seconds: Windows locks the files of a process for a moment after its end."""
    reason = _failure(act)
    for _ in range(_ATTEMPTS):
        if not reason:
            return
        time.sleep(0.1)
        reason = _failure(act)
    if reason:
        raise EnvironmentProblem(
            f"{otherwise} ({reason}); close the programs that use it and try again"
        )


def _failure(act: Callable[[], object]) -> str:
    try:
        act()
    except OSError as error:
        return error.strerror or str(error)
    return ""
