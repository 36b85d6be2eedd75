"""Side files of GDAL (.aux.xml, .aux) that contradict the raster beside which they lie."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import PurePath
from typing import TYPE_CHECKING, Any

from rasterio.enums import ColorInterp

from geomesh.raster.gdal import open_raster
from geomesh.raster.grid import IDENTITY

if TYPE_CHECKING:
    from collections.abc import Iterator

    import rasterio

_ENDINGS = (".aux.xml", ".aux")

_NODATA_VALUES = "NODATA_VALUES"

_SUBJECTS = {
    "nodatavals": "nodata value",
    "scales": "scale",
    "offsets": "offset",
    "colorinterp": "colour",
}

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
    beside = [name for name in dataset.files if name.lower().endswith(_ENDINGS)]
    if not beside:
        return None
    with open_raster(dataset.name, side_files=False) as plain:
        subjects = tuple(_contradicted(plain, dataset))
    return Contradiction(PurePath(beside[0]).name, subjects) if subjects else None


def _contradicted(own: rasterio.DatasetReader, other: rasterio.DatasetReader) -> Iterator[str]:
    if own.crs and own.crs != other.crs:
        yield f"CRS {_name(other.crs)} instead of {_name(own.crs)}"
    if _place(own) is not None and _place(own) != _place(other):
        yield "another georeference"
    for subject, unsaid in (
        ("nodatavals", (None,)),
        ("scales", (1.0,)),
        ("offsets", (0.0,)),
        ("colorinterp", _UNSAID),
    ):
        for index in range(own.count):
            said, otherwise = (getattr(each, subject)[index] for each in (own, other))
            if said not in unsaid and not _same(said, otherwise):
                yield (
                    f"{_SUBJECTS[subject]} {_name(otherwise)} instead of {_name(said)} of band "
                    f"{index + 1}"
                )
                break
    if _colors(own) is not None and _colors(own) != _colors(other):
        yield "another colour table"
    values = own.tags().get(_NODATA_VALUES)
    if values is not None and values != other.tags().get(_NODATA_VALUES):
        yield f"other {_NODATA_VALUES}"


def _place(dataset: rasterio.DatasetReader) -> Any:
    """Return the georeference without the CRS, or None."""
    if dataset.transform != IDENTITY:
        return dataset.transform
    points, _ = dataset.gcps
    return [(p.col, p.row, p.x, p.y) for p in points] or None


def _colors(dataset: rasterio.DatasetReader) -> Any:
    try:
        return dataset.colormap(1)
    except ValueError:
        return None


def _same(one: Any, other: Any) -> bool:
    both = isinstance(one, float) and isinstance(other, float)
    return one == other or (both and math.isnan(one) and math.isnan(other))


def _name(value: Any) -> str:
    if value is None:
        return "none"
    if isinstance(value, ColorInterp):
        return str(value.name)
    if isinstance(value, int | float):
        return f"{value:.10g}"
    return str(value.to_string())
