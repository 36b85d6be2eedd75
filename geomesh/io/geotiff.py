"""A GeoTIFF to write that is like a raster: its pixels, its types, what it says of its bands."""

from __future__ import annotations

import logging
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import rasterio
from rasterio.crs import CRS
from rasterio.enums import ColorInterp
from rasterio.errors import RasterioError

from geomesh.errors import OutputError, one_line
from geomesh.io.atomic import check_place
from geomesh.raster.bands import palette
from geomesh.raster.grid import IDENTITY
from geomesh.raster.scene import Excerpt, Scene, can_hold

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from os import PathLike

_EXTENSIONS = (".tif", ".tiff")

# What the file has as the raster has it: no creation option is to change that.
_SETTLED = frozenset(
    ("driver", "width", "height", "count", "dtype", "crs", "transform", "nodata", "gcps", "rpcs")
)

# Compressions that may change a pixel.
_LOSSY = ("jpeg", "webp", "lerc", "jxl")

# What a raster says of each band, beside its description.
_TOLD = ("colorinterp", "scales", "offsets", "units")
_COLORS = (ColorInterp.red, ColorInterp.green, ColorInterp.blue)


def check_geotiff(path: str | PathLike[str], *, overwrite: bool) -> None:
    """Refuse a file that could not be written; meant to be called before any work.

    Raises
    ------
    OutputError
    """
    if Path(path).suffix.lower() not in _EXTENSIONS:
        raise OutputError(f"{path} is to be a GeoTIFF: name it with {' or '.join(_EXTENSIONS)}")
    check_place(Path(path), overwrite=overwrite)


def choose_options(creation: Mapping[str, str]) -> dict[str, Any]:
    """Return creation options as rasterio takes them.

    Raises
    ------
    OutputError
        For what is none.
    """
    given = {name.lower(): value for name, value in creation.items()}
    for name in sorted(_SETTLED & set(given)):
        raise OutputError(
            f"{name} is no creation option of GTiff: the file has the raster's; leave it out"
        )
    return given


def is_exact(options: Mapping[str, Any]) -> bool:
    """Tell whether a file with these options gives back each pixel as it was written."""
    return not str(options.get("compress")).lower().startswith(_LOSSY)


@dataclass(frozen=True)
class Style:
    """What a GeoTIFF says of its bands.

    Parameters
    ----------
    dtype : numpy.dtype
    nodata : float or None
        Without one the file has a mask.
    told : mapping
        What else, by rasterio's name, a value for each band.
    """

    dtype: np.dtype[Any]
    nodata: float | None
    told: Mapping[str, Sequence[Any]]


def find_style(scene: Scene) -> Style:
    """Return what the raster of a scene says, as far as a GeoTIFF can say the same."""
    dtype, nodata = scene.dtype.newbyteorder("="), scene.nodata
    if dtype.kind == "f" and dtype.itemsize not in (4, 8):  # GDAL has no other
        dtype = np.dtype(np.float32 if dtype.itemsize < 4 else np.float64)
    told: dict[str, Sequence[Any]] = {}
    if not isinstance(scene.source, Excerpt):
        with scene.lend() as dataset:
            if palette(dataset) is not None:
                return Style(dtype, None, {"colorinterp": _COLORS})
            positions = [band.index - 1 for band in scene.bands]
            told = {name: [getattr(dataset, name)[k] for k in positions] for name in _TOLD}
            nodata = dataset.nodatavals[positions[0]] if nodata is None else nodata
    fits = nodata is not None and can_hold(dtype, nodata)
    return Style(dtype, nodata if fits else None, told)


@contextmanager
def create_like(
    path: Path, scene: Scene, style: Style, options: Mapping[str, Any]
) -> Iterator[Any]:
    """Yield the dataset to write to."""
    grid = scene.grid
    profile = {
        "driver": "GTiff",
        "width": grid.width,
        "height": grid.height,
        "count": len(scene.bands),
        "dtype": style.dtype,
        "nodata": style.nodata,
        "crs": None if grid.crs is None else CRS.from_wkt(grid.crs.to_wkt()),
        "transform": None if grid.transform == IDENTITY else grid.transform,
        "tiled": True,
        "bigtiff": "if_safer",
    }
    if "compress" not in options:
        profile |= {"compress": "deflate", "predictor": 3 if style.dtype.kind == "f" else 2}
    # The mask inside the file, not beside it.
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True):
        with _complaints(options):
            dataset = rasterio.open(path, "w", **{**profile, **options})
        with dataset:
            for number, band in enumerate(scene.bands, start=1):
                if band.description is not None:
                    dataset.set_band_description(number, band.description)
            for name, values in style.told.items():
                if tuple(values) != getattr(dataset, name):
                    setattr(dataset, name, values)
            yield dataset


@contextmanager
def _complaints(options: Mapping[str, Any]) -> Iterator[None]:
    """Raise OutputError for creation options that GDAL would only log a complaint about."""
    found: list[str] = []
    handler = logging.Handler()
    handler.emit = lambda record: found.append(record.getMessage())  # type: ignore[method-assign]
    log = logging.getLogger("rasterio")
    log.addHandler(handler)
    try:
        yield
    except (RasterioError, ValueError, TypeError) as error:
        raise OutputError(f"the creation options do not go together: {one_line(error)}") from error
    finally:
        log.removeHandler(handler)
    for name in options:
        for complaint in found:
            if name in complaint.lower():
                why = complaint.partition(" in ")[2] or complaint  # GDAL's own code comes first
                raise OutputError(f"creation option {name} is refused by GDAL: {why}")
