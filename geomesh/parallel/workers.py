"""The workers: threads of this process, or any executor, such as that of a Dask cluster.

Threads are the default. The slow steps (GDAL, OpenCV, compiled loops) run without the
interpreter lock, so threads are as fast as processes, and no data is copied.
"""

from __future__ import annotations

import threading
from collections import deque
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, TypeVar
from uuid import uuid4

from geomesh.errors import GeomeshError, WorkerError, one_line
from geomesh.parallel.cores import available_cores
from geomesh.raster.gdal import cache_size, set_cache_size, settings

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping

Task = TypeVar("Task")
Result = TypeVar("Result")

# Pending tasks per worker: one that it works on, and one more so that it never waits.
_PENDING_PER_WORKER = 2


@dataclass(frozen=True)
class Workers:
    """The executors that process the tiles of a scene.

    Parameters
    ----------
    tiles : Executor
        For tasks that can run in any process. Tasks and results can be pickled.
    size : int
        Number of tasks that `tiles` runs at the same time.
    local : Executor
        Threads of this process, for tasks that must stay here, such as writing a file.
    """

    tiles: Executor
    size: int
    local: Executor

    @property
    def shares_memory(self) -> bool:
        """Whether tasks use the objects of this process, not copies of them."""
        return isinstance(self.tiles, ThreadPoolExecutor)

    def map(self, function: Callable[[Task], Result], tasks: Iterable[Task]) -> Iterator[Result]:
        """Yield ``function(task)`` for each task, in their order.

        Only a few tasks are submitted at a time, so that tasks and results need little memory.

        Raises
        ------
        WorkerError
            If a worker was lost.
        """
        options = settings()
        pending: deque[Future[Result]] = deque()
        try:
            for task in tasks:
                if len(pending) >= _PENDING_PER_WORKER * self.size:
                    yield pending.popleft().result()
                call = _RemoteCall(function, task, options, self.shares_memory)
                pending.append(self.tiles.submit(call))
            while pending:
                yield pending.popleft().result()
        except (BrokenExecutor, CancelledError) as error:
            raise _lost(error) from error
        except Exception as error:
            # Convert errors of the Dask cluster itself. Errors of a task are raised unchanged.
            if type(error).__module__.partition(".")[0] == "distributed":
                raise _lost(error) from error
            raise
        finally:
            for future in pending:
                future.cancel()


@contextmanager
def open_workers(workers: int | None = None, executor: Executor | None = None) -> Iterator[Workers]:
    """Yield the workers: threads (by default one per core), or those of an executor.

    Parameters
    ----------
    workers : int, optional
        Number of tasks that run at the same time.
    executor : concurrent.futures.Executor, optional
        Used instead of threads. It is not shut down.

    Raises
    ------
    WorkerError
        If `workers` is not a positive whole number.
    """
    if workers is not None and (not isinstance(workers, int) or workers < 1):
        raise WorkerError(f"workers is {workers!r}: expected a whole number, 1 or more")
    # The executors of the standard library have this attribute; others may not.
    size = workers or getattr(executor, "_max_workers", None) or available_cores()
    threads = size if executor is None else available_cores()
    local = ThreadPoolExecutor(threads, thread_name_prefix="geomesh")
    done = False
    try:
        with _process_settings:
            yield Workers(executor or local, size, local)
        done = True
    finally:
        # After an error, do not wait for tasks that still run: their results are not needed.
        local.shutdown(wait=done, cancel_futures=True)


class _ProcessSettings:
    """Keep OpenCV at one thread while any `Workers` of this process are open.

    The tiles already use all cores. With another number of threads, SIFT finds slightly
    different keypoints. So the number is restored only when the last `Workers` are closed.
    Then the size of GDAL's cache, which `settings` changes, is restored too.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._open_count = 0
        self._threads = 0
        self._cache: Any = None

    def __enter__(self) -> None:
        import cv2

        with self._lock:
            if self._open_count == 0:
                self._threads, self._cache = cv2.getNumThreads(), cache_size()
                cv2.setNumThreads(1)
            self._open_count += 1

    def __exit__(self, *_: object) -> None:
        import cv2

        with self._lock:
            self._open_count -= 1
            if self._open_count == 0:
                cv2.setNumThreads(self._threads)
                set_cache_size(self._cache)


_process_settings = _ProcessSettings()


@dataclass(frozen=True, repr=False)
class _RemoteCall(Generic[Task, Result]):
    """A task for a worker, run with the GDAL settings of the caller."""

    function: Callable[[Task], Result]
    task: Task
    gdal_options: Mapping[str, Any]
    shares_memory: bool

    def __call__(self) -> Result:
        import cv2
        from rasterio.env import Env, setenv

        cv2.setNumThreads(1)  # in another process, _ProcessSettings is not active
        with Env():
            # Not as arguments of Env, because Env does not accept credentials.
            setenv(**self.gdal_options)
            try:
                return self.function(self.task)
            except GeomeshError as error:
                if not self.shares_memory:
                    # Errors of GDAL cannot be pickled, so remove them from this one.
                    error.__cause__ = error.__context__ = None
                raise

    @property
    def __name__(self) -> str:
        """Name that Dask shows. Without it Dask would show all fields, even credentials."""
        return type(self.function).__name__.strip("_")

    def __dask_tokenize__(self) -> str:
        """Return a unique token. Without it Dask would hash the pixels to detect equal tasks."""
        return uuid4().hex


def _lost(error: BaseException) -> WorkerError:
    return WorkerError(
        f"a worker was lost ({one_line(error)}), perhaps because memory ran out: a tile needs "
        "about 400 MB; use fewer workers, or give them more memory"
    )
