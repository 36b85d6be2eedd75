"""Parts, passes, units and blocks: nothing is lost, whatever the order, workers and time."""

from __future__ import annotations

import math
import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from dataclasses import fields, replace
from itertools import count
from typing import TYPE_CHECKING

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from geomesh.parallel.progress import silent
from geomesh.parallel.workers import open_workers
from geomesh.raster.open import open_scene
from geomesh.refine.block import Block
from geomesh.refine.least_squares import share_out
from geomesh.refine.moments import image_of
from geomesh.refine.parts import Part, divide
from geomesh.refine.passes import SHIFTS, Crew
from geomesh.refine.patch import BORDER, FREE, OTHER_PATCH, SHARED, SHARED_TWICE, STAYS, TWO_FANS
from geomesh.refine.plan import LeastSquares, refine_to_nodes
from geomesh.refine.settings import STAGES, Settings
from geomesh.refine.units import Units, bound_units, even_units
from support.refine import (
    MODELS,
    as_triangles,
    brute_error,
    check_block,
    check_topology,
    degrees,
    grid_part,
    hard_lines,
    outline,
    picture,
    same_lines,
    sampled,
    smallest,
)

if TYPE_CHECKING:
    from geomesh.refine.refined import Refined

SIZE = 40.0


def whole_mesh(seed: int, **options) -> tuple[Part, np.ndarray, np.ndarray]:
    """Return a mesh of about 3 x 3 blocks in pixel-edge coordinates, and its pixels."""
    rng = np.random.default_rng(seed)
    shape = {"notch": seed % 2 == 1, "touches": seed % 3 > 0, "breaks": 8}
    options = shape | {"stays": 0.05, "bands": 1 + seed % 2} | options
    part = grid_part(rng, 11, 9, 10, **options)
    pixels, valid = picture(rng, part, missing=0.1 * (seed % 3))
    return replace(part, points=part.points + 0.5), pixels, valid


def local(part: Part) -> Part:
    """Return a part of a whole mesh relative to the centre of the first pixel."""
    return replace(part, points=part.points - 0.5)


def scene_of(pixels: np.ndarray, valid: np.ndarray):
    hidden = np.broadcast_to(~valid, pixels.shape)
    return open_scene((np.ma.masked_array(pixels.astype(np.uint8), hidden), None, None))


def same(one, other) -> bool:
    """Return whether two dataclasses are equal, bit by bit."""
    pairs = [(getattr(one, field.name), getattr(other, field.name)) for field in fields(one)]
    return all(np.asarray(a).tobytes() == np.asarray(b).tobytes() for a, b in pairs)


@pytest.mark.parametrize("shift", SHIFTS)
@pytest.mark.parametrize("seed", range(3))
def test_divided_and_joined_a_mesh_is_the_same(seed, shift):
    whole, pixels, _ = whole_mesh(seed)
    whole = replace(whole, values=sampled(local(whole), pixels))
    blocks = divide(whole, SIZE, shift)
    assert len(blocks) >= 6
    parts = [blocks.part(b)[0] for b in range(len(blocks))]
    cells = [
        {tuple(np.floor(c / SIZE + shift)) for c in p.points[p.triangles].mean(axis=1)}
        for p in parts
    ]
    assert all(len(cell) == 1 for cell in cells)
    assert len(set.union(*cells)) == len(blocks)
    for part, own in zip(parts, blocks.own(), strict=True):
        check_topology(part.points, part.triangles, part.across, part.hard)
        is_shared = np.isin(part.held, [SHARED, SHARED_TWICE])
        assert (np.diff(is_shared.astype(int)) <= 0).all()  # shared nodes come first
        assert own == (~is_shared | (part.held == TWO_FANS)).sum()
    joined = blocks.join(parts)
    check_topology(joined.points, joined.triangles, joined.across, joined.hard)
    assert not (joined.across == OTHER_PATCH).any()
    assert as_triangles(joined) == as_triangles(whole)
    assert np.sort(joined.ids).tolist() == whole.ids.tolist()
    for name in ("points", "values", "held"):
        np.testing.assert_array_equal(getattr(joined, name), getattr(whole, name)[joined.ids])
    lines = [hard_lines(p.points, p.triangles, p.hard) for p in (joined, whole)]
    assert lines[0].equals(lines[1])
    np.testing.assert_array_equal((joined.across == BORDER).sum(), (whole.across == BORDER).sum())


@pytest.mark.parametrize("seed", range(4))
def test_nodes_with_two_fans_in_a_block_are_marked(seed):
    marked = 0
    for turn in range(4):
        whole, _, _ = whole_mesh(seed)
        blocks = divide(whole, 23.0, SHIFTS[turn])
        of_blocks = np.zeros(len(whole.points), int)
        for b in range(len(blocks)):
            of_blocks[blocks.part(b)[1]] += 1
        for b in range(len(blocks)):
            part, nodes = blocks.part(b)
            np.testing.assert_array_equal(part.points, whole.points[nodes])
            for v in range(len(nodes)):
                fans = count_fans(part, v)
                is_shared = blocks.shared[nodes[v]]
                assert (part.held[v] == SHARED_TWICE) == (is_shared and fans > 1)
                assert (part.held[v] == TWO_FANS) == (not is_shared and fans > 1)
                assert (part.held[v] == SHARED) == (is_shared and fans == 1)
                assert is_shared == (of_blocks[nodes[v]] > 1)
                marked += fans > 1
    assert marked > 0


def count_fans(part: Part, v: int) -> int:
    """Return in how many groups, linked by sides, the triangles of a node are."""
    left = set(np.flatnonzero((part.triangles == v).any(axis=1)).tolist())
    fans = 0
    while left:
        fans += 1
        todo = [left.pop()]
        while todo:
            near = left & set(part.across[todo.pop()].tolist())
            left -= near
            todo += near
    return fans


def test_blocks_can_be_refined_in_any_order():
    whole, pixels, valid = whole_mesh(1)
    whole = replace(local(whole), values=sampled(local(whole), pixels))
    image = image_of(pixels, valid)
    blocks = divide(whole, SIZE, (0, 0))
    found = []
    for order in (range(len(blocks)), range(len(blocks))[::-1]):
        parts = {}
        for b in order:
            block = Block(blocks.part(b)[0], image, degrees(10))
            block.replace(0.2, block.own)
            block.adjust(block.own + (7 if b % 2 else -7), 2)
            check_block(block)
            parts[b] = block.part()
        found.append(blocks.join([parts[b] for b in range(len(blocks))]))
    assert same(*found)
    joined = found[0]
    check_topology(joined.points, joined.triangles, joined.across, joined.hard)
    assert outline(joined).symmetric_difference(outline(whole)).area < 1e-6
    shared = np.flatnonzero(blocks.shared)
    np.testing.assert_array_equal(joined.ids[: len(shared)], shared)
    np.testing.assert_array_equal(joined.values[: len(shared)], whole.values[shared])
    np.testing.assert_array_equal(joined.held[: len(shared)], whole.held[shared])
    # The order of blocks decides only the numbers of triangles and nodes.
    parts[0] = replace(parts[0], across=np.where(parts[0].across == -2, -1, parts[0].across))
    with pytest.raises(AssertionError, match="border between blocks"):
        blocks.join([parts[b] for b in range(len(blocks))])


def refine(whole, pixels, valid, wanted=150, model="linear", effort="fast", **options) -> Refined:
    executor, workers = options.get("executor"), options.get("workers", 1)
    scene = scene_of(pixels, valid)
    with scene.open(), open_workers(workers, executor) as crew:
        units = Units(np.full(len(pixels), 100.0), np.ones(len(pixels)))
        team = Crew(scene, units, crew, SIZE, options.get("is_late", lambda: False))
        return refine_to_nodes(team, Settings(10.0, model, effort), whole, wanted, silent)


def check_refined(found: Refined, whole: Part) -> Part:
    """Check a refined mesh against its start, and return it as a part."""
    hard = {frozenset(edge) for edge in found.constraints.tolist()}
    triangles = found.triangles
    sides = [
        [frozenset(t[[(k + 1) % 3, (k + 2) % 3]].tolist()) for k in range(3)] for t in triangles
    ]
    owner: dict[frozenset, list[tuple[int, int]]] = {}
    for t, row in enumerate(sides):
        for k, side in enumerate(row):
            owner.setdefault(side, []).append((t, k))
    across = np.full(triangles.shape, BORDER)
    for one, *other in owner.values():
        if other:
            across[one], across[other[0]] = other[0][0], one[0]
    is_hard = np.array([[side in hard for side in row] for row in sides]).astype(np.uint8)
    check_topology(found.nodes, triangles, across, is_hard)
    part = Part(
        found.came_from,
        found.nodes,
        found.values,
        np.zeros(len(found.nodes), np.uint8),
        triangles,
        across,
        is_hard,
    )
    assert outline(part).symmetric_difference(outline(whole)).area < 1e-6
    lines = [hard_lines(p.points, p.triangles, p.hard) for p in (part, whole)]
    assert same_lines(*lines)
    stays = np.flatnonzero(whole.held == STAYS)
    place = [found.came_from.tolist().index(v) for v in stays]
    np.testing.assert_array_equal(found.nodes[place], whole.points[stays])
    angles = [smallest(p.points, p.triangles) for p in (part, whole)]
    assert angles[0] >= min(degrees(10), angles[1]) - 1e-12
    return part


@pytest.mark.parametrize("effort", STAGES)
@pytest.mark.parametrize("model", ["linear", "constant"])
def test_refined_meshes_have_as_many_nodes_as_wanted(model, effort):
    whole, pixels, valid = whole_mesh(2)
    found = refine(whole, pixels, valid, 190, model, effort)
    assert found.in_time
    assert len(found.nodes) == 190
    check_refined(found, whole)


@pytest.mark.parametrize("model", MODELS)
def test_errors_of_blocks_add_up_in_every_pass(model):
    whole, pixels, valid = whole_mesh(4)
    scene, units = scene_of(pixels, valid), Units(np.array([3.0]), np.ones(1))
    with scene.open(), open_workers(1) as workers:
        plan = LeastSquares(
            Crew(scene, units, workers, SIZE, lambda: False),
            Settings(10.0, ("linear", "constant")[model], "normal"),
            whole,
        )
        for stage in STAGES["normal"]:
            plan.run(stage, 180, silent)
            assert len(plan.part.points) == 180
            own = sum(report.own for report in plan.reports)
            assert own < 180
            expected = brute_error(local(plan.part), pixels - 3.0, valid, model)
            assert sum(report.error for report in plan.reports) == pytest.approx(expected)


def test_results_do_not_depend_on_the_workers():
    whole, pixels, valid = whole_mesh(5)
    expected = refine(whole, pixels, valid)
    assert same(refine(whole, pixels, valid, workers=2), expected)
    spawn = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(2, mp_context=spawn) as executor:
        assert same(refine(whole, pixels, valid, executor=executor, workers=2), expected)


@pytest.mark.parametrize("calls", [0, 1, 3, 9, 12, 20, 30])
def test_late_meshes_are_valid(calls):
    whole, pixels, valid = whole_mesh(3)
    counter = count()
    found = refine(whole, pixels, valid, is_late=lambda: next(counter) >= calls)
    assert not found.in_time
    check_refined(found, whole)
    assert np.isfinite(found.values).all()
    if calls == 0:
        assert as_triangles(check_refined(found, whole)) == as_triangles(whole)


@given(
    st.lists(st.one_of(st.just(0.0), st.floats(0, 1e12), st.floats(0, 1e-300)), min_size=1),
    st.integers(-5, 10**7),
)
def test_shares_add_up(weights, total):
    shares = share_out(np.array(weights), total)
    assert shares.sum() == max(total, 0)
    assert (shares >= 0).all()
    if total > 0 and sum(weights) > 1e-200:
        exact = total * np.array(weights) / math.fsum(weights)
        assert (np.abs(shares - exact) <= 1 + 2e-9 * total * len(weights)).all()


@pytest.mark.parametrize("dtype", ["uint8", "int16", "uint16", "int32"])
def test_units_are_exact_for_whole_numbers(dtype):
    info = np.iinfo(dtype)
    for spread in (1, 3, 100, 250, 5000, int(info.max)):
        rng = np.random.default_rng(spread)
        low = rng.integers(info.min, info.max, 2)
        steps = rng.integers(0, min(spread, int(info.max)), (2, 40, 30))
        bands = np.clip(low[:, None, None] + steps, info.min, info.max).astype(dtype)
        units = even_units(bands, np.ones((40, 30), bool))
        scaled = units.scaled(bands)
        np.testing.assert_array_equal(np.frexp(units.scale)[0], 0.5)
        restored = units.raw(scaled.reshape(2, -1).T).T.reshape(bands.shape)
        np.testing.assert_array_equal(restored, bands)
        # Sums of them have no rounding either.
        whole = scaled * units.scale[:, None, None]
        np.testing.assert_array_equal(whole, bands - units.offset[:, None, None])
        if dtype == "uint8":
            assert (units.scale == 1).all()
        else:
            wide = np.ptp(np.percentile(bands, (2, 98), axis=(1, 2)), axis=0)
            assert ((wide == 0) | ((wide / units.scale > 140) & (wide / units.scale < 285))).all()


def test_units_of_flat_and_bounded_bands():
    flat = np.full((1, 4, 4), 7.25, np.float32)
    units = even_units(flat, np.ones((4, 4), bool))
    assert units.scale == 1
    assert abs(units.scaled(flat)).max() < 1
    limits = bound_units((0.5, 4.0), np.array([100.0, 0.0]))
    raw = limits.raw(np.array([[1.0, 2.0]]))
    assert (raw < [[100.5, 8.0]]).all()  # a little less, for rounding
    np.testing.assert_allclose(raw, [[100.5, 8.0]], rtol=1e-4)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("seed", range(3))
def test_blocks_reach_their_target(seed, model):
    rng = np.random.default_rng(seed)
    part = grid_part(rng, 6, 5, 12, bands=2)
    pixels, valid = picture(rng, part)
    part = replace(part, values=sampled(part, pixels))
    block = Block(part, image_of(pixels, valid), degrees(10), model)
    for target in (90, 200, 60, 61, 59, 150):
        block.adjust(target, 3)
        assert block.own == target
        check_block(block)
    block.replace(0.3, 150)
    assert block.own == 150


@pytest.mark.parametrize("target", range(5))
def test_blocks_do_not_grow_beyond_a_small_target(target):
    rng = np.random.default_rng(2)
    part = grid_part(rng, 3, 3, 12)
    pixels, valid = picture(rng, part)
    shared = np.full(len(part.points), SHARED, np.uint8)
    block = Block(replace(part, held=shared), image_of(pixels, valid), 0.0)
    block.grow(target, 3)
    assert block.own == target


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("kind", ["noise", "constant", "one pixel", "invalid"])
def test_growth_ends_on_any_image(kind, model):
    rng = np.random.default_rng(1)
    part = grid_part(rng, 4, 4, 10, breaks=4)
    valid = np.ones((40, 40), bool)
    pixels = np.full((1, 40, 40), 77.0)
    if kind == "noise":
        pixels = rng.integers(0, 256, (1, 40, 40)).astype(float)
    elif kind != "constant":
        valid[:] = False
        valid[17, 13] = kind == "one pixel"
    part = replace(part, values=sampled(part, pixels))
    block = Block(part, image_of(pixels, valid), degrees(10), model)
    block.adjust(2000, 4)
    check_block(block)
    if kind == "noise":
        assert 300 < block.own <= 2000
    else:
        assert block.own == len(part.points)
        assert block.error < 1e-6
    block.replace(0.1, block.own)
    block.adjust(4, 2)
    block.finish(1)
    check_block(block)
    assert block.own < len(part.points)
    assert (block.part().held == FREE).all()
    assert np.isfinite(block.part().values).all()


@pytest.mark.parametrize("kind", ["constant", "half invalid"])
def test_passes_over_images_without_errors_keep_the_mesh_valid(kind):
    whole, pixels, valid = whole_mesh(2, bands=1)
    pixels[:] = 50
    if kind == "half invalid":
        valid[:, :60] = False
    found = refine(whole, pixels, valid, 200)
    check_refined(found, whole)
    assert len(found.nodes) <= 200
