"""Certificate: a good mesh passes, and each kind of damage fails the right check."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import Delaunay

from geomesh.errors import CertificateError
from geomesh.mesh.certificate import Certificate, DomainFacts
from geomesh.mesh.certify import certify
from geomesh.mesh.provenance import PixelCounts
from geomesh.mesh.topology import build_edges, neighbours
from support.geometry import exact_incircle

# Parts of the names of the checks. Each one belongs to one check only.
NODES = "nodes are finite"
ORIENTATION = "counter-clockwise"
MANIFOLD = "every inner edge"
AREA = "areas add up"
BOUNDARY = "the boundary is"
EULER = "Euler number"
DELAUNAY = "empty circumcircles"
PIXELS = "each pixel of the domain"
ANGLES = "once around every node"

SIDE = 40


class Case(NamedTuple):
    """A mesh with the facts about it. A test changes them with `_replace`."""

    nodes: np.ndarray
    triangles: np.ndarray
    constraints: np.ndarray
    domain: DomainFacts
    plane_scale: tuple[float, float] = (1.0, 1.0)
    counter_clockwise: bool = True
    pixels: PixelCounts | None = PixelCounts(SIDE * SIDE, SIDE * SIDE)
    delaunay: bool = True

    def certify(self) -> Certificate:
        return certify(
            self.nodes,
            self.triangles,
            constraints=self.constraints,
            plane_scale=self.plane_scale,
            counter_clockwise=self.counter_clockwise,
            domain=self.domain,
            pixels=self.pixels,
            delaunay=self.delaunay,
        )


def twice_areas(nodes: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    a, b, c = (nodes[triangles[:, k]] for k in range(3))
    return (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]


def ccw_delaunay(nodes: np.ndarray) -> np.ndarray:
    triangles = Delaunay(nodes).simplices.astype(np.int32)
    twice = twice_areas(nodes, triangles)
    triangles[twice < 0] = triangles[twice < 0][:, ::-1]
    return triangles[twice != 0]


def framed(inner: np.ndarray, side: int = SIDE, step: int = 8) -> Case:
    """Return a Delaunay mesh of a square. Its frame has a node every `step` pixels."""
    line = np.arange(0, side, step)
    frame = np.concatenate(
        [
            np.column_stack([line, np.zeros_like(line)]),
            np.column_stack([np.full_like(line, side), line]),
            np.column_stack([side - line, np.full_like(line, side)]),
            np.column_stack([np.zeros_like(line), side - line]),
        ]
    )
    ids = np.arange(len(frame), dtype=np.int32)
    nodes = np.concatenate([frame, inner]).astype(np.float64)
    domain = DomainFacts("image", float(side * side), 1, 0, side * side, side * side)
    loop = np.column_stack([ids, np.roll(ids, -1)])
    return Case(
        nodes, ccw_delaunay(nodes), loop, domain, pixels=PixelCounts(side * side, side * side)
    )


def random_inner(seed: int, count: int = 60) -> np.ndarray:
    """Return points inside the frame, on a lattice of 1/256 pixel."""
    return np.random.default_rng(seed).integers(256, (SIDE - 1) * 256, (count, 2)) / 256


@pytest.fixture
def good() -> Case:
    return framed(random_inner(7))


def failed(case: Case) -> set[str]:
    """Return the failed checks, each as a part of its name."""
    names = [check.name for check in case.certify().checks if not check.passed]
    known = (NODES, ORIENTATION, MANIFOLD, AREA, BOUNDARY, EULER, DELAUNAY, PIXELS, ANGLES)
    found = {word for name in names for word in known if word in name}
    assert len(found) == len(names), names
    return found


def inner_node(case: Case) -> int:
    """Return the node nearest to the middle."""
    return int(np.hypot(*(case.nodes - SIDE / 2).T).argmin())


def inner_triangle(case: Case) -> int:
    """Return a triangle without a node on the frame."""
    return int(np.flatnonzero((case.triangles >= len(case.constraints)).all(axis=1))[0])


def flip(triangles: np.ndarray, one: int, corner: int) -> np.ndarray:
    """Flip the edge opposite to a corner of a triangle."""
    other = neighbours(triangles)[one, corner]
    apex, start, stop = (triangles[one, (corner + k) % 3] for k in range(3))
    (far,) = set(triangles[other].tolist()) - {start, stop}
    flipped = triangles.copy()
    flipped[one], flipped[other] = (apex, start, far), (apex, far, stop)
    return flipped


def convex_flips(case: Case) -> list[np.ndarray]:
    """Return every mesh that differs by one flip in a strictly convex quadrilateral."""
    across = neighbours(case.triangles)
    found = []
    for one, corner in zip(*np.nonzero(across > np.arange(len(across))[:, None]), strict=True):
        flipped = flip(case.triangles, int(one), int(corner))
        if (twice_areas(case.nodes, flipped) > 0).all():
            found.append(flipped)
    return found


# Meshes that pass


@pytest.mark.parametrize("seed", range(5))
def test_a_delaunay_mesh_of_a_frame_passes(seed: int) -> None:
    case = framed(random_inner(seed))
    assert failed(case) == set()
    case.certify().require()


def test_a_certificate_is_plain_json(good: Case) -> None:
    document = json.loads(json.dumps(good.certify().to_dict(), allow_nan=False))
    assert document["passed"] is True
    assert len(document["checks"]) == 9
    assert {"name", "passed", "detail"} == set(document["checks"][0])


def test_the_least_angle_is_that_of_the_law_of_cosines(good: Case) -> None:
    least = math.inf
    for triangle in good.triangles:
        a, b, c = (
            math.dist(*good.nodes[np.delete(triangle, k)]) for k in range(3)
        )  # side k is opposite to corner k
        for x, y, z in ((a, b, c), (b, c, a), (c, a, b)):
            least = min(least, math.degrees(math.acos((y * y + z * z - x * x) / (2 * y * z))))
    assert good.certify().min_angle == pytest.approx(least, rel=1e-9)


def test_a_mesh_of_a_flipped_grid_passes_when_it_is_said_so(good: Case) -> None:
    turned = good._replace(triangles=good.triangles[:, ::-1], counter_clockwise=False)
    assert failed(turned) == set()


def lattice(step: int = 8) -> Case:
    """Return a square that is divided into squares, each divided into two triangles."""
    line = np.arange(step, SIDE, step)
    x, y = np.meshgrid(line, line)
    return framed(np.column_stack([x.ravel(), y.ravel()]), step=step)


@pytest.mark.parametrize("seed", range(10))
def test_cocircular_grids_pass_whichever_diagonals_they_have(seed: int) -> None:
    case = lattice()
    across = neighbours(case.triangles)
    # The diagonal of a cell is opposite to its right angle.
    sides = case.nodes[np.roll(case.triangles, 1, axis=1)] - case.nodes[case.triangles]
    corner = (np.abs(sides).min(axis=2) > 0).argmax(axis=1)
    opposite = (corner + 1) % 3
    rng = np.random.default_rng(seed)
    triangles = case.triangles
    for one in np.flatnonzero(rng.random(len(across)) < 0.5):
        other = across[one, opposite[one]]
        if one < other:
            triangles = flip(triangles, int(one), int(opposite[one]))
    turned = case._replace(triangles=triangles)
    assert not np.array_equal(triangles, case.triangles)
    assert failed(turned) == set()
    (check,) = (c for c in turned.certify().checks if DELAUNAY in c.name)
    assert "25 cocircular" in check.detail


@pytest.mark.parametrize("scale", [(256 / 300, 256 / 700), (1 / 3, 1 / 3), (10.1, 0.7)])
def test_grids_that_are_cocircular_but_for_rounding_pass(scale: tuple[float, float]) -> None:
    assert failed(lattice()._replace(plane_scale=scale)) == set()


def test_circumcircles_are_those_of_the_plane_that_was_triangulated() -> None:
    case = framed(random_inner(3))
    squeezed = case._replace(plane_scale=(0.25, 1.0))
    assert failed(squeezed) == {DELAUNAY}
    triangles = ccw_delaunay(case.nodes * np.array([0.25, 1]))
    assert failed(squeezed._replace(triangles=triangles)) == set()


def test_a_constrained_edge_need_not_be_delaunay(good: Case) -> None:
    flipped = next(m for m in convex_flips(good) if failed(good._replace(triangles=m)))
    before, after = (set(map(tuple, build_edges(t).nodes)) for t in (good.triangles, flipped))
    forced = np.array(sorted(after - before), np.int32)
    # Only a hull may have constraints that are not part of its outline.
    hull = good._replace(triangles=flipped, domain=replace(good.domain, kind="hull", pixels=None))
    unforced = hull._replace(constraints=np.empty((0, 2), np.int32), pixels=None)
    assert failed(unforced) == {DELAUNAY}
    assert failed(unforced._replace(constraints=forced)) == set()


def test_a_slit_passes_though_its_long_side_is_not_delaunay() -> None:
    #  7 ---- 6 3 ---- 2     a slit with depth 30 and width of at most 1; node 4 divides its
    #  |       \4      |     right side. It is inside every circle through the ends of the left
    #  |        5      |     side that does not contain 0 and 7
    #  0 ------------- 1
    nodes = np.array(
        [(0, 0), (40, 0), (40, 40), (20.5, 40), (20.25, 25), (20, 10), (19.5, 40), (0, 40)]
    )
    ids = np.arange(8, dtype=np.int32)
    loop = np.column_stack([ids, np.roll(ids, -1)])
    triangles = np.array(
        [(0, 1, 5), (1, 2, 4), (1, 4, 5), (2, 3, 4), (5, 6, 7), (0, 5, 7)], np.int32
    )
    domain = DomainFacts("valid", 1600 - 15, 1, 0, 1585, 1585)
    case = Case(nodes, triangles, loop, domain, pixels=PixelCounts(1585, 1585))
    assert failed(case) == set()
    unconstrained = build_edges(ccw_delaunay(nodes)).nodes.tolist()
    assert [5, 6] not in unconstrained


def two_squares_that_touch() -> Case:
    """Two squares that share one node, as diagonal islands do."""
    nodes = np.array([(0, 0), (4, 0), (4, 4), (0, 4), (8, 4), (8, 8), (4, 8)], float)
    triangles = np.array([(0, 1, 2), (0, 2, 3), (2, 4, 5), (2, 5, 6)], np.int32)
    loops = np.array([(0, 1), (1, 2), (2, 3), (3, 0), (2, 4), (4, 5), (5, 6), (6, 2)], np.int32)
    return Case(
        nodes, triangles, loops, DomainFacts("valid", 32, 2, 0, 32, 32), pixels=PixelCounts(32, 32)
    )


def test_islands_that_touch_in_a_node_pass() -> None:
    assert failed(two_squares_that_touch()) == set()


def test_a_frame_with_a_hole_passes_and_its_hole_is_counted() -> None:
    outer = np.array([(0, 0), (9, 0), (9, 9), (0, 9)], float)
    inner = np.array([(3, 3), (3, 6), (6, 6), (6, 3)], float)
    ids = np.arange(4, dtype=np.int32)
    loop = np.column_stack([ids, np.roll(ids, -1)])
    nodes, loops = np.concatenate([outer, inner]), np.concatenate([loop, loop + 4])
    triangles = np.array(
        [(0, 1, 4), (1, 7, 4), (1, 2, 7), (2, 6, 7), (2, 3, 6), (3, 5, 6), (3, 0, 5), (0, 4, 5)],
        np.int32,
    )
    case = Case(
        nodes, triangles, loops, DomainFacts("valid", 72, 1, 1, 72, 72), pixels=PixelCounts(72, 72)
    )
    assert failed(case) == set()
    assert failed(case._replace(domain=replace(case.domain, holes=0))) == {EULER}


def test_without_pixel_counts_the_certificate_says_so(good: Case) -> None:
    certificate = good._replace(pixels=None).certify()
    assert certificate.passed
    (check,) = [check for check in certificate.checks if PIXELS in check.name]
    assert "not checked" in check.detail


# Meshes that fail


def flipped_triangle(case: Case) -> Case:
    triangles = case.triangles.copy()
    one = inner_triangle(case)
    triangles[one] = triangles[one, ::-1]
    return case._replace(triangles=triangles)


def all_clockwise(case: Case) -> Case:
    return case._replace(triangles=case.triangles[:, ::-1])


def removed_triangle(case: Case) -> Case:
    return case._replace(triangles=np.delete(case.triangles, inner_triangle(case), axis=0))


def removed_border_triangle(case: Case) -> Case:
    border = np.flatnonzero((neighbours(case.triangles) == -1).sum(axis=1) == 1)[0]
    return case._replace(triangles=np.delete(case.triangles, border, axis=0))


def duplicated_triangle(case: Case) -> Case:
    one = case.triangles[[inner_triangle(case)]]
    return case._replace(triangles=np.concatenate([case.triangles, one]))


def duplicated_corner_triangle(case: Case) -> Case:
    """A triangle with two edges on the frame, so that only one edge occurs three times."""
    nodes = np.array([(0, 0), (4, 0), (4, 4), (0, 4)], float)
    loop = np.array([(0, 1), (1, 2), (2, 3), (3, 0)], np.int32)
    triangles = np.array([(0, 1, 2), (0, 2, 3), (0, 1, 2)], np.int32)
    return Case(
        nodes, triangles, loop, DomainFacts("image", 16, 1, 0, 16, 16), pixels=PixelCounts(16, 16)
    )


def triangle_on_top(case: Case) -> Case:
    """An additional triangle of distant nodes, which covers other triangles."""
    return case._replace(triangles=np.concatenate([case.triangles, [[0, 5, 10]]]))


def fold(case: Case) -> Case:
    """A node that is moved across an edge opposite to it."""
    node = inner_node(case)
    one, corner = np.argwhere(case.triangles == node)[0]
    ends = case.nodes[np.delete(case.triangles[one], corner)]
    nodes = case.nodes.copy()
    nodes[node] += 1.2 * (ends.mean(axis=0) - nodes[node])
    return case._replace(nodes=nodes)


def winds_twice(case: Case) -> Case:
    """A fan that goes around its centre twice. All its triangles and edges are valid."""
    angles = np.arange(12) * (2 * np.pi / 6)
    rim = (
        np.column_stack([np.cos(angles), np.sin(angles)])
        * np.where(np.arange(12) < 6, 9, 10.0)[:, None]
    )
    ids = np.arange(1, 13, dtype=np.int32)
    loop = np.column_stack([ids, np.roll(ids, -1)])
    triangles = np.column_stack([np.zeros(12, np.int32), loop])
    area = 6 * math.sqrt(3) / 4 * 100
    return Case(
        np.concatenate([[(0, 0)], rim]),
        triangles,
        loop,
        DomainFacts("valid", area, 1, 0, 260, 260),
        pixels=PixelCounts(260, 260),
    )


def unused_node(case: Case) -> Case:
    return case._replace(nodes=np.concatenate([case.nodes, [[1.25, 1.25]]]))


def duplicate_node(case: Case) -> Case:
    """Two nodes at the same place: the triangles between them have no area."""
    nodes = case.nodes.copy()
    one = case.triangles[inner_triangle(case)]
    nodes[one[0]] = nodes[one[1]]
    return case._replace(nodes=nodes)


def shuffled_coordinates(case: Case) -> Case:
    """The same triangles and the same positions, but in a different order."""
    return case._replace(nodes=np.random.default_rng(1).permutation(case.nodes))


def seam(case: Case) -> Case:
    """Two halves of a square that touch but do not share nodes."""
    nodes = np.array([(0, 0), (4, 0), (4, 4), (0, 0), (4, 4), (0, 4)], float)
    loop = np.array([(0, 1), (1, 2), (4, 5), (5, 3)], np.int32)
    triangles = np.array([(0, 1, 2), (3, 4, 5)], np.int32)
    return Case(
        nodes, triangles, loop, DomainFacts("image", 16, 1, 0, 16, 16), pixels=PixelCounts(16, 16)
    )


def nan_node(case: Case) -> Case:
    nodes = case.nodes.copy()
    nodes[inner_node(case), 1] = np.nan
    return case._replace(nodes=nodes)


def infinite_node(case: Case) -> Case:
    nodes = case.nodes.copy()
    nodes[inner_node(case), 0] = np.inf
    return case._replace(nodes=nodes)


def bad_flip(case: Case) -> Case:
    return case._replace(triangles=convex_flips(case)[0])


def missing_constraint(case: Case) -> Case:
    return case._replace(constraints=np.concatenate([case.constraints, [[0, 10]]]))


def outline_without_a_segment(case: Case) -> Case:
    return case._replace(constraints=case.constraints[1:])


def too_few_pixels(case: Case) -> Case:
    return case._replace(pixels=PixelCounts(SIDE * SIDE - 1, SIDE * SIDE - 1))


def a_pixel_twice(case: Case) -> Case:
    return case._replace(pixels=PixelCounts(SIDE * SIDE + 1, SIDE * SIDE))


def more_valid_pixels_than_there_are(case: Case) -> Case:
    facts = replace(case.domain, valid_pixels=SIDE * SIDE - 10)
    return case._replace(domain=facts)


def no_triangles(case: Case) -> Case:
    return case._replace(triangles=np.empty((0, 3), np.int32))


def two_components_told(case: Case) -> Case:
    return case._replace(domain=replace(case.domain, components=2))


def another_area(case: Case) -> Case:
    return case._replace(domain=replace(case.domain, area=SIDE * SIDE + 1e-3))


BROKEN: list[Any] = [
    # how it is broken, checks that must fail, other checks that may fail
    (flipped_triangle, {ORIENTATION, MANIFOLD}, {AREA, DELAUNAY, BOUNDARY}),
    (all_clockwise, {ORIENTATION, AREA}, set()),
    (removed_triangle, {AREA, BOUNDARY, EULER}, set()),
    (removed_border_triangle, {AREA, BOUNDARY}, set()),
    (duplicated_triangle, {MANIFOLD, AREA}, {EULER, DELAUNAY, BOUNDARY}),
    (duplicated_corner_triangle, {MANIFOLD, AREA}, {EULER, DELAUNAY, BOUNDARY}),
    (triangle_on_top, {AREA, BOUNDARY}, {EULER, DELAUNAY, MANIFOLD}),
    (fold, {ORIENTATION}, {DELAUNAY}),
    (winds_twice, {AREA, ANGLES}, {DELAUNAY}),
    (unused_node, {NODES}, set()),
    (duplicate_node, {NODES, ORIENTATION}, {DELAUNAY}),
    (shuffled_coordinates, {ORIENTATION}, {AREA, DELAUNAY}),
    (seam, {NODES, BOUNDARY}, {EULER}),
    (nan_node, {NODES, ORIENTATION, AREA}, {DELAUNAY}),
    (infinite_node, {NODES, AREA}, {ORIENTATION, DELAUNAY}),
    (bad_flip, {DELAUNAY}, set()),
    (missing_constraint, {BOUNDARY}, set()),
    (outline_without_a_segment, {BOUNDARY}, set()),
    (too_few_pixels, {PIXELS}, set()),
    (a_pixel_twice, {PIXELS}, set()),
    (more_valid_pixels_than_there_are, {PIXELS}, set()),
    (no_triangles, {NODES, AREA, BOUNDARY, EULER}, set()),
    (two_components_told, {EULER}, set()),
    (another_area, {AREA}, set()),
]


@pytest.mark.filterwarnings("ignore:invalid value encountered:RuntimeWarning")
@pytest.mark.parametrize(
    ("broken", "must", "may"), BROKEN, ids=[case[0].__name__ for case in BROKEN]
)
def test_a_broken_mesh_fails_the_right_check(broken, must: set, may: set, good: Case) -> None:
    case = broken(good)
    found = failed(case)
    assert must <= found
    # The sum of angles is wrong wherever triangles are folded, duplicated or missing.
    assert found <= must | may | ({ANGLES} if len(must - {BOUNDARY, PIXELS, EULER}) else set())
    certificate = case.certify()
    assert not certificate.passed
    with pytest.raises(CertificateError) as caught:
        certificate.require()
    message = str(caught.value)
    assert "\n" not in message
    for check in certificate.checks:
        assert (check.name in message) == (not check.passed)
        assert (check.detail in message) >= (not check.passed)


@pytest.mark.parametrize("broken", [nan_node, no_triangles])
def test_a_failed_certificate_is_strict_json_too(broken, good: Case) -> None:
    json.dumps(broken(good).certify().to_dict(), allow_nan=False)


def test_every_convex_flip_of_a_mesh_in_general_position_is_found(good: Case) -> None:
    flips = convex_flips(good)
    assert len(flips) > 50
    for mesh in flips:
        assert failed(good._replace(triangles=mesh)) == {DELAUNAY}


@pytest.mark.filterwarnings("ignore:invalid value encountered:RuntimeWarning")
@pytest.mark.parametrize(
    ("broken", "must", "may"), BROKEN, ids=[case[0].__name__ for case in BROKEN]
)
def test_a_mesh_that_need_not_be_delaunay_has_all_other_checks(
    broken, must: set, may: set, good: Case
) -> None:
    case = broken(good)
    assert failed(case._replace(delaunay=False)) == failed(case) - {DELAUNAY}
    names = {check.name for check in case.certify().checks}
    others = {check.name for check in case._replace(delaunay=False).certify().checks}
    assert {name for name in names if DELAUNAY in name} == names - others
    assert others < names


def test_a_hull_need_not_be_constrained_but_must_be_covered(good: Case) -> None:
    none = np.empty((0, 2), np.int32)
    hull = good._replace(constraints=none, domain=replace(good.domain, kind="hull", pixels=None))
    assert failed(hull) == set()
    dented = removed_border_triangle(hull._replace(pixels=None))
    assert failed(dented) == {AREA, ANGLES}
    # Even a very small dent means that it is not a hull.
    assert ANGLES in failed(dented._replace(domain=replace(dented.domain, area=SIDE**2 - 1e-9)))
    assert failed(missing_constraint(hull._replace(pixels=None))) == {BOUNDARY}
    twice = hull._replace(pixels=PixelCounts(SIDE * SIDE, SIDE * SIDE + 1))
    assert failed(twice) == {PIXELS}


# Compared with exact arithmetic


@st.composite
def flipped_lattice_meshes(draw: st.DrawFn) -> Case:
    """Lattice points, many of them cocircular, after some flips of edges."""
    places = draw(
        st.sets(st.tuples(st.integers(1, 11), st.integers(1, 11)), min_size=1, max_size=25)
    )
    case = framed(np.array(sorted(places), float), side=12, step=4)
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    for _ in range(draw(st.integers(0, 3))):
        flips = convex_flips(case)
        if flips:
            case = case._replace(triangles=flips[rng.integers(len(flips))])
    return case


def exact_counts(case: Case) -> str:
    """Return the expected detail of the check of circumcircles, computed exactly."""
    edges = build_edges(case.triangles)
    values = []
    for left, right in zip(edges.left, edges.right, strict=True):
        if min(left, right) >= 0:
            (apex,) = set(case.triangles[right].tolist()) - set(case.triangles[left].tolist())
            values.append(exact_incircle(case.nodes, case.triangles[left], apex))
    inside, tied = sum(value > 0 for value in values), sum(value == 0 for value in values)
    return f"{len(values)} edges tested, {inside} violations, {tied} cocircular"


@given(flipped_lattice_meshes())
def test_violations_and_ties_are_counted_exactly(case: Case) -> None:
    (check,) = (check for check in case.certify().checks if DELAUNAY in check.name)
    assert exact_counts(case) in check.detail


@given(st.integers(0, 2**32 - 1), st.integers(1, 20))
def test_whatever_the_damage_there_is_a_certificate(seed: int, count: int) -> None:
    rng = np.random.default_rng(seed)
    case = framed(random_inner(7))
    triangles = case.triangles.copy()
    rows = rng.integers(0, len(triangles), count)
    triangles[rows] = rng.integers(0, len(case.nodes), (count, 3))
    certificate = case._replace(triangles=triangles).certify()
    assert not certificate.passed
    assert len(certificate.checks) == 9


def test_an_edge_without_a_far_side_is_not_taken_for_one_with_it(good: Case) -> None:
    turned = flipped_triangle(good)
    edges = build_edges(turned.triangles)
    (check,) = (check for check in turned.certify().checks if DELAUNAY in check.name)
    two_sided = (edges.uses == 2) & (edges.left >= 0) & (edges.right >= 0)
    assert check.detail.startswith(f"{np.count_nonzero(two_sided)} edges tested")
    assert np.count_nonzero(two_sided) < np.count_nonzero(edges.uses == 2)


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 3)), min_size=1), st.booleans())
def test_duplicates_are_counted_in_any_order(places: list[tuple[int, int]], ordered: bool) -> None:
    if ordered:
        places = sorted(places, key=lambda place: place[::-1])
    case = two_squares_that_touch()._replace(nodes=np.array([*places, *[(9, 9)] * 7], float))
    (check,) = (check for check in case.certify().checks if NODES in check.name)
    repeated = len(places) - len(set(places)) + 6
    assert f"{repeated} duplicate" in check.detail


def test_a_certificate_does_not_depend_on_how_many_triangles_are_seen_at_once(
    good: Case, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = good.certify()
    monkeypatch.setattr("geomesh.arrays.table._BLOCK", 7)
    assert good.certify() == whole


@pytest.mark.slow
@given(flipped_lattice_meshes())
def test_a_lattice_mesh_passes_just_where_no_node_is_in_a_circumcircle(case: Case) -> None:
    empty = all(
        exact_incircle(case.nodes, triangle, query) <= 0
        for triangle in case.triangles
        for query in range(len(case.nodes))
        if query not in triangle
    )
    assert failed(case) == (set() if empty else {DELAUNAY})
