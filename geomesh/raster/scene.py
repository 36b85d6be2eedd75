"""Scene: a raster of any source, read in windows as chosen bands and a mask of valid pixels."""

from __future__ import annotations

from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any
from uuid import uuid4

import numpy as np

from geomesh.errors import SourceError, one_line
from geomesh.raster.bands import Band, described_color, find_rgb, palette
from geomesh.raster.file_set import find_culprit
from geomesh.raster.gdal import (
    CACHE_BYTES,
    GDAL_ERRORS,
    BorrowedDataset,
    close_handles,
    handles,
)
from geomesh.raster.paths import is_remote
from geomesh.raster.pixels import Excerpt, Pixels, convert, read_stored

if TYPE_CHECKING:
    from collections.abc import Iterator

    import rasterio
    from numpy.typing import NDArray

    from geomesh.parameters import Alpha
    from geomesh.raster.grid import Grid, Window
    from geomesh.raster.nodata import Number
    from geomesh.raster.pixel_mask import PixelMask
    from geomesh.raster.scaling import Scaling


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
        Of the pixels that `read` returns.
    source : str, BorrowedDataset or Excerpt
        The absolute path or URL of a file, the caller's open dataset, or an array.
    size : (int, int)
        Width and height of the whole raster.
    nodata : int, float or None
        Used instead of the file's own nodata value. It is a stored value, before `scalings`.
    alpha : {"mask", "data"}
        "data": bands tagged as alpha are ordinary bands, and masks hide no pixels.
    unscale : bool
        Whether scale and offset were to be applied.
    scalings : tuple of (float, float)
        Scale and offset to apply to each band; empty for the stored values.
    side_files : bool
        Whether GDAL may read metadata from side files (.aux.xml).
    area : PixelMask or None
        Area of interest. Pixels outside are invalid.
    class_band : (Band, numpy.dtype) or None
        The band of a palette, whose values are classes; `classes` returns a scene of it.
    notes : tuple of str
        Notes about the georeference and the values, for the user.
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
    nodata: Number | None = None
    alpha: Alpha = "mask"
    unscale: bool = False
    scalings: tuple[Scaling, ...] = ()
    side_files: bool = True
    area: PixelMask | None = None
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
            indexes = [band.index - 1 for band in self.bands]
            stored, valid = self.source.read(there, shape, indexes, self.nodata)
            bands, valid = convert(stored, valid, self.dtype, self.scalings)
        else:
            # Decimated windows do not overlap, so threads need not share blocks. But if the
            # whole scene fits into the cache of one handle, share it: later reads use it too.
            with self.borrow(shared=shape is None or self._fits_cache) as dataset:
                bands, valid = self._read_dataset(dataset, there, shape)
        return bands, self._narrowed(valid, there)

    def borrow(self, *, shared: bool = True) -> AbstractContextManager[rasterio.DatasetReader]:
        """Return a context that yields the rasterio dataset, for one thread at a time."""
        if isinstance(self.source, Excerpt):
            raise TypeError(f"{self.name} is an array, not a dataset")
        if isinstance(self.source, BorrowedDataset):
            return self.source.borrow()
        pool = handles(self.reading, self.source, self.size, side_files=self.side_files)
        return pool.borrow(shared=shared)

    @property
    def _fits_cache(self) -> bool:
        pixels = self.window.width * self.window.height
        return pixels * len(self.bands) * self.dtype.itemsize <= CACHE_BYTES

    def _read_dataset(
        self, dataset: rasterio.DatasetReader, window: Window, shape: tuple[int, int] | None
    ) -> Pixels:
        try:
            colors = palette(dataset, alpha=self.alpha, nodata=self.nodata)
            indexes = [1] if colors is not None else [band.index for band in self.bands]
            stored, valid = read_stored(
                dataset, window, shape, indexes, nodata=self.nodata, alpha=self.alpha
            )
        except IndexError as error:
            raise SourceError(
                f"{self.name} changed while it was read ({one_line(error)}); start again when the "
                "file is complete"
            ) from error
        except GDAL_ERRORS as error:
            reason = "the file is truncated or damaged; download or export it again"
            if isinstance(self.source, str) and is_remote(self.source):
                reason = "the file is damaged or the transfer failed; try again, or download it"
            elif isinstance(self.source, str):
                reason = find_culprit(self.source, one_line(error)) or reason
            raise SourceError(
                f"{self.name}: cannot read columns {window.col} to {window.stop_col}, rows "
                f"{window.row} to {window.stop_row}: {reason} (GDAL: {one_line(error)})"
            ) from error
        if colors is not None:
            entries = colors[np.clip(stored[0], 0, len(colors) - 1)]
            valid &= entries[..., 3] > 0
            if self.bands[0].is_class:
                return convert(stored, valid, self.dtype, ())
            wanted = [{"red": 0, "green": 1, "blue": 2}[str(b.color)] for b in self.bands]
            stored = np.ascontiguousarray(np.moveaxis(entries[..., wanted], -1, 0))
        return convert(stored, valid, self.dtype, self.scalings)

    def _narrowed(self, valid: NDArray[np.bool_], window: Window) -> NDArray[np.bool_]:
        """Mark pixels as invalid that are outside the area of interest."""
        if self.area is not None:
            valid &= self.area.read(window, valid.shape)
        return valid

    def excerpt(self, window: Window) -> Scene:
        """Return a scene for a worker that reads only `window`. What is in memory is cut to it."""
        base = self.window
        there = replace(window, col=window.col + base.col, row=window.row + base.row)
        source = self.source.cut(there) if isinstance(self.source, Excerpt) else self.source
        return replace(self, source=source, area=self.area.cut(there) if self.area else None)

    def crop(self, window: Window, area: PixelMask | None = None) -> Scene:
        """Return the part of the scene in `window`, which is in its pixels, and in `area`."""
        return replace(
            self,
            grid=self.grid.window(window),
            window=replace(
                window, col=self.window.col + window.col, row=self.window.row + window.row
            ),
            area=area,
        )
