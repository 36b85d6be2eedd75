"""Topology: two triangles written by hand, and brute force over random triangulations."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial import Delaunay

from geomesh.mesh.topology import (
    FILL,
    boundary_edges,
    build_edges,
    edge_keys,
    euler_number,
    find_edges,
    neighbours,
)

#   3 --- 2      triangle 0: 0 1 2
#   |   / |      triangle 1: 0 2 3
#   | /   |      counter-clockwise, y up
#   0 --- 1
PAIR = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
NONE = np.empty((0, 3), np.int32)


def disc(rows: int, cols: int) -> np.ndarray:
    """Return counter-clockwise triangles of a lattice, two for each cell, row by row."""
    first = (np.arange(rows)[:, None] * (cols + 1) + np.arange(cols)).ravel()
    right, up = first + 1, first + cols + 1
    cells = np.stack([np.stack([first, right, up + 1]), np.stack([first, up + 1, up])])
    return np.ascontiguousarray(cells.transpose(2, 0, 1).reshape(-1, 3), np.int32)


@st.composite
def triangulations(draw: st.DrawFn) -> tuple[np.ndarray, np.ndarray]:
    """Points and counter-clockwise Delaunay triangles, with random numbers and first corners."""
    seed = draw(st.integers(0, 2**32 - 1))
    count = draw(st.integers(3, 40))
    rng = np.random.default_rng(seed)
    points = rng.random((count, 2))
    triangles = Delaunay(points).simplices
    corners = points[triangles]
    ab, ac = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    clockwise = ab[:, 0] * ac[:, 1] < ab[:, 1] * ac[:, 0]
    triangles[clockwise] = triangles[clockwise][:, ::-1]
    turns = rng.integers(0, 3, len(triangles))[:, None]
    triangles = np.take_along_axis(triangles, (np.arange(3) + turns) % 3, axis=1)
    return points, rng.permutation(triangles).astype(np.int32)


def directed(triangle: np.ndarray) -> list[tuple[int, int]]:
    a, b, c = map(int, triangle)
    return [(a, b), (b, c), (c, a)]


def owners(triangles: np.ndarray) -> dict[tuple[int, int], int]:
    """Return the triangle of each directed edge."""
    return {pair: t for t, triangle in enumerate(triangles) for pair in directed(triangle)}


# Examples by hand


def test_edges_of_two_triangles() -> None:
    edges = build_edges(PAIR)
    assert edges.nodes.tolist() == [[0, 1], [0, 2], [0, 3], [1, 2], [2, 3]]
    assert edges.left.tolist() == [0, 1, FILL, 0, 1]
    assert edges.right.tolist() == [FILL, 0, 1, FILL, FILL]
    assert edges.uses.tolist() == [1, 2, 1, 1, 1]
    assert all(array.dtype == np.int32 for array in edges)


def test_neighbours_of_two_triangles_lie_opposite_to_the_corner() -> None:
    assert neighbours(PAIR).tolist() == [[FILL, 1, FILL], [FILL, FILL, 0]]
    assert neighbours(PAIR).dtype == np.int32


def test_boundary_of_two_triangles_runs_counter_clockwise() -> None:
    pairs = set(map(tuple, boundary_edges(PAIR).tolist()))
    assert pairs == {(0, 1), (1, 2), (2, 3), (3, 0)}


def test_a_turned_triangle_runs_along_both_its_edges_twice() -> None:
    turned = np.array([[0, 1, 2], [0, 3, 2]], np.int32)
    shared = build_edges(turned).nodes.tolist().index([0, 2])
    assert build_edges(turned).uses[shared] == 2
    assert build_edges(turned).left[shared] == FILL


def test_an_edge_of_three_triangles_says_so() -> None:
    fan = np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4]], np.int32)
    edges = build_edges(fan)
    assert edges.uses[edges.nodes.tolist().index([0, 1])] == 3


def test_no_triangles_have_no_topology() -> None:
    edges = build_edges(NONE)
    assert edges.nodes.shape == (0, 2)
    assert neighbours(NONE).shape == (0, 3)
    assert boundary_edges(NONE).shape == (0, 2)
    assert euler_number(NONE) == 0


def test_one_triangle_has_no_neighbours() -> None:
    alone = np.array([[7, 3, 5]], np.int32)
    assert neighbours(alone).tolist() == [[FILL] * 3]
    assert set(map(tuple, boundary_edges(alone).tolist())) == {(7, 3), (3, 5), (5, 7)}


@given(st.lists(st.tuples(st.integers(0, 2**31 - 1), st.integers(0, 2**31 - 1)), min_size=2))
def test_edge_keys_tell_pairs_apart_whatever_their_direction(
    pairs: list[tuple[int, int]],
) -> None:
    keys = edge_keys(np.array(pairs, np.int32))
    assert keys.dtype == np.int64
    assert edge_keys(np.array(pairs, np.int32)[:, ::-1]).tolist() == keys.tolist()
    distinct = {tuple(sorted(pair)) for pair in pairs}
    assert len(set(keys.tolist())) == len(distinct)


# Compared with brute force


@given(triangulations())
def test_edges_are_those_that_brute_force_finds(mesh: tuple[np.ndarray, np.ndarray]) -> None:
    _, triangles = mesh
    runs = owners(triangles)
    uses = Counter(tuple(sorted(pair)) for triangle in triangles for pair in directed(triangle))
    edges = build_edges(triangles)
    found = list(map(tuple, edges.nodes.tolist()))
    assert found == sorted(uses)
    assert edges.uses.tolist() == [uses[pair] for pair in found]
    assert edges.left.tolist() == [runs.get((low, high), FILL) for low, high in found]
    assert edges.right.tolist() == [runs.get((high, low), FILL) for low, high in found]


damaged = st.lists(st.tuples(*[st.integers(0, 6)] * 3), max_size=12)


@given(damaged, st.lists(st.tuples(st.integers(0, 8), st.integers(0, 8)), max_size=9))
def test_edges_of_any_triangles_are_those_of_a_dictionary(
    rows: list[tuple[int, int, int]], wanted: list[tuple[int, int]]
) -> None:
    triangles = np.array(rows, np.int32).reshape(-1, 3)
    uses: Counter[tuple[int, int]] = Counter()
    left, right = {}, {}
    for corner in range(3):
        for t, triangle in enumerate(rows):
            a, b = triangle[corner], triangle[(corner + 1) % 3]
            pair = min(a, b), max(a, b)
            uses[pair] += 1
            (left if a < b else right)[pair] = t  # if there are several, the last one
    pairs = sorted(uses)
    edges = build_edges(triangles)
    assert list(map(tuple, edges.nodes.tolist())) == pairs
    assert edges.uses.tolist() == [uses[pair] for pair in pairs]
    assert edges.left.tolist() == [left.get(pair, FILL) for pair in pairs]
    assert edges.right.tolist() == [right.get(pair, FILL) for pair in pairs]
    place = {pair: k for k, pair in enumerate(pairs)}
    found = find_edges(edges, np.array(wanted, np.int32).reshape(-1, 2))
    assert found.tolist() == [place.get((min(pair), max(pair)), FILL) for pair in wanted]
    once = [pair if pair in left else pair[::-1] for pair in pairs if uses[pair] == 1]
    assert list(map(tuple, boundary_edges(triangles).tolist())) == once


def test_a_negative_node_has_no_edges() -> None:
    with pytest.raises(ValueError, match="node id -2"):
        build_edges(np.array([[0, 1, -2]], np.int32))


@given(triangulations())
def test_the_left_triangle_is_on_the_left_hand(mesh: tuple[np.ndarray, np.ndarray]) -> None:
    points, triangles = mesh
    edges = build_edges(triangles)
    start, way = points[edges.nodes[:, 0]], points[edges.nodes[:, 1]] - points[edges.nodes[:, 0]]
    centres = points[triangles].mean(axis=1)
    for side, hand in ((edges.left, 1), (edges.right, -1)):
        there = side != FILL
        off = centres[side[there]] - start[there]
        turn = way[there, 0] * off[:, 1] - way[there, 1] * off[:, 0]
        assert (np.sign(turn) == hand).all()


@given(triangulations())
def test_neighbours_are_those_of_qhull(mesh: tuple[np.ndarray, np.ndarray]) -> None:
    points, triangles = mesh
    qhull = Delaunay(points)
    name = {frozenset(nodes): t for t, nodes in enumerate(map(tuple, triangles.tolist()))}
    found = neighbours(triangles)
    for nodes, across in zip(qhull.simplices.tolist(), qhull.neighbors.tolist(), strict=True):
        here = name[frozenset(nodes)]
        # In Qhull too, neighbour k is opposite to corner k of the triangle.
        expected = {
            node: FILL if other < 0 else name[frozenset(qhull.simplices[other].tolist())]
            for node, other in zip(nodes, across, strict=True)
        }
        assert dict(zip(triangles[here].tolist(), found[here].tolist(), strict=True)) == expected


@given(triangulations())
def test_the_boundary_is_the_convex_hull_counter_clockwise(
    mesh: tuple[np.ndarray, np.ndarray],
) -> None:
    points, triangles = mesh
    pairs = boundary_edges(triangles)
    hull = {frozenset(pair) for pair in Delaunay(points).convex_hull.tolist()}
    assert {frozenset(pair) for pair in pairs.tolist()} == hull
    assert len(pairs) == len(hull)
    x, y = points.T
    start, stop = pairs.T
    # All other points are on the left of each edge of the hull.
    turn = (x[stop] - x[start])[:, None] * (y - y[start][:, None])
    turn -= (y[stop] - y[start])[:, None] * (x - x[start][:, None])
    assert (turn > -1e-9).all()


@given(triangulations())
def test_a_boundary_is_closed(mesh: tuple[np.ndarray, np.ndarray]) -> None:
    pairs = boundary_edges(mesh[1])
    assert sorted(pairs[:, 0]) == sorted(pairs[:, 1])


@given(triangulations())
def test_a_convex_mesh_has_euler_number_one(mesh: tuple[np.ndarray, np.ndarray]) -> None:
    assert euler_number(mesh[1]) == 1


@settings(max_examples=30)
@given(triangulations(), st.integers(0, 1000))
def test_euler_number_does_not_count_unused_nodes(
    mesh: tuple[np.ndarray, np.ndarray], shift: int
) -> None:
    assert euler_number(mesh[1] + np.int32(shift)) == 1


# Discs and rings

DISC = disc(3, 3)
CENTRE_CELL = [8, 9]  # the two triangles of the middle cell
ANNULUS = np.delete(DISC, CENTRE_CELL, axis=0)
TWO_DISCS = np.concatenate([DISC, DISC + 100])
PINCHED = np.concatenate([PAIR, PAIR[:, [0, 1, 2]] + 10])
PINCHED[PINCHED == 10] = 2  # both squares share node 2


@pytest.mark.parametrize(
    ("triangles", "expected"),
    [
        pytest.param(DISC, 1, id="disc"),
        pytest.param(ANNULUS, 0, id="annulus"),
        pytest.param(TWO_DISCS, 2, id="two components"),
        pytest.param(np.concatenate([ANNULUS, ANNULUS + 100]), 0, id="two annuli"),
        pytest.param(np.concatenate([ANNULUS, DISC + 100]), 1, id="annulus and disc"),
        pytest.param(PINCHED, 1, id="two squares that share a node"),
        pytest.param(np.delete(disc(3, 5), [12, 13, 16, 17], axis=0), -1, id="two holes"),
    ],
)
def test_euler_number(triangles: np.ndarray, expected: int) -> None:
    assert euler_number(triangles) == expected


def test_the_hole_of_an_annulus_is_bounded_clockwise() -> None:
    pairs = set(map(tuple, boundary_edges(ANNULUS).tolist()))
    # Nodes of the middle cell of a 4 x 4 lattice, counter-clockwise: 5 6 10 9.
    assert {(6, 5), (10, 6), (9, 10), (5, 9)} <= pairs
    assert len(pairs) == 12 + 4
