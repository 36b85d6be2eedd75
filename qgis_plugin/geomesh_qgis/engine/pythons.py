"""Find a Python to create an environment from. It is never simply `sys.executable`. No Qt.

On Windows and macOS, `sys.executable` is QGIS itself: used as Python, it would open a second QGIS.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from . import OPTIONS
from .child import ask
from .environment import EnvironmentProblem

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

OLDEST = (3, 11)
# A newer Python is used only if there is no other: numba supports a new Python months later.
_NEWEST_KNOWN = (3, 13)

_TIMEOUT = 30.0

_PROBE = """
import importlib, json, struct, sys
missing = []
for name in ("venv", "ensurepip", "ssl"):
    try:
        importlib.import_module(name)
    except Exception:
        missing.append(name)
print(json.dumps([list(sys.version_info[:3]), missing, struct.calcsize("P") * 8]))
"""


@dataclass(frozen=True)
class BasePython:
    """A Python that works.

    Parameters
    ----------
    path : Path
    version : tuple of int
    missing : tuple of str
        Modules that an environment needs and this Python does not have.
    bits : int
    """

    path: Path
    version: tuple[int, ...]
    missing: tuple[str, ...]
    bits: int

    @property
    def usable(self) -> bool:
        """Whether geomesh can be installed with this Python."""
        return self.version >= OLDEST and not self.missing and self.bits == 64

    def __str__(self) -> str:
        version = ".".join(map(str, self.version))
        narrow = "" if self.bits == 64 else f", {self.bits} bits"
        lacks = f", without {' and '.join(self.missing)}" if self.missing else ""
        return f"{self.path}: {version}{narrow}{lacks}"


def find_base_python() -> Path:
    """Return the best Python on this computer to create an environment from.

    Raises
    ------
    EnvironmentProblem
        If there is none. The message lists what was found.
    """
    return choose(look(candidates()))


def look(paths: Iterable[Path]) -> list[BasePython]:
    """Return the Pythons among these paths. Each program is run only once."""
    seen: set[Path] = set()
    found = []
    for path in paths:
        real = path.resolve()
        if real not in seen and path.is_file():
            seen.add(real)
            answer = probe(path)
            if answer is not None:
                found.append(answer)
    return found


def choose(found: Iterable[BasePython]) -> Path:
    """Return the best of these Pythons: the newest one for which all wheels are known to exist.

    Raises
    ------
    EnvironmentProblem
        If none of them is usable.
    """
    found = list(found)
    usable = [python for python in found if python.usable]
    if usable:
        known = [python for python in usable if python.version[:2] <= _NEWEST_KNOWN]
        if known:
            return max(known, key=lambda python: python.version[:2]).path
        return min(usable, key=lambda python: python.version[:2]).path
    raise EnvironmentProblem(_none_usable(found))


def _none_usable(found: list[BasePython]) -> str:
    wanted = ".".join(map(str, OLDEST))
    told = "; ".join(map(str, found)) or "none"
    incomplete = [python for python in found if python.version >= OLDEST and python.missing]
    if incomplete and sys.platform.startswith("linux"):
        return (
            f"a system package is missing (found {told}): run `sudo apt install python3-venv`, or "
            "install the same package under the name that your system uses, and press Install again"
        )
    return (
        f"no Python {wanted} or newer was found (found {told}): install one from python.org or "
        "with your system's package manager and press Install again, or choose an environment that "
        f"has geomesh in {OPTIONS}"
    )


def probe(path: Path) -> BasePython | None:
    """Run a program and return which Python it is, or None if it is not a working Python."""
    try:
        done = ask([str(path), "-c", _PROBE], _TIMEOUT)
        version, missing, bits = json.loads(done.stdout.decode("utf-8", "replace"))
        return BasePython(path, tuple(version), tuple(missing), int(bits))
    except (OSError, ValueError, TypeError, subprocess.SubprocessError):
        return None


def candidates() -> Iterator[Path]:
    """Yield the usual paths of Pythons. Many of them do not exist."""
    names = [f"python3.{minor}" for minor in range(_NEWEST_KNOWN[1], OLDEST[1] - 1, -1)]
    names += ["python3", "python"]
    if sys.platform == "win32":
        yield from _windows()
    # The Python for which QGIS's modules were built is in a folder beside them.
    for prefix in dict.fromkeys((sys.exec_prefix, sys.base_exec_prefix, sys.base_prefix)):
        yield from _in(Path(prefix) / "bin", names)
    for name in names:
        found = shutil.which(name)
        if found:
            yield Path(found)
    for folder in ("/usr/bin", "/usr/local/bin", "/opt/homebrew/bin", "/opt/local/bin"):
        yield from _in(Path(folder), names)
    if sys.platform == "darwin":
        framework = Path("/Library/Frameworks/Python.framework/Versions")
        yield from sorted(framework.glob("3.*/bin/python3"), reverse=True)


def _in(folder: Path, names: Iterable[str]) -> Iterator[Path]:
    return (folder / name for name in names)


def _windows() -> Iterator[Path]:
    for prefix in dict.fromkeys((sys.exec_prefix, sys.base_prefix)):
        yield from _in(Path(prefix), ("python.exe", "python3.exe"))
    launcher = shutil.which("py")
    if launcher:
        yield from _launched(launcher)
    for variable, place in (("LOCALAPPDATA", "Programs/Python"), ("PROGRAMFILES", ".")):
        root = os.environ.get(variable)
        if root:
            yield from sorted((Path(root) / place).glob("Python3*/python.exe"), reverse=True)


def _launched(launcher: str) -> Iterator[Path]:
    """Yield the Pythons that the Windows launcher of python.org lists."""
    try:
        done = ask([launcher, "-0p"], _TIMEOUT)
    except (OSError, subprocess.SubprocessError):
        return
    for line in done.stdout.decode("utf-8", "replace").splitlines():
        # " -V:3.12 *        C:\\Program Files\\Python312\\python.exe"
        drive = line.find(":\\")
        if drive > 0:
            yield Path(line[drive - 1 :].strip())
