"""Work in processes of their own: how long it took, and the most memory it held.

The high-water mark of a child begins with that of its parent (Linux), so whoever calls
this imports nothing heavy.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import Any

# Linux counts in kilobytes, macOS in bytes.
_UNIT = 1 if sys.platform == "darwin" else 2**10


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
        The most memory it held, in bytes.
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
        printed = child.stdout.read()
        _, status, usage = os.wait4(child.pid, 0)
        seconds = perf_counter() - start
        child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        raise SystemExit(f"{' '.join(command)} failed ({child.returncode})")
    told = json.loads(printed) if printed.strip() else None
    return Run(seconds, usage.ru_utime + usage.ru_stime, usage.ru_maxrss * _UNIT, told)


def mesh(scene: Path, out: Path, workers: int, *options: str) -> Run:
    """Run ``geomesh mesh`` on a scene; what it told is its nodes and triangles."""
    quiet = ("--json", "--progress", "none", "--overwrite")
    run = run_module(
        "geomesh", "mesh", scene, "-o", out, "--workers", str(workers), *quiet, *options
    )
    (result,) = run.told["results"]
    return Run(run.seconds, run.cpu, run.peak, result)
