"""Peak memory of one triangulation, measured in a separate process.

On Linux, the peak memory of a child starts at that of its parent. So call this before the
parent uses much memory.
"""

from __future__ import annotations

import resource
import subprocess
import sys

from benchmarks import inputs

# Bytes per unit of ru_maxrss: Linux counts in kilobytes, macOS in bytes.
_UNIT = 1 if sys.platform == "darwin" else 2**10


def peak_megabytes(contender: str, count: int) -> float:
    """Return the megabytes that `contender` needs in addition to libraries and input."""
    command = [sys.executable, "-m", "benchmarks.memory", contender, str(count)]
    output = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return float(output)


def _measure(contender: str, count: int) -> float:
    points = inputs.uniform(count)
    # Import both libraries, so that both measurements start from the same memory.
    from scipy.spatial import Delaunay

    from geomesh.delaunay.triangulate import delaunay

    triangulate = {"geomesh": delaunay, "scipy": Delaunay}[contender]
    triangulate(points[:100])
    before = _high_water()
    kept = triangulate(points)
    grown = _high_water() - before
    del kept
    return grown


def _high_water() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * _UNIT / 1e6


if __name__ == "__main__":
    print(_measure(sys.argv[1], int(sys.argv[2])))
