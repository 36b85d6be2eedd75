"""Peak memory of one triangulation, in a process of its own.

The high-water mark of a child begins with that of its parent (Linux), so this is to
be called before the parent has grown.
"""

from __future__ import annotations

import resource
import subprocess
import sys

from benchmarks import inputs

# Linux counts in kilobytes, macOS in bytes.
_UNIT = 2**20 if sys.platform == "darwin" else 2**10


def peak_megabytes(contender: str, count: int) -> float:
    """Return the megabytes that `contender` takes beyond libraries and input."""
    command = [sys.executable, "-m", "benchmarks.memory", contender, str(count)]
    output = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    return float(output)


def _measure(contender: str, count: int) -> float:
    points = inputs.uniform(count)
    # Both are loaded, so that both start from the same mark.
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
