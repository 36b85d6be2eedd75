"""No command writes over what it reads."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from geomesh.errors import OutputError

if TYPE_CHECKING:
    from collections.abc import Iterable

# A file inside a name for one of GDAL's drivers, such as NETCDF:"file.nc":band.
_INSIDE = re.compile(r"[A-Za-z0-9_]{2,}:(?:\"([^\"]+)\"|(.+?))(?::[^:]*)?")


def protect_inputs(outputs: Iterable[str | Path], inputs: Iterable[str | None]) -> None:
    """Refuse outputs that would take the place of something that is read.

    Raises
    ------
    OutputError
    """
    read = [path for path in inputs if path is not None]
    for output in outputs:
        for path in read:
            if any(_is_same_file(file, output) for file in _files(path)):
                raise OutputError(f"{output} is {path}, which is read; choose another name")


def _files(path: str) -> list[str]:
    """Return what may be the file behind a name."""
    match = _INSIDE.fullmatch(path)
    return [path, match[1] or match[2]] if match else [path]


def _is_same_file(path: str, output: str | Path) -> bool:
    try:
        return Path(output).samefile(path)
    except OSError:  # one of them is not there
        return False
