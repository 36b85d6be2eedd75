"""GDAL's shared state in one place: open datasets, the cache of blocks, settings to carry along."""

from __future__ import annotations

import os
import re
import threading
import warnings
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rasterio
from rasterio.env import get_gdal_config, getenv, hasenv, set_gdal_config
from rasterio.errors import NotGeoreferencedWarning, RasterioError

from geomesh.errors import SourceError, one_line

if TYPE_CHECKING:
    from collections.abc import Iterator

# GDAL's cache of decoded blocks is to hold a scene of some forty megapixels, or of a larger
# one what the next row of tiles reads again; not the share of the machine's memory that it
# would take by default.
_CACHE = "GDAL_CACHEMAX"
CACHE_BYTES = 256_000_000

# One handle on a local file streams so many cores: see Handles.lend.
_CORES_A_HANDLE = 8

# A process that reads one scene after another keeps the handles of the last few.
_MOST_READINGS = 4

_lock = threading.Lock()


def settings() -> dict[str, Any]:
    """Return the settings of the rasterio.Env around the call, which other threads do not see."""
    given = dict(getenv()) if hasenv() else {}
    return given if _CACHE in given or _CACHE in os.environ else {**given, _CACHE: CACHE_BYTES}


def cache_size() -> Any:
    """Return the size of GDAL's cache, which is the whole process's, not one Env's."""
    return get_gdal_config(_CACHE)


def set_cache_size(size: Any) -> None:
    """Set it to what `cache_size` returned."""
    set_gdal_config(_CACHE, size)


class Handles:
    """The handles on one raster in this process.

    Parameters
    ----------
    name : str
        Path or URL.
    size : (int, int)
        Width and height that the raster is known to have.
    """

    def __init__(self, name: str, size: tuple[int, int]) -> None:
        self._name = name
        self._size = size
        self._free: list[rasterio.DatasetReader] = []
        self._closed = False
        readers = max((os.cpu_count() or 1) // _CORES_A_HANDLE, 1)
        self._turns = None if is_remote(name) else threading.Semaphore(readers)

    @contextmanager
    def lend(self, *, shared: bool) -> Iterator[rasterio.DatasetReader]:
        """Yield a handle that no other thread uses meanwhile.

        A handle keeps the blocks that it decoded. So windows whose blocks others need too
        (`shared`) are read through one handle, in turns: decoding is quick, and with a handle
        each, every thread would decode what its neighbours decode. A remote file is waited
        for, not decoded: there each thread has its own.
        """
        with self._turns if self._turns is not None and shared else nullcontext():
            handle = self._take() or self._open()
            try:
                yield handle
            finally:
                with _lock:
                    self._free.append(handle)
                if self._closed:
                    self.close()

    def close(self) -> None:
        """Close the handles; one that is in use, as soon as it is given back."""
        self._closed = True
        while (handle := self._take()) is not None:
            handle.close()

    def _take(self) -> rasterio.DatasetReader | None:
        with _lock:
            return self._free.pop() if self._free else None

    def _open(self) -> rasterio.DatasetReader:
        try:
            handle = open_raster(self._name)
        except SourceError as error:
            raise SourceError(
                f"{error}; it was there when the work began, and each worker needs it in that place"
            ) from error
        if (handle.width, handle.height) != self._size:
            found = f"{handle.width} x {handle.height}"
            handle.close()
            raise SourceError(
                f"{self._name} changed while it was read: it had {self._size[0]} x {self._size[1]} "
                f"pixels and has {found}; start again when it is complete"
            )
        return handle


class BorrowedDataset:
    """A dataset that the caller opened, and may close as soon as it is given back.

    It is one handle, whatever threads want it. A task that nobody waits for any more may
    still want to read: after the end it is refused.

    Parameters
    ----------
    dataset : open rasterio dataset
    """

    # One for all: a dataset may be lent to several meshes.
    _turns = threading.Lock()

    def __init__(self, dataset: Any) -> None:
        self._dataset = dataset
        self._users = 0
        self._ended = False

    @contextmanager
    def lend(self) -> Iterator[Any]:
        """Yield the dataset, which nobody else uses meanwhile."""
        with self._turns:
            if self._ended:
                raise SourceError(f"{self._dataset.name} was given back to its owner")
            yield self._dataset

    @contextmanager
    def used(self) -> Iterator[None]:
        """Give the dataset back at the end of the outermost such block."""
        with self._turns:
            self._users += 1
            self._ended = False
        try:
            yield
        finally:
            with self._turns:
                self._users -= 1
                self._ended = self._users == 0


_readings: dict[str, Handles] = {}


def handles(reading: str, name: str, size: tuple[int, int]) -> Handles:
    """Return this process's handles for one reading of a raster.

    Parameters
    ----------
    reading : str
        Tells one reading from the next, before which the file may be replaced.
    name, size
        As in `Handles`.
    """
    with _lock:
        found = _readings.get(reading)
        if found is None:
            found = _readings[reading] = Handles(name, size)
        oldest = next(iter(_readings)) if len(_readings) > _MOST_READINGS else None
    if oldest is not None:
        close_handles(oldest)
    return found


def close_handles(reading: str) -> None:
    """Close this process's handles for one reading, if it has any."""
    with _lock:
        found = _readings.pop(reading, None)
    if found is not None:
        found.close()


def open_raster(name: str) -> rasterio.DatasetReader:
    """Open a raster by path or URL; raise SourceError in one line if that fails."""
    try:
        with _lock, warnings.catch_warnings():  # filters belong to the process
            warnings.simplefilter("ignore", NotGeoreferencedWarning)
            return rasterio.open(name)
    except (RasterioError, ValueError, TypeError) as error:
        path = Path(name)
        reason = f"is not a raster that GDAL can open ({one_line(error)})"
        if not is_remote(name) and not path.exists():
            reason = "no such file; check the path"
        elif not is_remote(name) and path.is_dir():
            reason = "is a folder; name the raster files in it"
        raise SourceError(f"{name}: {reason}") from error


def is_remote(name: str) -> bool:
    """Tell whether a name is no path: a URL, or one for a driver, such as GPKG:file.gpkg:table."""
    return re.match(r"/vsi|[A-Za-z0-9_+.-]{2,}:", name) is not None
