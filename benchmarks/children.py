"""Run work in child processes and measure time and peak memory.

On Linux, the peak memory of a child starts at that of its parent. So a program that calls
this module should not import large libraries.
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

# Bytes per unit of ru_maxrss: Linux counts in kilobytes, macOS in bytes.
_UNIT = 1 if sys.platform == "darwin" else 2**10

# Seconds between two measurements of a process and its children.
_PAUSE = 0.02


@dataclass(frozen=True)
class Run:
    """The measurements and the output of a child process.

    Attributes
    ----------
    seconds : float
        Wall-clock time from start to exit.
    cpu : float
        CPU seconds of all its threads.
    peak : float
        Peak memory of the child and its own children together, in bytes.
    output : Any
        The JSON that it printed.
    """

    seconds: float
    cpu: float
    peak: float
    output: Any


def run_module(module: str, *arguments: str | Path) -> Run:
    """Run ``python -m module``, which prints JSON or nothing, and wait until it ends."""
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
    output = json.loads(printed) if printed.strip() else None
    peak = max(usage.ru_maxrss * _UNIT, family)
    return Run(seconds, usage.ru_utime + usage.ru_stime, peak, output)


class _Watch:
    """Measures the memory of a process and its children many times per second (Linux)."""

    def __init__(self, pid: int) -> None:
        self._pid = pid
        self._peak = 0
        self._ended = Event()
        self._thread = Thread(target=self._measure)
        self._thread.start()

    def stop(self) -> int:
        """Return the peak memory, in bytes."""
        self._ended.set()
        self._thread.join()
        return self._peak

    def _measure(self) -> None:
        while not self._ended.wait(_PAUSE):
            pids = {self._pid}
            with suppress(OSError):
                for children in Path(f"/proc/{self._pid}/task").glob("*/children"):
                    pids.update(map(int, children.read_text().split()))
            self._peak = max(self._peak, sum(map(_resident, pids)))


def _resident(pid: int) -> int:
    with suppress(OSError):
        return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * resource.getpagesize()
    return 0


def mesh(scene: Path, out: Path, workers: int, *options: str, preset: str = "features") -> Run:
    """Run ``geomesh mesh`` on a scene; the output has the numbers of nodes and triangles."""
    quiet = ("--json", "--progress", "none", "--overwrite", "--preset", preset)
    run = run_module(
        "geomesh", "mesh", scene, "-o", out, "--workers", str(workers), *quiet, *options
    )
    (result,) = run.output["results"]
    return Run(run.seconds, run.cpu, run.peak, result)
