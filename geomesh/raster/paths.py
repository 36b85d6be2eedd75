"""Names of files, as GDAL and pyogrio understand them."""

from __future__ import annotations

import os
import re
from os import PathLike

# Characters that change the meaning of a path for pyogrio.
_SPECIAL = frozenset("!;\t\n\r")


def is_remote(name: str) -> bool:
    """Return whether a name is a URL or a driver's name (GPKG:file.gpkg:table), not a path."""
    return re.match(r"/vsi|[A-Za-z0-9_+.-]{2,}:", name) is not None


def plain_name(path: str | PathLike[str]) -> str:
    """Return a name with which pyogrio opens exactly this file.

    pyogrio parses a path as a URL: some characters have a special meaning or are left out, except
    in GDAL's virtual file systems. `/vsisubfile/0,` is such a file system: the whole file, from
    its first byte.
    """
    name = os.path.abspath(path)  # noqa: PTH100  (pathlib would not open "zip:mesh.gpkg" either)
    special = set(name) & _SPECIAL or name.startswith("//")
    return f"/vsisubfile/0,{name}" if special else name
