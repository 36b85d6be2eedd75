"""Removal of nodes against brute force, and random sequences of all changes of a block."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from geomesh.refine.block import Block
from geomesh.refine.connect import can_merge
from geomesh.refine.moments import LINEAR, image_of
from geomesh.refine.node_system import new_room
from geomesh.refine.patch import FREE, SHARED, SHARED_TWICE, STAYS, TWO_FANS
from geomesh.refine.refined import start_part
from geomesh.refine.remove import NEVER, remove_nodes
from geomesh.refine.star import MOST_AROUND, Star, new_star
from support.refine import (
    MODELS,
    as_triangles,
    best_step,
    between,
    brute_error,
    check_block,
    check_topology,
    degrees,
    grid_part,
    hard_ends,
    hard_lines,
    outline,
    picture,
    pixel_errors,
    random_block,
    rounding,
    same_lines,
    sampled,
    smallest,
)

SEEDS = range(6)


def removal_costs(block: Block) -> np.ndarray:
    costs = np.full(block.patch.size[0], NEVER)
    remove_nodes(
        *(block.patch, block.surface, block.image, new_star(), new_star()),
        *(new_room(block.surface.values.shape[1]), np.arange(len(costs))),
        *(np.zeros(len(costs), np.bool_), costs, block.floor, 0, block.model),
    )
    return costs


def brute_cost(block, part, pixels, valid, v):
    """Return the least growth of the error if node `v` is merged into a neighbour."""
    points, triangles, lines = part.points, part.triangles, hard_ends(part)
    if part.held[v] != FREE or (lines[v] and not between(points, v, lines[v])):
        return NEVER
    at_v = (triangles == v).any(axis=1)
    growths = []
    for u in set(triangles[at_v].ravel().tolist()) - {v}:
        if part.held[u] >= SHARED_TWICE or (lines[v] and u not in lines[v]):
            continue
        at_u = (triangles == u).any(axis=1)
        new = np.where(triangles[at_v & ~at_u] == v, u, triangles[at_v & ~at_u])
        a, b, c = points[new].swapaxes(0, 1)
        doubled = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
        if (doubled < 0.1).any() or smallest(points, new) < block.floor:
            continue
        star = np.vstack([triangles[at_u & ~at_v], new])
        values = part.values.copy()
        if block.model == LINEAR and part.held[u] < SHARED:
            values[u] += best_step(points, values, star, u, pixels, valid)
        old = triangles[at_u | at_v]
        one, other = (
            pixel_errors(points, known, rows, pixels, valid, block.model).sum()
            for known, rows in ((part.values, old), (values, star))
        )
        growths.append(other - one)
    return min(growths, default=NEVER)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("seed", SEEDS)
def test_costs_of_removal_are_those_of_the_pixels(seed, model):
    _, part, pixels, valid = random_block(seed, model, cols=4, spacing=8)
    rng = np.random.default_rng(seed)
    held = rng.choice([FREE, STAYS, SHARED, SHARED_TWICE], len(part.points), p=[0.7, *[0.1] * 3])
    part = replace(part, held=np.maximum(part.held, held).astype(np.uint8))
    block = Block(part, image_of(pixels, valid), degrees(8), model)
    expected = [brute_cost(block, part, pixels, valid, v) for v in range(len(part.points))]
    assert sum(cost < NEVER for cost in expected) >= 2
    np.testing.assert_allclose(removal_costs(block), expected, rtol=1e-9, atol=1e-5)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("seed", SEEDS)
def test_removals_keep_area_outline_and_lines(seed, model):
    block, part, pixels, valid = random_block(seed, model)
    block.grow(block.own + 30, 2)
    grown = block.part()
    angle = smallest(grown.points, grown.triangles)
    removed = block.shrink(8)
    assert removed == 8
    # No two of them were neighbours.
    left = set(map(tuple, block.part().points.tolist()))
    is_gone = np.array([tuple(point) not in left for point in grown.points.tolist()])
    assert is_gone.sum() == 8
    assert is_gone[grown.triangles].sum(axis=1).max() == 1
    for _ in range(3):
        removed += block.shrink(1000)
    check_block(block)
    now = block.part()
    assert len(now.points) == len(grown.points) - removed == block.own
    assert smallest(now.points, now.triangles) >= min(block.floor, angle) - 1e-12
    assert shapely.area(shapely.polygons(now.points[now.triangles])).sum() == outline(part).area
    assert outline(now).equals(outline(part))
    lines = hard_lines(part.points, part.triangles, part.hard)
    assert same_lines(hard_lines(now.points, now.triangles, now.hard), lines)
    assert block.error == pytest.approx(brute_error(now, pixels, valid, model))
    # Corners of the lines are there as before.
    ends = hard_ends(part)
    corners = [v for v in ends if ends[v] and not between(part.points, v, ends[v])]
    assert set(corners) <= set(now.ids.tolist())


@pytest.mark.parametrize("held", [SHARED, SHARED_TWICE])
def test_nodes_of_two_fans_are_never_merged_into(held):
    corners = [[0, 0], [8, 0], [8, 8], [0, 8]]
    triangles = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]], np.int32)
    nodes = np.array([*corners, [4, 4]], float)
    part = start_part(nodes, triangles, np.empty((0, 2), np.int32), np.zeros(5, bool), 1)
    part = replace(part, points=part.points - 0.5, held=np.array([*[held] * 4, FREE], np.uint8))
    block = Block(part, image_of(np.ones((1, 8, 8)), np.ones((8, 8), bool)), degrees(10))
    assert block.shrink(5) == (held == SHARED)
    assert len(block.part().triangles) == (2 if held == SHARED else 4)
    check_block(block)


def test_neighbours_merge_only_if_they_share_no_more_than_the_triangles_at_their_edge():
    def star(ring):
        return Star(*(np.array(a) for a in (ring, ring, ring, np.roll(ring, -1))))

    def merges(one, other, closed=True, other_closed=True, along=False):
        one, other = star(one), star(other)
        lengths = (len(s.first) - (not done) for s, done in ((one, closed), (other, other_closed)))
        m, n = lengths
        return can_merge.py_func(one, m, closed, other, n, other_closed, along)

    assert merges([1, 2, 3, 4], [0, 2, 7, 4])
    assert not merges([1, 2, 3, 4], [0, 2, 3, 4])
    assert not merges([1, 2, 3, 4], [0, 2, 8, 3, 9, 4])
    # Open stars end at their last neighbour.
    assert merges([1, 2, 3], [5, 2, 0], closed=False, other_closed=False, along=True)
    assert not merges([1, 2, 3], [5, 3, 2, 0], closed=False, other_closed=False, along=True)
    assert merges([1, 2, 3, 4], [2, 0, 4], other_closed=False)


@pytest.mark.parametrize("model", MODELS)
def test_nodes_with_too_many_triangles_are_left_alone(model):
    """Two hubs: merged, one node would have more triangles than a star has room for."""
    count = MOST_AROUND // 2 + 8
    turn = np.linspace(0, np.pi, count)
    arc = np.column_stack([np.sin(turn), -np.cos(turn)]) * 60
    right, left = arc + 72, arc[::-1] * [-1, 1] + [56, 72]
    nodes = np.rint(np.vstack([[[72, 72], [56, 72]], right, left]) * 256) / 256
    ring = [*range(2, 2 + 2 * count)]
    triangles = [[0, a, b] for a, b in pairwise(ring[:count])]
    triangles += [[1, a, b] for a, b in pairwise(ring[count:])]
    triangles += [[0, ring[count - 1], 1], [1, ring[count - 1], ring[count]]]
    triangles += [[0, 1, ring[0]], [1, ring[-1], ring[0]]]
    part = start_part(
        nodes - 0.5,
        np.array(triangles, np.int32),
        np.empty((0, 2), np.int32),
        np.arange(len(nodes)) >= 2,
        1,
    )
    check_topology(part.points, part.triangles, part.across, part.hard)
    pixels, valid = picture(np.random.default_rng(1), part)
    part = replace(part, values=sampled(part, pixels))
    block = Block(part, image_of(pixels, valid), 0.0, model)
    assert block.shrink(1) == 1
    check_block(block)
    assert np.bincount(block.part().triangles.ravel()).max() <= MOST_AROUND
    block.relax(2)
    block.flip()
    check_block(block)


OPERATIONS = {
    "grow": lambda block: block.grow(block.own + 7, 2),
    "replace": lambda block: block.replace(0.2, block.own),
    "flip": lambda block: block.flip(),
    "relax": lambda block: block.relax(2),
    "values": lambda block: block.relax(2, moving=False),
    "shrink": lambda block: block.shrink(6),
    "adjust": lambda block: block.adjust(block.own - 5, 1),
    "finish": lambda block: block.finish(1),
    "reload": lambda block: block._load(block.part(), 3),
}
NEVER_WORSE = {"flip", "relax", "values", "finish", "reload"}


@given(
    st.integers(0, 2**32 - 1),
    st.sampled_from(MODELS),
    st.sampled_from([0, 0, 10, 25]),
    st.booleans(),
    st.booleans(),
    st.integers(0, 12),
    st.sampled_from([0, 0.3, 0.9, 1]),
    st.lists(st.sampled_from(sorted(OPERATIONS)), min_size=2, max_size=8),
)
@settings(max_examples=50)
def test_any_sequence_of_changes_keeps_the_mesh(
    seed, model, angle, notch, touches, breaks, missing, operations
):
    rng = np.random.default_rng(seed)
    shape = {"notch": notch, "touches": touches, "breaks": breaks}
    part = grid_part(rng, **shape, bands=1 + seed % 2, stays=0.05)
    pixels, valid = picture(rng, part, missing=missing)
    shared = rng.random(len(part.points)) < 0.05
    held = np.where(shared, np.maximum(part.held, SHARED), part.held).astype(np.uint8)
    part = replace(part, values=sampled(part, pixels), held=held)
    floor = degrees(angle)
    block = Block(part, image_of(pixels, valid), floor, model)
    lines = hard_lines(part.points, part.triangles, part.hard)
    least = min(floor, smallest(part.points, part.triangles))
    for operation in operations:
        before = block.error
        OPERATIONS[operation](block)
        check_block(block)
        now = block.part()
        if operation in NEVER_WORSE:
            assert block.error <= before * (1 + 1e-9) + rounding(block)
        assert smallest(now.points, now.triangles) >= least - 1e-12
        assert outline(now).symmetric_difference(outline(part)).area < 1e-6
        assert same_lines(hard_lines(now.points, now.triangles, now.hard), lines)
        assert block.own == np.isin(now.held, [FREE, STAYS, TWO_FANS]).sum()
    expected = brute_error(now, pixels, valid, model)
    assert block.error == pytest.approx(expected, rel=1e-9, abs=10 * rounding(block))
    for v in np.flatnonzero(part.held != FREE):
        at = int(np.flatnonzero(now.ids == v)[0])
        np.testing.assert_array_equal(now.points[at], part.points[v])
        if part.held[v] >= SHARED:
            np.testing.assert_array_equal(now.values[at], part.values[v])
    check_topology(now.points, now.triangles, now.across, now.hard)
    again = Block(now, image_of(pixels, valid), floor, model).part()
    assert as_triangles(again) == as_triangles(now)
