"""Choose the bands of a raster; detect an alpha band and a palette."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from rasterio.enums import ColorInterp

from geomesh.errors import BandError
from geomesh.raster.band_names import BandText, name_bands
from geomesh.raster.band_texts import dataset_texts, read_descriptions, read_units

if TYPE_CHECKING:
    from collections.abc import Sequence

    import rasterio
    from numpy.typing import NDArray

    from geomesh.parameters import Alpha
    from geomesh.raster.nodata import Number

# The gray image of more bands takes minutes, and no table has room for their statistics. A damaged
# header may claim 65535 bands.
_MOST_BANDS = 2000


_COLORS = ("red", "green", "blue")


@dataclass(frozen=True)
class Band:
    """A band of a scene.

    Parameters
    ----------
    index : int
        Number of the band in the file; the first is 1.
    description : str or None
        Description in the file.
    color : {"red", "green", "blue"} or None
        Colour interpretation in the file.
    name : str
        Name of its columns in the tables of a mesh: see `geomesh.raster.band_names`.
    is_class : bool
        Whether its values are classes: those of a palette, not measurements.
    unit : str
        Unit of its values as the file names it; empty if it does not.
    """

    index: int
    description: str | None
    color: str | None
    name: str
    is_class: bool = False
    unit: str = ""


def find_rgb(colors: Sequence[str | None]) -> tuple[int, int, int] | None:
    """Return the positions of "red", "green" and "blue", or None if one is missing."""
    if {"red", "green", "blue"} <= set(colors):
        return colors.index("red"), colors.index("green"), colors.index("blue")
    return None


def described_color(band: Band) -> str | None:
    """Return the colour in the description of a band, as in "B4 red", or None."""
    words = re.findall("[a-z]+", (band.description or "").lower())
    return next((word for word in words if word in _COLORS), None)


def dataset_bands(
    name: str, dataset: rasterio.DatasetReader, bidx: Sequence[int] | None, alpha: Alpha = "mask"
) -> tuple[tuple[Band, ...], np.dtype[Any]]:
    """Return the chosen bands of a dataset and their common data type.

    Default: all bands except alpha, unless alpha is data. A palette becomes three bands of
    colours.

    Raises
    ------
    BandError
        If a band does not exist, is the alpha band, is chosen twice or is not real.
    """
    indexes = _choose(name, bidx, dataset.count, alpha_indexes(dataset, alpha))
    for index in indexes:
        _require_real(name, dataset.dtypes[index - 1], index if dataset.count > 1 else None)
    dtype = common_type([dataset.dtypes[index - 1] for index in indexes])
    if palette(dataset) is not None:
        bands = tuple(Band(1, color, color, color) for color in _COLORS)
        return bands, np.dtype(np.uint8)
    known = _known_bands(dataset)
    return tuple(known[index - 1] for index in indexes), dtype


def class_band(dataset: rasterio.DatasetReader) -> tuple[Band, np.dtype[Any]] | None:
    """Return the band of a palette raster and its data type; None for other rasters."""
    if palette(dataset) is None:
        return None
    return _known_bands(dataset)[0], np.dtype(dataset.dtypes[0])


def _known_bands(dataset: rasterio.DatasetReader) -> list[Band]:
    names = name_bands(dataset_texts(dataset))
    descriptions = read_descriptions(dataset)
    units = read_units(dataset)
    tagged = zip(descriptions, dataset.colorinterp, dataset.dtypes, names, units, strict=True)
    return [
        Band(
            index,
            description,
            color.name if color.name in _COLORS else None,
            name,
            is_class=color == ColorInterp.palette and np.dtype(dtype).kind in "ui",
            unit=unit or "",
        )
        for index, (description, color, dtype, name, unit) in enumerate(tagged, start=1)
    ]


def array_bands(
    name: str,
    dtype: np.dtype[Any],
    descriptions: Sequence[str | None],
    texts: Sequence[BandText],
    bidx: Sequence[int] | None,
    unit: str = "",
) -> tuple[Band, ...]:
    """Return the chosen bands of an array that has one band for each description."""
    _require_real(name, dtype)
    chosen = _choose(name, bidx, len(descriptions), ())
    names = name_bands(texts)
    return tuple(Band(k, descriptions[k - 1], None, names[k - 1], unit=unit) for k in chosen)


def _choose(name: str, bidx: Sequence[int] | None, count: int, alphas: Sequence[int]) -> list[int]:
    if (count if bidx is None else len(bidx)) > _MOST_BANDS:
        raise BandError(
            f"{name} has {count} bands, more than the {_MOST_BANDS} that one mesh can have: choose "
            "some with `bidx`"
        )
    if bidx is None:
        return [index for index in range(1, count + 1) if index not in alphas]
    if not bidx:
        raise BandError(f"no band is chosen: choose from bands 1 to {count} of {name}")
    for index in bidx:
        if not 1 <= index <= count:
            raise BandError(f"band {index} does not exist: {name} has bands 1 to {count}")
        if index in alphas:
            raise BandError(
                f"band {index} of {name} is tagged as alpha, so it is used as a mask: leave it "
                'out, or use it as data with `alpha="data"`'
            )
    if len(set(bidx)) < len(bidx):
        raise BandError(
            f"bands {','.join(map(str, bidx))} of {name} repeat a band: give each band once"
        )
    return list(bidx)


def _require_real(name: str, dtype: np.dtype[Any] | str | None, index: int | None = None) -> None:
    # A text is rasterio's name of the type, which numpy may not know: complex_int16.
    kind = np.dtype(dtype).kind if _is_known(dtype) else str(dtype)[0]
    if kind in "uif":
        return
    step = "take the magnitude or one part" if kind == "c" else "convert them"
    if index is not None:
        name, step = f"band {index} of {name}", f"choose other bands with `bidx`, or {step}"
    raise BandError(
        f"{name} has values of type {dtype}: only real numbers can be meshed; {step} first"
    )


def _is_known(dtype: Any) -> bool:
    try:
        return dtype is not None and np.dtype(dtype) is not None
    except TypeError:
        return False


def common_type(dtypes: Sequence[str]) -> np.dtype[Any]:
    """Return the least type that holds the values of bands of these types.

    For int64 and uint64 together that is float64, which rounds values beyond 2^53.
    """
    return np.result_type(*map(np.dtype, dtypes))


def alpha_indexes(dataset: rasterio.DatasetReader, alpha: Alpha = "mask") -> tuple[int, ...]:
    """Return the 1-based numbers of the bands that are used as alpha.

    Bands that are all tagged as alpha are data: there is nothing that they could mask.
    """
    tagged = tuple(
        index
        for index, color in enumerate(dataset.colorinterp, start=1)
        if color == ColorInterp.alpha
    )
    return tagged if alpha == "mask" and len(tagged) < dataset.count else ()


def palette(
    dataset: rasterio.DatasetReader, *, alpha: Alpha = "mask", nodata: Number | None = None
) -> NDArray[np.uint8] | None:
    """Return the colour table (n, 4) as RGBA of a palette raster of one band, else None.

    No entry is transparent if `alpha` is "data". GDAL makes the entry of the file's own nodata
    value transparent; it is not, if `nodata` replaces that value.
    """
    if dataset.count != 1 or dataset.colorinterp[0] != ColorInterp.palette:
        return None
    if np.dtype(dataset.dtypes[0]).kind not in "ui":  # only whole numbers are classes
        return None
    try:
        entries = dataset.colormap(1)
    except ValueError:  # the band is tagged as a palette, and there is no colour table
        return None
    table = np.zeros((max(entries) + 1, 4), np.uint8)
    for value, rgba in entries.items():
        table[value] = rgba
    if alpha == "data":
        table[:, 3] = 255
    elif nodata is not None and dataset.nodata in entries:
        table[int(dataset.nodata), 3] = 255
    return table
