"""The outline of the valid data: traced exactly, and simplified without changing any pixel."""

import warnings

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from rasterio.features import shapes
from scipy import ndimage
from scipy.spatial import cKDTree
from shapely.geometry import shape

import geomesh
from geomesh.domain.loops import loop_area, simplify, subdivide
from geomesh.domain.outline import drop_small_loops, find_turns, trace
from geomesh.errors import GeomeshWarning
from geomesh.parallel.tiles import plan_tiles
from geomesh.raster.grid import Window
from support.samples import SAMPLES

masks = arrays(np.bool_, st.tuples(st.integers(1, 24), st.integers(1, 24)))
blobs = st.builds(
    lambda seed, sigma, share: smooth_mask(seed, sigma, share),  # noqa: PLW0108 (defined below)
    st.integers(0, 10**6),
    st.sampled_from([1.0, 2.0, 5.0]),
    st.floats(0.1, 0.9),
)


NO_SEGMENTS = np.empty((0, 2, 2))


def smooth_mask(seed, sigma, share):
    noise = ndimage.gaussian_filter(np.random.default_rng(seed).normal(size=(40, 50)), sigma)
    return noise < np.quantile(noise, share)


def outline_of(mask, core=1024):
    extent = Window(0, 0, mask.shape[1], mask.shape[0])
    tiles = plan_tiles(extent, core=core, halo=1)
    return trace([find_turns(mask[t.read.slices()], t, extent) for t in tiles]), extent


def loops_of(outline):
    return [outline.xy[a:b] for a, b in zip(outline.starts[:-1], outline.starts[1:], strict=True)]


def centres(mask, value=True):
    row, col = np.nonzero(mask == value)
    return shapely.points(col + 0.5, row + 0.5)


def inside(loops, points):
    """Use the even-odd rule over all loops, so loops may be nested or touch each other."""
    total = np.zeros(len(points), int)
    for loop in loops:
        total += shapely.contains(shapely.Polygon(loop), points)
    return total % 2 == 1


@given(mask=masks | blobs)
def test_loops_are_the_borders_of_the_4_connected_regions(mask):
    outline, _ = outline_of(mask)
    areas = outline.areas()
    _, regions = ndimage.label(mask)
    holes, _ = ndimage.label(~np.pad(mask, 1), structure=np.ones((3, 3)))
    assert np.count_nonzero(areas > 0) == regions
    assert np.count_nonzero(areas < 0) == holes.max(initial=0) - bool(holes.size)
    assert areas.sum() == mask.sum()


@given(mask=masks | blobs)
def test_traced_outline_has_the_length_and_area_of_gdals_polygons(mask):
    outline, _ = outline_of(mask)
    polygons = [
        shape(geometry)
        for geometry, value in shapes(mask.astype(np.uint8), connectivity=4)
        if value == 1
    ]
    length = sum(np.abs(np.diff(loop, axis=0, append=loop[:1])).sum() for loop in loops_of(outline))
    assert length == pytest.approx(sum(polygon.length for polygon in polygons))
    assert outline.areas().sum() == pytest.approx(sum(polygon.area for polygon in polygons))


@pytest.mark.slow
@given(mask=masks | blobs, core=st.integers(1, 9))
def test_the_outline_does_not_depend_on_the_tiles(mask, core):
    whole, _ = outline_of(mask)
    tiled, _ = outline_of(mask, core=core)
    np.testing.assert_array_equal(tiled.xy, whole.xy)
    np.testing.assert_array_equal(tiled.starts, whole.starts)


@given(mask=masks | blobs)
def test_simplified_loops_keep_every_pixel_centre_on_its_side(mask):
    outline, extent = outline_of(mask)
    loops = simplify(outline, extent)
    assert inside(loops, centres(mask)).all()
    assert not inside(loops, centres(mask, False)).any()


@given(mask=masks | blobs)
def test_simplified_loops_move_by_less_than_a_pixel_and_do_not_cross(mask):
    outline, extent = outline_of(mask)
    loops = simplify(outline, extent)
    for exact, loop in zip(loops_of(outline), loops, strict=True):
        assert len(loop) >= 3
        ring, simple = shapely.LinearRing(exact), shapely.LinearRing(loop)
        assert shapely.hausdorff_distance(ring, simple, densify=0.1) < 1
        assert len(loop) <= len(exact)
    lines = shapely.linestrings(np.concatenate([segments(loop) for loop in loops] or [NO_SEGMENTS]))
    crossing = shapely.STRtree(lines).query(lines, predicate="crosses")
    assert crossing.size == 0


def segments(loop):
    return np.stack([loop, np.roll(loop, -1, axis=0)], axis=1)


@pytest.mark.parametrize("degrees", [1.0, 5.0, 13.0, 31.7, 44.0])
def test_a_turned_footprint_gets_few_corners(degrees):
    """The valid area of a satellite scene: a rotated square of 500 pixels."""
    y, x = np.mgrid[:800, :800] - 399.5
    angle = np.radians(degrees)
    u, v = x * np.cos(angle) + y * np.sin(angle), y * np.cos(angle) - x * np.sin(angle)
    outline, extent = outline_of((np.abs(u) < 250) & (np.abs(v) < 250))
    (loop,) = simplify(outline, extent)
    assert len(loop) < 60


def test_the_frame_and_rectangles_stay_as_they_are():
    mask = np.ones((30, 40), bool)
    mask[10:20, 5:25] = False
    outline, extent = outline_of(mask)
    loops = simplify(outline, extent)
    found = {frozenset(map(tuple, loop)) for loop in loops}
    assert found == {
        frozenset([(0, 0), (40, 0), (40, 30), (0, 30)]),
        frozenset([(5, 10), (25, 10), (25, 20), (5, 20)]),
    }


def test_diagonal_pixels_touch_in_a_corner_and_stay_apart():
    outline, extent = outline_of(np.eye(3, dtype=bool))
    assert sorted(outline.areas()) == [1, 1, 1]
    assert len(simplify(outline, extent)) == 3


def test_small_islands_and_holes_go_with_what_is_in_them():
    mask = np.zeros((60, 60), bool)
    mask[5:55, 5:55] = True
    mask[20:27, 20:27] = False  # a hole of 49 pixels
    mask[22:25, 22:25] = True  # an island of 9 pixels in the hole
    mask[1:3, 1:3] = True  # an island of 4 pixels
    outline, _ = outline_of(mask)
    kept, dropped = drop_small_loops(outline, 64)
    assert (len(kept.areas()), dropped) == (1, (2, 1, 9 + 4 - 49))
    kept, _ = drop_small_loops(outline, 10_000)
    np.testing.assert_array_equal(kept.areas(), [50 * 50])
    kept, dropped = drop_small_loops(outline, 5)
    assert (len(kept.areas()), dropped) == (3, (1, 0, 4))


def test_subdivision_follows_the_distance_to_the_nodes_inside():
    loop = np.array([(0, 0), (256, 0), (256, 256), (0, 256)], float)
    near_corner = subdivide(loop, 4.0, cKDTree([(8.0, 8.0)]))
    top = np.sort(near_corner[near_corner[:, 1] == 0][:, 0])
    steps = np.diff(top)
    assert steps[0] <= 8
    assert steps[-1] >= 64
    assert (np.diff(steps) >= 0).all()
    assert loop_area(near_corner) == loop_area(loop)
    np.testing.assert_array_equal(subdivide(loop, 4.0, cKDTree(np.empty((0, 2)))), loop)


@pytest.mark.parametrize("min_hole", [0, 1, 64])
@pytest.mark.parametrize("sigma", [0.0, 1.0, 4.0])
def test_triangles_never_span_nodata(sigma, min_hole):
    """A different rasterization shows that no triangle covers the centre of a nodata pixel."""
    rng = np.random.default_rng(7)
    noise = rng.normal(size=(90, 110))
    mask = (ndimage.gaussian_filter(noise, sigma) if sigma else noise) < 0
    image = np.where(mask, rng.integers(0, 255, mask.shape), np.nan).astype(np.float32)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GeomeshWarning)
        mesh = geomesh.mesh_raster((image, None, None), min_hole=min_hole)
    assert mesh.certify().passed
    covered = mesh.to_geodataframe().union_all()
    lost = ~shapely.contains(covered, centres(mask))
    wrong = shapely.contains(covered, centres(mask, False))
    if min_hole <= 1:
        assert lost.sum() == wrong.sum() == 0
    counted = mesh.triangle_table["count"].sum()
    assert counted == mask.sum() - lost.sum()
    assert mesh.metadata["pixels"]["covered"] == counted + wrong.sum()


def test_the_mesh_of_a_collared_scene_covers_its_valid_pixels():
    path = SAMPLES / "parana_landsat8_rgb_uint16_nodata_edge.tif"
    mesh = geomesh.mesh_raster(path, min_hole=1)
    assert mesh.triangle_table["count"].sum() == mesh.domain.valid_pixels
