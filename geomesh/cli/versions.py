"""`geomesh --version`: the versions of geomesh and of the libraries that it uses."""

from __future__ import annotations

import importlib
import platform
from typing import TYPE_CHECKING

from geomesh._version import __version__
from geomesh.cli.streams import echo
from geomesh.errors import one_line

if TYPE_CHECKING:
    from collections.abc import Iterator

    import click

# Each library contains its own GDAL or PROJ, and their versions may differ.
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
    """Print the versions and exit, if the option is given."""
    if not value or ctx.resilient_parsing:
        return
    # Programs read the first line. The other lines are for people and for bug reports.
    echo(f"geomesh, version {__version__}")
    for line in _libraries():
        echo(line)
    ctx.exit()


def _libraries() -> Iterator[str]:
    from importlib.metadata import version

    yield f"Python {platform.python_version()}, {platform.platform()}"
    for name, attributes in _LIBRARIES.items():
        try:
            library = importlib.import_module(name)
        except Exception as error:  # report a broken library, and go on
            yield f"{name} cannot be imported: {one_line(error)}"
        else:
            yield ", ".join(
                f"{label} {getattr(library, attribute, None)}"
                for label, attribute in attributes.items()
            )
    yield f"pythoncdt {version('pythoncdt')}"
