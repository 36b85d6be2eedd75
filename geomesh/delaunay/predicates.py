"""Exact predicates: whether four points lie on one circle."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from geomesh.arrays.jit import kernel
from geomesh.raster.grid import LATTICE

# Of the in-circle determinant, relative to the sum of its terms' magnitudes
# (Shewchuk 1997, with the roundings of the bound itself).
_UNIT = 2.0**-53


_BOUND = (10 + 96 * _UNIT) * _UNIT


# Lattice coordinates are taken as integers up to here ...
_LARGEST = 2.0**52


# ... and a determinant of integers is known from its last 64 bits up to here.
_WORD = 2.0**62


_SPLITTER = 2.0**27 + 1


TERMS = 384


@kernel
def cocircular(
    points: NDArray[np.float64], a: int, b: int, c: int, d: int, terms: NDArray[np.float64]
) -> bool:
    """Tell exactly whether four points lie on one circle; `terms` is room to work in."""
    ax, ay, bx, by = points[a, 0], points[a, 1], points[b, 0], points[b, 1]
    cx, cy, dx, dy = points[c, 0], points[c, 1], points[d, 0], points[d, 1]
    adx, ady, bdx, bdy, cdx, cdy = ax - dx, ay - dy, bx - dx, by - dy, cx - dx, cy - dy
    bc, cb, ca, ac, ab, ba = bdx * cdy, cdx * bdy, cdx * ady, adx * cdy, adx * bdy, bdx * ady
    aa, bb, cc = adx * adx + ady * ady, bdx * bdx + bdy * bdy, cdx * cdx + cdy * cdy
    value = abs(aa * (bc - cb) + bb * (ca - ac) + cc * (ab - ba))
    size = aa * (abs(bc) + abs(cb)) + bb * (abs(ca) + abs(ac)) + cc * (abs(ab) + abs(ba))
    bound = _BOUND * size
    if value > bound:
        return False
    on_lattice = _on_lattice(points, a) and _on_lattice(points, b)
    on_lattice = on_lattice and _on_lattice(points, c) and _on_lattice(points, d)
    if on_lattice and (value + bound) * LATTICE**4 < _WORD:
        # The determinant, in units of the lattice, is an integer below 2^62: it is zero
        # if its last 64 bits are, and those come out right though products overflow.
        x0, y0 = _integer(ax) - _integer(dx), _integer(ay) - _integer(dy)
        x1, y1 = _integer(bx) - _integer(dx), _integer(by) - _integer(dy)
        x2, y2 = _integer(cx) - _integer(dx), _integer(cy) - _integer(dy)
        last = (x0 * x0 + y0 * y0) * (x1 * y2 - x2 * y1)
        last += (x1 * x1 + y1 * y1) * (x2 * y0 - x0 * y2)
        last += (x2 * x2 + y2 * y2) * (x0 * y1 - x1 * y0)
        return bool(last == np.uint64(0))
    count = _lifted_area(terms, 0, 1.0, ax, ay, bx, by, cx, cy, dx, dy)
    count = _lifted_area(terms, count, -1.0, bx, by, ax, ay, cx, cy, dx, dy)
    count = _lifted_area(terms, count, 1.0, cx, cy, ax, ay, bx, by, dx, dy)
    count = _lifted_area(terms, count, -1.0, dx, dy, ax, ay, bx, by, cx, cy)
    return _sums_to_zero(terms)


@kernel
def _on_lattice(points: NDArray[np.float64], p: int) -> bool:
    x, y = points[p, 0] * LATTICE, points[p, 1] * LATTICE
    return bool(max(abs(x), abs(y)) < _LARGEST and x == np.floor(x) and y == np.floor(y))


@kernel
def _integer(value: float) -> np.uint64:
    # By way of int64: what a negative float becomes as unsigned depends on the processor.
    return np.uint64(np.int64(value * LATTICE))


@kernel
def _lifted_area(
    terms: NDArray[np.float64],
    count: int,
    sign: float,
    px: float,
    py: float,
    ax: float,
    ay: float,
    bx: float,
    by: float,
    cx: float,
    cy: float,
) -> int:
    """Append 96 terms whose exact sum is (px^2 + py^2) times twice the area of abc, signed."""
    lift = (*_product(px, px), *_product(py, py))
    for p, q in ((ax, by), (-ay, bx), (bx, cy), (-by, cx), (cx, ay), (-cy, ax)):
        for factor in _product(sign * p, q):
            for part in lift:
                terms[count], terms[count + 1] = _product(factor, part)
                count += 2
    return count


@kernel
def _product(a: float, b: float) -> tuple[float, float]:
    """Two floats whose exact sum is the product (Dekker 1971)."""
    high = a * b
    split = _SPLITTER * a
    a1 = split - (split - a)
    a2 = a - a1
    split = _SPLITTER * b
    b1 = split - (split - b)
    b2 = b - b1
    return high, a2 * b2 - (((high - a1 * b1) - a2 * b1) - a1 * b2)


@kernel
def _sums_to_zero(terms: NDArray[np.float64]) -> bool:
    """Tell exactly whether floats add up to zero; they are overwritten.

    Each sweep adds them up and keeps every rounding error in place, so the exact sum
    stays what it is while its magnitude moves into the last of them.
    """
    last = len(terms) - 1
    while True:
        total, rest = terms[0], 0.0
        for i in range(last):
            term = terms[i + 1]
            high = total + term
            shared = high - total
            terms[i] = (total - (high - shared)) + (term - shared)
            rest += abs(terms[i])
            total = high
        terms[last] = total
        if not abs(total) <= 1.0001 * rest:  # also where there is no number any more
            return False
        if rest == 0.0:
            return True
