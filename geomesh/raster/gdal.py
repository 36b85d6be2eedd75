"""Shared state of GDAL: open datasets, the block cache, and settings to pass to workers."""

from __future__ import annotations

import os
import threading
import warnings
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rasterio
from rasterio._err import CPLE_BaseError
from rasterio.env import get_gdal_config, getenv, hasenv, set_gdal_config
from rasterio.errors import NotGeoreferencedWarning, RasterioError

from geomesh.errors import SourceError, one_line
from geomesh.raster.file_set import check_source, explain_failure
from geomesh.raster.paths import is_remote

if TYPE_CHECKING:
    from collections.abc import Iterator

# GDAL's cache of decoded blocks has room for a scene of about forty megapixels. Of a larger
# scene it keeps the blocks that the next row of tiles reads again. GDAL's default, a
# percentage of the memory of the machine, would be too large.
_CACHE = "GDAL_CACHEMAX"
CACHE_BYTES = 256_000_000

# Reading a whole PNG at once, GDAL 3.10 takes damaged data for whatever the memory held before.
_STRICT = {"GDAL_PNG_WHOLE_IMAGE_OPTIM": "NO"}

# Never take pixels from overviews, because they may hold anything. A VRT with larger pixels
# than its sources would.
_NO_OVERVIEWS = {"GDAL_OVERVIEW_OVERSAMPLING_THRESHOLD": "0"}
# Without it GDAL drops the datum shift in a GeoTIFF whose datum has a code.
_STRIP_SHIFT = "OSR_STRIP_TOWGS84"

# One handle on a local file is enough for this many cores; see Handles.borrow.
_CORES_A_HANDLE = 8

# A process that reads many scenes keeps the handles of this many openings.
_MOST_READINGS = 4

# What rasterio raises if GDAL fails. Most are RasterioError; some reach us as GDAL raised them,
# and texts that are not UTF-8 do not reach us at all.
GDAL_ERRORS = (RasterioError, CPLE_BaseError, UnicodeDecodeError)

_lock = threading.Lock()


def settings() -> dict[str, Any]:
    """Return the settings of the current rasterio.Env. Other threads do not see that Env."""
    options = {**_STRICT, **(dict(getenv()) if hasenv() else {}), **_NO_OVERVIEWS}
    is_set = _CACHE in options or _CACHE in os.environ
    return options if is_set else {**options, _CACHE: CACHE_BYTES}


def cache_size() -> Any:
    """Return the size of GDAL's cache. It belongs to the whole process, not to one Env."""
    return get_gdal_config(_CACHE)


def set_cache_size(size: Any) -> None:
    """Set the size of GDAL's cache to a value from `cache_size`."""
    set_gdal_config(_CACHE, size)


class Handles:
    """A pool of open handles on one raster, in this process.

    Parameters
    ----------
    name : str
        Path or URL.
    size : (int, int)
        Expected width and height. A raster of another size was changed.
    side_files : bool
        As in `open_raster`.
    """

    def __init__(self, name: str, size: tuple[int, int], *, side_files: bool) -> None:
        self._name = name
        self._size = size
        self._side_files = side_files
        self._free: list[rasterio.DatasetReader] = []
        self._closed = False
        readers = max((os.cpu_count() or 1) // _CORES_A_HANDLE, 1)
        self._access = None if is_remote(name) else threading.Semaphore(readers)

    @contextmanager
    def borrow(self, *, shared: bool) -> Iterator[rasterio.DatasetReader]:
        """Yield a handle that no other thread uses at the same time.

        Each handle has its own decoded blocks. So windows whose blocks other threads need too
        (`shared`) are read through one handle, one thread at a time. Decoding is fast, and with
        one handle per thread, every thread would decode the same blocks again. For a remote
        file the time is spent on waiting, so each thread has its own handle.
        """
        with self._access if self._access is not None and shared else nullcontext():
            handle = self._take() or self._open()
            try:
                yield handle
            finally:
                with _lock:
                    self._free.append(handle)
                if self._closed:
                    self.close()

    def close(self) -> None:
        """Close the handles. A handle in use is closed when it is returned."""
        self._closed = True
        while (handle := self._take()) is not None:
            handle.close()

    def _take(self) -> rasterio.DatasetReader | None:
        with _lock:
            return self._free.pop() if self._free else None

    def _open(self) -> rasterio.DatasetReader:
        try:
            handle = open_raster(self._name, side_files=self._side_files)
            opening_error(handle)
        except SourceError as error:
            raise SourceError(
                f"{error}; it existed when the work began, and each worker needs it at that path"
            ) from error
        if (handle.width, handle.height) != self._size:
            size = f"{handle.width} x {handle.height}"
            handle.close()
            raise SourceError(
                f"{self._name} changed while it was read: it had {self._size[0]} x {self._size[1]} "
                f"pixels and now has {size}; start again when the file is complete"
            )
        return handle


class BorrowedDataset:
    """A dataset that the caller opened. Only one thread reads it at a time.

    The caller may close it when the last `used` block ends. A cancelled task can still try to
    read after that; it then gets an error.

    Parameters
    ----------
    dataset : open rasterio dataset
    """

    # One lock for all instances, because two scenes can use the same dataset.
    _access = threading.Lock()

    def __init__(self, dataset: Any) -> None:
        self._dataset = dataset
        self._users = 0
        self._ended = False

    @contextmanager
    def borrow(self) -> Iterator[Any]:
        """Yield the dataset. No other thread uses it at the same time."""
        with self._access:
            if self._ended:
                raise SourceError(f"{self._dataset.name} cannot be read: its mesh is finished")
            yield self._dataset

    @contextmanager
    def used(self) -> Iterator[None]:
        """Allow `borrow` within the block. Blocks may be nested; after the last it is refused."""
        with self._access:
            self._users += 1
            self._ended = False
        try:
            yield
        finally:
            with self._access:
                self._users -= 1
                self._ended = self._users == 0


_readings: dict[str, Handles] = {}


def handles(reading: str, name: str, size: tuple[int, int], *, side_files: bool) -> Handles:
    """Return this process's handles for one opening of a raster.

    Parameters
    ----------
    reading : str
        Unique id of the opening. A later opening has another id, because the file may have
        been replaced.
    name, size, side_files
        As in `Handles`.
    """
    with _lock:
        pool = _readings.get(reading)
        if pool is None:
            pool = _readings[reading] = Handles(name, size, side_files=side_files)
        oldest = next(iter(_readings)) if len(_readings) > _MOST_READINGS else None
    if oldest is not None:
        close_handles(oldest)
    return pool


def close_handles(reading: str) -> None:
    """Close this process's handles for one opening of a raster, if there are any."""
    with _lock:
        pool = _readings.pop(reading, None)
    if pool is not None:
        pool.close()


def open_raster(name: str, *, side_files: bool = True) -> rasterio.DatasetReader:
    """Open a raster by path or URL. Raise SourceError with one line if that fails.

    `side_files` tells whether GDAL may read metadata from side files (.aux.xml).
    """
    check_source(name)
    without = nullcontext() if side_files else rasterio.Env(GDAL_PAM_ENABLED=False)
    try:
        # Warning filters and GDAL's settings are shared by all threads.
        with _lock, warnings.catch_warnings(), without, _own_shifts():
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            return rasterio.open(name)
    except (*GDAL_ERRORS, ValueError, TypeError) as error:
        path = Path(name)
        reason = f"is not a raster that GDAL can open ({one_line(error)})"
        if not is_remote(name) and not path.exists():
            reason = "no such file; check the path"
        elif (missing := explain_failure(name)) is not None:
            reason = missing
        elif not is_remote(name) and path.is_dir():
            reason = "is a folder; name the raster files in it"
        raise SourceError(f"{name}: {reason}") from error


@contextmanager
def _own_shifts() -> Iterator[None]:
    before = get_gdal_config(_STRIP_SHIFT, normalize=False)
    set_gdal_config(_STRIP_SHIFT, "NO", normalize=False)
    try:
        yield
    finally:
        # "YES" is the default, and there is no public way to unset it.
        set_gdal_config(_STRIP_SHIFT, before or "YES", normalize=False)


def opening_error(dataset: rasterio.DatasetReader) -> str | None:
    """Return the error that GDAL reported about a dataset that it opened nevertheless, or None.

    Call it first: else rasterio raises the error later, in another call of this thread that may
    be about another dataset. Asking for the colours makes GDAL read the georeference too.
    """
    try:
        _ = dataset.colorinterp
    except GDAL_ERRORS as error:
        return one_line(error)
    return None
