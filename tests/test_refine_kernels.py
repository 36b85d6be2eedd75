"""The kernels of refinement on small meshes, against plain loops over triangles and pixels."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from geomesh.raster.grid import Window
from geomesh.refine.block import Block
from geomesh.refine.flip_edges import flip_edges
from geomesh.refine.insert import insert_where_worst
from geomesh.refine.moments import LINEAR, Surface, image_of, measure_all
from geomesh.refine.node_system import new_room
from geomesh.refine.patch import FREE, SHARED, STAYS, Patch
from geomesh.refine.split import new_log
from geomesh.zonal.owners import find_owners
from support.refine import (
    MODELS,
    best_step,
    between,
    brute_error,
    check_block,
    degrees,
    grid_part,
    hard_ends,
    hard_lines,
    in_use,
    outline,
    owned_moments,
    picture,
    pixel_errors,
    random_block,
    same_lines,
    smallest,
)

SEEDS = range(6)


def loose(points: np.ndarray, triangles: np.ndarray) -> Patch:
    """Return triangles without neighbours, which may overlap."""
    count = len(triangles)
    return Patch(
        np.array(points, float),
        np.array(triangles, np.int64),
        np.full((count, 3), -1, np.int64),
        np.ones((count, 3), np.uint8),
        np.zeros(len(points), np.int64),
        np.ones(count, bool),
        np.zeros(len(points), np.uint8),
        np.array([len(points), count]),
    )


def moments_of(patch: Patch, pixels: np.ndarray, valid: np.ndarray) -> np.ndarray:
    count, width = len(patch.triangles), 6 + 4 * len(pixels)
    surface = Surface(
        np.zeros((len(patch.points), len(pixels))),
        *(np.zeros((3 * count, width)), np.zeros((count, width)), np.zeros(count)),
    )
    measure_all(patch, surface, image_of(pixels, valid), LINEAR)
    return surface.moments


@pytest.mark.parametrize("seed", SEEDS)
def test_moments_are_exact_sums_over_the_pixels_of_each_triangle(seed):
    rng = np.random.default_rng(seed)
    part = grid_part(rng, bands=1 + seed % 3)
    pixels, valid = picture(rng, part, most=65_535, missing=(0, 0.3)[seed % 2])
    block = Block(part, image_of(pixels, valid), 0.0)
    found = block.surface.moments[: len(part.triangles)]
    expected = [owned_moments(part.points[t], pixels, valid) for t in part.triangles]
    np.testing.assert_array_equal(found, expected)
    # Together they own each pixel once.
    corners = np.array([[-1, -1], [10**3, -1], [-1, 10**3]], float)
    np.testing.assert_array_equal(found.sum(axis=0), owned_moments(corners, pixels, valid))
    # And it is the rule of the statistics.
    owners = find_owners(part.points + 0.5, part.triangles, Window(0, 0, *valid.shape[::-1]))
    counts = np.bincount(owners[valid], minlength=len(part.triangles))
    np.testing.assert_array_equal(found[:, 0], counts)


@pytest.mark.parametrize("step", [1, 1 / 2, 1 / 4, 1 / 256])
def test_crossings_at_pixel_centres_are_exact(step):
    """The centres of many pixels lie on sides: none may change its owner by rounding."""
    rng = np.random.default_rng(3)
    size = 60
    points = np.rint(rng.uniform(-0.5, size - 0.5, (1500, 2)) / step) * step
    points = np.clip(points, -0.5, size - 0.5)
    points[:3] = [[0, 3], [54, 29], [2, 40]]  # 16 rows at a slope of 54/26: 27.000000000000004
    triangles = np.arange(1500).reshape(-1, 3)
    a, b, c = points[triangles].swapaxes(0, 1)
    turned = (b - a)[:, 0] * (c - a)[:, 1] < (b - a)[:, 1] * (c - a)[:, 0]
    triangles[turned] = triangles[turned][:, [0, 2, 1]]
    pixels, valid = rng.integers(0, 256, (1, size, size)).astype(float), np.ones((size, size), bool)
    found = moments_of(loose(points, triangles), pixels, valid)
    expected = [owned_moments(points[t], pixels, valid) for t in triangles]
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("seed", SEEDS)
def test_errors_are_those_of_the_pixels(seed, model):
    block, part, pixels, valid = random_block(seed, model)
    expected = pixel_errors(part.points, part.values, part.triangles, pixels, valid, model)
    found = block.surface.errors[: len(part.triangles)]
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-6)
    assert block.error == pytest.approx(brute_error(part, pixels, valid, model))


@pytest.mark.parametrize("seed", SEEDS)
def test_values_of_one_node_are_those_of_least_squares(seed):
    block, part, pixels, valid = random_block(seed, touches=False)
    for v in range(seed, len(part.points), 5):
        values = block.surface.values[: len(part.points)].copy()
        block.patch.held[:] = SHARED
        block.patch.held[v] = FREE
        block.relax(1, moving=False)
        star = part.triangles[(part.triangles == v).any(axis=1)]
        values[v] += best_step(part.points, values, star, v, pixels, valid)
        found = block.surface.values[: len(part.points)]
        np.testing.assert_allclose(found, values, atol=1e-7)
    np.testing.assert_array_equal(block.part().points, part.points)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("seed", SEEDS)
def test_moves_lower_the_error_and_keep_what_they_must(seed, model):
    _, part, pixels, valid = random_block(seed, model, stays=0.1)
    rng = np.random.default_rng(seed)
    shared = rng.random(len(part.points)) < 0.1
    held = np.where(shared, np.maximum(part.held, SHARED), part.held).astype(np.uint8)
    part = replace(part, held=held)
    floor = degrees(20)
    block = Block(part, image_of(pixels, valid), floor, model)
    lines, ends = hard_lines(part.points, part.triangles, part.hard), hard_ends(part)
    corners = [v for v in ends if ends[v] and not between(part.points, v, ends[v])]
    for _ in range(6):
        before, angle = block.error, smallest(block.part().points, part.triangles)
        block.relax(1)
        assert block.error <= before * (1 + 1e-12)
        now = block.part()
        assert smallest(now.points, part.triangles) >= min(floor, angle) - 1e-12
    check_block(block)
    assert block.error == pytest.approx(brute_error(now, pixels, valid, model), rel=1e-9)
    np.testing.assert_array_equal(now.triangles, part.triangles)
    moved = (now.points != part.points).any(axis=1)
    assert moved.any()
    assert not moved[corners].any()
    assert not moved[part.held != FREE].any()
    assert same_lines(hard_lines(now.points, now.triangles, now.hard), lines)
    for v, line in ends.items():  # exactly, not only up to rounding
        assert between(now.points, v, line) == between(part.points, v, line)
    if model == LINEAR:
        changed = (now.values != part.values).any(axis=1)
        assert not changed[shared].any()
        assert changed[part.held == STAYS].any() == (part.held == STAYS).any()


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("seed", SEEDS)
def test_no_node_raises_the_error_where_hardly_any_move_helps(seed, model):
    block, _, _, _ = random_block(seed, model)
    block.relax(15)
    held = block.patch.held.copy()
    for v in np.flatnonzero(held == FREE):
        block.patch.held[:] = SHARED
        block.patch.held[v] = FREE
        before = block.error
        block.relax(1)
        assert block.error <= before * (1 + 1e-12)


def flippable(patch: Patch, floor: float) -> list[tuple[np.ndarray, np.ndarray, int, int]]:
    """Return what each flip that is allowed would make: the old and new pair, and both numbers."""
    found = []
    for t, k in np.argwhere(patch.alive[:, None] & (patch.hard == 0)).tolist():
        u = int(patch.across[t, k])
        if u < t:
            continue
        a, b, d = np.roll(patch.triangles[t], -k)
        e = next(v for v in patch.triangles[u] if v not in (b, d))
        old, new = np.array([[a, b, d], [e, d, b]]), np.array([[a, b, e], [a, e, d]])
        p, q, r = patch.points[new].swapaxes(0, 1)
        area = (q - p)[:, 0] * (r - p)[:, 1] - (q - p)[:, 1] * (r - p)[:, 0]
        if (area < 0.1).any():
            continue
        if smallest(patch.points, new) < min(floor, smallest(patch.points, old)):
            continue
        found.append((old, new, t, u))
    return found


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("seed", SEEDS)
def test_flips_lower_the_error_until_no_flip_does(seed, model):
    block, part, pixels, valid = random_block(seed, model)
    gain, angle = 2.0, smallest(part.points, part.triangles)
    edges = {v: frozenset(far) for v, far in hard_ends(part).items()}
    errors = [block.error]
    for _ in range(50):
        changed = np.zeros(block.patch.size[1], np.int64)
        flips = flip_edges(
            *(block.patch, block.surface, block.image, new_room(len(pixels)), changed),
            *(block.floor, gain, 1, model),
        )
        errors.append(block.error)
        assert errors[-1] <= errors[-2] - gain * flips
        assert flips == 0 or (changed == 1).sum() >= 2
        if flips == 0:
            break
    else:
        raise AssertionError("flips go on and on")
    assert len(errors) > 2
    check_block(block)
    now = block.part()
    assert brute_error(now, pixels, valid, model) == pytest.approx(errors[-1])
    assert {v: frozenset(far) for v, far in hard_ends(now).items()} == edges
    assert smallest(now.points, now.triangles) >= min(block.floor, angle) - 1e-12
    for old, new, _, _ in flippable(block.patch, block.floor * (1 + 1e-9)):
        one, other = (
            pixel_errors(part.points, part.values, pair, pixels, valid, model).sum()
            for pair in (old, new)
        )
        assert other >= one - gain - 1e-6


def insert(block: Block, wanted: int, floor: float) -> int:
    rows = block.patch.size[1]
    order = np.argsort(-block.surface.errors[:rows], kind="stable")
    touched = np.zeros(len(block.patch.triangles), bool)
    return int(
        insert_where_worst(
            *(block.patch, block.surface, block.image, new_log(), order, touched),
            *(floor, wanted, block.model),
        )
    )


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("seed", SEEDS)
def test_insertions_keep_the_floor_and_lines(seed, model):
    block, part, pixels, valid = random_block(seed, model)
    floor, angle = degrees(20), smallest(part.points, part.triangles)
    assert insert(block, 3, floor) == 3
    added = 3 + insert(block, 1000, floor)
    assert 3 < added < len(part.triangles)
    check_block(block)
    now = block.part()
    assert len(now.points) == len(part.points) + added
    np.testing.assert_array_equal(now.points[: len(part.points)], part.points)
    np.testing.assert_array_equal(now.ids, [*part.ids, *[-1] * added])
    assert smallest(now.points, now.triangles) >= min(floor, angle) - 1e-12
    assert outline(now).equals(outline(part))
    lines = hard_lines(part.points, part.triangles, part.hard)
    assert same_lines(hard_lines(now.points, now.triangles, now.hard), lines)
    # New nodes on hard sides are exactly on the line.
    ends = hard_ends(now)
    on_lines = [v for v in range(len(part.points), len(now.points)) if ends[v]]
    assert all(between(now.points, v, ends[v]) for v in on_lines)
    assert block.error == pytest.approx(brute_error(now, pixels, valid, model))


def test_insertions_split_hard_sides_and_stay_off_borders_of_blocks():
    on_lines = 0
    for seed in range(8):
        _, part, pixels, valid = random_block(seed, breaks=6)
        block = Block(part, image_of(pixels, valid), degrees(20))
        for _ in range(4):
            insert(block, 1000, degrees(25))
        now = block.part()
        ends = hard_ends(now)
        on_lines += sum(bool(ends[v]) for v in range(len(part.points), len(now.points)))
        # The same with every side at the border shared with other blocks.
        across = np.where(part.across < 0, -2, part.across).astype(np.int32)
        block = Block(replace(part, across=across), image_of(pixels, valid), degrees(20))
        assert insert(block, 1000, degrees(25)) > 0
        insert(block, 1000, degrees(25))
        check_block(block)
        assert (block.part().across == -2).sum() == (part.across < 0).sum()
    assert on_lines > 10


@pytest.mark.parametrize("seed", SEEDS)
def test_insertions_below_the_floor_are_undone(seed):
    block, part, _, _ = random_block(seed)
    before = in_use(block.patch)
    held, points = block.patch.held.copy(), block.patch.points[: len(part.points)].copy()
    surface = [array.copy() for array in block.surface[1:]]
    assert insert(block, 1000, 2.0) == 0  # no triangle is as blunt as that
    for found, expected in zip(in_use(block.patch), before, strict=True):
        np.testing.assert_array_equal(found, expected)
    np.testing.assert_array_equal(block.patch.held, held)
    np.testing.assert_array_equal(block.patch.points[: len(points)], points)
    np.testing.assert_array_equal(block.patch.size, [len(points), len(part.triangles)])
    for found, expected in zip(block.surface[1:], surface, strict=True):
        np.testing.assert_array_equal(found, expected)
    check_block(block)
