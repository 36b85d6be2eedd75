"""The program of a process that meshes small rasters for a batch.

On standard input it gets jobs, pickled; to each it answers on standard output with any number
of pairs (fraction, message) and one Outcome, pickled too.
"""

from __future__ import annotations

import os
import pickle
import signal
import sys
import time
import warnings
from typing import TYPE_CHECKING, Any

from geomesh.errors import GeomeshError, GeomeshWarning, one_line
from geomesh.pipeline.batch import LOOK, Outcome
from geomesh.pipeline.jobs import MeshJob, MeshSummary

if TYPE_CHECKING:
    from geomesh.parallel.progress import Progress
    from geomesh.parallel.workers import Workers


def main() -> None:
    """Mesh one job after the other, until standard input ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # whoever started it decides
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))
    # Only answers may go where they are read.
    answers = os.fdopen(os.dup(1), "wb")
    os.dup2(2, 1)
    from geomesh.io.gdal_process import load_pyogrio
    from geomesh.parallel.memory import keep_freed_memory
    from geomesh.parallel.workers import open_workers

    keep_freed_memory()
    load_pyogrio()
    with open_workers(1) as workers:
        while True:
            try:
                job = pickle.load(sys.stdin.buffer)
            except EOFError:
                return
            outcome = _mesh_small(job, workers, _teller(answers))
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
    told = [str(each.message) for each in caught if issubclass(each.category, GeomeshWarning)]
    if summary is None and error is None and crash is None:
        return Outcome()  # what is to be told is told where the raster is meshed
    return Outcome(summary, error, crash, tuple(told))


def _teller(answers: Any) -> Progress:
    """Return a callable that sends progress, a few times a second at most."""
    last = 0.0

    def tell(fraction: float, message: str) -> None:
        nonlocal last
        now = time.monotonic()
        if now - last >= LOOK:
            last = now
            pickle.dump((fraction, message), answers)
            answers.flush()

    return tell
