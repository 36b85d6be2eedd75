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
    read = [path for path in inputs if path is not None]
    for output in outputs:
        for path in read:
            if any(_is_same_file(file, output) for file in _files(path)):
                raise OutputError(f"{output} is the input {path}; choose another name")


def _files(path: str) -> list[str]:
    """Return the paths of files that a name of GDAL can refer to."""
    match = _INSIDE.fullmatch(path)
    return [path, match[1] or match[2]] if match else [path]


def _is_same_file(path: str, output: str | Path) -> bool:
    try:
        return Path(output).samefile(path)
    except OSError:  # one of them does not exist
        return False
