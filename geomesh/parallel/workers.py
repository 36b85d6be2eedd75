"""Who does the work: threads of this process, or any executor, a Dask cluster's among them.

Threads are the default: the heavy steps (GDAL, OpenCV, compiled loops) run without the
interpreter's lock, so two threads gain what two processes do, and nothing is copied.
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

# So many tasks a worker are under way: one that it does, and one so that it never waits.
_AHEAD = 2


@dataclass(frozen=True)
class Workers:
    """Those who work on the tiles of a scene.

    Parameters
    ----------
    tiles : Executor
        Does what can be done anywhere: its tasks and their results can be pickled.
    size : int
        How many tasks it does at a time.
    local : Executor
        Threads of this process, for what has to stay here, such as writing the file.
    """

    tiles: Executor
    size: int
    local: Executor

    @property
    def shares_memory(self) -> bool:
        """Whether tasks see the objects of this process, not copies of them."""
        return isinstance(self.tiles, ThreadPoolExecutor)

    def map(self, function: Callable[[Task], Result], tasks: Iterable[Task]) -> Iterator[Result]:
        """Yield ``function(task)`` for each task, in their order.

        Only a few tasks are under way at a time, so neither they nor their results pile up.

        Raises
        ------
        WorkerError
            If a worker was lost.
        """
        options = settings()
        under_way: deque[Future[Result]] = deque()
        try:
            for task in tasks:
                if len(under_way) >= _AHEAD * self.size:
                    yield under_way.popleft().result()
                errand = _RemoteCall(function, task, options, self.shares_memory)
                under_way.append(self.tiles.submit(errand))
            while under_way:
                yield under_way.popleft().result()
        except (BrokenExecutor, CancelledError) as error:
            raise _lost(error) from error
        except Exception as error:
            # Of what a cluster says of itself; what a task raised comes as it was.
            if type(error).__module__.partition(".")[0] == "distributed":
                raise _lost(error) from error
            raise
        finally:
            for future in under_way:
                future.cancel()


@contextmanager
def open_workers(workers: int | None = None, executor: Executor | None = None) -> Iterator[Workers]:
    """Yield the workers: threads, one a core by default, or those of an executor.

    Parameters
    ----------
    workers : int, optional
        How many work at a time.
    executor : concurrent.futures.Executor, optional
        Takes the place of the threads; it stays open.

    Raises
    ------
    WorkerError
        If `workers` is no positive number.
    """
    if workers is not None and (not isinstance(workers, int) or workers < 1):
        raise WorkerError(f"workers is {workers!r}: expected a whole number, 1 or more")
    # The standard executors know their size; of others nothing can be asked.
    size = workers or getattr(executor, "_max_workers", None) or available_cores()
    threads = size if executor is None else available_cores()
    local = ThreadPoolExecutor(threads, thread_name_prefix="geomesh")
    done = False
    try:
        with _process_kept:
            yield Workers(executor or local, size, local)
        done = True
    finally:
        # After an error nobody waits for what is still running: it is not needed.
        local.shutdown(wait=done, cancel_futures=True)


class _ProcessKept:
    """Keeps OpenCV to one thread for as long as any `Workers` of this process are open.

    The cores are for the tiles; and with another number of threads SIFT finds a few other
    keypoints, so that none may set it free while others are at work. At the end of the
    last one GDAL's cache, which `settings` changes, has its size again, too.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._crews = 0
        self._threads = 0
        self._cache: Any = None

    def __enter__(self) -> None:
        import cv2

        with self._lock:
            if self._crews == 0:
                self._threads, self._cache = cv2.getNumThreads(), cache_size()
                cv2.setNumThreads(1)
            self._crews += 1

    def __exit__(self, *_: object) -> None:
        import cv2

        with self._lock:
            self._crews -= 1
            if self._crews == 0:
                cv2.setNumThreads(self._threads)
                set_cache_size(self._cache)


_process_kept = _ProcessKept()


@dataclass(frozen=True, repr=False)
class _RemoteCall(Generic[Task, Result]):
    """A task to be done elsewhere, under the caller's settings."""

    function: Callable[[Task], Result]
    task: Task
    gdal_options: Mapping[str, Any]
    shares_memory: bool

    def __call__(self) -> Result:
        import cv2
        from rasterio.env import Env, setenv

        cv2.setNumThreads(1)  # elsewhere no `Workers` are open
        with Env():
            # Not as arguments of Env, which refuses credentials among them.
            setenv(**self.gdal_options)
            try:
                return self.function(self.task)
            except GeomeshError as error:
                if not self.shares_memory:
                    # Of GDAL's errors no copy can be made, and so none of what they caused.
                    error.__cause__ = error.__context__ = None
                raise

    @property
    def __name__(self) -> str:
        """What Dask shows; else it would be all that is in here, credentials too."""
        return type(self.function).__name__.strip("_")

    def __dask_tokenize__(self) -> str:
        """Keep Dask from hashing pixels to see whether it had done the same before."""
        return uuid4().hex


def _lost(error: BaseException) -> WorkerError:
    return WorkerError(
        f"a worker was lost ({one_line(error)}), perhaps for want of memory: a tile takes "
        "about 400 MB; use fewer workers, or give them more memory"
    )
