"""Scene: any raster that rasterio opens, as arrays of chosen bands and their validity."""

from __future__ import annotations

import math
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import rasterio
from affine import Affine
from numpy.typing import NDArray
from rasterio.errors import NotGeoreferencedWarning, RasterioError

from geomesh.bands import (
    Band,
    alpha_index,
    described_color,
    find_rgb,
    palette,
)
from geomesh.errors import EmptyError, SourceError, one_line
from geomesh.grid import Grid, Window
from geomesh.tiles import plan_tiles

Pixels = tuple[NDArray[Any], NDArray[np.bool_]]

_OVERVIEW_SIZE = 1024


class Reader(Protocol):
    """What a scene is read through: one opened handle, for one thread."""

    def read(self, window: Window, shape: tuple[int, int] | None = None) -> Pixels:
        """Return bands (B, h, w) and validity (h, w) of `window`, decimated to `shape`."""


@dataclass(frozen=True, eq=False)
class Scene:
    """A raster, the bands chosen from it and the part of it to work on.

    Made by `geomesh.sources.open_scene`; it holds no open file, so it can be sent to workers.

    Parameters
    ----------
    name : str
        The source as the user gave it, for messages and metadata.
    grid : Grid
        Lattice of `window`.
    window : Window
        The part to work on, in the pixels of the file.
    bands : tuple of Band
        After a palette has become colours.
    dtype : numpy.dtype
    source : path, open dataset or array
    nodata : float or None
        Replaces the file's own nodata value.
    area : shapely geometry or None
        Area of interest in pixel-edge coordinates of the file, on the lattice of nodes:
        so whichever window is read, a pixel is in it or not. Pixels with their centre
        outside are invalid.
    notes : tuple of str
        What the user should know about the georeference.
    """

    name: str
    grid: Grid
    window: Window
    bands: tuple[Band, ...]
    dtype: np.dtype[Any]
    source: Any
    nodata: float | None = None
    area: Any = None
    notes: tuple[str, ...] = ()

    @property
    def rgb(self) -> tuple[int, int, int] | None:
        """Positions in `bands` of red, green and blue: as tagged, or the only three there are."""
        return find_rgb([band.color for band in self.bands]) or (
            (0, 1, 2) if len(self.bands) == 3 else None
        )

    @property
    def display(self) -> tuple[int, int, int]:
        """Positions in `bands` of what to show as red, green and blue.

        As tagged, or as the bands' descriptions say, or the first three, or the first.
        """
        told = find_rgb([described_color(band) for band in self.bands])
        return self.rgb or told or ((0, 1, 2) if len(self.bands) > 2 else (0, 0, 0))

    @contextmanager
    def open(self) -> Iterator[Reader]:
        """Open the source for reading in this thread."""
        if isinstance(self.source, tuple):
            yield _ArrayReader(self)
        elif isinstance(self.source, str):
            with open_dataset(self.source) as dataset:
                yield _DatasetReader(self, dataset)
        else:
            yield _DatasetReader(self, self.source)

    def overview(self, reader: Reader) -> Pixels:
        """Return one decimated read of the whole scene, at most 1024 pixels a side.

        Where decimation meets no valid pixel, the first tile that holds one is
        taken instead.

        Raises
        ------
        EmptyError
            If no pixel of the scene is valid.
        """
        extent = self.grid.extent
        step = max(extent.width, extent.height) / _OVERVIEW_SIZE
        shape = extent.shape
        if step > 1:
            shape = (math.ceil(extent.height / step), math.ceil(extent.width / step))
        bands, valid = reader.read(extent, shape)
        if valid.any():
            return bands, valid
        for tile in plan_tiles(extent) if step > 1 else []:
            bands, valid = reader.read(tile.core)
            if valid.any():
                return bands, valid
        raise EmptyError(
            f"{self.name} has no valid pixel here: all are nodata, masked, not finite or outside "
            "--mask; choose other bands or another area, or override the nodata value with --nodata"
        )

    def crop(self, window: Window, area: Any = None) -> Scene:
        """Return the scene of the part in `window` (pixels of this scene) and in `area`."""
        return replace(
            self,
            grid=self.grid.window(window),
            window=replace(
                window, col=self.window.col + window.col, row=self.window.row + window.row
            ),
            area=area,
        )


@dataclass(frozen=True)
class _ArrayReader:
    scene: Scene

    def read(self, window: Window, shape: tuple[int, int] | None = None) -> Pixels:
        array = self.scene.source[0]
        base = self.scene.window
        absolute = replace(window, col=window.col + base.col, row=window.row + base.row)
        rows, cols = absolute.slices()
        indexes = [band.index - 1 for band in self.scene.bands]
        if shape is None:
            block = array[indexes, rows, cols]
        else:
            sides = zip((rows.start, cols.start), shape, window.shape, strict=True)
            picks = [s + ((np.arange(n) + 0.5) * size / n).astype(int) for s, n, size in sides]
            block = array[np.ix_(indexes, *picks)]
        valid: NDArray[np.bool_] = ~np.any(np.ma.getmaskarray(block), axis=0)
        bands = np.ma.getdata(block)
        return bands, _valid(self.scene, bands, valid, window)


@dataclass(frozen=True)
class _DatasetReader:
    scene: Scene
    dataset: rasterio.DatasetReader

    def read(self, window: Window, shape: tuple[int, int] | None = None) -> Pixels:
        base = self.scene.window
        where = rasterio.windows.Window(
            window.col + base.col, window.row + base.row, window.width, window.height
        )
        out = {"window": where, "out_shape": shape or window.shape}
        dataset = self.dataset
        try:
            colors = palette(dataset)
            indexes = [1] if colors is not None else [band.index for band in self.scene.bands]
            bands = dataset.read(indexes, **out)
            if self.scene.nodata is None:
                valid = dataset.read_masks(indexes, **out).all(axis=0)
            else:
                valid = np.ones(bands.shape[1:], bool)
            alpha = alpha_index(dataset)
            if alpha is not None:
                valid &= dataset.read(alpha, **out) > 0
        except RasterioError as error:
            raise SourceError(
                f"{self.scene.name}: cannot read columns {where.col_off} to "
                f"{where.col_off + where.width}, rows {where.row_off} to "
                f"{where.row_off + where.height}: the file is truncated or damaged; "
                f"fetch or export it again (GDAL: {one_line(error)})"
            ) from error
        if colors is not None:
            entries = colors[np.clip(bands[0], 0, len(colors) - 1)]
            valid &= entries[..., 3] > 0
            wanted = [{"red": 0, "green": 1, "blue": 2}[str(b.color)] for b in self.scene.bands]
            bands = np.ascontiguousarray(np.moveaxis(entries[..., wanted], -1, 0))
        return bands, _valid(self.scene, bands, valid, window)


def _holds(dtype: np.dtype[Any], value: float) -> bool:
    """Tell whether a pixel of this type can have the value at all."""
    if dtype.kind == "f":
        return True
    limits = np.iinfo(dtype)
    return value.is_integer() and limits.min <= value <= limits.max


def _valid(
    scene: Scene, bands: NDArray[Any], valid: NDArray[np.bool_], window: Window
) -> NDArray[np.bool_]:
    """Narrow `valid` by the nodata override, non-finite values and the area of interest."""
    if scene.nodata is not None and _holds(bands.dtype, scene.nodata):
        with np.errstate(over="ignore"):
            valid &= (bands != np.array(scene.nodata).astype(bands.dtype)).all(axis=0)
    if bands.dtype.kind == "f":
        valid &= np.isfinite(bands).all(axis=0)
    if scene.area is not None:
        from rasterio.features import geometry_mask

        height, width = valid.shape
        col, row = window.col + scene.window.col, window.row + scene.window.row
        to_file = Affine(window.width / width, 0, col, 0, window.height / height, row)
        valid &= geometry_mask([scene.area], valid.shape, to_file, invert=True)
    return valid


@contextmanager
def open_dataset(name: str) -> Iterator[rasterio.DatasetReader]:
    """Open a raster by path or URL; raise SourceError in one line if that fails."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            dataset = rasterio.open(name)
    except (RasterioError, ValueError, TypeError) as error:
        path = Path(name)
        # Not a URL, nor a name for a driver, such as GPKG:file.gpkg:table.
        looks_local = not re.match(r"/vsi|[A-Za-z0-9_+.-]{2,}:", name)
        if looks_local and not path.exists():
            reason = "no such file; check the path"
        elif looks_local and path.is_dir():
            reason = "is a folder; name the raster files in it"
        else:
            reason = f"is not a raster that GDAL can open ({one_line(error)})"
        raise SourceError(f"{name}: {reason}") from error
    with dataset:
        yield dataset
