"""Add one node to a patch: split a triangle or an edge, flip for better angles, or undo it all."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from geomesh.arrays.jit import inner, int64, named, uint8, writes
from geomesh.refine.connect import flip
from geomesh.refine.patch import OTHER_PATCH, Patch, corner_of, relink, side_of
from geomesh.refine.shape import convex, corner_sharpness, lattice_step

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geomesh.arrays.types import Counts

# Distance to a side, relative to its length, below which the side is split, not the triangle.
_NEAR_SIDE = 0.03

# Triangles that one insertion may change, and rows that its log can hold.
_MOST_CHANGED = 28
_LOG = 400


class Log(NamedTuple):
    """The rows of triangles before they were changed, so that an insertion can be undone.

    Attributes
    ----------
    size : int64 (2,)
        Rows of the log, and rows of `changed`, in use.
    row : int64 (L,)
        Numbers of the triangles.
    triangles, across : int64 (L, 3)
    hard : uint8 (L, 3)
    changed : int64 (C,)
        The triangles around the new node.
    """

    size: NDArray[np.int64]
    row: Counts
    triangles: Counts
    across: Counts
    hard: NDArray[np.uint8]
    changed: Counts


LOG = named(
    *(Log, writes(int64, 1), writes(int64, 1), writes(int64, 2), writes(int64, 2)),
    *(writes(uint8, 2), writes(int64, 1)),
)


def new_log() -> Log:
    """Return room for the log of one insertion."""
    return Log(
        np.zeros(2, np.int64),
        np.empty(_LOG, np.int64),
        np.empty((_LOG, 3), np.int64),
        np.empty((_LOG, 3), np.int64),
        np.empty((_LOG, 3), np.uint8),
        np.empty(_MOST_CHANGED + 8, np.int64),
    )


@inner
def insert_node(patch: Patch, t: int, x: float, y: float, floor: float, log: Log) -> int:
    """Add a node in triangle `t` at (x, y), or nearby on its side; return its number.

    Then flips raise the smallest angle. If a triangle around the node is sharper than `floor`,
    everything is undone and -1 is returned. `log.changed` has the triangles around the node.
    """
    log.size[:] = 0
    v, rows = patch.size[0], patch.size[1]
    side, x, y = _nearest_side(patch, t, x, y)
    if side == OTHER_PATCH:
        return -1
    patch.points[v, 0], patch.points[v, 1] = x, y
    patch.held[v] = 0
    if side < 0:
        _split_triangle(patch, t, v, log)
    else:
        _split_side(patch, t, side, v, log)
    _raise_angles(patch, v, log)
    patch.size[0] = v + 1
    triangles = patch.triangles
    for i in range(log.size[1]):
        q = log.changed[i]
        sharp = corner_sharpness(patch.points, triangles[q, 0], triangles[q, 1], triangles[q, 2])
        if sharp < 0 or sharp < floor:
            _undo(patch, v, rows, log)
            return -1
    return int(v)


@inner
def _nearest_side(patch: Patch, t: int, x: float, y: float) -> tuple[int, float, float]:
    """Return which side of `t` to split at (x, y), -1 for none, and where.

    A hard side is split exactly on its line, which must have a point of the lattice there.
    `OTHER_PATCH` means that the node cannot be added.
    """
    triangles, across, p = patch.triangles, patch.across, patch.points
    for k in range(3):
        b, d = triangles[t, (k + 1) % 3], triangles[t, (k + 2) % 3]
        ux, uy = p[d, 0] - p[b, 0], p[d, 1] - p[b, 1]
        length = math.sqrt(ux * ux + uy * uy)
        distance = ((p[b, 0] - x) * (p[d, 1] - y) - (p[b, 1] - y) * (p[d, 0] - x)) / length
        if distance >= _NEAR_SIDE * length and distance > 0:
            continue
        if across[t, k] == OTHER_PATCH:
            return OTHER_PATCH, x, y
        if not patch.hard[t, k]:
            return k, x, y
        sx, sy, steps = lattice_step(ux, uy)
        place = ((x - p[b, 0]) * ux + (y - p[b, 1]) * uy) / (length * length)
        step = np.rint(place * steps)
        if not 0 < step < steps:
            return OTHER_PATCH, x, y
        return k, p[b, 0] + step * sx, p[b, 1] + step * sy
    return -1, x, y


@inner
def _record(patch: Patch, t: int, log: Log) -> None:
    if t < 0 or log.size[0] >= _LOG:
        return
    i = log.size[0]
    log.row[i] = t
    for k in range(3):
        log.triangles[i, k] = patch.triangles[t, k]
        log.across[i, k] = patch.across[t, k]
        log.hard[i, k] = patch.hard[t, k]
    log.size[0] = i + 1


@inner
def _record_around(patch: Patch, t: int, log: Log) -> None:
    _record(patch, t, log)
    for k in range(3):
        _record(patch, patch.across[t, k], log)


@inner
def _changed(t: int, log: Log) -> None:
    log.changed[log.size[1]] = t
    log.size[1] += 1


@inner
def _set_row(patch: Patch, t: int, a: int, b: int, c: int, n0: int, n1: int, n2: int) -> None:
    """Make `t` the triangle of three nodes, with the given neighbours and soft sides."""
    patch.triangles[t, 0], patch.triangles[t, 1], patch.triangles[t, 2] = a, b, c
    patch.across[t, 0], patch.across[t, 1], patch.across[t, 2] = n0, n1, n2
    patch.hard[t, 0] = patch.hard[t, 1] = patch.hard[t, 2] = 0
    patch.at[a] = patch.at[b] = patch.at[c] = t
    patch.alive[t] = True


@inner
def _split_triangle(patch: Patch, t: int, v: int, log: Log) -> None:
    """Replace `t` by three triangles around `v`."""
    _record_around(patch, t, log)
    triangles, across, hard = patch.triangles, patch.across, patch.hard
    a, b, d = triangles[t, 0], triangles[t, 1], triangles[t, 2]
    n0, n1, n2 = across[t, 0], across[t, 1], across[t, 2]
    h0, h1, h2 = hard[t, 0], hard[t, 1], hard[t, 2]
    w1 = patch.size[1]
    w2 = w1 + 1
    patch.size[1] = w2 + 1
    _set_row(patch, t, a, b, v, w1, w2, n2)
    _set_row(patch, w1, b, d, v, w2, t, n0)
    _set_row(patch, w2, d, a, v, t, w1, n1)
    hard[t, 2], hard[w1, 2], hard[w2, 2] = h2, h0, h1
    relink(across, n0, t, w1)
    relink(across, n1, t, w2)
    _changed(t, log)
    _changed(w1, log)
    _changed(w2, log)


@inner
def _split_side(patch: Patch, t: int, k: int, v: int, log: Log) -> None:
    """Split the side k of `t`, and the triangle across it, at `v`."""
    _record_around(patch, t, log)
    triangles, across, hard = patch.triangles, patch.across, patch.hard
    u = across[t, k]
    a, b, d = triangles[t, k], triangles[t, (k + 1) % 3], triangles[t, (k + 2) % 3]
    da, ab = across[t, (k + 1) % 3], across[t, (k + 2) % 3]
    h, h_da, h_ab = hard[t, k], hard[t, (k + 1) % 3], hard[t, (k + 2) % 3]
    w1 = patch.size[1]
    patch.size[1] = w1 + 1
    if u < 0:
        _set_row(patch, t, a, b, v, u, w1, ab)
        _set_row(patch, w1, a, v, d, u, da, t)
    else:
        _record_around(patch, u, log)
        k2 = side_of(across, u, t)
        e = triangles[u, k2]
        be, ed = across[u, (k2 + 1) % 3], across[u, (k2 + 2) % 3]
        h_be, h_ed = hard[u, (k2 + 1) % 3], hard[u, (k2 + 2) % 3]
        w2 = patch.size[1]
        patch.size[1] = w2 + 1
        _set_row(patch, t, a, b, v, w2, w1, ab)
        _set_row(patch, w1, a, v, d, u, da, t)
        _set_row(patch, u, e, d, v, w1, w2, ed)
        _set_row(patch, w2, e, v, b, t, be, u)
        hard[u, 0], hard[u, 2] = h, h_ed
        hard[w2, 0], hard[w2, 1] = h, h_be
        relink(across, be, u, w2)
        _changed(u, log)
        _changed(w2, log)
    hard[t, 0], hard[t, 2] = h, h_ab
    hard[w1, 0], hard[w1, 1] = h, h_da
    relink(across, da, t, w1)
    _changed(t, log)
    _changed(w1, log)


@inner
def _raise_angles(patch: Patch, v: int, log: Log) -> None:
    """Flip the sides opposite to `v` where that raises the smallest angle."""
    triangles, across, p = patch.triangles, patch.across, patch.points
    i = 0
    while i < log.size[1] and log.size[1] < _MOST_CHANGED:
        t = log.changed[i]
        k = corner_of(triangles, t, v)
        u = across[t, k]
        if u >= 0 and not patch.hard[t, k] and log.size[0] + 8 <= _LOG:
            b, d = triangles[t, (k + 1) % 3], triangles[t, (k + 2) % 3]
            e = triangles[u, side_of(across, u, t)]
            before = min(corner_sharpness(p, v, b, d), corner_sharpness(p, e, d, b))
            after = min(corner_sharpness(p, v, b, e), corner_sharpness(p, v, e, d))
            if after > before and convex(p, v, b, d, e):
                _record_around(patch, t, log)
                _record_around(patch, u, log)
                flip(patch, t, k)
                _changed(u, log)
                continue  # look at the new side of t
        i += 1


@inner
def _undo(patch: Patch, v: int, rows: int, log: Log) -> None:
    """Restore the rows before the insertion of `v`; `rows` is the number of triangles then."""
    for i in range(log.size[0] - 1, -1, -1):
        t = log.row[i]
        for k in range(3):
            patch.triangles[t, k] = log.triangles[i, k]
            patch.across[t, k] = log.across[i, k]
            patch.hard[t, k] = log.hard[i, k]
    for i in range(log.size[0]):
        t = log.row[i]
        if t < rows:
            for k in range(3):
                patch.at[patch.triangles[t, k]] = t
    for t in range(rows, patch.size[1]):
        patch.alive[t] = False
    patch.size[0], patch.size[1] = v, rows
    patch.at[v] = -1
