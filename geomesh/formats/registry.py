"""The registry of formats. A new format needs a module with a FORMAT, and a line here."""

from __future__ import annotations

from importlib import import_module
from pathlib import PurePath
from typing import TYPE_CHECKING

from geomesh.errors import OutputError
from geomesh.formats.format import COMPRESSED

if TYPE_CHECKING:
    from os import PathLike

    from geomesh.formats.format import Format

# One line per format, in the order in which help texts and messages list them.
_MODULES = (
    "geopackage",
    "geojson",
    "flatgeobuf",
    "geoparquet",
    "landxml",
    "dxf",
    "mesh_2dm",
    "gr3",
    "stl",
    "obj",
    "ply",
    "glb",
    "vtu",
    "ugrid",
)

FORMATS: tuple[Format, ...] = tuple(
    import_module(f"geomesh.formats.{name}").FORMAT for name in _MODULES
)

DRIVERS = tuple(known.driver for known in FORMATS)
EXTENSIONS = tuple(extension for known in FORMATS for extension in known.extensions)


def find_format(path: str | PathLike[str], driver: str | None = None) -> Format:
    """Return the format with the name `driver`, or else with the extension of `path`.

    Raises
    ------
    OutputError
        If there is no such format.
    """
    if driver is not None:
        for known in FORMATS:
            if known.driver.lower() == driver.lower():
                return known
        raise OutputError(f"there is no vector format {driver!r}; choose from {', '.join(DRIVERS)}")
    extension = extension_of(path)
    for known in FORMATS:
        if extension in known.extensions:
            return known
    usual = ", ".join(known.extensions[0] for known in FORMATS)
    raise OutputError(f"{path} has no extension that names a format; choose from {usual}")


def extension_of(path: str | PathLike[str]) -> str:
    """Return the extension of a file name, in lower case; of a compressed file, both parts."""
    name = PurePath(path)
    last = name.suffix.lower()
    return PurePath(name.stem).suffix.lower() + last if last == COMPRESSED else last
