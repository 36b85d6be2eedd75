"""Quality of triangles: the paper's Ki and standard measures.

Ki = 2 CA BC / (CA + AB + BC) (eq. 10 of the paper) is a length. For meshes of one image
with N nodes it decreases as 1 / sqrt(N), so Ki alone ranks coarse meshes first. The side
AB is not in the numerator, so the value also depends on which side is called AB.
Therefore Ki is reported together with its labelling, the size of the image and N.
Reported too are Ki / sqrt(image area / N), which has no unit, and measures that do not
change with scale. These measures are defined as in the Verdict library (Stimpson et al.
2007); the equilateral triangle is the ideal.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from geomesh.arrays.plain import plain_json
from geomesh.arrays.table import Table, blocks

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from numpy.typing import ArrayLike, NDArray

    from geomesh.arrays.types import Floats, Points, Triangles

LABELLING = (
    "ki: AB is the shortest side, BC the longest (the greatest value of the three labellings); "
    "ki_min: AB is the longest side; ki_mean: mean of the three labellings"
)
_PERCENTILES = (5, 25, 75, 95)
_SMALL_ANGLES = (10, 20)
_ROOT_3 = math.sqrt(3.0)


@dataclass(frozen=True, eq=False)
class Quality:
    """The measures of the triangles of one mesh.

    Parameters
    ----------
    table : Table
        One row per triangle. ``ab`` (the shortest side), ``bc`` (the longest side),
        ``ca``, ``ki``, ``ki_min`` and ``ki_mean`` are lengths in the unit of the plane,
        ``area`` is in its square, ``min_angle`` and ``max_angle`` are in degrees. The
        other measures have no unit. They are 1 for an equilateral triangle, with two
        exceptions: ``equiangle_skew`` is 0 for it, and ``relative_size_squared`` is 1
        for a triangle of mean area.
    nodes : int
        Number of nodes of the mesh.
    size : (float, float)
        Width and height of the plane in which lengths are measured.
    """

    table: Table
    nodes: int
    size: tuple[float, float]

    def __repr__(self) -> str:
        return f"<Quality: {self.table.length} triangles, {', '.join(self.table)}>"

    def summary(self) -> dict[str, Any]:
        """Return statistics over all triangles as plain JSON values.

        Values that are not finite, and all values of a mesh without triangles, are None.
        """
        ki_scale = math.sqrt(self.size[0] * self.size[1] / self.nodes) if self.nodes else 0.0
        least = self.table["min_angle"]
        return {
            "nodes": self.nodes,
            "triangles": self.table.length,
            "size": [float(length) for length in self.size],
            "labelling": LABELLING,
            "ki_normalised": plain_json(_mean(self.table["ki"]) / ki_scale) if ki_scale else None,
            "mean_sides": {
                name: plain_json(_mean(self.table[name])) for name in ("ab", "bc", "ca")
            },
            "share_min_angle_under": {
                str(limit): plain_json(_mean(least < limit)) for limit in _SMALL_ANGLES
            },
            "measures": {name: _figures(values) for name, values in self.table.items()},
        }


def ki(ab: ArrayLike, bc: ArrayLike, ca: ArrayLike) -> Floats:
    """Return Ki, 2 CA BC / (CA + AB + BC), eq. (10) of the paper.

    The three arrays of lengths have the same shape. Ki is zero if all three lengths are.
    """
    ab, bc, ca = (np.asarray(length, dtype=np.float64) for length in (ab, bc, ca))
    return _ratio(2 * ca * bc, ca + ab + bc, 0.0)


def measure(points: Points, triangles: Triangles, *, size: tuple[float, float]) -> Quality:
    """Measure every triangle of a mesh.

    Parameters
    ----------
    points : float64 (N, 2)
        Node coordinates in the plane in which lengths and angles are measured.
    triangles : int32 (T, 3)
        In either orientation.
    size : (float, float)
        Width and height of that plane, in its unit.

    Returns
    -------
    Quality
        For a triangle without area the ratios are infinite and ``shape`` is 0.
    """
    columns = measure_each(points, triangles)
    area = columns["area"]
    relative = _ratio(area, np.full_like(area, _mean(area)), 0.0)
    size_squared = np.minimum(relative, _ratio(1.0, relative, np.inf)) ** 2
    table = Table({**columns, "relative_size_squared": size_squared})
    return Quality(table, len(points), (float(size[0]), float(size[1])))


class _Shapes(NamedTuple):
    """Sides, area and angles of n triangles, (n,) each: the input of all measures."""

    ab: Floats
    bc: Floats
    ca: Floats
    area: Floats
    least: Floats  # in radians
    min_angle: Floats
    max_angle: Floats

    @property
    def perimeter(self) -> Floats:
        return self.ab + self.bc + self.ca

    @property
    def squares(self) -> Floats:
        return self.ab**2 + self.bc**2 + self.ca**2


_MEASURES: dict[str, Callable[[_Shapes], Floats]] = {
    "ab": lambda s: s.ab,
    "bc": lambda s: s.bc,
    "ca": lambda s: s.ca,
    "ki": lambda s: ki(s.ab, s.bc, s.ca),
    "ki_min": lambda s: ki(s.bc, s.ab, s.ca),
    "ki_mean": lambda s: _ratio(
        2 / 3 * (s.ab * s.bc + s.bc * s.ca + s.ca * s.ab), s.perimeter, 0.0
    ),
    "area": lambda s: s.area,
    "min_angle": lambda s: s.min_angle,
    "max_angle": lambda s: s.max_angle,
    "edge_ratio": lambda s: _ratio(s.bc, s.ab, np.inf),
    "aspect_ratio": lambda s: _ratio(s.bc * s.perimeter, 4 * _ROOT_3 * s.area, np.inf),
    # R / (2 r) with R = ab bc ca / (4 area), r = 2 area / perimeter.
    "radius_ratio": lambda s: _ratio(s.ab * s.bc * s.ca * s.perimeter, (4 * s.area) ** 2, np.inf),
    "condition": lambda s: _ratio(s.squares, 4 * _ROOT_3 * s.area, np.inf),
    "shape": lambda s: _ratio(4 * _ROOT_3 * s.area, s.squares, 0.0),
    "scaled_jacobian": lambda s: 2 / _ROOT_3 * np.sin(s.least),
    "equiangle_skew": lambda s: np.maximum((s.max_angle - 60) / 120, (60 - s.min_angle) / 60),
}


def measure_each(
    points: Points, triangles: Triangles, names: Iterable[str] = tuple(_MEASURES)
) -> dict[str, Floats]:
    """Return the measures `names`, (T,) each, that depend on one triangle only.

    The arrays are read-only.
    """
    columns = {name: np.empty(len(triangles)) for name in names}
    for block in blocks(len(triangles)):
        shapes = _shapes(points[triangles[block]])
        for name, column in columns.items():
            column[block] = _MEASURES[name](shapes)
    for column in columns.values():
        column.flags.writeable = False  # so that a table need not copy it
    return columns


def _shapes(corners: Floats) -> _Shapes:
    """Return sides, area and angles of triangles with corners (n, 3, 2)."""
    # Side k is opposite to corner k.
    sides = [corners[:, (k + 2) % 3] - corners[:, (k + 1) % 3] for k in range(3)]
    lengths = np.stack([np.hypot(side[:, 0], side[:, 1]) for side in sides])
    ab, ca, bc = np.sort(lengths, axis=0)
    twice = np.abs(sides[0][:, 0] * sides[1][:, 1] - sides[0][:, 1] * sides[1][:, 0])
    # The arc tangent of cross and dot product is precise also near 0 and 180 degrees;
    # the law of cosines and the arc sine are not.
    # `0.0 - x`, not `-x`: a minus sign turns 0 into -0.0, whose angle is 180 degrees.
    dots = [0.0 - (sides[(k + 1) % 3] * sides[(k + 2) % 3]).sum(axis=1) for k in range(3)]
    angles = np.arctan2(twice, np.stack(dots))
    least, greatest = angles.min(axis=0), angles.max(axis=0)
    return _Shapes(ab, bc, ca, twice / 2, least, np.degrees(least), np.degrees(greatest))


def _ratio(numerator: ArrayLike, denominator: Floats, otherwise: float) -> Floats:
    """Return the quotient, or `otherwise` where the denominator is zero."""
    result = np.full(np.broadcast_shapes(np.shape(numerator), denominator.shape), otherwise)
    with np.errstate(over="ignore"):  # a ratio too large for float64 becomes infinite
        np.divide(numerator, denominator, out=result, where=denominator > 0)
    return result


def _mean(values: NDArray[Any]) -> float:
    return float(values.mean()) if len(values) else math.nan


def _figures(values: Floats) -> dict[str, float | None]:
    """Return mean, median, percentiles, minimum and maximum of one measure."""
    if not len(values):
        return dict.fromkeys(
            ("mean", "median", *(f"p{p}" for p in _PERCENTILES), "min", "max"), None
        )
    with np.errstate(invalid="ignore"):  # interpolation between infinite values gives NaN
        ranks = np.percentile(values, _PERCENTILES)
        median = float(np.median(values))
    return {
        "mean": plain_json(_mean(values)),
        "median": plain_json(median),
        **{f"p{p}": plain_json(float(rank)) for p, rank in zip(_PERCENTILES, ranks, strict=True)},
        "min": plain_json(float(values.min())),
        "max": plain_json(float(values.max())),
    }
