"""Large sets of points in tiles: the same triangles as in one piece, for any tiles."""

from concurrent.futures import ThreadPoolExecutor
from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import Delaunay

import geomesh
from geomesh.delaunay import kd_split as kd
from geomesh.delaunay import tiled, triangulate
from geomesh.delaunay.predicates import are_cocircular
from geomesh.errors import CertificateError
from geomesh.mesh.topology import boundary_edges
from support.geometry import area, as_sets, assert_delaunay, exact_incircle
from support.samples import SAMPLES

TILES = (2, 30, 400)


def triangulated(points, segments=None, tile=None, executor=None):
    """Triangulate as a whole, or in tiles of at most `tile` points."""
    with pytest.MonkeyPatch.context() as patch:
        if tile is not None:
            patch.setattr(triangulate, "TILED_ABOVE", 0)
            patch.setattr(triangulate, "TILE_POINTS", tile)
        if segments is None:
            return triangulate.delaunay(points, executor=executor)
        return triangulate.constrained_delaunay(points, segments, executor=executor)


def assert_same_by_tiles(points, segments=None, tiles=TILES):
    whole = triangulated(points, segments)
    for tile in tiles:
        parts = triangulated(points, segments, tile)
        np.testing.assert_array_equal(parts.triangles, whole.triangles)
        np.testing.assert_array_equal(parts.used, whole.used)
    return whole


def integers(seed, extent, count):
    return np.unique(np.random.default_rng(seed).integers(0, extent, (count, 2)), axis=0) * 1.0


def lattice(width, height):
    return np.argwhere(np.ones((width, height))).astype(float)


def clusters(seed, count, size):
    rng = np.random.default_rng(seed)
    spread = np.exp(rng.uniform(-3, 5, count))
    return np.concatenate([rng.normal(rng.uniform(0, 1e4, 2), s, (size, 2)) for s in spread])


def ring(count, radius=1.0, turn=0.0):
    angle = turn + np.arange(count) * (2 * np.pi / count)
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def loop(first, count):
    start = np.arange(count)
    return first + np.column_stack([start, np.roll(start, -1)])


@pytest.mark.parametrize("tile", TILES)
def test_equals_scipy_on_random_points(tile):
    points = np.random.default_rng(tile).uniform(0, 1000, (3000, 2))
    assert as_sets(triangulated(points, tile=tile).triangles) == as_sets(Delaunay(points).simplices)


@pytest.mark.slow
def test_equals_the_global_triangulation_on_uniform_points():
    points = np.random.default_rng(1).uniform(0, 300, (20_000, 2))
    assert_same_by_tiles(points, tiles=(2, 30, 3000))
    assert_same_by_tiles(np.unique(np.round(points * 256), axis=0) / 256)


def test_equals_the_global_triangulation_on_clustered_points():
    assert_same_by_tiles(clusters(2, 40, 200))


@pytest.mark.parametrize(
    "points", [lattice(70, 40), integers(3, 60, 5000), integers(4, 2**20, 3000), lattice(3, 900)]
)
def test_equals_the_global_triangulation_on_cocircular_points(points):
    assert_same_by_tiles(points)


@pytest.mark.slow
def test_equals_the_global_triangulation_on_a_turned_lattice_far_from_the_origin():
    """Only exact arithmetic can distinguish the ties and near ties in these points."""
    points = lattice(40, 40) @ np.array([[0.8, 0.6], [-0.6, 0.8]]) + 5e6
    assert_delaunay(points, assert_same_by_tiles(points).triangles)


@pytest.mark.slow
def test_equals_the_global_triangulation_around_large_empty_areas():
    far = [integers(5, 40, 900) + offset for offset in ((0, 0), (1e5, 3), (7, 4e6))]
    assert_same_by_tiles(np.concatenate(far))
    assert_same_by_tiles(np.concatenate([ring(2000, 1000.0), ring(2000, 999.0, 0.001)]))
    assert_same_by_tiles(np.concatenate([ring(1500, 500.0), [[0.0, 0.0]]]))


def test_tiles_without_area_are_left_to_the_rest():
    line = np.column_stack([np.arange(300.0), np.zeros(300)])
    assert_same_by_tiles(np.vstack([line, [[150.0, 1e4]]]))
    assert_same_by_tiles(np.vstack([line, line + np.array([0, 1e4])]))
    assert len(triangulated(line, tile=30).triangles) == 0
    assert len(triangulated(line[:2], tile=30).triangles) == 0
    assert_same_by_tiles(np.array([(0.0, 0.0), (1.0, 0.0), (0.0, 1.0)]))


@given(
    points=st.lists(
        st.tuples(st.integers(0, 9), st.integers(0, 9)), min_size=3, max_size=60, unique=True
    ),
    tile=st.integers(1, 40),
)
def test_any_tiles_of_any_small_lattice_points(points, tile):
    points = np.array(points, float)
    whole = assert_same_by_tiles(points, tiles=(tile,))
    assert_delaunay(points, whole.triangles)


@given(
    points=st.lists(
        st.tuples(st.integers(0, 6), st.integers(0, 6)), min_size=3, max_size=40, unique=True
    ),
    seed=st.integers(0, 1000),
)
def test_the_triangulation_does_not_depend_on_the_order_of_points(points, seed):
    points = np.array(points, float)
    order = np.random.default_rng(seed).permutation(len(points))
    one, other = triangulated(points).triangles, triangulated(points[order]).triangles
    assert as_sets(one) == as_sets(order[other])


def test_cocircular_points_are_joined_to_the_lowest():
    points = np.array([(5, 0), (4, 3), (3, 4), (0, 5), (-3, 4), (-5, 0), (-4, -3), (3, -4.0)])
    triangles, _ = triangulated(points)
    assert as_sets(triangles) == {frozenset((7, k, k + 1)) for k in range(6)}
    # Triangles are never merged across a constraint, so each side has its own fan. The chord
    # is given twice, because the area behind a single one is outside.
    chord = np.array([(0, 3), (0, 3)])
    triangles, _ = triangulated(points, np.vstack([loop(0, 8), chord]))
    fans = [(0, 1, 2), (0, 2, 3), (7, 0, 3), (7, 3, 4), (7, 4, 5), (7, 5, 6)]
    assert as_sets(triangles) == {frozenset(triangle) for triangle in fans}


def test_the_frame_and_keypoints_on_it():
    side = np.arange(0, 64, 8.0)
    zero, full = np.zeros(8), np.full(8, 64.0)
    frame = np.concatenate(
        [
            np.column_stack(xy)
            for xy in ((side, zero), (full, side), (64 - side, full), (zero, 64 - side))
        ]
    )
    loose = np.random.default_rng(6).integers(0, 65, (4000, 2)).astype(float)
    points = np.vstack([frame, loose])
    points = points[np.sort(np.unique(points, axis=0, return_index=True)[1])]
    triangles, used = assert_same_by_tiles(points, loop(0, len(frame)))
    assert area(points, triangles) == 64**2
    assert len(used) == len(points)


def test_nested_loops_with_holes_and_long_segments():
    """Sides that cross many tiles, from a few distant nodes, through dense points."""
    nested = np.vstack([ring(3, 400), ring(4, 150), ring(5, 100, 0.2), ring(3, 60, 1.0)])
    nested = np.round(nested * 256) / 256
    segments = np.vstack([loop(0, 3), loop(3, 4), loop(7, 5), loop(12, 3)])
    loose = np.random.default_rng(7).normal(0, 150, (8000, 2))
    points = np.vstack([nested, np.unique(np.round(loose * 256) / 256, axis=0)])
    triangles, _ = assert_same_by_tiles(points, segments, tiles=(2, 30, 400, 3000))
    x, y = (points - points[0])[segments].transpose(2, 1, 0)
    loops = np.split((x[0] * y[1] - x[1] * y[0]) / 2, [3, 7, 12])
    sizes = [float(part.sum()) for part in loops]
    assert area(points, triangles) == pytest.approx(sizes[0] - sizes[1] + sizes[2] - sizes[3])


def test_loops_that_share_a_side_keep_it():
    """A segment is given twice and has points on it: both sides stay, and ties end at its parts."""
    square = np.array([(0, 0), (12, 0), (12, 12), (0, 12), (24, 0), (24, 12)], float)
    segments = np.array([(0, 1), (1, 2), (2, 3), (3, 0), (1, 4), (4, 5), (5, 2), (2, 1)])
    # Two points on the side and three on the circle through them, the lowest on the left.
    circle = np.array([(12, 2), (12, 10), (9, 1), (14, 6), (5, 3)], float)
    dense = integers(8, 25, 200)
    dense = dense[~(dense[:, None] == square).all(axis=2).any(axis=1) & (dense[:, 1] <= 12)]
    for inner in (circle, dense):
        points = np.vstack([square, inner])
        triangles, _ = assert_same_by_tiles(points, segments, tiles=(2, 10, 60))
        assert area(points, triangles) == 24 * 12
        sides = np.sign(points[triangles][:, :, 0] - 12)
        assert (sides.min(axis=1) * sides.max(axis=1) >= 0).all()


def outlines(cells, joined):
    """Return corners (N, 2) and sides (S, 2) of the loops around True cells.

    If `joined`, collinear sides are joined.
    """
    padded = np.pad(cells, 1).astype(int)
    across, down = np.diff(padded, axis=1)[1:-1], np.diff(padded, axis=0)[:, 1:-1]
    sides = {((r, c), (r + 1, c)) for r, c in np.argwhere(across).tolist()}
    sides |= {((r, c), (r, c + 1)) for r, c in np.argwhere(down).tolist()}
    meeting = {}
    for side in sides:
        for corner, other in (side, side[::-1]):
            meeting.setdefault(corner, set()).add(other)
    if joined:
        for corner, others in list(meeting.items()):
            if len(others) == 2:
                one, two = others
                if one[0] == two[0] or one[1] == two[1]:
                    del meeting[corner]
                    meeting[one] ^= {corner, two}
                    meeting[two] ^= {corner, one}
    names = {corner: k for k, corner in enumerate(meeting)}
    pairs = [(names[a], names[b]) for a, others in meeting.items() for b in others if a < b]
    return np.array(list(meeting)), np.array(pairs)


@given(
    rows=st.lists(st.lists(st.booleans(), min_size=4, max_size=4), min_size=2, max_size=5),
    joined=st.booleans(),
    shear=st.sampled_from([((1, 0), (0, 1)), ((3, 1), (-1, 2)), ((1, 1), (-1, 1))]),
    size=st.sampled_from([2, 6, 7]),
    count=st.integers(0, 150),
    seed=st.integers(0, 10**6),
    tile=st.integers(1, 90),
)
def test_any_outline_with_holes_and_pinches(rows, joined, shear, size, count, seed, tile):
    """Loops around random cells: nested, touching in corners, with points exactly on them."""
    cells = np.array(rows)
    if not cells.any():
        return
    corners, segments = outlines(cells, joined)
    corners = corners * size
    rng = np.random.default_rng(seed)
    high = np.array(cells.shape) * size + size
    loose = rng.integers(-size, high + 1, (count, 2))
    loose = loose[~(loose[:, None] == corners).all(axis=2).any(axis=1)]
    loose = np.unique(loose, axis=0)
    points = (np.vstack([corners, loose]) @ np.array(shear)).astype(float)
    triangles, used = assert_same_by_tiles(points, segments, tiles=(tile,))
    assert area(points, triangles) == pytest.approx(
        cells.sum() * size**2 * abs(np.linalg.det(shear))
    )
    assert_delaunay(points, triangles)
    np.testing.assert_array_equal(used, np.unique(triangles))


@given(seed=st.integers(0, 10**6), tile=st.integers(1, 60), sides=st.integers(3, 14))
def test_any_star_among_random_points(seed, tile, sides):
    """No three points are collinear, coordinates use 53 bits, and sides are long."""
    rng = np.random.default_rng(seed)
    star = ring(sides, 1.0, 0.1) * rng.uniform(0.05, 1, (sides, 1))
    points = np.vstack([star, rng.uniform(-1, 1, (150, 2))])
    triangles, _ = assert_same_by_tiles(points, loop(0, sides), tiles=(tile,))
    assert_delaunay(points, triangles)
    assert len(boundary_edges(triangles)) == sides


def test_without_segments_nothing_is_inside():
    points = integers(9, 50, 500)
    none = np.empty((0, 2), np.int32)
    assert len(assert_same_by_tiles(points, none).triangles) == 0


def test_crossing_segments_are_refused():
    points = np.vstack([[(0, 0), (50, 50), (50, 0), (0, 50)], integers(10, 40, 300) + 3.5])
    with pytest.raises(CertificateError, match="crosses itself"):
        triangulated(points, loop(0, 4), tile=20)


@pytest.mark.parametrize("workers", [1, 3])
def test_threads_change_nothing(workers):
    points = integers(11, 500, 9000)
    frame = np.array([(-1, -1), (501, -1), (501, 501), (-1, 501.0)])
    points = np.vstack([frame, points])
    with ThreadPoolExecutor(workers) as executor:
        for segments in (None, loop(0, 4)):
            parts = triangulated(points, segments, 400, executor)
            np.testing.assert_array_equal(parts.triangles, triangulated(points, segments).triangles)


def test_few_points_are_triangulated_twice(monkeypatch):
    """The number of points left over depends on the borders of the tiles, not on their size."""
    counts = []
    engine = tiled.triangulate_points
    monkeypatch.setattr(
        tiled, "triangulate_points", lambda p, *s: counts.append(len(p)) or engine(p, *s)
    )
    points = np.random.default_rng(12).uniform(0, 1000, (100_000, 2))
    square = 1000.0 * np.array([(0, 0), (1, 0), (1, 1), (0, 1)])
    for segments in (None, loop(0, 4)):
        counts.clear()
        triangulated(np.vstack([square, points]), segments, tile=20_000)
        *tiles, rest = counts
        assert sum(tiles) == 100_004
        assert max(tiles) <= 20_000
        assert rest < 5000


@pytest.mark.filterwarnings("ignore::geomesh.GeomeshWarning")
@pytest.mark.parametrize(
    "recipe",
    [
        {"domain": "valid"},
        {"preset": "features", "domain": "hull"},
        {"preset": "paper", "domain": "valid"},
    ],
)
def test_a_mesh_does_not_depend_on_the_threshold(monkeypatch, recipe):
    path = SAMPLES / "bahamas_landsat7_rgb_nodata_collar.tif"
    whole = geomesh.mesh_raster(path, **recipe)
    calls = []
    by_tiles = tiled.triangulate_by_tiles
    monkeypatch.setattr(tiled, "triangulate_by_tiles", lambda *a: calls.append(a) or by_tiles(*a))
    monkeypatch.setattr(triangulate, "TILED_ABOVE", 50)
    monkeypatch.setattr(triangulate, "TILE_POINTS", 300)
    parts = geomesh.mesh_raster(path, **recipe)
    assert calls
    assert parts.certify().passed
    np.testing.assert_array_equal(parts.triangles, whole.triangles)
    np.testing.assert_array_equal(parts.nodes, whole.nodes)


@given(
    points=st.lists(st.tuples(st.integers(0, 5), st.integers(0, 9)), min_size=1, max_size=60),
    most=st.integers(1, 20),
)
def test_boxes_hold_no_point_of_another_tile(points, most):
    points = np.array(points, float)
    order, stops, boxes = kd.split(points, most)
    np.testing.assert_array_equal(np.sort(order), np.arange(len(points)))
    tiles = np.split(points[order], stops[:-1])
    assert max(map(len, tiles)) <= most
    for k, (tile, box) in enumerate(zip(tiles, boxes, strict=True)):
        assert ((tile >= box[:2]) & (tile <= box[2:])).all()
        others = np.concatenate([*tiles[:k], *tiles[k + 1 :], np.empty((0, 2))])
        assert not ((others > box[:2]) & (others < box[2:])).all(axis=1).any()


@given(
    angles=st.lists(st.integers(0, 11), min_size=4, max_size=4, unique=True),
    scale=st.sampled_from([1.0, 1 / 256, 2.0**18, 1 / 3, 0.1, 2.0**30]),
    shift=st.tuples(*[st.sampled_from([0.0, 7.0, -3.5, 1e6, 2.0**31, 1 / 3, -1e9 / 7])] * 2),
    nudge=st.sampled_from([0, 0, 1, -1, 5]),
)
def test_cocircular_is_decided_exactly(angles, scale, shift, nudge):
    """Points on a circle of radius 5, moved and scaled with rounding, one by its last digit."""
    circle = [(5, 0), (4, 3), (3, 4), (0, 5), (-3, 4), (-4, 3)]
    circle += [(-x, -y) for x, y in circle]
    points = np.array(circle, float)[angles] * scale + np.array(shift)
    # Not from zero, because the fourth power of the smallest numbers is zero.
    column = int(points[1, 0] == 0)
    for _ in range(abs(nudge)):
        points[1, column] = np.nextafter(points[1, column], np.inf * nudge)
    if len(np.unique(points, axis=0)) < 4:
        return
    exact = exact_incircle(points, (0, 1, 2), 3) == Fraction(0)
    assert are_cocircular(*points[:, None]).tolist() == [exact]


@pytest.mark.parametrize("radius", [3.0, 2.0**17, 5 * 2.0**18, 2.0**19 + 1 / 256, 2.0**40, 1e7 / 3])
def test_one_step_along_the_tangent_is_seen(radius):
    """The determinant changes by less than the precision of float64, but this is detected."""
    points = radius * np.array([(1, 0), (0, 1), (-1, 0), (0, -1.0)])
    assert are_cocircular(*points[:, None]).all()
    points[0, 1] = max(1 / 256, radius * 2.0**-32)
    assert exact_incircle(points, (0, 1, 2), 3) != 0
    assert not are_cocircular(*points[:, None]).any()
