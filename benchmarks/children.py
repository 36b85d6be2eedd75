"""Work in processes of their own: how long it took, and the most memory it held.

The high-water mark of a child begins with that of its parent (Linux), so whoever calls
this imports nothing heavy.
"""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from threading import Event, Thread
from time import perf_counter
from typing import Any

# Linux counts in kilobytes, macOS in bytes.
_UNIT = 1 if sys.platform == "darwin" else 2**10

# Seconds between looks at a family of processes.
_PAUSE = 0.02


@dataclass(frozen=True)
class Run:
    """What came of a child.

    Attributes
    ----------
    seconds : float
        By the clock, from start to exit.
    cpu : float
        Seconds that its threads computed, together.
    peak : float
        The most memory that it and its own children held, in bytes.
    told : Any
        The JSON that it printed.
    """

    seconds: float
    cpu: float
    peak: float
    told: Any


def run_module(module: str, *arguments: str | Path) -> Run:
    """Run ``python -m module``, which prints JSON or nothing, to its end."""
    start = perf_counter()
    command = [sys.executable, "-m", module, *map(str, arguments)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as child:
        assert child.stdout is not None
        watch = _Watch(child.pid)
        printed = child.stdout.read()
        _, status, usage = os.wait4(child.pid, 0)
        seconds = perf_counter() - start
        child.returncode = os.waitstatus_to_exitcode(status)
    family = watch.stop()
    if child.returncode:
        raise SystemExit(f"{' '.join(command)} failed ({child.returncode})")
    told = json.loads(printed) if printed.strip() else None
    peak = max(usage.ru_maxrss * _UNIT, family)
    return Run(seconds, usage.ru_utime + usage.ru_stime, peak, told)


class _Watch:
    """Looks, many times a second, at what a process and its children hold together (Linux)."""

    def __init__(self, pid: int) -> None:
        self._pid = pid
        self._most = 0
        self._ended = Event()
        self._thread = Thread(target=self._look)
        self._thread.start()

    def stop(self) -> int:
        """Return the most memory seen, in bytes."""
        self._ended.set()
        self._thread.join()
        return self._most

    def _look(self) -> None:
        while not self._ended.wait(_PAUSE):
            pids = {self._pid}
            with suppress(OSError):
                for children in Path(f"/proc/{self._pid}/task").glob("*/children"):
                    pids.update(map(int, children.read_text().split()))
            self._most = max(self._most, sum(map(_resident, pids)))


def _resident(pid: int) -> int:
    with suppress(OSError):
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * resource.getpagesize()
    return 0


def mesh(scene: Path, out: Path, workers: int, *options: str) -> Run:
    """Run ``geomesh mesh`` on a scene; what it told is its nodes and triangles."""
    quiet = ("--json", "--progress", "none", "--overwrite")
    run = run_module(
        "geomesh", "mesh", scene, "-o", out, "--workers", str(workers), *quiet, *options
    )
    (result,) = run.told["results"]
    return Run(run.seconds, run.cpu, run.peak, result)
