"""The checks behind a certificate.

Each is independent of how the mesh was made: it looks at the finished arrays and at
a few numbers known beforehand about the area to be covered.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from geomesh.certificate import Certificate, Check, DomainFacts
from geomesh.grid import signed_areas
from geomesh.topology import FILL, Edges, build_edges, edge_keys, find_edges

# Bounds on the rounding error of the two predicates in float64, relative to the
# sum of the absolute values of their terms (Shewchuk 1997, error bounds A).
_EPSILON = 2.0**-53
_INCIRCLE_ERROR = (10 + 96 * _EPSILON) * _EPSILON
_AREA_TOLERANCE = 1e-9
_ANGLE_TOLERANCE = 1e-6


def certify(
    nodes: NDArray[np.float64],
    triangles: NDArray[np.int32],
    *,
    constraints: NDArray[np.int32],
    plane_scale: tuple[float, float],
    counter_clockwise: bool,
    domain: DomainFacts,
    covered_pixels: int | None = None,
    counted_pixels: int | None = None,
) -> Certificate:
    """Check a triangulation of pixel-edge coordinates.

    Parameters
    ----------
    nodes : float64 (N, 2)
        Pixel-edge coordinates.
    triangles : int32 (T, 3)
    constraints : int32 (C, 2)
        Node pairs that had to become edges.
    plane_scale : (float, float)
        Factors in x and y from pixels to the plane that was triangulated.
    counter_clockwise : bool
        Orientation expected in (x, y) pixel numbers.
    domain : DomainFacts
    covered_pixels, counted_pixels : int, optional
        Pixel centres, and valid ones, inside the triangles, as found by the statistics.
    """
    known = (triangles >= 0) & (triangles < len(nodes))
    if not known.all():
        missing = int(np.count_nonzero(~known))
        return Certificate(
            (Check("all nodes exist", False, f"{missing} corners do not"),), math.nan
        )
    edges, plane = build_edges(triangles), nodes * plane_scale
    angles = _angles(plane, triangles)
    areas = signed_areas(nodes[triangles]) * (1 if counter_clockwise else -1)
    checks = [
        _check_nodes(nodes, triangles),
        _check_orientation(areas),
        _check_manifold(edges),
        _check_area(float(areas.sum()), domain.area),
        _check_boundary(edges, constraints, domain),
        _check_euler(triangles, edges, domain),
        _check_angles(angles, triangles, edges, domain),
        _check_delaunay(plane, triangles, edges, constraints),
        _check_pixels(covered_pixels, counted_pixels, domain),
    ]
    least = float(np.degrees(angles.min())) if len(triangles) else math.nan
    return Certificate(tuple(checks), least)


def _check_nodes(nodes: NDArray[np.float64], triangles: NDArray[np.int32]) -> Check:
    unused = len(nodes) - _count_used(triangles)
    # As complex numbers points are ordered by x, then y: equal ones meet.
    points = np.sort(np.ascontiguousarray(nodes).view(np.complex128)[:, 0])
    duplicates = int(np.count_nonzero(points[1:] == points[:-1]))
    finite = bool(np.isfinite(nodes).all())
    return Check(
        "nodes are finite, distinct and used",
        finite and unused == 0 and duplicates == 0 and len(triangles) > 0,
        f"{len(nodes)} nodes, {duplicates} duplicate, {unused} unused",
    )


def _count_used(triangles: NDArray[np.int32]) -> int:
    """Return how many different nodes occur."""
    return int(np.count_nonzero(np.bincount(triangles.ravel())))


def _check_orientation(areas: NDArray[np.float64]) -> Check:
    bad = int(np.count_nonzero(~(areas > 0)))
    least = float(areas.min(initial=np.inf))
    return Check(
        "every triangle is counter-clockwise on the map and has an area",
        bad == 0,
        f"{len(areas)} triangles, {bad} not, smallest {least:.3g} px2",
    )


def _check_manifold(edges: Edges) -> Check:
    inner = edges.uses == 2
    bad = int(np.count_nonzero(edges.uses > 2))
    bad += int(np.count_nonzero(inner & ((edges.left == FILL) | (edges.right == FILL))))
    return Check(
        "every inner edge is used once in each direction",
        bad == 0,
        f"{int(inner.sum())} inner edges, {bad} not",
    )


def _check_area(area: float, expected: float) -> Check:
    return Check(
        "the triangles cover the domain without overlap: areas add up",
        abs(area - expected) <= _AREA_TOLERANCE * max(expected, 1.0),
        f"{area:.6f} px2 of {expected:.6f}",
    )


def _check_boundary(edges: Edges, constraints: NDArray[np.int32], domain: DomainFacts) -> Check:
    boundary = edges.nodes[edges.uses == 1]
    missing = int(np.count_nonzero(find_edges(edges, constraints) == FILL))
    stray = 0
    if domain.kind != "hull":
        stray = len(np.setxor1d(edge_keys(boundary), edge_keys(constraints)))
    return Check(
        "the boundary is the domain's outline, and every constraint is an edge",
        missing == 0 and stray == 0,
        f"{len(boundary)} boundary edges, {stray} elsewhere, {missing} constraints missing",
    )


def _check_euler(triangles: NDArray[np.int32], edges: Edges, domain: DomainFacts) -> Check:
    number = _count_used(triangles) - len(edges.nodes) + len(triangles)
    # Where the outline touches itself in a node, the closed area has one loop more
    # than its interior: each further visit lowers the number by one.
    visits = np.bincount(edges.nodes[edges.uses == 1].ravel())
    pinches = int((visits[visits > 0] // 2 - 1).sum())
    expected = domain.components - domain.holes - pinches
    return Check(
        "Euler number",
        number == expected,
        f"{number}, expected {expected} ({domain.components} components, {domain.holes} holes)",
    )


def _check_delaunay(
    points: NDArray[np.float64],
    triangles: NDArray[np.int32],
    edges: Edges,
    constraints: NDArray[np.int32],
) -> Check:
    """Every inner edge that is no constraint passes the in-circle test.

    For a triangulation that is locally Delaunay at each edge, no circumcircle
    holds any visible node (Chew 1989). A test within its own rounding error is a
    tie: the four nodes are cocircular as far as float64 can tell.
    """
    free = edges.uses == 2
    fixed = find_edges(edges, constraints)
    free[fixed[fixed != FILL]] = False
    pairs, first, second = edges.nodes[free], edges.left[free], edges.right[free]
    apex = triangles[second].sum(axis=1) - pairs.sum(axis=1)
    value, bound = _incircle(points[triangles[first]], points[apex])
    violations = int(np.count_nonzero(value > bound))
    ties = int(np.count_nonzero(np.abs(value) <= bound))
    return Check(
        "empty circumcircles (Delaunay; constrained where constraints are)",
        violations == 0,
        f"{len(first)} edges tested, {violations} violations, {ties} cocircular; "
        f"{np.count_nonzero(edges.uses == 2) - len(first)} inner edges constrained",
    )


def _incircle(
    corners: NDArray[np.float64], query: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """In-circle determinant, positive inside for either orientation, and its error bound."""
    a, b, c = (corners[:, k] - query for k in range(3))
    lifts = [(p * p).sum(axis=1) for p in (a, b, c)]
    value = np.zeros(len(query))
    magnitude = np.zeros(len(query))
    for lift, p, q in zip(lifts, (b, c, a), (c, a, b), strict=True):
        left, right = p[:, 0] * q[:, 1], p[:, 1] * q[:, 0]
        value += lift * (left - right)
        magnitude += lift * (np.abs(left) + np.abs(right))
    return value * np.sign(signed_areas(corners)), _INCIRCLE_ERROR * magnitude


def _check_pixels(covered: int | None, counted: int | None, domain: DomainFacts) -> Check:
    """Compare three independent counts: pixels in triangles, in the outline, and valid ones."""
    name = "each pixel of the domain lies in one triangle, none outside it"
    if covered is None or counted is None:
        return Check(name, True, "not checked: the mesh was made without a raster")
    if domain.kind == "valid":
        holds = covered == domain.pixels == domain.valid_pixels - domain.pixels_dropped
        holds &= counted == domain.valid_pixels or domain.islands_dropped > 0
    elif domain.kind == "image":
        holds = covered == domain.pixels and counted == domain.valid_pixels
    else:
        holds = True
    return Check(
        name,
        holds and counted <= min(covered, domain.valid_pixels),
        f"{covered} pixels{'' if domain.pixels is None else f' of {domain.pixels}'}; "
        f"{counted} of {domain.valid_pixels} valid ones, "
        f"{domain.islands_dropped} small islands dropped, {domain.holes_bridged} holes bridged",
    )


def _check_angles(
    angles: NDArray[np.float64], triangles: NDArray[np.int32], edges: Edges, domain: DomainFacts
) -> Check:
    """Angles around an inner node make one turn; on a hull's boundary, half a turn at most."""
    count = int(triangles.max(initial=-1)) + 1
    total = np.bincount(triangles.ravel(), angles.ravel(), minlength=count)
    border = np.zeros(count, np.bool_)
    border[edges.nodes[edges.uses == 1]] = True
    inner = ~border & (total > 0)
    limit = np.where(border & (domain.kind == "hull"), np.pi, 2 * np.pi)
    bad = ~(total <= limit + _ANGLE_TOLERANCE)
    bad |= inner & (total < 2 * np.pi - _ANGLE_TOLERANCE)
    return Check(
        "triangles go once around every node",
        not bad.any(),
        f"{np.count_nonzero(inner)} inner nodes, {np.count_nonzero(bad)} nodes with other angles",
    )


def _angles(points: NDArray[np.float64], triangles: NDArray[np.int32]) -> NDArray[np.float64]:
    """Angles at the corners of the triangles, (T, 3), in radians."""
    corners = points[triangles]
    angles = np.empty(triangles.shape)
    for k in range(3):
        u = corners[:, (k + 1) % 3] - corners[:, k]
        v = corners[:, (k + 2) % 3] - corners[:, k]
        with np.errstate(invalid="ignore"):
            cross = np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
            dot = u[:, 0] * v[:, 0] + u[:, 1] * v[:, 1]
        angles[:, k] = np.arctan2(cross, dot)
    return angles
