"""Scene: a raster of any source, read in windows as chosen bands and a mask of valid pixels."""

from __future__ import annotations

import math
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any
from uuid import uuid4

import numpy as np
import rasterio
from affine import Affine
from numpy.typing import NDArray
from rasterio.enums import MaskFlags
from rasterio.errors import RasterioError

from geomesh.errors import SourceError, one_line
from geomesh.raster.bands import (
    Band,
    alpha_index,
    described_color,
    find_rgb,
    palette,
)
from geomesh.raster.gdal import CACHE_BYTES, BorrowedDataset, close_handles, handles, is_remote

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from geomesh.raster.grid import Grid, Window

Pixels = tuple[NDArray[Any], NDArray[np.bool_]]


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

    def read(self, window: Window, shape: tuple[int, int] | None, indexes: Sequence[int]) -> Pixels:
        """Return the bands at `indexes` and the mask of valid pixels in `window`.

        `shape` (rows, columns) decimates them; None keeps all pixels.
        """
        rows, cols = window.slices(self.window)
        if shape is not None:
            rows, cols = _thin(rows, shape[0]), _thin(cols, shape[1])
        block = np.asanyarray(self.array[indexes, rows, cols])
        return np.ma.getdata(block), ~np.any(np.ma.getmaskarray(block), axis=0)

    def cut(self, window: Window) -> Excerpt:
        """Return the part in `window`. No pixel is copied."""
        return Excerpt(self.array[:, *window.slices(self.window)], window)


def _thin(side: slice, count: int) -> slice:
    """Return a slice of `count` pixels of a side: the middle one of every n pixels."""
    step = (side.stop - side.start) // count
    return slice(side.start + step // 2, side.start + step * count, step)


@dataclass(frozen=True, eq=False)
class Scene:
    """A raster, the bands chosen from it, and the part of it to process.

    `geomesh.raster.open.open_scene` returns it. It can be sent to workers in other processes,
    because each process opens the file itself.

    Parameters
    ----------
    name : str
        Name of the source in messages and metadata.
    grid : Grid
        Grid of `window`.
    window : Window
        The part to process, in pixels of the file.
    bands : tuple of Band
        The chosen bands. A palette has three: red, green and blue.
    dtype : numpy.dtype
    source : str, BorrowedDataset or Excerpt
        The absolute path or URL of a file, the caller's open dataset, or an array.
    size : (int, int)
        Width and height of the whole raster.
    nodata : float or None
        Used instead of the file's own nodata value.
    area : shapely geometry or None
        Area of interest, in pixel-edge coordinates of the file. Pixels whose centre is
        outside are invalid. Its coordinates are rounded to the lattice of nodes, so that a
        pixel is inside or outside for every window.
    class_band : (Band, numpy.dtype) or None
        The band of a palette, whose values are classes; `classes` returns a scene of it.
    notes : tuple of str
        Notes about the georeference, for the user.
    reading : str
        Unique id of this opening of the raster, the same in every process.
    """

    name: str
    grid: Grid
    window: Window
    bands: tuple[Band, ...]
    dtype: np.dtype[Any]
    source: str | BorrowedDataset | Excerpt
    size: tuple[int, int]
    nodata: float | None = None
    area: Any = None
    class_band: tuple[Band, np.dtype[Any]] | None = None
    notes: tuple[str, ...] = ()
    reading: str = field(default_factory=lambda: uuid4().hex, repr=False)

    @property
    def rgb(self) -> tuple[int, int, int] | None:
        """Positions of red, green and blue in `bands`, or None.

        By colour interpretation; else 0, 1, 2 if there are exactly three bands.
        """
        return find_rgb([band.color for band in self.bands]) or (
            (0, 1, 2) if len(self.bands) == 3 else None
        )

    @property
    def display(self) -> tuple[int, int, int]:
        """Positions in `bands` of the bands to show as red, green and blue.

        As in `rgb`; else by the descriptions of the bands; else the first three bands; else
        the first band.
        """
        described = find_rgb([described_color(band) for band in self.bands])
        return self.rgb or described or ((0, 1, 2) if len(self.bands) > 2 else (0, 0, 0))

    @property
    def classes(self) -> Scene:
        """The scene of the stored classes of a palette; of other rasters, the scene itself."""
        if self.class_band is None:
            return self
        band, dtype = self.class_band
        return replace(self, bands=(band,), dtype=dtype)

    @contextmanager
    def open(self) -> Iterator[Scene]:
        """Close this process's handles on the source when the block ends."""
        try:
            with self.source.used() if isinstance(self.source, BorrowedDataset) else nullcontext():
                yield self
        finally:
            close_handles(self.reading)

    def read(self, window: Window, shape: tuple[int, int] | None = None) -> Pixels:
        """Return the bands (B, h, w) and the mask of valid pixels (h, w) in `window`.

        `shape` (rows, columns) decimates them. Several threads may read at the same time.
        """
        base = self.window
        there = replace(window, col=window.col + base.col, row=window.row + base.row)
        if isinstance(self.source, Excerpt):
            bands, valid = self.source.read(there, shape, [band.index - 1 for band in self.bands])
        else:
            # Decimated windows do not overlap, so threads need not share blocks. But if the
            # whole scene fits into the cache of one handle, share it: later reads use it too.
            with self.borrow(shared=shape is None or self._fits_cache) as dataset:
                bands, valid = self._read_dataset(dataset, there, shape)
        return bands, self._narrowed(bands, valid, there)

    def borrow(self, *, shared: bool = True) -> AbstractContextManager[rasterio.DatasetReader]:
        """Return a context that yields the rasterio dataset, for one thread at a time."""
        if isinstance(self.source, Excerpt):
            raise TypeError(f"{self.name} is an array, not a dataset")
        if isinstance(self.source, BorrowedDataset):
            return self.source.borrow()
        return handles(self.reading, self.source, self.size).borrow(shared=shared)

    @property
    def _fits_cache(self) -> bool:
        pixels = self.window.width * self.window.height
        return pixels * len(self.bands) * self.dtype.itemsize <= CACHE_BYTES

    def _read_dataset(
        self, dataset: rasterio.DatasetReader, window: Window, shape: tuple[int, int] | None
    ) -> Pixels:
        where = rasterio.windows.Window(window.col, window.row, window.width, window.height)
        out = {"window": where, "out_shape": shape or window.shape}
        try:
            colors = palette(dataset)
            indexes = [1] if colors is not None else [band.index for band in self.bands]
            bands = dataset.read(indexes, **out)
            valid = np.ones(bands.shape[1:], np.bool_)
            flags = [dataset.mask_flag_enums[index - 1] for index in indexes]
            if self.nodata is None and any(MaskFlags.all_valid not in each for each in flags):
                valid = dataset.read_masks(indexes, **out).all(axis=0)
            alpha = alpha_index(dataset)
            if alpha is not None:
                valid &= dataset.read(alpha, **out) > 0
        except IndexError as error:
            raise SourceError(
                f"{self.name} changed while it was read ({one_line(error)}); start again when the "
                "file is complete"
            ) from error
        except RasterioError as error:
            reason = "the file is truncated or damaged; download or export it again"
            if isinstance(self.source, str) and is_remote(self.source):
                reason = "the file is damaged or the transfer failed; try again, or download it"
            raise SourceError(
                f"{self.name}: cannot read columns {window.col} to {window.stop_col}, rows "
                f"{window.row} to {window.stop_row}: {reason} (GDAL: {one_line(error)})"
            ) from error
        if colors is not None:
            entries = colors[np.clip(bands[0], 0, len(colors) - 1)]
            valid &= entries[..., 3] > 0
            if not self.bands[0].is_class:
                wanted = [{"red": 0, "green": 1, "blue": 2}[str(b.color)] for b in self.bands]
                bands = np.ascontiguousarray(np.moveaxis(entries[..., wanted], -1, 0))
        return bands, valid

    def _narrowed(
        self, bands: NDArray[Any], valid: NDArray[np.bool_], window: Window
    ) -> NDArray[np.bool_]:
        """Mark pixels as invalid: `nodata` values, not finite, or outside the area of interest."""
        if self.nodata is not None and can_hold(bands.dtype, self.nodata):
            valid &= (bands != np.array(self.nodata).astype(bands.dtype)).all(axis=0)
        if bands.dtype.kind == "f":
            valid &= np.isfinite(bands).all(axis=0)
        if self.area is not None:
            from rasterio.features import geometry_mask

            height, width = valid.shape
            scale = window.width / width, window.height / height
            to_file = Affine(scale[0], 0, window.col, 0, scale[1], window.row)
            valid &= geometry_mask([self.area], valid.shape, to_file, invert=True)
        return valid

    def excerpt(self, window: Window) -> Scene:
        """Return a scene for a worker that reads only `window`. An array is cut to it."""
        if not isinstance(self.source, Excerpt):
            return self
        base = self.window
        there = replace(window, col=window.col + base.col, row=window.row + base.row)
        return replace(self, source=self.source.cut(there))

    def crop(self, window: Window, area: Any = None) -> Scene:
        """Return the part of the scene in `window` and in `area`.

        `window` is in pixels of this scene, `area` in pixel-edge coordinates of the file.
        """
        return replace(
            self,
            grid=self.grid.window(window),
            window=replace(
                window, col=self.window.col + window.col, row=self.window.row + window.row
            ),
            area=area,
        )


def can_hold(dtype: np.dtype[Any], value: float) -> bool:
    """Return whether a pixel of this data type can have the value."""
    if dtype.kind == "f":
        return not math.isfinite(value) or abs(value) <= float(np.finfo(dtype).max)
    limits = np.iinfo(dtype)
    return value.is_integer() and limits.min <= value <= limits.max
