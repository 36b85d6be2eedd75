"""The checks of a certificate.

They do not depend on how the mesh was made: they use only the finished arrays and a few
numbers about the area to cover that were known before the triangulation.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from geomesh.arrays.jit import contiguous
from geomesh.arrays.table import blocks
from geomesh.mesh.certificate import Certificate, Check, DomainFacts
from geomesh.mesh.topology import FILL, Edges, build_edges, edge_keys, find_edges
from geomesh.raster.areas import signed_areas

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geomesh.mesh.provenance import PixelCounts

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
    pixels: PixelCounts | None = None,
    edges: Edges | None = None,
    delaunay: bool = True,
    breaklines: bool = False,
) -> Certificate:
    """Check a triangulation and return its certificate.

    Parameters
    ----------
    nodes : float64 (N, 2)
        Pixel-edge coordinates.
    triangles : int32 (T, 3)
    constraints : int32 (C, 2)
        Pairs of nodes that must be edges.
    plane_scale : (float, float)
        Factors in x and y from pixels to the plane in which the nodes were triangulated.
    counter_clockwise : bool
        Whether triangles should be counter-clockwise in (x, y) pixel coordinates.
    domain : DomainFacts
    pixels : PixelCounts, optional
        What the band statistics counted; None for a mesh without a raster.
    edges : Edges, optional
        The edges of the triangles, if they are known.
    delaunay : bool
        False for a refined mesh, whose edges follow the image.
    breaklines : bool
        Whether constraints may also be inside: they are breaklines.
    """
    missing = int(np.count_nonzero((triangles < 0) | (triangles >= len(nodes))))
    if missing:
        check = Check("all nodes exist", False, f"{missing} corners do not")
        return Certificate((check,), math.nan)
    nodes, triangles = contiguous(nodes, np.float64), contiguous(triangles, np.int32)
    edges = build_edges(triangles) if edges is None else edges
    plane = nodes * plane_scale
    used = np.zeros(len(nodes), np.bool_)
    used[triangles] = True
    areas = signed_areas(nodes, triangles) * (1 if counter_clockwise else -1)
    angle_sums, least = _angles(plane, triangles)
    fixed = find_edges(edges, constraints)
    checks = [
        _check_nodes(nodes, used, len(triangles)),
        _check_orientation(areas),
        _check_manifold(edges),
        _check_area(float(areas.sum()), domain.area),
        _check_boundary(edges, constraints, fixed, domain, breaklines=breaklines),
        _check_euler(used, len(triangles), edges, domain),
        _check_angles(angle_sums, edges, domain),
        *([_check_circles(plane, triangles, edges, fixed)] if delaunay else []),
        _check_pixels(pixels, domain),
    ]
    return Certificate(tuple(checks), float(np.degrees(least)))


def _check_nodes(nodes: NDArray[np.float64], used: NDArray[np.bool_], triangle_count: int) -> Check:
    unused = len(nodes) - int(np.count_nonzero(used))
    duplicates = _count_duplicates(nodes)
    is_used = unused == 0 and triangle_count > 0
    return Check(
        "nodes are finite, distinct and used",
        bool(np.isfinite(nodes).all()) and duplicates == 0 and is_used,
        f"{len(nodes)} nodes, {duplicates} duplicate, {unused} unused",
    )


def _count_duplicates(nodes: NDArray[np.float64]) -> int:
    """Return the number of nodes at the position of an earlier node."""
    x, y = nodes.T
    # If the nodes are strictly sorted by y, then x, all are distinct.
    if ((y[1:] > y[:-1]) | ((y[1:] == y[:-1]) & (x[1:] > x[:-1]))).all():
        return 0
    # Complex numbers are sorted by x, then y, so equal points become neighbours.
    points = np.sort(np.ascontiguousarray(nodes).view(np.complex128)[:, 0])
    return int(np.count_nonzero(points[1:] == points[:-1]))


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


def _check_boundary(
    edges: Edges,
    constraints: NDArray[np.int32],
    fixed: NDArray[np.intp],
    domain: DomainFacts,
    *,
    breaklines: bool,
) -> Check:
    boundary = edges.nodes[edges.uses == 1]
    missing = int(np.count_nonzero(fixed == FILL))
    stray = 0
    if domain.kind != "hull":
        found = fixed[fixed != FILL]
        inner = found[edges.uses[found] == 2]
        outline = np.setdiff1d(edge_keys(constraints), edge_keys(edges.nodes[inner]))
        stray = len(np.setxor1d(edge_keys(boundary), outline))
        stray += 0 if breaklines else len(inner)
    return Check(
        "the boundary is the domain's outline, and every constraint is an edge",
        missing == 0 and stray == 0,
        f"{len(boundary)} boundary edges, {stray} elsewhere, {missing} constraints missing",
    )


def _check_euler(
    used: NDArray[np.bool_], triangle_count: int, edges: Edges, domain: DomainFacts
) -> Check:
    number = int(np.count_nonzero(used)) - len(edges.nodes) + triangle_count
    # Where the outline touches itself in a node, the closed area has one loop more than
    # its interior. So each additional visit of a node lowers the Euler number by one.
    visits = np.bincount(edges.nodes[edges.uses == 1].ravel())
    pinches = int((visits[visits > 0] // 2 - 1).sum())
    expected = domain.components - domain.holes - pinches
    return Check(
        "Euler number",
        number == expected,
        f"{number}, expected {expected} ({domain.components} components, {domain.holes} holes)",
    )


def _check_circles(
    plane: NDArray[np.float64],
    triangles: NDArray[np.int32],
    edges: Edges,
    fixed: NDArray[np.intp],
) -> Check:
    # Imported here: a refined mesh is not tested, so the kernel need not be compiled for it.
    from geomesh.mesh.certify_delaunay import check_delaunay

    return check_delaunay(plane, triangles, edges, fixed)


def _check_pixels(pixels: PixelCounts | None, domain: DomainFacts) -> Check:
    """Compare three independent counts: pixels in triangles, in the outline, valid pixels."""
    name = "each pixel of the domain lies in one triangle, none outside it"
    if pixels is None:
        return Check(name, True, "not checked: the mesh was made without a raster")
    covered, counted, holds = pixels.covered, pixels.counted, True
    if domain.kind == "valid":
        holds = covered == domain.pixels == domain.valid_pixels - domain.pixels_dropped
        holds &= counted == domain.valid_pixels or domain.islands_dropped > 0
    elif domain.kind == "image":
        holds = covered == domain.pixels and counted == domain.valid_pixels
    return Check(
        name,
        holds and counted <= min(covered, domain.valid_pixels),
        f"{covered} pixels{'' if domain.pixels is None else f' of {domain.pixels}'}; "
        f"{counted} of {domain.valid_pixels} valid ones, "
        f"{domain.islands_dropped} small islands dropped, {domain.holes_bridged} holes bridged",
    )


def _check_angles(angle_sums: NDArray[np.float64], edges: Edges, domain: DomainFacts) -> Check:
    """Check that angles sum to 360 degrees at inner nodes, at most 180 on a hull's boundary."""
    border = np.bincount(edges.nodes[edges.uses == 1].ravel(), minlength=len(angle_sums)) > 0
    inner = ~border & (angle_sums > 0)
    limit = np.where(border & (domain.kind == "hull"), np.pi, 2 * np.pi)
    bad = ~(angle_sums <= limit + _ANGLE_TOLERANCE)
    bad |= inner & (angle_sums < 2 * np.pi - _ANGLE_TOLERANCE)
    return Check(
        "triangles go once around every node",
        not bad.any(),
        f"{np.count_nonzero(inner)} inner nodes, {np.count_nonzero(bad)} nodes with other angles",
    )


def _angles(
    points: NDArray[np.float64], triangles: NDArray[np.int32]
) -> tuple[NDArray[np.float64], float]:
    """Return the angle sum of each node and the smallest angle (NaN of none), in radians."""
    sums, least = np.zeros(len(points)), math.inf if len(triangles) else math.nan
    for block in blocks(len(triangles)):
        angles = np.arctan2(*_products(points[triangles[block]]))
        np.add.at(sums, triangles[block].ravel(), angles.ravel())
        least = np.minimum(least, angles.min())
    return sums, least


def _products(corners: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return cross (absolute) and dot products (T, 3) of the sides at corners (T, 3, 2)."""
    u = corners[:, [1, 2, 0]] - corners
    v = corners[:, [2, 0, 1]] - corners
    cross = np.abs(u[..., 0] * v[..., 1] - u[..., 1] * v[..., 0])
    return cross, u[..., 0] * v[..., 0] + u[..., 1] * v[..., 1]
