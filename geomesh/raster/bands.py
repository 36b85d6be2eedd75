"""Choose the bands of a raster; detect an alpha band and a palette."""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from rasterio.enums import ColorInterp

from geomesh.errors import BandError

if TYPE_CHECKING:
    from collections.abc import Sequence

    import rasterio
    from numpy.typing import NDArray

    from geomesh.parameters import Alpha
    from geomesh.raster.nodata import Number


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
    """

    index: int
    description: str | None
    color: str | None


def find_rgb(colors: Sequence[str | None]) -> tuple[int, int, int] | None:
    """Return the positions of "red", "green" and "blue", or None if one is missing."""
    if {"red", "green", "blue"} <= set(colors):
        return colors.index("red"), colors.index("green"), colors.index("blue")
    return None


def described_color(band: Band) -> str | None:
    """Return the colour in the description of a band, as in "B4 red", or None."""
    words = re.findall("[a-z]+", (band.description or "").lower())
    return next((word for word in words if word in ("red", "green", "blue")), None)


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
        bands = tuple(Band(1, color, color) for color in ("red", "green", "blue"))
        return bands, np.dtype(np.uint8)
    colors = {c: c.name for c in (ColorInterp.red, ColorInterp.green, ColorInterp.blue)}
    tagged = zip(dataset.descriptions, map(colors.get, dataset.colorinterp), strict=True)
    known = [Band(index, *tags) for index, tags in enumerate(tagged, start=1)]
    return tuple(known[index - 1] for index in indexes), dtype


def array_bands(
    name: str,
    dtype: np.dtype[Any],
    descriptions: Sequence[str | None],
    bidx: Sequence[int] | None,
) -> tuple[Band, ...]:
    """Return the chosen bands of an array that has one band for each description."""
    _require_real(name, dtype)
    chosen = _choose(name, bidx, len(descriptions), ())
    return tuple(Band(index, descriptions[index - 1], None) for index in chosen)


def _choose(name: str, bidx: Sequence[int] | None, count: int, alphas: Sequence[int]) -> list[int]:
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
    entries = dataset.colormap(1)
    table = np.zeros((max(entries) + 1, 4), np.uint8)
    for value, rgba in entries.items():
        table[value] = rgba
    if alpha == "data":
        table[:, 3] = 255
    elif nodata is not None and dataset.nodata in entries:
        table[int(dataset.nodata), 3] = 255
    return table
