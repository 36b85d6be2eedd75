"""Extent: a box or an area of interest keeps exactly the pixels with their centre inside."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import geopandas as gpd
import numpy as np
import pytest
import shapely
from affine import Affine
from hypothesis import given, settings
from hypothesis import strategies as st
from shapely import affinity

from geomesh.errors import EmptyError, GeoreferenceError, SourceError
from geomesh.features.overview import read_overview
from geomesh.parallel.workers import open_workers
from geomesh.raster.grid import Window
from geomesh.raster.open import open_scene
from support.samples import OLINDA

if TYPE_CHECKING:
    from pathlib import Path

    from geomesh.raster.scene import Scene

UTM = "EPSG:32618"
WIDTH, HEIGHT = 60, 50
# Pixel (row, col) has the value 1000 row + col, so a value shows the position of its pixel.
VALUES = (np.arange(HEIGHT)[:, None] * 1000 + np.arange(WIDTH)).astype(np.int32)
TRANSFORMS = {
    "north-up": Affine(30, 0, 600_000, 0, -30, 4_900_000),
    "south-up": Affine(30, 0, 600_000, 0, 30, 4_900_000),
    "mirrored": Affine(-30, 0, 600_000, 0, -30, 4_900_000),
    "rotated": Affine(20, 15, 600_000, 15, -20, 4_900_000),
    "sheared": Affine(30, 9, 600_000, 0, -20, 4_900_000),
    "a quarter turn": Affine(0, 30, 600_000, 30, 0, 4_900_000),
}
NORTH_UP = TRANSFORMS["north-up"]
every_transform = pytest.mark.parametrize("transform", TRANSFORMS.values(), ids=TRANSFORMS)


def open_area(transform: Affine, crs: str | None = UTM, **options: Any) -> Scene:
    return open_scene((VALUES, transform, crs), **options)


def read_valid(scene: Scene) -> np.ndarray:
    """Return which pixels of the whole raster are valid, found from the values."""
    with scene.open() as reader:
        bands, valid = reader.read(scene.grid.extent)
    rows, cols = np.divmod(bands[0][valid], 1000)
    found = np.zeros(VALUES.shape, bool)
    found[rows, cols] = True
    # Each pixel is where the grid of the scene says.
    row, col = np.nonzero(valid)
    whole = np.column_stack([cols, rows]) - np.column_stack([col, row])
    assert (whole == (scene.window.col, scene.window.row)).all()
    return found


def centres(transform: Affine) -> tuple[np.ndarray, np.ndarray]:
    """Return the map coordinates of the pixel centres."""
    x, y = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    t = transform
    return t.a * x + t.b * y + t.c, t.d * x + t.e * y + t.f


def inside(area: Any, transform: Affine) -> np.ndarray:
    """Return which pixel centres are in an area. None may be on its border."""
    x, y = centres(transform)
    assert shapely.distance(area.boundary, shapely.points(x, y)).min() > 1e-3
    return shapely.contains_xy(area, x, y)


def on_map(shape: Any, transform: Affine) -> Any:
    """Return a shape on the map from one in pixel-edge coordinates."""
    t = transform
    return affinity.affine_transform(shape, [t.a, t.b, t.d, t.e, t.c, t.f])


def frame_of(*shapes: Any, crs: str | None = UTM) -> gpd.GeoDataFrame:
    return gpd.GeoDataFrame(geometry=list(shapes), crs=crs)


# No pixel centre is on a border of these shapes.
BLOB = shapely.Polygon(
    [(5.3, 8.1), (30.2, 3.3), (51.7, 20.9), (40.1, 44.4), (28.6, 22.2), (9.9, 39.8)]
)
RING = shapely.Polygon(
    [(4.15, 4.3), (55.3, 6.2), (50.3, 46.1), (8.8, 42.7)],
    [[(20.1, 15.3), (40.2, 18.4), (35.7, 33.3), (22.8, 30.6)]],
)
PARTS = shapely.MultiPolygon([shapely.box(3.2, 3.3, 12.4, 20.1), shapely.box(30.2, 25.6, 55, 49)])
SHAPES = {"blob": BLOB, "ring": RING, "two parts": PARTS}


# Bounds


@every_transform
def test_bounds_of_the_whole_raster_change_nothing(transform: Affine) -> None:
    whole = open_area(transform)
    found = open_area(transform, bounds=whole.grid.bounds())
    assert found.window == whole.window
    assert found.grid == whole.grid
    assert read_valid(found).all()


@pytest.mark.parametrize("name", ["north-up", "south-up", "mirrored"])
@given(
    left=st.integers(0, WIDTH - 1),
    top=st.integers(0, HEIGHT - 1),
    width=st.integers(1, 20),
    height=st.integers(1, 20),
)
def test_bounds_along_pixel_borders_keep_those_pixels(
    name: str, left: int, top: int, width: int, height: int
) -> None:
    transform = TRANSFORMS[name]
    window = Window(left, top, width, height).clip(Window(0, 0, WIDTH, HEIGHT))
    box = shapely.box(left, top, window.stop_col, window.stop_row)
    scene = open_area(transform, bounds=on_map(box, transform).bounds)
    assert scene.window == window
    assert scene.grid == open_area(transform).grid.window(window)
    with scene.open() as reader:
        bands, valid = reader.read(scene.grid.extent)
    np.testing.assert_array_equal(bands[0], VALUES[window.slices()])
    assert valid.all()


@pytest.mark.parametrize("pixel", [1 / 3600, 0.1, 1 / 7])
@given(st.floats(-170, 170), st.integers(0, WIDTH - 2), st.integers(0, HEIGHT - 2))
def test_bounds_along_borders_that_float64_cannot_hold_keep_those_pixels(
    pixel: float, west: float, col: int, row: int
) -> None:
    transform = Affine(pixel, 0, west, 0, -pixel, 40.1)
    bounds = (
        west + col * pixel,
        40.1 - (row + 2) * pixel,
        west + (col + 2) * pixel,
        40.1 - row * pixel,
    )
    scene = open_area(transform, crs="EPSG:4326", bounds=bounds)
    assert scene.window == Window(col, row, 2, 2)


@pytest.mark.parametrize("name", ["north-up", "south-up", "mirrored"])
def test_bounds_keep_the_pixels_whose_centre_is_inside(name: str) -> None:
    transform = TRANSFORMS[name]
    box = on_map(shapely.box(10.2, 20.7, 12.1, 22.9), transform)
    assert open_area(transform, bounds=box.bounds).window == Window(10, 21, 2, 2)


@pytest.mark.parametrize("name", ["north-up", "south-up", "mirrored"])
def test_bounds_may_reach_beyond_the_raster(name: str) -> None:
    transform = TRANSFORMS[name]
    box = on_map(shapely.box(-1000, 40.5, 10.5, 9000), transform)
    assert open_area(transform, bounds=box.bounds).window == Window(0, 40, 11, 10)


@pytest.mark.parametrize("name", ["rotated", "sheared", "a quarter turn"])
@settings(max_examples=40)
@given(
    x=st.floats(0.1, 0.8), y=st.floats(0.1, 0.8), width=st.floats(0.1, 0.5),
    height=st.floats(0.1, 0.5),
)  # fmt: skip
def test_bounds_of_a_turned_raster_keep_the_centres_inside(
    name: str, x: float, y: float, width: float, height: float
) -> None:
    transform = TRANSFORMS[name]
    west, south, east, north = open_area(transform).grid.bounds()
    # The bounds miss all centres, whose coordinates are multiples of 2.5 m.
    box = shapely.box(
        *np.floor([west + x * (east - west), south + y * (north - south)]) + 0.3,
        *np.floor([west + (x + width) * (east - west), south + (y + height) * (north - south)])
        + 0.3,
    )
    expected = inside(box, transform)
    try:
        found = read_valid(open_area(transform, bounds=box.bounds))
    except EmptyError:
        found = np.zeros_like(expected)
    np.testing.assert_array_equal(found, expected)


@every_transform
@pytest.mark.parametrize("shift", [(100, 0), (0, -100), (-100, 100)])
def test_bounds_beside_the_raster_are_an_error(transform: Affine, shift: tuple) -> None:
    box = on_map(affinity.translate(shapely.box(10, 10, 20, 20), *shift), transform)
    with pytest.raises(EmptyError, match="`bounds` lies outside") as caught:
        open_area(transform, bounds=box.bounds)
    assert "EPSG:32618" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "bounds",
    [(5, 0, 5, 9), (9, 0, 5, 9), (0, 9, 5, 0), (0, 5, 5, 5), (float("nan"), 0, 5, 9)],
)
def test_bounds_in_the_wrong_order_are_an_error(bounds: tuple) -> None:
    with pytest.raises(GeoreferenceError, match="west < east and south < north") as caught:
        open_area(NORTH_UP, bounds=bounds)
    assert " ".join(f"{value:g}" for value in bounds) in str(caught.value)


@pytest.mark.parametrize("name", TRANSFORMS)
@pytest.mark.filterwarnings("ignore:invalid value:RuntimeWarning")
def test_bounds_without_end_are_an_error(name: str) -> None:
    for bounds in ((600_000, -np.inf, np.inf, 4_900_000), (-np.inf, -np.inf, np.inf, np.inf)):
        with pytest.raises(GeoreferenceError, match="inf"):
            open_area(TRANSFORMS[name], bounds=bounds)


def test_bounds_of_a_raster_without_georeference_are_pixels() -> None:
    scene = open_area(Affine.identity(), crs=None, bounds=(10, 5, 20, 12))
    assert scene.window == Window(10, 5, 10, 7)


# Mask


@every_transform
@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
def test_a_mask_keeps_the_centres_inside(transform: Affine, shape: Any) -> None:
    area = on_map(shape, transform)
    scene = open_area(transform, mask=frame_of(area))
    np.testing.assert_array_equal(read_valid(scene), inside(area, transform))


@every_transform
@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
def test_a_mask_leaves_the_least_window(transform: Affine, shape: Any) -> None:
    scene = open_area(transform, mask=frame_of(on_map(shape, transform)))
    rows, cols = np.nonzero(inside(on_map(shape, transform), transform))
    assert scene.window.slices() == (
        slice(rows.min(), rows.max() + 1),
        slice(cols.min(), cols.max() + 1),
    )


@settings(max_examples=60, deadline=None)
@given(
    name=st.sampled_from(sorted(TRANSFORMS)),
    corners=st.lists(
        st.tuples(st.integers(-10 * 16, 70 * 16), st.integers(-10 * 16, 60 * 16)),
        min_size=3,
        max_size=9,
        unique=True,
    ),
)
def test_any_polygon_keeps_the_centres_inside(name: str, corners: list) -> None:
    hull = shapely.convex_hull(shapely.multipoints(np.array(corners) / 16 + 1 / 64))
    if hull.geom_type != "Polygon":
        return
    transform = TRANSFORMS[name]
    area = on_map(hull, transform)
    # Rounding decides whether a centre exactly on the border is inside.
    near = shapely.distance(area.boundary, shapely.points(*centres(transform))) < 1e-6
    expected = shapely.contains_xy(area, *centres(transform))
    try:
        found = read_valid(open_area(transform, mask=frame_of(area)))
    except EmptyError:
        found = np.zeros_like(expected)
    np.testing.assert_array_equal(found[~near], expected[~near])


@every_transform
@pytest.mark.parametrize("crs", ["EPSG:4326", "EPSG:32617", "EPSG:3857"])
def test_a_mask_in_another_crs_is_brought_to_the_rasters(transform: Affine, crs: str) -> None:
    there = frame_of(on_map(BLOB, transform), on_map(PARTS, transform)).to_crs(crs)
    back = there.to_crs(UTM).union_all()
    found = read_valid(open_area(transform, mask=there))
    np.testing.assert_array_equal(found, inside(back, transform))
    assert found.any()
    assert not found.all()


@pytest.mark.parametrize("driver", ["GPKG", "GeoJSON"])
def test_a_mask_may_be_a_file(tmp_path: Path, driver: str) -> None:
    there = frame_of(on_map(BLOB, NORTH_UP)).to_crs("EPSG:4326")
    path = tmp_path / f"area.{driver.lower()}"
    there.to_file(path, driver=driver)
    for given_as in (path, str(path)):
        found = read_valid(open_area(NORTH_UP, mask=given_as))
        np.testing.assert_array_equal(found, inside(on_map(BLOB, NORTH_UP), NORTH_UP))


def test_a_mask_may_be_a_geoseries() -> None:
    area = on_map(BLOB, NORTH_UP)
    found = read_valid(open_area(NORTH_UP, mask=gpd.GeoSeries([area], crs=UTM)))
    np.testing.assert_array_equal(found, inside(area, NORTH_UP))


def test_a_mask_without_crs_is_in_the_rasters_coordinates() -> None:
    area = on_map(BLOB, NORTH_UP)
    for crs in (UTM, None):
        found = read_valid(open_area(NORTH_UP, crs=crs, mask=frame_of(area, crs=None)))
        np.testing.assert_array_equal(found, inside(area, NORTH_UP))


def test_points_and_lines_of_a_mask_are_passed_over() -> None:
    area = on_map(BLOB, NORTH_UP)
    line = on_map(shapely.LineString([(0, 0), (60, 50)]), NORTH_UP)
    found = read_valid(open_area(NORTH_UP, mask=frame_of(line, area, None, shapely.Point(0, 0))))
    np.testing.assert_array_equal(found, inside(area, NORTH_UP))


def test_a_mask_that_crosses_itself_is_mended() -> None:
    bow = shapely.Polygon([(5.2, 5.3), (40.1, 40.2), (40.1, 5.3), (5.2, 40.2)])
    area = on_map(bow, NORTH_UP)
    found = read_valid(open_area(NORTH_UP, mask=frame_of(area)))
    np.testing.assert_array_equal(found, inside(shapely.make_valid(area), NORTH_UP))


@every_transform
def test_a_mask_is_the_same_in_parts_as_in_whole(transform: Affine) -> None:
    scene = open_area(transform, mask=frame_of(on_map(RING, transform)))
    with scene.open() as reader:
        _, whole = reader.read(scene.grid.extent)
        for col, row in ((0, 0), (7, 11), (25, 20)):
            window = Window(col, row, 13, 9)
            _, part = reader.read(window)
            np.testing.assert_array_equal(part, whole[window.slices()])


# Both


@every_transform
def test_bounds_and_mask_keep_what_is_in_both(transform: Affine) -> None:
    shape = on_map(BLOB, transform)
    # A box on the map around the middle. Its borders touch no pixel centre.
    x, y = on_map(shapely.Point(25, 20), transform).coords[0]
    box = shapely.box(x - 300.7, y - 240.3, x + 330.9, y + 270.1)
    found = read_valid(open_area(transform, bounds=box.bounds, mask=frame_of(shape)))
    expected = inside(shape, transform)
    if transform.b == 0 == transform.d:  # such bounds keep all pixels that they touch
        kept = np.zeros_like(expected)
        kept[open_area(transform, bounds=box.bounds).window.slices()] = True
        expected &= kept
    else:
        expected &= inside(box, transform)
    np.testing.assert_array_equal(found, expected)
    assert found.any()


@every_transform
def test_bounds_and_mask_with_nothing_in_common_are_an_error(transform: Affine) -> None:
    box = on_map(shapely.box(2, 2, 8, 8), transform)
    far = on_map(shapely.box(40.2, 40.2, 50.4, 48.3), transform)
    with pytest.raises(EmptyError) as caught:
        look_at(open_area(transform, bounds=box.bounds, mask=frame_of(far)))
    assert "`mask`" in str(caught.value)


@pytest.mark.parametrize("name", ["rotated", "sheared"])
def test_bounds_and_mask_whose_windows_overlap_only_are_an_error(name: str, recwarn) -> None:
    transform = TRANSFORMS[name]
    # In pixels, the box is a slanted quadrilateral. The mask is in a corner of its window.
    x, y = on_map(shapely.Point(30, 25), transform).coords[0]
    box = shapely.box(x - 200.3, y - 200.3, x + 200.3, y + 200.3)
    back = [*(~transform)[:6]]
    slanted = affinity.affine_transform(box, [back[0], back[1], back[3], back[4], back[2], back[5]])
    left, top, _, _ = slanted.bounds
    corner = on_map(shapely.box(left, top, left + 1.6, top + 1.6), transform)
    assert not corner.intersects(box)
    with pytest.raises(EmptyError):
        look_at(open_area(transform, bounds=box.bounds, mask=frame_of(corner)))
    assert [str(warning.message) for warning in recwarn] == []


def look_at(scene: Scene) -> None:
    with open_workers(1) as workers, scene.open():
        read_overview(scene, workers, lambda _fraction, _message: None)


# Errors


@every_transform
def test_a_mask_beside_the_raster_is_an_error(transform: Affine) -> None:
    with pytest.raises(EmptyError, match="`mask` lies outside"):
        open_area(transform, mask=frame_of(on_map(shapely.box(100, 0, 120, 9), transform)))


def test_a_mask_between_pixel_centres_is_an_error() -> None:
    small = on_map(shapely.box(9.6, 9.6, 10.4, 10.4), NORTH_UP)
    with pytest.raises(EmptyError, match="`mask` contains no centre of a pixel"):
        open_area(NORTH_UP, mask=frame_of(small))


@pytest.mark.parametrize("shapes", [[], [shapely.Point(1, 2)], [None]])
def test_a_mask_without_polygons_is_an_error(shapes: list) -> None:
    with pytest.raises(SourceError, match="the mask contains no polygon"):
        open_area(NORTH_UP, mask=frame_of(*shapes))


def test_a_mask_of_an_empty_polygon_is_an_error() -> None:
    with pytest.raises(SourceError, match="the mask contains no polygon"):
        open_area(NORTH_UP, mask=frame_of(shapely.Polygon()))


def test_a_mask_with_crs_needs_a_raster_with_one() -> None:
    with pytest.raises(GeoreferenceError, match="EPSG:32618 but the array has no CRS"):
        open_area(NORTH_UP, crs=None, mask=frame_of(on_map(BLOB, NORTH_UP)))


def test_a_mask_file_that_is_missing_is_named(tmp_path: Path) -> None:
    path = tmp_path / "absent.gpkg"
    with pytest.raises(SourceError) as caught:
        open_area(NORTH_UP, mask=path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_mask_file_that_is_no_vector_file_is_named(tmp_path: Path) -> None:
    path = tmp_path / "notes.gpkg"
    path.write_text("not a vector file")
    with pytest.raises(SourceError) as caught:
        open_area(NORTH_UP, mask=path)
    assert str(path) in str(caught.value)


def test_a_table_without_geometry_is_an_error(tmp_path: Path) -> None:
    path = tmp_path / "table.csv"
    path.write_text("a,b\n1,2\n")
    with pytest.raises(SourceError):
        open_area(NORTH_UP, mask=path)


@pytest.mark.parametrize("mask", [5, [BLOB]], ids=["number", "list"])
def test_what_is_no_mask_is_an_error(mask: Any) -> None:
    with pytest.raises(SourceError, match="mask"):
        open_area(NORTH_UP, mask=mask)


UNDEFINED = (
    'GEOGCRS["Undefined geographic SRS",DATUM["unknown",ELLIPSOID["unknown",6378137,298.25]],'
    'CS[ellipsoidal,2],AXIS["latitude",north],AXIS["longitude",east],'
    'ANGLEUNIT["degree",0.0174532925199433]]'
)


def test_the_crs_that_geopackages_give_to_layers_without_one_is_none():
    west, south, east, north = open_scene(OLINDA).grid.bounds()
    middle = shapely.box(west + 2000, south + 2000, east - 2000, north - 2000)
    frame = gpd.GeoDataFrame(geometry=[middle], crs=UNDEFINED)
    assert open_scene(OLINDA, mask=frame).grid.width < open_scene(OLINDA).grid.width


def test_a_mask_in_a_wrong_crs_is_told_in_one_line(tmp_path):
    frame = gpd.GeoDataFrame(geometry=[shapely.box(290_000, 9e6, 291_000, 9.1e6)], crs="EPSG:4326")
    with pytest.raises(GeoreferenceError, match="check the CRS of the mask") as caught:
        open_scene(OLINDA, mask=frame)
    assert "\n" not in str(caught.value)
