"""The program of a process that meshes small rasters of a batch.

It reads pickled jobs from standard input. For each job it writes to standard output, also
pickled, any number of pairs (fraction, message) and then one Outcome.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
import time
import warnings
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from geomesh.errors import GeomeshError, GeomeshWarning, one_line
from geomesh.pipeline.batch import POLL, Outcome
from geomesh.pipeline.jobs import MeshJob, MeshSummary

if TYPE_CHECKING:
    from geomesh.parallel.progress import Progress
    from geomesh.parallel.workers import Workers


def main() -> None:
    """Mesh jobs one after the other, until standard input ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is handled by the parent process
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    # Only answers may go to standard output: redirect everything else to standard error.
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    from geomesh.io.gdal_process import load_pyogrio
    from geomesh.parallel.memory import keep_freed_memory
    from geomesh.parallel.workers import open_workers

    keep_freed_memory()
    load_pyogrio()
    # Either end of the pipes is closed when the parent process has ended.
    with suppress(EOFError, BrokenPipeError), open_workers(1) as workers:
        while True:
            job = pickle.load(sys.stdin.buffer)
            outcome = _mesh_small(job, workers, _progress_sender(answers))
            pickle.dump(outcome, answers)
            answers.flush()


def _mesh_small(job: MeshJob, workers: Workers, progress: Progress) -> Outcome:
    from geomesh.pipeline.mesh_file import fits_one_worker, mesh_opened, open_job

    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", GeomeshWarning)
        summary, error, crash = None, None, None
        try:
            scene = open_job(job)
            if isinstance(scene, MeshSummary):
                summary = scene
            elif fits_one_worker(scene):
                summary = mesh_opened(job, scene, workers, None, progress)
        except (GeomeshError, MemoryError) as failure:
            error = failure
        except Exception as failure:
            crash = type(failure).__name__, one_line(failure)
    notes = [str(each.message) for each in caught if issubclass(each.category, GeomeshWarning)]
    if summary is None and error is None and crash is None:
        return Outcome()  # too large: the process that meshes the raster will also warn
    return Outcome(summary, error, crash, tuple(notes))


def _progress_sender(answers: Any) -> Progress:
    """Return a callable that sends progress, at most once every `POLL` seconds."""
    last = 0.0

    def send(fraction: float, message: str) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= POLL:
            last = now
            pickle.dump((fraction, message), answers)
            answers.flush()

    return send
