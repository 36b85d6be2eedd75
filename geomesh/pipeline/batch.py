"""Many rasters, one mesh file each: small ones side by side, large ones on all workers.

A raster of one tile gives work to one worker only. So processes mesh the small ones of a batch
at the same time; whatever is larger comes back, and is meshed on all workers. Results come in
the order of the jobs.
"""

from __future__ import annotations

import pickle
import threading
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

# So many jobs a process are under way: one that it does, and some so that it never waits.
_AHEAD = 3

# Seconds between looks at how far a process is.
LOOK = 0.1

# A process writes each layer of a GeoPackage, as far as there are cores.
_MOST_LAYERS = 3


@dataclass(frozen=True)
class Outcome:
    """What became of a job in a process: nothing at all if the raster is too large for it.

    Parameters
    ----------
    summary : MeshSummary, optional
    error : GeomeshError or MemoryError, optional
    crash : (str, str), optional
        Kind and text of any other error: those of libraries often cannot be sent.
    warnings : tuple of str
    """

    summary: MeshSummary | None = None
    error: Exception | None = None
    crash: tuple[str, str] | None = None
    warnings: tuple[str, ...] = ()

    def get(self) -> MeshSummary | None:
        """Return the summary, or raise what went wrong; warn in any case."""
        for warning in self.warnings:
            warnings.warn(warning, GeomeshWarning, stacklevel=3)
        if self.error is not None:
            raise self.error
        if self.crash is not None:
            kind, text = self.crash
            raise type(kind, (RuntimeError,), {})(text)
        return self.summary


@dataclass
class _Ticket:
    """A job under way in a process, and how far it is."""

    latest: tuple[float, str] | None = None
    future: Future[Outcome] = field(default_factory=Future)


class Batch:
    """Meshes jobs in their order: see `open_batch`."""

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
        self._whole: tuple[Workers, WriterPool] | None = None
        self._pool = pool
        self._waiting = deque(jobs)
        self._has_mask = any(job.reading.get("mask") is not None for job in jobs)
        self._tickets: deque[_Ticket] = deque()
        self._threads = ThreadPoolExecutor(pool.count if pool else 1, "geomesh-batch")
        self._first = threading.Event()

    def mesh(self, job: MeshJob, progress: Progress) -> MeshSummary:
        """Return what was made of the next job, which has to be `job`; raise what went wrong."""
        if self._pool is None:
            return self._mesh_here(job, progress)
        ticket = self._next_ticket()
        while not ticket.future.done():
            wait([ticket.future], timeout=LOOK)
            if ticket.latest is not None:
                progress(*ticket.latest)
        self._first.set()
        summary = ticket.future.result().get()
        if summary is None:
            return self._mesh_here(job, progress)
        progress(1.0, "Written")
        return summary

    def _next_ticket(self) -> _Ticket:
        assert self._pool is not None
        # The first job goes alone: it compiles what is not compiled yet, for all.
        room = _AHEAD * self._pool.count if self._first.is_set() else 1
        while self._waiting and len(self._tickets) < room:
            ticket, job = _Ticket(), self._waiting.popleft()
            ticket.future = self._threads.submit(_run, self._pool, job, ticket)
            self._tickets.append(ticket)
        return self._tickets.popleft()

    def _mesh_here(self, job: MeshJob, progress: Progress) -> MeshSummary:
        from geomesh.pipeline.mesh_file import mesh_file

        return mesh_file(job, *self.open(), progress)

    def open(self) -> tuple[Workers, WriterPool]:
        """Return all workers, and the processes that write, opened when first asked for."""
        if self._whole is None:
            from geomesh.io.gdal_process import WriterPool, load_pyogrio
            from geomesh.parallel.background import in_background

            if not self._has_mask:  # reading it imports geopandas, perhaps at the same time
                in_background(load_pyogrio)
            workers = self._stack.enter_context(self._open_workers())
            self._whole = workers, self._stack.enter_context(WriterPool(self._writers))
        return self._whole

    def stop(self, folders: Sequence[Any]) -> None:
        """End what is still under way, and remove what it has left unfinished."""
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
    """Yield the batch whose `mesh` is to be called for each job, in their order.

    Parameters
    ----------
    jobs : sequence of MeshJob
    open_workers : callable
        Opens the workers on which a large raster is meshed; called when one comes.
    size : int
        How many processes mesh small rasters, and most that write the layers of a large one.
    side_by_side : bool
        Whether small rasters may be meshed by processes: they open sources by name.
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


def _run(pool: ProcessPool, job: MeshJob, ticket: _Ticket) -> Outcome:
    """Have a job done by a process."""
    try:
        with pool.borrow() as process:
            pickle.dump(job, process.requests)
            process.requests.flush()
            while isinstance(answer := pickle.load(process.answers), tuple):
                ticket.latest = answer
            return answer  # type: ignore[no-any-return]
    except (OSError, EOFError, pickle.PickleError) as error:
        return Outcome(
            error=WorkerError(
                f"{job.source}: the process that meshed it was lost ({one_line(error)}), perhaps "
                "for want of memory; use fewer workers"
            )
        )
