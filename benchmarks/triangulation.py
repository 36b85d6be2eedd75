"""Triangulation: compare geomesh.delaunay with Qhull (scipy.spatial)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import ConvexHull, Delaunay

from benchmarks import inputs
from benchmarks.memory import peak_megabytes
from benchmarks.timing import Row, alternate
from geomesh.delaunay.triangulate import constrained_delaunay, delaunay
from geomesh.mesh.topology import boundary_edges

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

EXPECTED = 8.0
PEER = "scipy.spatial.Delaunay"


def memory(*, quick: bool) -> Row:
    """Compare the memory that both need in addition to their input, in separate processes."""
    count = 100_000 if quick else 1_000_000
    ours, theirs = peak_megabytes("geomesh", count), peak_megabytes("scipy", count)
    evidence = "extra peak memory of a new process"
    return Row(f"{count:,} uniform, memory", PEER, [ours], [theirs], None, True, evidence, "MB")


def run(*, quick: bool) -> Iterator[Row]:
    small, large = (10_000, 100_000) if quick else (100_000, 1_000_000)
    expected = None if quick else EXPECTED
    rounds = 3 if quick else 5
    yield _duel(f"{small:,} uniform", inputs.uniform(small), rounds, expected)
    yield _duel(f"{large:,} uniform", inputs.uniform(large), 3, expected)
    yield _duel(f"{small:,} clustered", inputs.clustered(small), rounds, None)
    yield _duel(f"{small:,} integer lattice", inputs.lattice(small), rounds, None)
    yield _outlined(small, rounds)


def _duel(case: str, points: NDArray[np.float64], rounds: int, expected: float | None) -> Row:
    contenders: tuple[Callable[[], NDArray[np.int32]], ...] = (
        lambda: delaunay(points).triangles,
        lambda: Delaunay(points).simplices,
    )
    (ours, theirs), (one, other) = alternate(rounds, *contenders)
    hull = ConvexHull(points).volume
    sound = [_is_sound(points, triangles, hull) for triangles in (one, other)]
    same = len(one) == len(other)
    if same and not np.array_equal(points, np.floor(points)):
        # The triangulation is unique, except for cocircular points such as those of a lattice.
        same = np.array_equal(_canonical(one), _canonical(other))
    evidence = f"{len(one):,} triangles, scipy {len(other):,}; Euler, area"
    if not sound[1]:
        evidence += " (scipy's fail)"
    return Row(case, PEER, ours, theirs, expected, sound[0] and (same or not sound[1]), evidence)


def _outlined(count: int, rounds: int) -> Row:
    points, segments = inputs.framed(count, 2048)
    (times,), (found,) = alternate(rounds, lambda: constrained_delaunay(points, segments))
    sound = _is_sound(points, found.triangles, 2048.0**2)
    case = f"{len(points):,} in an outline of {len(segments):,}"
    return Row(case, "", times, [], None, sound, f"{len(found.triangles):,} triangles; Euler, area")


def _is_sound(points: NDArray[np.float64], triangles: NDArray[np.int32], area: float) -> bool:
    """Return whether the triangles use all points and have the right number and total area."""
    corners = points[triangles]
    (abx, aby), (acx, acy) = (corners[:, 1:] - corners[:, :1]).transpose(1, 2, 0)
    total = np.abs(abx * acy - aby * acx).sum() / 2
    used = len(np.unique(triangles))
    # Euler's formula for a disc whose boundary has b edges: T = 2 N - 2 - b.
    euler = len(triangles) == 2 * used - 2 - len(boundary_edges(triangles))
    return used == len(points) and euler and bool(np.isclose(total, area, rtol=1e-9))


def _canonical(triangles: NDArray[np.int32]) -> NDArray[np.int32]:
    corners = np.sort(triangles, axis=1)
    return corners[np.lexsort(corners.T)]
