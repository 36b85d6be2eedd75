"""Bounded refinement: against plain NumPy on small meshes, and what holds for every result."""

from __future__ import annotations

import pickle
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.tri import LinearTriInterpolator, Triangulation

from geomesh.mesh.topology import neighbours
from geomesh.refine.bound import BOUND, measure_bound
from geomesh.refine.bound_merge import merge_nodes
from geomesh.refine.bounded import Report, Step, bound_block, is_needed, schedule
from geomesh.refine.bounded_block import BoundedBlock
from geomesh.refine.parts import Part, divide
from geomesh.refine.passes import SHIFTS
from geomesh.refine.patch import BORDER, OTHER_PATCH, SHARED, SHARED_TWICE, STAYS
from geomesh.refine.star import new_star

FLOOR = float(np.sin(np.radians(10)) ** 2)


def grid_part(image: np.ndarray, spacing: float = 16.0) -> Part:
    """A grid over the whole image, whose outline is hard; heights are those of pixels."""
    height, width = image.shape[1:]
    cols, rows = max(round(width / spacing), 1) + 1, max(round(height / spacing), 1) + 1
    x, y = np.meshgrid(np.rint(np.linspace(0, width, cols)), np.rint(np.linspace(0, height, rows)))
    points = np.stack([x, y], axis=-1).reshape(-1, 2) - 0.5
    a = (np.arange(rows - 1)[:, None] * cols + np.arange(cols - 1)).ravel()
    one = np.stack([a, a + 1, a + cols + 1], axis=1)
    other = np.stack([a, a + cols + 1, a + cols], axis=1)
    triangles = np.concatenate([one, other]).astype(np.int32)
    across = neighbours(triangles)
    col, row = np.clip(np.rint(points).astype(int), 0, [width - 1, height - 1]).T
    return Part(
        ids=np.arange(len(points), dtype=np.int32),
        points=points,
        values=np.nan_to_num(image[:, row, col].T).copy(),
        held=np.zeros(len(points), np.uint8),
        triangles=triangles,
        across=across,
        hard=(across < 0).astype(np.uint8),
    )


def hills(height: int, width: int, bands: int = 1, seed: int = 0) -> np.ndarray:
    """A smooth surface of a few waves, several units high, with a little noise."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width]
    image = np.zeros((bands, height, width))
    for b in range(bands):
        for _ in range(5):
            u, v, phase = *rng.normal(0, 0.12, 2), rng.uniform(0, 6)
            image[b] += rng.uniform(1, 3) * np.sin(u * x + v * y + phase)
        image[b] += rng.normal(0, 0.1, (height, width))
    return image


def with_gap(image: np.ndarray, seed: int = 0) -> np.ndarray:
    """An image without some pixels: a block, and some here and there."""
    rng = np.random.default_rng(seed)
    height, width = image.shape[1:]
    gap = rng.random((height, width)) < 0.05
    gap[height // 3 : height // 2, width // 4 : width // 2] = True
    return np.where(gap, np.nan, image)


def corners_of(part: Part) -> np.ndarray:
    return part.points[part.triangles]


def doubled_areas(part: Part) -> np.ndarray:
    a, b, c = corners_of(part).transpose(1, 0, 2)
    ab, ac = b - a, c - a
    return ab[:, 0] * ac[:, 1] - ab[:, 1] * ac[:, 0]


def sharpness_of(part: Part) -> np.ndarray:
    corners = corners_of(part)
    squares = np.sort(((np.roll(corners, -1, axis=1) - corners) ** 2).sum(axis=2), axis=1)
    return doubled_areas(part) ** 2 / (squares[:, 1] * squares[:, 2])


def errors_of(part: Part, image: np.ndarray) -> np.ndarray:
    """Errors at each pixel, by matplotlib."""
    y, x = np.mgrid[: image.shape[1], : image.shape[2]]
    mesh = Triangulation(*part.points.T, part.triangles)
    shown = [LinearTriInterpolator(mesh, heights)(x, y) for heights in part.values.T]
    assert not any(np.ma.is_masked(band) for band in shown)
    return np.abs(np.array(shown) - image)


def assert_sound(part: Part, image: np.ndarray) -> None:
    """The mesh covers the image once, and its links are those of its triangles."""
    assert (doubled_areas(part) > 0).all()
    assert doubled_areas(part).sum() == 2 * image.shape[1] * image.shape[2]
    expected = neighbours(part.triangles)
    assert np.array_equal(part.across, expected)
    assert np.array_equal(part.points * 256, np.rint(part.points * 256))
    border = part.across == BORDER
    assert (part.hard[border] == 1).all()
    rows, sides = np.nonzero(part.across >= 0)
    others = part.across[rows, sides]
    back = (part.across[others] == rows[:, None]).argmax(axis=1)
    assert np.array_equal(part.hard[rows, sides], part.hard[others, back])


def assert_bounded(part: Part, image: np.ndarray) -> None:
    assert_sound(part, image)
    assert np.nanmax(errors_of(part, image), initial=0) <= 1 + 1e-6
    assert sharpness_of(part).min() >= FLOOR * (1 - 1e-9)


def hard_length(part: Part, along: int, at: float) -> float:
    """Length of the hard edges on the line where the coordinate `along` is `at`."""
    rows, sides = np.nonzero(part.hard)
    ends = np.stack([part.triangles[rows, (sides + k) % 3] for k in (1, 2)], axis=1)
    ends = np.unique(np.sort(ends, axis=1), axis=0)
    one, other = part.points[ends[:, 0]], part.points[ends[:, 1]]
    on_line = (one[:, along] == at) & (other[:, along] == at)
    return float(np.abs(one - other)[on_line].sum())


def refined(image: np.ndarray, rounds: int = 3, spacing: float = 16.0) -> Part:
    block = BoundedBlock(grid_part(image, spacing), image, FLOOR)
    assert block.insert() == 0
    block.simplify(rounds, 1)
    assert block.violations == 0
    assert block.below_floor == 0
    return block.part()


# ---- measures


@pytest.mark.parametrize("bands", [1, 2])
def test_errors_are_those_of_the_interpolated_surface(bands: int) -> None:
    image = with_gap(hills(30, 40, bands))
    part = grid_part(image, 9)
    block = BoundedBlock(part, image, FLOOR)
    expected = errors_of(part, image)
    assert block.worst == pytest.approx(np.nanmax(expected), rel=1e-9)
    _, total, pixel = block._measured
    assert total.sum() == pytest.approx(np.nansum(expected**8), rel=1e-9)
    triangle = int(block.errors.argmax())
    col, row = pixel[triangle]
    assert expected[:, row, col].max() == pytest.approx(block.worst)


def test_a_block_without_valid_pixels_has_no_errors_and_loses_its_inner_nodes() -> None:
    image = np.full((1, 40, 40), np.nan)
    block = BoundedBlock(grid_part(image, 10), image, FLOOR)
    assert block.worst == 0
    assert block.insert() == 0
    block.simplify(6)
    assert block.own == 4


def test_nodes_without_a_value_are_refused() -> None:
    image = hills(20, 20)
    part = grid_part(image)
    part.values[0] = np.nan
    with pytest.raises(ValueError, match="finite"):
        BoundedBlock(part, image, FLOOR)


# ---- merges


def brute_width(part: Part, image: np.ndarray, v: int) -> float:
    """Half of the widest interval of heights over all merges of node `v`; -1 if there is none."""
    best = -1.0
    triangles = part.triangles.astype(int)
    ring = np.unique(triangles[(triangles == v).any(axis=1)])
    for u in ring[ring != v]:
        places = [part.points[u]]
        if u > v and not is_hard(part, u):
            places.append(np.rint((part.points[u] + part.points[v]) * 128) / 256)
        around = triangles[(triangles == v).any(axis=1) | (triangles == u).any(axis=1)]
        link = []
        for t in around:
            if u in t and v in t:
                continue
            k = int(np.flatnonzero((t == u) | (t == v))[0])
            link.append((t[(k + 1) % 3], t[(k + 2) % 3]))
        for place in places:
            best = max(best, brute_interval(part, image, place, link))
    return best


def is_hard(part: Part, v: int) -> bool:
    rows, sides = np.nonzero(part.hard)
    ends = np.stack([part.triangles[rows, (sides + k) % 3] for k in (1, 2)])
    return bool((ends == v).any())


def brute_interval(part: Part, image: np.ndarray, place: np.ndarray, link: list) -> float:
    """Half of the width of the heights at `place`, from every pixel of the closed triangles."""
    rows, cols = np.mgrid[: image.shape[1], : image.shape[2]]
    low, high = np.full(len(image), -1e30), np.full(len(image), 1e30)
    for b, c in link:
        (bx, by), (cx, cy) = part.points[b], part.points[c]
        d = (bx - place[0]) * (cy - place[1]) - (by - place[1]) * (cx - place[0])
        sides = [np.hypot(bx - cx, by - cy)]
        sides += [np.hypot(*(part.points[w] - place)) for w in (b, c)]
        if d < 0.1 or d * d < FLOOR * np.prod(np.sort(sides)[1:] ** 2):
            return -1.0
        wa = ((bx - cols) * (cy - rows) - (by - rows) * (cx - cols)) / d
        wb = ((cx - cols) * (place[1] - rows) - (cy - rows) * (place[0] - cols)) / d
        wc = 1 - wa - wb
        inside = np.minimum(np.minimum(wa, wb), wc) >= -1e-9
        for band, pixels in enumerate(image):
            use = inside & ~np.isnan(pixels)
            rest = (pixels - wb * part.values[b, band] - wc * part.values[c, band])[use]
            weight = wa[use]
            if (np.abs(rest[weight < 1e-7]) > BOUND).any():
                return -1.0
            rest, weight = rest[weight >= 1e-7], weight[weight >= 1e-7]
            low[band] = max(low[band], ((rest - 1) / weight).max(initial=-1e30))
            high[band] = min(high[band], ((rest + 1) / weight).min(initial=1e30))
    return float((high - low).min() / 2) if (low <= high).all() else -1.0


@pytest.mark.parametrize("bands", [1, 2])
@pytest.mark.parametrize("seed", range(3))
def test_intervals_of_heights_are_exact(bands: int, seed: int) -> None:
    image = with_gap(hills(48, 40, bands, seed), seed)
    block = BoundedBlock(grid_part(image, 12), image, FLOOR)
    block.insert()
    part = block.part()
    block = BoundedBlock(part, image, FLOOR)
    nodes = len(part.points)
    width, target = np.full(nodes, -1.0), np.full(nodes, -1)
    stars = (new_star(), new_star(), new_star())
    merge_nodes(
        *(block.patch, block.values, image, *stars, np.zeros((4, bands)), FLOOR),
        *(np.arange(nodes), width, target, False),
    )
    inner = [v for v in range(nodes) if not is_hard(part, v)]
    expected = [brute_width(part, image, v) for v in inner]
    assert np.count_nonzero(width[inner] >= 0) > 5
    np.testing.assert_allclose(width[inner], expected, rtol=1e-6, atol=1e-9)


def test_merging_keeps_the_bound_and_removes_many_nodes() -> None:
    image = hills(64, 64)
    block = BoundedBlock(grid_part(image), image, FLOOR)
    block.insert()
    before = block.own
    merged = block.collapse()
    assert merged > before // 4
    assert block.own == before - merged
    assert_bounded(block.part(), image)


def test_no_node_is_merged_into_one_between_two_fans() -> None:
    image = np.zeros((1, 32, 32))
    grid = grid_part(image, 8)
    middle, near = (int(np.flatnonzero((grid.points == at).all(axis=1))[0]) for at in (15.5, 7.5))
    low, high = corners_of(grid).min(axis=(1, 2)), corners_of(grid).max(axis=(1, 2))
    rows = np.concatenate([np.flatnonzero(low >= 15), np.flatnonzero(high <= 16)])
    triangles = grid.triangles[rows]
    across = neighbours(triangles)
    across[(across < 0) & (grid.across[rows] >= 0)] = OTHER_PATCH
    held = np.zeros(len(grid.points), np.uint8)
    for k in range(3):
        held[np.delete(triangles, k, axis=1)[across[:, k] == OTHER_PATCH]] = SHARED
    held[middle] = SHARED_TWICE
    part = replace(grid, held=held, triangles=triangles, across=across, hard=grid.hard[rows])
    block = BoundedBlock(part, image, FLOOR)
    before = np.count_nonzero(triangles == middle)
    width, target = np.zeros(len(held)), np.full(len(held), 2 * middle)
    stars = (new_star(), new_star(), new_star())
    merged = merge_nodes(
        *(block.patch, block.values, image, *stars, np.zeros((4, 1)), FLOOR),
        *(np.array([near]), width, target, True),
    )
    assert merged == 1
    assert np.count_nonzero(block.patch.triangles[block.patch.alive] == middle) <= before


def test_a_constant_image_keeps_only_its_corners() -> None:
    image = np.full((1, 64, 64), 7.0)
    part = refined(image, rounds=6)
    assert len(part.points) == 4
    assert_bounded(part, image)


def test_places_found_by_newton_steps_save_more_nodes() -> None:
    image = hills(96, 96, 2, seed=2)
    counts = []
    for placing in (False, True):
        block = BoundedBlock(grid_part(image), image, FLOOR)
        block.insert()
        for _ in range(3):
            block.collapse(placing=placing)
            block.relax()
        assert_bounded(block.part(), image)
        counts.append(block.own)
    assert counts[1] < counts[0]


# ---- moves and flips


def test_moves_lower_the_sum_and_keep_the_bound() -> None:
    image = hills(64, 64, 2)
    block = BoundedBlock(grid_part(image), image, FLOOR)
    block.insert()
    block.collapse()
    before = np.nansum(errors_of(block.part(), image) ** 8)
    for _ in range(2):
        assert block.relax() > 0
        part = block.part()
        assert_bounded(part, image)
        after = np.nansum(errors_of(part, image) ** 8)
        assert after < before
        before = after


def test_moves_lower_errors_that_are_out_of_bounds() -> None:
    image = hills(48, 48)
    block = BoundedBlock(grid_part(image, 8), image, FLOOR)
    before = block.worst
    assert before > 1
    block.relax()
    assert block.worst <= before
    assert_sound(block.part(), image)


def test_flips_lower_the_sum_keep_the_bound_and_what_is_measured() -> None:
    image = with_gap(hills(64, 64))
    block = BoundedBlock(grid_part(image), image, FLOOR)
    block.insert()
    block.collapse()
    block.errors  # noqa: B018  measured
    before = block._measured[1].sum()
    assert block.flip() > 0
    worst, total, _ = (array.copy() for array in block._measured)
    measure_bound(block.patch, block.values, image, *block._measured)
    rows = np.flatnonzero(block.patch.alive)
    np.testing.assert_allclose(worst[rows], block._measured[0][rows], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(total[rows], block._measured[1][rows], rtol=1e-9, atol=1e-12)
    assert total.sum() < before
    assert_bounded(block.part(), image)


# ---- insertion


def test_insertion_ends_within_the_bound() -> None:
    image = hills(80, 60)
    block = BoundedBlock(grid_part(image), image, FLOOR)
    assert block.violations > 0
    assert block.insert() == 0
    assert_bounded(block.part(), image)


def test_white_noise_stops() -> None:
    image = np.random.default_rng(1).normal(0, 20, (1, 24, 24))
    block = BoundedBlock(grid_part(image, 8), image, FLOOR)
    left = block.insert()
    assert left <= 0.02 * np.count_nonzero(block.patch.alive)
    assert block.own <= 2 * image.size
    assert block.below_floor == 0
    assert_sound(block.part(), image)


def test_no_node_serves_missing_pixels() -> None:
    image = hills(64, 64)
    image[:, 16:48, 16:48] = np.nan
    part = refined(image)
    assert_bounded(part, image)
    deep = (np.abs(part.points - 31.5) < 12).all(axis=1)
    assert np.count_nonzero(deep) <= 2


def test_a_bound_for_each_band() -> None:
    image = hills(64, 64, 2)
    loose, tight = np.array([2.0, 1.0]), np.array([2.0, 0.25])
    counts = []
    for bounds in (loose, tight):
        scaled = image / bounds[:, None, None]
        part = refined(scaled)
        assert_bounded(part, scaled)
        error = np.nanmax(errors_of(part, scaled), axis=(1, 2)) * bounds
        assert (error <= bounds * (1 + 1e-6)).all()
        counts.append(len(part.points))
    assert counts[0] < counts[1]


# ---- what stays


def test_hard_edges_stay() -> None:
    image = hills(64, 64, seed=3)
    part = grid_part(image)
    rows, sides = np.nonzero(part.across >= 0)
    one = part.points[part.triangles[rows, (sides + 1) % 3]]
    other = part.points[part.triangles[rows, (sides + 2) % 3]]
    line = (one[:, 1] == 31.5) & (other[:, 1] == 31.5)
    part.hard[rows[line], sides[line]] = 1
    block = BoundedBlock(part, image, FLOOR)
    block.insert()
    block.simplify(4)
    result = block.part()
    assert_bounded(result, image)
    for axis, at, length in ((1, 31.5, 64), (1, -0.5, 64), (1, 63.5, 64), (0, -0.5, 64)):
        assert hard_length(result, axis, at) == length
    assert len(result.points) < 0.7 * len(part.points) + 200


def test_nodes_that_stay_neither_move_nor_vanish() -> None:
    image = hills(64, 64)
    part = grid_part(image)
    part.held[::3] = STAYS
    block = BoundedBlock(part, image, FLOOR)
    block.insert()
    block.simplify(3)
    result = block.part()
    kept = {tuple(point) for point in result.points.tolist()}
    assert all(tuple(point) in kept for point in part.points[::3].tolist())
    assert_bounded(result, image)


def valid_of(image: np.ndarray) -> np.ndarray:
    return ~np.isnan(image).any(axis=0)


def test_shared_nodes_are_the_same_bit_for_bit_and_blocks_join() -> None:
    image = with_gap(hills(96, 96, seed=5), 5)
    whole = grid_part(image)
    reports: list[Report] = []
    turn = 0
    for step in schedule(FLOOR, "best", blocks=True):
        if not is_needed(step, reports):
            continue
        cut = divide(whole, 48, SHIFTS[turn % len(SHIFTS)])
        turn += 1
        parts, reports = [], []
        for b in range(len(cut)):
            part, _ = cut.part(b)
            result, report = bound_block(part, image, valid_of(image), step)
            shared = np.count_nonzero(part.held >= SHARED)
            # The first pass gives all nodes their first values.
            same = (
                ("ids", "points", "held") if step.is_first else ("ids", "points", "values", "held")
            )
            for name in same:
                before, after = getattr(part, name)[:shared], getattr(result, name)[:shared]
                assert before.tobytes() == after.tobytes()
            assert (part.across == OTHER_PATCH).sum() == (result.across == OTHER_PATCH).sum()
            parts.append(result)
            reports.append(report)
        whole = cut.join(parts)
        assert_sound(whole, image)
    assert sum(report.violations for report in reports) == 0
    assert_bounded(whole, image)
    assert len(whole.points) <= 1.3 * len(refined(image, rounds=6).points)


# ---- the plan


def test_the_plan_inserts_first_and_then_merges_on_other_blocks() -> None:
    steps = schedule(FLOOR, "best", blocks=True)
    merging = [step for step in steps if step.rounds]
    first = steps.index(merging[0])
    after = first + len(merging)
    assert steps[first:after] == merging
    assert [step.if_violated for step in steps[:first]] == [False] + [True] * (first - 1)
    assert all(step.if_violated for step in steps[after:])
    assert [step.is_first for step in steps] == [True] + [False] * (len(steps) - 1)
    fast = schedule(FLOOR, "fast", blocks=True)
    assert sum(step.rounds for step in fast) < sum(step.rounds for step in steps)
    one = schedule(FLOOR, "best", blocks=False)
    assert one[0].rounds == 6
    assert all(step.if_violated and step.floor < FLOOR / 100 for step in one[1:])
    assert [step.placing_from for step in merging] == [2, 0, 0]
    assert {step.placing_from for step in fast} == {None}


def test_a_pass_for_violations_is_left_out_without_any() -> None:
    step = Step(0, FLOOR, if_violated=True)
    good, bad = Report(1, 0, 0, 0, 0.9), Report(1, 0, 2, 0, 3.0)
    assert is_needed(step, [good, bad])
    assert not is_needed(step, [good, good])
    assert is_needed(Step(0, FLOOR), [])


def test_work_can_be_sent_to_another_process() -> None:
    image = hills(32, 32)
    function, step = pickle.loads(
        pickle.dumps((bound_block, schedule(FLOOR, "fast", blocks=False)[0]))
    )
    part, report = function(grid_part(image), image, valid_of(image), step)
    assert pickle.loads(pickle.dumps(report)) == report
    assert report.violations == report.below_floor == 0
    assert report.worst <= BOUND
    assert report.nodes == len(part.points)
    assert_bounded(part, image)


# ---- whatever the image


@settings(deadline=None, max_examples=30)
@given(
    seed=st.integers(0, 2**32 - 1),
    height=st.integers(8, 48),
    width=st.integers(8, 48),
    bands=st.integers(1, 3),
    scale=st.sampled_from([0.1, 1.0, 4.0]),
    gap=st.booleans(),
)
def test_whatever_the_image_the_result_is_sound(
    seed: int, height: int, width: int, bands: int, scale: float, gap: bool
) -> None:
    image = hills(height, width, bands, seed) * scale
    if gap:
        image = with_gap(image, seed)
    start = grid_part(image, 8)
    block = BoundedBlock(start, image, FLOOR)
    left = block.insert()
    block.simplify(3, 1)
    part = block.part()
    assert_sound(part, image)
    assert sharpness_of(part).min() >= min(FLOOR, sharpness_of(start).min()) * (1 - 1e-9)
    assert block.below_floor == np.count_nonzero(sharpness_of(part) < FLOOR)
    worst = np.nanmax(errors_of(part, image), initial=0)
    assert worst == pytest.approx(block.worst, rel=1e-6, abs=1e-9)
    assert block.violations == 0 or left > 0
    assert (worst <= 1 + 1e-6) == (block.violations == 0)
