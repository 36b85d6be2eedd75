"""`geomesh --version`: geomesh's, and those of what it stands on."""

from __future__ import annotations

import importlib
import platform
from typing import TYPE_CHECKING

import click

from geomesh._version import __version__
from geomesh.errors import one_line

if TYPE_CHECKING:
    from collections.abc import Iterator

# What the libraries bring with them: each its own GDAL and PROJ, of versions that may differ.
_LIBRARIES = {
    "rasterio": {"rasterio": "__version__", "GDAL": "__gdal_version__", "PROJ": "__proj_version__"},
    "pyogrio": {"pyogrio": "__version__", "GDAL": "__gdal_version_string__"},
    "pyproj": {"pyproj": "__version__", "PROJ": "proj_version_str"},
    "shapely": {"shapely": "__version__", "GEOS": "geos_version_string"},
    "cv2": {"OpenCV": "__version__"},
    "numpy": {"numpy": "__version__"},
    "scipy": {"scipy": "__version__"},
    "numba": {"numba": "__version__"},
}


def print_versions(ctx: click.Context, _param: click.Parameter, value: bool) -> None:
    """Print the versions and exit, if asked for."""
    if not value or ctx.resilient_parsing:
        return
    # Programs read the first line; the others are for people, and for reports of defects.
    click.echo(f"geomesh, version {__version__}")
    for line in _libraries():
        click.echo(line)
    ctx.exit()


def _libraries() -> Iterator[str]:
    from importlib.metadata import version

    yield f"Python {platform.python_version()}, {platform.platform()}"
    for name, told in _LIBRARIES.items():
        try:
            library = importlib.import_module(name)
        except Exception as error:  # what is broken is what one wants to know
            yield f"{name} cannot be imported: {one_line(error)}"
        else:
            yield ", ".join(
                f"{what} {getattr(library, where, None)}" for what, where in told.items()
            )
    yield f"pythoncdt {version('pythoncdt')}"
