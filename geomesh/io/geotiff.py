"""Create a GeoTIFF with the grid, the data type and the band descriptions of a raster."""

from __future__ import annotations

import logging
import os
from contextlib import contextmanager, suppress
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
from geomesh.raster.nodata import stored_value
from geomesh.raster.pixels import Excerpt

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence
    from os import PathLike

    from geomesh.raster.nodata import Number
    from geomesh.raster.scene import Scene

_EXTENSIONS = (".tif", ".tiff")

# Properties that the file takes from the raster; creation options must not change them.
_FROM_RASTER = frozenset(
    ("driver", "width", "height", "count", "dtype", "crs", "transform", "nodata", "gcps", "rpcs")
)

# Compressions that may change a pixel.
_LOSSY = ("jpeg", "webp", "lerc", "jxl")

# Metadata of each band, in addition to its description: attributes of a rasterio dataset.
_BAND_METADATA = ("colorinterp", "scales", "offsets", "units")
_COLORS = (ColorInterp.red, ColorInterp.green, ColorInterp.blue)

# Bytes that are written after the end of a file and removed again.
_PROBE = 4096

# What is no longer so of scaled values.
_OF_STORED_VALUES = ("scales", "offsets")


def check_geotiff(path: str | PathLike[str], *, overwrite: bool) -> None:
    """Raise OutputError if the file cannot be written; call this before any work is done.

    Raises
    ------
    OutputError
        If `path` is not named as a GeoTIFF, exists (unless `overwrite`), or cannot be written.
    """
    if Path(path).suffix.lower() not in _EXTENSIONS:
        raise OutputError(
            f"{path} is not named as a GeoTIFF; use a name that ends in {' or '.join(_EXTENSIONS)}"
        )
    check_place(Path(path), overwrite=overwrite)


def choose_options(creation: Mapping[str, str]) -> dict[str, Any]:
    """Return creation options as keywords of rasterio.

    Raises
    ------
    OutputError
        If an option is not a creation option but a property of the raster.
    """
    given = {name.lower(): value for name, value in creation.items()}
    for name in sorted(_FROM_RASTER & set(given)):
        raise OutputError(
            f"{name} is not a creation option of GTiff: the file gets it from the raster; "
            "leave it out"
        )
    return given


def is_exact(options: Mapping[str, Any]) -> bool:
    """Return whether a file with these creation options stores every pixel without loss."""
    return not str(options.get("compress")).lower().startswith(_LOSSY)


@dataclass(frozen=True)
class Style:
    """Data type, nodata value and metadata of the bands of a GeoTIFF.

    Parameters
    ----------
    dtype : numpy.dtype
    nodata : int, float or None
        If None, the file has a mask.
    metadata : mapping
        Name of an attribute of a rasterio dataset to its values, one for each band.
    """

    dtype: np.dtype[Any]
    nodata: Number | None
    metadata: Mapping[str, Sequence[Any]]


def find_style(scene: Scene) -> Style:
    """Return the style of the raster of a scene, without what a GeoTIFF cannot store."""
    dtype, nodata = scene.dtype.newbyteorder("="), scene.nodata
    if dtype.kind == "f" and dtype.itemsize not in (4, 8):  # GDAL has only these two sizes
        dtype = np.dtype(np.float32 if dtype.itemsize < 4 else np.float64)
    metadata: dict[str, Sequence[Any]] = {}
    if not isinstance(scene.source, Excerpt):
        with scene.borrow() as dataset:
            if palette(dataset) is not None:
                return Style(dtype, None, {"colorinterp": _COLORS})
            positions = [band.index - 1 for band in scene.bands]
            for name in _BAND_METADATA:
                with suppress(UnicodeDecodeError):  # units in an old encoding
                    metadata[name] = [getattr(dataset, name)[k] for k in positions]
            nodata = dataset.nodatavals[positions[0]] if nodata is None else nodata
        # A band of data must not become a mask when the file is read.
        metadata["colorinterp"] = [
            ColorInterp.undefined if color == ColorInterp.alpha else color
            for color in metadata["colorinterp"]
        ]
    if scene.scalings:
        plain = {k: values for k, values in metadata.items() if k not in _OF_STORED_VALUES}
        return Style(dtype, None, plain)
    return Style(dtype, None if nodata is None else stored_value(dtype, nodata), metadata)


@contextmanager
def create_like(
    path: Path, scene: Scene, style: Style, options: Mapping[str, Any]
) -> Iterator[Any]:
    """Yield a new dataset with the grid and the bands of a scene, to write pixels to."""
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
    # Store the mask inside the file, not in a second file.
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True):
        with _refused_options(options):
            dataset = rasterio.open(path, "w", **{**profile, **options})
        with dataset:
            for number, band in enumerate(scene.bands, start=1):
                if band.description is not None:
                    dataset.set_band_description(number, band.description)
            for name, values in style.metadata.items():
                if tuple(values) != getattr(dataset, name):
                    setattr(dataset, name, values)
            yield dataset
    _require_room(path)


def _require_room(path: Path) -> None:
    """Raise OSError if the disk is full.

    GDAL only prints that the last bytes of a file could not be written when it is closed. If
    a few more bytes fit now, they could be written.
    """
    with path.open("r+b") as file:
        size = file.seek(0, os.SEEK_END)
        file.write(bytes(_PROBE))
        file.flush()
        file.truncate(size)


@contextmanager
def _refused_options(options: Mapping[str, Any]) -> Iterator[None]:
    """Raise OutputError for creation options that GDAL refuses, even if it only logs that."""
    messages: list[str] = []
    handler = logging.Handler()
    handler.emit = lambda record: messages.append(record.getMessage())  # type: ignore[method-assign]
    log = logging.getLogger("rasterio")
    log.addHandler(handler)
    try:
        yield
    except (RasterioError, ValueError, TypeError) as error:
        raise OutputError(
            f"the creation options cannot be used together: {one_line(error)}; change them"
        ) from error
    finally:
        log.removeHandler(handler)
    for name in options:
        for message in messages:
            if name in message.lower():
                why = message.partition(" in ")[2] or message  # drop GDAL's error code
                raise OutputError(f"creation option {name} is refused by GDAL: {why}")
