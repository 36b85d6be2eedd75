"""Side files of GDAL (.aux.xml, .aux) that contradict the raster beside which they lie."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

import numpy as np
from pyproj.exceptions import CRSError
from rasterio.enums import ColorInterp

from geomesh.raster.crs import crs_label, same_crs, to_pyproj
from geomesh.raster.gdal import open_raster, opening_error
from geomesh.raster.grid import IDENTITY
from geomesh.raster.nodata import stored_range

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    import rasterio
    from pyproj import CRS

_ENDINGS = (".aux.xml", ".aux")

_NODATA_VALUES = "NODATA_VALUES"

# Largest difference of positions that rounding explains, in pixels.
_TOLERANCE = 1e-3

# Colour interpretations that say nothing: drivers report them for any band.
_UNSAID = (ColorInterp.undefined, ColorInterp.gray)


@dataclass(frozen=True)
class Contradiction:
    """What a side file says otherwise than the file itself.

    Parameters
    ----------
    side_file : str
        Its name, without the folder.
    subjects : tuple of str
        What it contradicts, in words.
    """

    side_file: str
    subjects: tuple[str, ...]

    def __str__(self) -> str:
        return f"{self.side_file} contradicts the file itself ({'; '.join(self.subjects)})"


def find_contradiction(dataset: rasterio.DatasetReader) -> Contradiction | None:
    """Return what the side file of an open dataset says otherwise than the file, or None.

    A side file may add what the file does not say, such as the CRS of a PNG.
    """
    try:
        beside = [name for name in dataset.files if name.lower().endswith(_ENDINGS)]
    except UnicodeDecodeError:  # the name of a file is not UTF-8
        return None
    if not beside:
        return None
    with open_raster(dataset.name, side_files=False) as plain:
        opening_error(plain)
        subjects = tuple(_contradicted(plain, dataset))
    return Contradiction(PurePath(beside[0]).name, subjects) if subjects else None


def _contradicted(own: rasterio.DatasetReader, other: rasterio.DatasetReader) -> Iterator[str]:
    if own.crs:
        said, otherwise = _crs(own), _crs(other)
        if not same_crs(said, otherwise):
            yield f"CRS {crs_label(otherwise)} instead of {crs_label(said)}"
    if not _same_place(own, other):
        yield "another georeference"
    for label, attribute, unsaid, is_same in _OF_BANDS:
        for index, dtype in enumerate(own.dtypes):
            said, otherwise = (getattr(each, attribute)[index] for each in (own, other))
            if said not in unsaid and not is_same(said, otherwise, dtype):
                names = f"{_name(otherwise)} instead of {_name(said)}"
                yield f"{label} {names} of band {index + 1}"
                break
    if own.count and _colors(own) is not None and _colors(own) != _colors(other):
        yield "another colour table"
    values = own.tags().get(_NODATA_VALUES)
    if values is not None and values != other.tags().get(_NODATA_VALUES):
        yield f"other {_NODATA_VALUES}"


def _crs(dataset: rasterio.DatasetReader) -> CRS | None:
    try:
        return to_pyproj(dataset.crs)
    except CRSError:
        return None


def _same_place(own: rasterio.DatasetReader, other: rasterio.DatasetReader) -> bool:
    """Return whether a dataset lies where `own` says, up to rounding, if it says anything."""
    if own.transform == IDENTITY:
        points, others = (
            [(point.col, point.row, point.x, point.y) for point in each.gcps[0]]
            for each in (own, other)
        )
        return not points or (points == others and other.transform == IDENTITY)
    if not own.transform.determinant:
        return bool(own.transform == other.transform)
    to_pixels = ~own.transform * other.transform
    corners = [(x, y) for x in (0, own.width) for y in (0, own.height)]
    return all(math.dist(to_pixels * corner, corner) < _TOLERANCE for corner in corners)


def _same_nodata(one: float, other: float | None, dtype: str) -> bool:
    if other is None or math.isnan(one):
        return other is not None and math.isnan(other)
    return stored_range(np.dtype(dtype), one) == stored_range(np.dtype(dtype), other)


def _same_number(one: float, other: float, _dtype: str) -> bool:
    return math.isclose(one, other, rel_tol=1e-9) or (math.isnan(one) and math.isnan(other))


def _same_color(one: ColorInterp, other: ColorInterp, _dtype: str) -> bool:
    return bool(one == other)


# What is told of each band: in words, the attribute of rasterio, the values of it that say
# nothing, and how two values are compared.
_OF_BANDS: tuple[tuple[str, str, tuple[Any, ...], Callable[..., bool]], ...] = (
    ("nodata value", "nodatavals", (None,), _same_nodata),
    ("scale", "scales", (1.0,), _same_number),
    ("offset", "offsets", (0.0,), _same_number),
    ("colour", "colorinterp", _UNSAID, _same_color),
)


def _colors(dataset: rasterio.DatasetReader) -> Any:
    try:
        return dataset.colormap(1)
    except ValueError:
        return None


def _name(value: Any) -> str:
    if value is None:
        return "none"
    return str(value.name) if isinstance(value, ColorInterp) else f"{value:.10g}"
