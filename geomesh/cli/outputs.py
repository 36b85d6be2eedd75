"""Protect the inputs of a command: an output must not replace them."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from geomesh.errors import OutputError

if TYPE_CHECKING:
    from collections.abc import Iterable

# A file name inside the name for a GDAL driver, such as NETCDF:"file.nc":band.
_INSIDE = re.compile(r"[A-Za-z0-9_]{2,}:(?:\"([^\"]+)\"|(.+?))(?::[^:]*)?")


def protect_inputs(outputs: Iterable[str | Path], inputs: Iterable[str | None]) -> None:
    """Raise an error if an output would replace an input.

    Raises
    ------
    OutputError
    """
    # One look at each file, not at each pair: a batch may have thousands.
    written = {_identity(output): output for output in outputs}
    written.pop(None, None)
    for path in inputs:
        for file in _files(path) if path is not None else ():
            output = written.get(_identity(file))
            if output is not None:
                raise OutputError(f"{output} is the input {path}; choose another name")


def _files(path: str) -> list[str]:
    """Return the paths of files that a name of GDAL can refer to."""
    match = _INSIDE.fullmatch(path)
    return [path, match[1] or match[2]] if match else [path]


def _identity(path: str | Path) -> tuple[int, int] | None:
    """Return the device and the number of a file, the same for all its names; None if absent."""
    try:
        status = Path(path).stat()
    except OSError:
        return None
    return status.st_dev, status.st_ino
