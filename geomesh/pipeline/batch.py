"""Mesh many rasters: small rasters in parallel processes, large rasters on all workers.

A raster of one tile can keep only one worker busy. So several processes mesh the small
rasters of a batch at the same time. A process returns a larger raster without meshing it,
and then the main process meshes it on all workers. Results are in the order of the jobs.
"""

from __future__ import annotations

import pickle
import warnings
from collections import deque
from concurrent.futures import Future, ThreadPoolExecutor, wait
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from geomesh.errors import GeomeshWarning, WorkerError, one_line
from geomesh.io.atomic import remove_leftovers
from geomesh.parallel.processes import Process, ProcessPool

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

    from geomesh.io.gdal_process import WriterPool
    from geomesh.parallel.progress import Progress
    from geomesh.parallel.workers import Workers
    from geomesh.pipeline.jobs import MeshJob, MeshSummary

# Submitted jobs per process: one is running, and the others wait so that it is never idle.
_AHEAD = 3

# Seconds between two progress reports of a process.
POLL = 0.1

# Maximum number of processes that write the layers of a GeoPackage: one per layer.
_MOST_LAYERS = 3


@dataclass(frozen=True)
class Outcome:
    """The result of a job in a process; all fields are empty if the raster is too large.

    Parameters
    ----------
    summary : MeshSummary, optional
    error : GeomeshError or MemoryError, optional
    crash : (str, str), optional
        Class name and text of any other error. Errors of libraries often cannot be pickled.
    warnings : tuple of str
    """

    summary: MeshSummary | None = None
    error: Exception | None = None
    crash: tuple[str, str] | None = None
    warnings: tuple[str, ...] = ()

    def get(self) -> MeshSummary | None:
        """Issue the warnings; then return the summary or raise the error."""
        for warning in self.warnings:
            warnings.warn(warning, GeomeshWarning, stacklevel=3)
        if self.error is not None:
            raise self.error
        if self.crash is not None:
            kind, text = self.crash
            raise type(kind, (RuntimeError,), {})(text)
        return self.summary


@dataclass
class _Task:
    """A submitted job: its latest progress and its future outcome."""

    latest: tuple[float, str] | None = None
    future: Future[Outcome] = field(default_factory=Future)


class Batch:
    """Meshes jobs one after the other, in order: see `open_batch`."""

    def __init__(
        self,
        jobs: Sequence[MeshJob],
        stack: ExitStack,
        open_workers: Callable[[], AbstractContextManager[Workers]],
        writers: int,
        pool: ProcessPool | None,
    ) -> None:
        self._stack = stack
        self._open_workers = open_workers
        self._writers = writers
        self._opened: tuple[Workers, WriterPool] | None = None
        self._pool = pool
        self._waiting = deque(jobs)
        self._tasks: deque[_Task] = deque()
        self._threads = ThreadPoolExecutor(pool.count if pool else 1, "geomesh-batch")

    def mesh(self, job: MeshJob, progress: Progress) -> MeshSummary:
        """Return the summary of the next job, which must be `job`; raise its error, if any."""
        if self._pool is None:
            return self._mesh_here(job, progress)
        task = self._next_task()
        while not task.future.done():
            wait([task.future], timeout=POLL)
            if task.latest is not None:
                progress(*task.latest)
        summary = task.future.result().get()
        if summary is None:
            return self._mesh_here(job, progress)
        progress(1.0, "Written")
        return summary

    def _next_task(self) -> _Task:
        assert self._pool is not None
        while self._waiting and len(self._tasks) < _AHEAD * self._pool.count:
            task, job = _Task(), self._waiting.popleft()
            task.future = self._threads.submit(_run, self._pool, job, task)
            self._tasks.append(task)
        return self._tasks.popleft()

    def _mesh_here(self, job: MeshJob, progress: Progress) -> MeshSummary:
        from geomesh.pipeline.mesh_file import mesh_file

        return mesh_file(job, *self.open(), progress)

    def open(self) -> tuple[Workers, WriterPool]:
        """Return the workers and the writer processes; the first call opens them."""
        if self._opened is None:
            from geomesh.io.gdal_process import WriterPool, load_pyogrio
            from geomesh.parallel.background import in_background

            in_background(load_pyogrio)
            workers = self._stack.enter_context(self._open_workers())
            self._opened = workers, self._stack.enter_context(WriterPool(self._writers))
        return self._opened

    def stop(self, folders: Sequence[Any]) -> None:
        """Stop the running jobs, and remove their temporary files."""
        self._threads.shutdown(wait=False, cancel_futures=True)
        if self._pool is not None:
            for pid in self._pool.stop(Process.terminate):
                for folder in folders:
                    remove_leftovers(folder, pid)


@contextmanager
def open_batch(
    jobs: Sequence[MeshJob],
    open_workers: Callable[[], AbstractContextManager[Workers]],
    size: int,
    *,
    side_by_side: bool,
) -> Iterator[Batch]:
    """Yield a batch; call its `mesh` for each job, in order.

    Parameters
    ----------
    jobs : sequence of MeshJob
    open_workers : callable
        Opens the workers for large rasters; called for the first large raster.
    size : int
        Number of processes that mesh small rasters, and maximum number of processes that
        write the layers of a large raster.
    side_by_side : bool
        Whether processes may mesh small rasters. They can open sources only by name.
    """
    with ExitStack() as stack:
        pool = None
        if side_by_side and min(size, len(jobs)) > 1:
            count = min(size, len(jobs))
            pool = stack.enter_context(ProcessPool("geomesh.pipeline.batch_process", count))
            pool.warm()
        batch = Batch(jobs, stack, open_workers, min(size, _MOST_LAYERS), pool)
        try:
            if pool is None:
                batch.open()
            yield batch
        finally:
            batch.stop(sorted({job.output.parent for job in jobs}))


def _run(pool: ProcessPool, job: MeshJob, task: _Task) -> Outcome:
    """Run a job in a process and return its outcome; update the progress of `task`."""
    try:
        with pool.borrow() as process:
            pickle.dump(job, process.requests)
            process.requests.flush()
            while isinstance(answer := pickle.load(process.answers), tuple):
                task.latest = answer
            return answer  # type: ignore[no-any-return]
    except (OSError, EOFError, pickle.PickleError) as error:
        return Outcome(
            error=WorkerError(
                f"{job.source}: the process that meshed it ended unexpectedly "
                f"({one_line(error)}), perhaps because memory was full; use fewer workers"
            )
        )
