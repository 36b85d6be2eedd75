"""Exact predicates: test whether four points lie on one circle.

A floating-point test decides nearly every case; exact arithmetic decides the others. The
result is exact for all coordinates whose products up to the fourth degree neither overflow
nor underflow.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geomesh.arrays.jit import inner
from geomesh.raster.grid import LATTICE

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geomesh.arrays.types import Floats, Mask, Points

# Bound on the rounding error of the in-circle determinant, relative to the sum of the
# magnitudes of its terms (Shewchuk 1997; the rounding of the bound itself is included).
_UNIT = 2.0**-53
IN_CIRCLE_ERROR = (10 + 96 * _UNIT) * _UNIT

# Lattice coordinates below this limit are converted to integers.
_LARGEST = 2.0**52
# The last 64 bits determine an integer determinant below this limit.
_WORD = 2.0**62

_SPLITTER = 2.0**27 + 1

# Number of quadruples processed at a time; each has 384 terms.
_BLOCK = 2048


@inner
def in_circle(
    ax: float, ay: float, bx: float, by: float, cx: float, cy: float, dx: float, dy: float
) -> tuple[float, float]:
    """Return the in-circle determinant of a, b, c relative to d, and the sum of magnitudes.

    The determinant is positive if d is inside the circumcircle of a counter-clockwise
    triangle abc. Its sign is uncertain if its magnitude is at most `IN_CIRCLE_ERROR` times
    the sum of the magnitudes of its terms.
    """
    ax, ay, bx, by, cx, cy = ax - dx, ay - dy, bx - dx, by - dy, cx - dx, cy - dy
    aa, bb, cc = ax * ax + ay * ay, bx * bx + by * by, cx * cx + cy * cy
    bxcy, cxby, cxay, axcy, axby, bxay = bx * cy, cx * by, cx * ay, ax * cy, ax * by, bx * ay
    value = aa * (bxcy - cxby) + bb * (cxay - axcy) + cc * (axby - bxay)
    size = (
        aa * (abs(bxcy) + abs(cxby)) + bb * (abs(cxay) + abs(axcy)) + cc * (abs(axby) + abs(bxay))
    )
    return value, size


def are_cocircular(a: Points, b: Points, c: Points, d: Points) -> Mask:
    """Return exactly which quadruples of points, (K, 2) each, lie on one circle.

    Use it only for the few quadruples that `in_circle` cannot decide: exact sums are slow.
    """
    corners = np.stack([a, b, c, d])
    on_lattice = _fits_lattice(corners)
    cocircular = np.empty(len(a), np.bool_)
    cocircular[on_lattice] = _on_lattice(corners[:, on_lattice])
    rest = np.flatnonzero(~on_lattice)
    for start in range(0, len(rest), _BLOCK):
        block = rest[start : start + _BLOCK]
        cocircular[block] = _sums_to_zero(_terms(corners[:, block]))
    return cocircular


def _fits_lattice(corners: NDArray[np.float64]) -> Mask:
    """Return which quadruples (4, K, 2) are on the lattice and have a small determinant."""
    scaled = corners * LATTICE
    whole = (np.abs(scaled) < _LARGEST) & (scaled == np.floor(scaled))
    x, y = np.moveaxis(scaled[:3] - scaled[3], -1, 0)
    lifted = x * x + y * y
    value, size = np.zeros((2, corners.shape[1]))
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        value += lifted[i] * (x[j] * y[k] - x[k] * y[j])
        size += lifted[i] * (np.abs(x[j] * y[k]) + np.abs(x[k] * y[j]))
    fits: Mask = whole.all(axis=(0, 2)) & (np.abs(value) + IN_CIRCLE_ERROR * size < _WORD)
    return fits


def _on_lattice(corners: NDArray[np.float64]) -> Mask:
    """Return which quadruples (4, K, 2) of lattice points lie on one circle.

    In units of the lattice, the determinant is an integer below 2^62. It is zero if its last
    64 bits are zero, and these bits are correct even if products overflow.
    """
    whole = (corners * LATTICE).astype(np.int64).view(np.uint64)
    x, y = np.moveaxis(whole[:3] - whole[3], -1, 0)
    lifted = x * x + y * y
    last = lifted[0] * (x[1] * y[2] - x[2] * y[1])
    last += lifted[1] * (x[2] * y[0] - x[0] * y[2])
    last += lifted[2] * (x[0] * y[1] - x[1] * y[0])
    zero: Mask = last == 0
    return zero


def _terms(corners: NDArray[np.float64]) -> Floats:
    """Return terms (384, K) whose exact sum is the in-circle determinant of corners (4, K, 2)."""
    (ax, ay), (bx, by), (cx, cy), (dx, dy) = np.moveaxis(corners, -1, 1)
    lifted = (
        (1.0, ax, ay, bx, by, cx, cy, dx, dy),
        (-1.0, bx, by, ax, ay, cx, cy, dx, dy),
        (1.0, cx, cy, ax, ay, bx, by, dx, dy),
        (-1.0, dx, dy, ax, ay, bx, by, cx, cy),
    )
    return np.stack([term for each in lifted for term in _lifted_area(*each)])


def _lifted_area(
    sign: float, px: Floats, py: Floats, ax: Floats, ay: Floats, *rest: Floats
) -> list[Floats]:
    """Return 96 terms whose exact sum is (px^2 + py^2) times twice the signed area of abc."""
    bx, by, cx, cy = rest
    lift = (*_product(px, px), *_product(py, py))
    pairs = ((ax, by), (-ay, bx), (bx, cy), (-by, cx), (cx, ay), (-cy, ax))
    factors = [factor for p, q in pairs for factor in _product(sign * p, q)]
    return [term for factor in factors for part in lift for term in _product(factor, part)]


def _product(a: Floats, b: Floats) -> tuple[Floats, Floats]:
    """Return two floats whose exact sum is the product (Dekker 1971)."""
    high = a * b
    split = _SPLITTER * a
    a1 = split - (split - a)
    a2 = a - a1
    split = _SPLITTER * b
    b1 = split - (split - b)
    b2 = b - b1
    return high, a2 * b2 - (((high - a1 * b1) - a2 * b1) - a1 * b2)


def _sums_to_zero(terms: Floats) -> Mask:
    """Return exactly which columns of the floats (M, K) sum to zero; overwrites `terms`.

    Each pass adds up the columns and stores every rounding error in place of a term. So the
    exact sum does not change, while its magnitude moves into the last row.
    """
    zero = np.zeros(terms.shape[1], np.bool_)
    left = np.arange(terms.shape[1])
    while len(left):
        total, rest = terms[0].copy(), np.zeros(len(left))
        for row in range(len(terms) - 1):
            term = terms[row + 1]
            high = total + term
            shared = high - total
            error = (total - (high - shared)) + (term - shared)
            terms[row] = error
            rest += np.abs(error)
            total = high
        terms[-1] = total
        zero[left[rest == 0.0]] = total[rest == 0.0] == 0.0
        # A column that has become NaN is finished, too: comparisons with NaN are false.
        open_ = (np.abs(total) <= 1.0001 * rest) & (rest > 0.0)
        left, terms = left[open_], terms[:, open_]
    return zero
