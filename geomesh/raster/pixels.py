"""Read windows of a dataset or an array: the stored values, and which of them are valid."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np
from rasterio.enums import MaskFlags
from rasterio.errors import RasterioIOError
from rasterio.windows import Window as RasterioWindow

from geomesh.raster.bands import alpha_indexes
from geomesh.raster.nodata import Number, is_nodata
from geomesh.raster.scaling import Scaling, apply_scalings

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    import rasterio
    from numpy.typing import NDArray

    from geomesh.parameters import Alpha
    from geomesh.raster.grid import Window

# Bands (B, h, w) and the mask of valid pixels (h, w).
Pixels = tuple["NDArray[Any]", "NDArray[np.bool_]"]

# Bands (B, h, w), or one (h, w) for each band if their data types differ.
Stored: TypeAlias = "NDArray[Any] | Sequence[NDArray[Any]]"

# Floats are exact integers up to here.
_FIRST_ROUNDED = 2**53

# Pixels that one call of GDAL reads when they are decimated: fewer than those of a tile.
_MOST_PIXELS = 1 << 20


# To recognise pixels that were not read. Any type can hold them.
_UNLIKELY = (101, 58)


@dataclass(frozen=True, eq=False)
class Excerpt:
    """A part of a raster as an array in memory, or as a lazy array.

    Parameters
    ----------
    array : (B, h, w), which may be masked
        All bands of `window`: a numpy array, or one that converts to numpy when it is read.
    window : Window
    """

    array: Any
    window: Window

    def __reduce__(self) -> tuple[Any, ...]:
        # Pickle the pixels, not a lazy array: another process need not compute them.
        return Excerpt, (np.asanyarray(self.array), self.window)

    def read(
        self,
        window: Window,
        shape: tuple[int, int] | None,
        indexes: Sequence[int],
        nodata: Number | None,
    ) -> Pixels:
        """Return the bands at `indexes` and the mask of valid pixels in `window`.

        `shape` (rows, columns) decimates them; None keeps all pixels.
        """
        rows, cols = window.slices(self.window)
        if shape is not None:
            rows, cols = _thin(rows, shape[0]), _thin(cols, shape[1])
        # In the order of a file: compiled code takes no other.
        block = np.asanyarray(self.array[indexes, rows, cols], order="C")
        stored, valid = np.ma.getdata(block), ~np.any(np.ma.getmaskarray(block), axis=0)
        _exclude(valid, stored, [nodata] * len(stored))
        return stored, valid

    def cut(self, window: Window) -> Excerpt:
        """Return the part in `window`. No pixel is copied."""
        return Excerpt(self.array[:, *window.slices(self.window)], window)


def read_stored(
    dataset: rasterio.DatasetReader,
    window: Window,
    shape: tuple[int, int] | None,
    indexes: Sequence[int],
    *,
    nodata: Number | None,
    alpha: Alpha,
) -> tuple[Stored, NDArray[np.bool_]]:
    """Return bands of a dataset as they are stored, and which pixels the dataset calls valid.

    Parameters
    ----------
    dataset : open rasterio dataset
    window : Window
    shape : (int, int) or None
        Rows and columns to decimate to.
    indexes : sequence of int
        1-based bands.
    nodata : int, float or None
        Replaces the nodata values of the bands, but neither a mask nor alpha.
    alpha : {"mask", "data"}
        "data": neither bands tagged as alpha nor masks hide pixels.

    Returns
    -------
    stored : (B, h, w), or one (h, w) for each band if their data types differ
    valid : bool (h, w)

    Raises
    ------
    IndexError
        If the dataset has fewer bands: it is no longer the one that was opened first.
    """
    # Each of these looks at all bands: with hundreds of them, once is enough.
    dtypes, nodatavals, flags = dataset.dtypes, dataset.nodatavals, dataset.mask_flag_enums

    def read(method: Callable[..., NDArray[Any]], bands: Any) -> NDArray[Any]:
        first = bands if isinstance(bands, int) else bands[0]
        is_mask = method == dataset.read_masks
        dtype = np.dtype(np.uint8 if is_mask else dtypes[first - 1])
        return _read(method, bands, dtype, window, shape, _block_height(dataset))

    if max(indexes) > dataset.count:
        raise IndexError(f"it has no band {max(indexes)}")
    if len({dtypes[index - 1] for index in indexes}) == 1:
        stored: Stored = read(dataset.read, list(indexes))
    else:
        stored = [read(dataset.read, index) for index in indexes]
    valid = np.ones(stored[0].shape, np.bool_)
    own = [nodatavals[index - 1] for index in indexes]
    if nodata is not None:
        own = [nodata] * len(own)
    for k, index in enumerate(indexes):
        has_own = nodata is None and MaskFlags.nodata in flags[index - 1]
        if has_own and _is_rounded(own[k], stored[k].dtype):
            valid &= read(dataset.read_masks, index) > 0
            own[k] = None
    _exclude(valid, stored, own)
    for index in masked_bands(dataset, indexes, alpha=alpha, nodata=nodata):
        valid &= read(dataset.read_masks, index) > 0
    for index in alpha_indexes(dataset, alpha):
        valid &= read(dataset.read, index) > 0
    return stored, valid


def masked_bands(
    dataset: rasterio.DatasetReader,
    indexes: Sequence[int],
    *,
    alpha: Alpha,
    nodata: Number | None = None,
) -> list[int]:
    """Return the bands among `indexes` whose masks are to be read, besides nodata and alpha.

    These are masks in the file or beside it (.msk), and what GDAL derives from the metadata
    NODATA_VALUES: pixels that have these values in all bands.
    """
    found, of_bands = [], dataset.mask_flag_enums
    for index in indexes:
        flags = set(of_bands[index - 1])
        if flags & {MaskFlags.all_valid, MaskFlags.alpha} or flags == {MaskFlags.nodata}:
            continue
        is_believed = nodata is None if MaskFlags.nodata in flags else alpha == "mask"
        if is_believed:
            found.append(index)
            if MaskFlags.per_dataset in flags:
                break
    return found


def convert(
    stored: Stored,
    valid: NDArray[np.bool_],
    dtype: np.dtype[Any],
    scalings: Sequence[Scaling],
) -> Pixels:
    """Return stored bands in one data type, scaled if wanted; non-finite pixels are invalid.

    Parameters
    ----------
    stored : (B, h, w), or one (h, w) for each band
    valid : bool (h, w)
        Is changed.
    dtype : numpy.dtype
        The common type of the bands, if they are not scaled.
    scalings : sequence of (float, float)
        Scale and offset of each band; empty for the stored values.
    """
    if scalings:
        bands: NDArray[Any] = apply_scalings(stored, scalings)
    elif isinstance(stored, np.ndarray):
        bands = stored
    else:
        bands = np.stack([values.astype(dtype) for values in stored])
    if bands.dtype.kind == "f":
        valid &= np.isfinite(bands).all(axis=0)
    return bands, valid


def _exclude(valid: NDArray[np.bool_], stored: Stored, nodata: Sequence[Number | None]) -> None:
    """Mark pixels as invalid that have the nodata value of their band."""
    for values, value in zip(stored, nodata, strict=True):
        if value is not None:
            valid &= ~is_nodata(values, value)


def _is_rounded(nodata: float | None, dtype: np.dtype[Any]) -> bool:
    """Return whether rasterio cannot tell a nodata value that GDAL has as an integer.

    rasterio returns it as a float, or as None if rounding takes it beyond the limits.
    """
    is_wide = dtype.kind in "iu" and dtype.itemsize == np.int64().itemsize
    return is_wide and (nodata is None or abs(nodata) >= _FIRST_ROUNDED)


def _read(
    method: Callable[..., NDArray[Any]],
    bands: int | Sequence[int],
    dtype: np.dtype[Any],
    window: Window,
    shape: tuple[int, int] | None,
    block_height: int,
) -> NDArray[Any]:
    """Call a method of a dataset that reads `bands` of `window`; decimate to `shape`.

    GDAL could decimate too, but would take the pixels from overviews, of which nobody knows
    how they were made: those of the dataset, of its mask, or of the sources of a VRT.
    """

    def call(row: int, height: int) -> NDArray[Any]:
        there = RasterioWindow(window.col, window.row + row, window.width, height)
        return _filled(partial(method, bands, window=there), (*planes, height, window.width), dtype)

    planes = () if isinstance(bands, int) else (len(bands),)
    if shape is None:
        return call(0, window.height)
    rows, cols = _thin(slice(0, window.height), shape[0]), _thin(slice(0, window.width), shape[1])
    if block_height < rows.step:  # whole blocks lie between the rows: do not decode these
        parts = [call(row, 1)[..., cols].copy() for row in range(window.height)[rows]]
    else:
        step = rows.step * max(_MOST_PIXELS // (window.width * rows.step), 1)
        starts = range(0, rows.step * shape[0], step)
        parts = [
            call(start, min(step, window.height - start))[..., rows.start :: rows.step, cols].copy()
            for start in starts
        ]
    return np.concatenate(parts, axis=-2)[..., : shape[0], :]


def _filled(read: Callable[..., Any], shape: tuple[int, ...], dtype: np.dtype[Any]) -> NDArray[Any]:
    """Return what `read(out=...)` writes; raise RasterioIOError if it stopped in silence.

    rasterio returns normally if GDAL fails without a message, or with one that is not UTF-8.
    The last pixel then still has the value from before, whichever that was.
    """
    for value in _UNLIKELY:
        out = np.full(shape, value, dtype)
        read(out=out)
        if not (out[..., -1, -1] == np.array(value).astype(dtype)).any():
            return out
    raise RasterioIOError("no pixels, and no reason that can be shown")


def _block_height(dataset: rasterio.DatasetReader) -> int:
    """Return the height of the blocks in which a dataset is stored, in pixels."""
    return max(int(height) for height, _ in dataset.block_shapes)


def _thin(side: slice, count: int) -> slice:
    """Return a slice of `count` pixels of a side: the middle one of every n pixels."""
    step = (side.stop - side.start) // count
    return slice(side.start + step // 2, side.start + step * count, step)
