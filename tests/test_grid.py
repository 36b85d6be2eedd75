"""Grid and Window, compared with affine's own arithmetic and with PROJ's geodesic areas."""

from __future__ import annotations

import math

import numpy as np
import pytest
import shapely
from affine import Affine
from hypothesis import assume, given
from hypothesis import strategies as st
from pyproj import CRS, Geod

from geomesh.errors import GeoreferenceError
from geomesh.raster.grid import Grid, Window

# affine 3 has a pending deprecation of `*` in favour of `@`; affine 2 has only `*`.
pytestmark = pytest.mark.filterwarnings("ignore:Use `@` matmul:PendingDeprecationWarning")

ONE = np.array([[0, 1, 2]], np.int32)
US_FOOT = 1200 / 3937

NORTH_UP = Affine(30, 0, 600_000, 0, -30, 4_900_000)
SOUTH_UP = Affine(30, 0, 600_000, 0, 30, 4_900_000)
MIRRORED = Affine(-30, 0, 600_000, 0, -30, 4_900_000)
ROTATED = Affine(20, 15, 600_000, 15, -20, 4_900_000)
SHEARED = Affine(30, 12, 600_000, 0, -30, 4_900_000)
TRANSPOSED = Affine(0, 30, 600_000, 30, 0, 4_900_000)
TRANSFORMS = [
    pytest.param(NORTH_UP, id="north-up"),
    pytest.param(SOUTH_UP, id="south-up"),
    pytest.param(MIRRORED, id="mirrored"),
    pytest.param(ROTATED, id="rotated"),
    pytest.param(SHEARED, id="sheared"),
    pytest.param(TRANSPOSED, id="transposed"),
]

blocks = st.builds(
    Window,
    st.integers(-20, 20),
    st.integers(-20, 20),
    st.integers(0, 30),
    st.integers(0, 30),
)
shifts = st.floats(-1e6, 1e6)
sizes = st.floats(0.01, 1000) | st.floats(-1000, -0.01)
points = st.lists(st.tuples(st.floats(-50, 500), st.floats(-50, 500)), min_size=1, max_size=20)


@st.composite
def transforms(draw: st.DrawFn) -> Affine:
    """Any position on the map, with flips, rotation and shear, but not nearly a line."""
    shear = draw(st.floats(-45, 45))
    return (
        Affine.translation(draw(shifts), draw(shifts))
        * Affine.rotation(draw(st.floats(-180, 180)))
        * Affine.shear(shear, 0)
        * Affine.scale(draw(sizes), draw(sizes))
    )


def pixels_of(window: Window) -> set[tuple[int, int]]:
    return {
        (row, col)
        for row in range(window.row, window.row + window.height)
        for col in range(window.col, window.col + window.width)
    }


# Window


@given(blocks, blocks)
def test_clip_keeps_the_pixels_that_both_windows_hold(one: Window, other: Window) -> None:
    both = one.clip(other)
    assert both.width >= 0
    assert both.height >= 0
    assert pixels_of(both) == pixels_of(one) & pixels_of(other)


@given(blocks, st.integers(0, 9))
def test_pad_adds_every_pixel_within_reach(window: Window, reach: int) -> None:
    assume(window.width and window.height)
    expected = {
        (row + down, col + right)
        for row, col in pixels_of(window)
        for down in (-reach, 0, reach)
        for right in (-reach, 0, reach)
    }
    padded = window.pad(reach)
    assert expected <= pixels_of(padded)
    assert padded.shape == (window.height + 2 * reach, window.width + 2 * reach)
    assert padded.pad(-reach) == window


def test_slices_cut_the_window_out_of_an_array() -> None:
    window, within = Window(5, 3, 4, 2), Window(2, 1, 20, 10)
    row, col = np.mgrid[0:30, 0:30]
    assert row[window.slices()].tolist() == [[3] * 4, [4] * 4]
    assert col[window.slices()].tolist() == [[5, 6, 7, 8]] * 2
    part = (row[within.slices()], col[within.slices()])
    assert part[0][window.slices(within)].tolist() == [[3] * 4, [4] * 4]
    assert part[1][window.slices(within)].tolist() == [[5, 6, 7, 8]] * 2


def test_a_window_stops_after_its_last_pixel() -> None:
    window = Window(5, 3, 4, 2)
    assert (window.stop_col, window.stop_row, window.shape) == (9, 5, (2, 4))


# To the map and back


@given(transforms(), points)
def test_to_map_is_what_affine_says(transform: Affine, xy: list[tuple[float, float]]) -> None:
    expected = [transform * pair for pair in xy]
    found = Grid(10, 10, transform).to_map(xy)
    assert found.shape == (len(xy), 2)
    np.testing.assert_allclose(found, expected, rtol=1e-12, atol=1e-8)


@given(transforms(), points)
def test_to_pixel_undoes_to_map(transform: Affine, xy: list[tuple[float, float]]) -> None:
    grid = Grid(10, 10, transform)
    # The float64 precision of a map coordinate of up to 2e6, in pixels of 0.01 or more.
    np.testing.assert_allclose(grid.to_pixel(grid.to_map(xy)), xy, rtol=1e-9, atol=1e-6)


def test_no_points_are_no_points_on_the_map() -> None:
    grid = Grid(10, 10, NORTH_UP)
    assert grid.to_map(np.empty((0, 2))).shape == (0, 2)
    assert grid.to_pixel([]).shape == (0, 2)


def test_a_pixel_centre_is_half_a_pixel_from_its_corner() -> None:
    grid = Grid(100, 100, NORTH_UP)
    assert grid.to_map([(0.5, 0.5)]).tolist() == [[600_015, 4_899_985]]


@given(transforms(), st.integers(0, 50), st.integers(0, 40))
def test_window_keeps_the_place_of_its_pixels(transform: Affine, col: int, row: int) -> None:
    grid = Grid(60, 50, transform, CRS(32618))
    window = Window(col, row, 60 - col, 50 - row)
    part = grid.window(window)
    assert (part.width, part.height, part.crs) == (60 - col, 50 - row, grid.crs)
    inner = np.array([(0, 0), (3.5, 1.25)])
    np.testing.assert_allclose(
        part.to_map(inner), grid.to_map(inner + np.array([col, row])), rtol=1e-12, atol=1e-7
    )


@given(transforms(), st.integers(1, 200), st.integers(1, 200))
def test_scaled_covers_the_same_area(transform: Affine, width: int, height: int) -> None:
    grid = Grid(60, 50, transform, CRS(32618))
    zoomed = grid.scaled(width, height)
    assert (zoomed.width, zoomed.height, zoomed.crs) == (width, height, grid.crs)
    shares = np.array([(0, 0), (1, 0), (1, 1), (0, 1), (0.3, 0.6)])
    np.testing.assert_allclose(
        zoomed.to_map(shares * (width, height)),
        grid.to_map(shares * (60, 50)),
        rtol=1e-12,
        atol=1e-7,
    )


@pytest.mark.parametrize("transform", TRANSFORMS)
def test_bounds_are_those_of_the_raster_as_a_polygon(transform: Affine) -> None:
    grid = Grid(40, 20, transform)
    corners = [transform * corner for corner in [(0, 0), (40, 0), (40, 20), (0, 20)]]
    assert grid.bounds() == pytest.approx(shapely.Polygon(corners).bounds, rel=1e-12)


def test_bounds_of_a_rotated_grid_worked_out_by_hand() -> None:
    # One column is (20, 15) m and one row is (15, -20) m. So 40 columns reach (800, 600), and
    # 20 rows reach (300, -400).
    assert Grid(40, 20, ROTATED).bounds() == (600_000, 4_899_600, 601_100, 4_900_600)


@pytest.mark.parametrize("transform", TRANSFORMS)
def test_flips_tells_whether_a_turn_is_mirrored_on_the_map(transform: Affine) -> None:
    turn = [(0, 0), (1, 0), (0, 1)]  # counter-clockwise in (x, y)
    on_map = shapely.LinearRing([transform * corner for corner in turn])
    assert Grid(5, 5, transform).flips == (not on_map.is_ccw)


@pytest.mark.parametrize(
    ("transform", "expected"),
    [
        (NORTH_UP, True),
        (SOUTH_UP, True),
        (MIRRORED, True),
        (ROTATED, False),
        (SHEARED, False),
        (Affine(30, 0, 0, 9, -30, 0), False),
        (TRANSPOSED, False),
    ],
)
def test_only_grids_along_the_axes_are_rectilinear(transform: Affine, expected: bool) -> None:
    assert Grid(5, 5, transform).is_rectilinear is expected


def test_a_raster_without_georeference_is_its_own_map() -> None:
    grid = Grid(7, 5)
    assert grid.to_map([(2.5, 1)]).tolist() == [[2.5, 1]]
    assert grid.bounds() == (0, 0, 7, 5)
    assert not grid.flips


# Errors


@pytest.mark.parametrize(("width", "height"), [(0, 5), (5, 0), (-1, 5), (0, 0)])
def test_a_grid_without_pixels_is_refused(width: int, height: int) -> None:
    with pytest.raises(GeoreferenceError, match=rf"{width} x {height} pixels") as caught:
        Grid(width, height)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("place", range(6))
def test_a_transform_that_is_not_finite_is_refused(bad: float, place: int) -> None:
    values = [30.0, 0.0, 0.0, 0.0, -30.0, 0.0]
    values[place] = bad
    with pytest.raises(GeoreferenceError, match=r"not finite") as caught:
        Grid(5, 5, Affine(*values))
    assert str(bad) in str(caught.value)


@pytest.mark.parametrize(
    "transform",
    [Affine(0, 0, 5, 0, 0, 5), Affine(1, 2, 0, 2, 4, 0), Affine(30, 0, 0, 0, 0, 0)],
)
def test_a_transform_onto_a_line_is_refused(transform: Affine) -> None:
    with pytest.raises(GeoreferenceError, match="onto a line"):
        Grid(5, 5, transform)


def test_a_grid_is_frozen() -> None:
    grid = Grid(5, 5)
    with pytest.raises(AttributeError):
        grid.width = 6  # type: ignore[misc]


# Areas in a plane


@pytest.mark.parametrize("transform", TRANSFORMS)
@given(points)
def test_projected_areas_are_planar_square_metres(
    transform: Affine, xy: list[tuple[float, float]]
) -> None:
    assume(len(xy) > 2)
    triangles = np.array([(0, 1, 2), (2, 1, 0)], np.int32)
    grid = Grid(5, 5, transform, CRS(32618))
    expected = shapely.Polygon([transform * pair for pair in xy[:3]]).area
    # The coordinates of the corners are about 5e6 and exact to 1e-9.
    np.testing.assert_allclose(grid.areas(xy, triangles), expected, rtol=1e-9, atol=1e-3)


def test_without_a_crs_areas_are_map_units_squared() -> None:
    corners = [(0, 0), (4, 0), (0, 6)]
    assert Grid(9, 9).areas(corners, ONE) == pytest.approx([12])


@pytest.mark.parametrize(
    ("crs", "metre"),
    [
        pytest.param(CRS(2263), US_FOOT, id="US survey feet"),
        pytest.param(CRS(2222), 0.3048, id="international feet"),
        pytest.param(CRS("EPSG:2263+6360"), US_FOOT, id="compound in US survey feet"),
        pytest.param(CRS("EPSG:26918+5703"), 1.0, id="compound in metres"),
        pytest.param(
            CRS("+proj=utm +zone=33 +ellps=bessel +towgs84=500,0,0 +units=us-ft +type=crs"),
            US_FOOT,
            id="bound to WGS 84",
        ),
        pytest.param(CRS("+proj=utm +zone=33 +units=km +type=crs"), 1000.0, id="kilometres"),
    ],
)
def test_areas_are_square_metres_whatever_the_unit_of_the_map(crs: CRS, metre: float) -> None:
    grid = Grid(100, 100, Affine(10, 0, 900_000, 0, -10, 200_000), crs)
    corners = [(0, 0), (4, 0), (0, 6)]
    assert grid.areas(corners, ONE) == pytest.approx([12 * 100 * metre**2], rel=1e-9)


# Areas on the ellipsoid

MARS = CRS("IAU_2015:49900")
GEOGRAPHIC = [
    pytest.param(CRS(4326), id="WGS 84"),
    pytest.param(CRS(4269), id="NAD83"),
    pytest.param(CRS(4979), id="WGS 84, three axes"),
    pytest.param(CRS("EPSG:4326+5773"), id="compound"),
    pytest.param(CRS(4807), id="grads"),
    pytest.param(MARS, id="Mars"),
    pytest.param(CRS("IAU_2015:30100"), id="Moon, a sphere"),
    pytest.param(CRS("+proj=longlat +a=6378137 +b=6000000 +type=crs"), id="rather flat"),
]
SMALL = 1 / 3600  # degrees: about 30 m


def degrees_of(crs: CRS) -> float:
    """Return degrees per unit of the map."""
    return math.degrees(crs.axis_info[0].unit_conversion_factor)


def geodesic_area(crs: CRS, corners: np.ndarray) -> float:
    geod = crs.get_geod()
    assert isinstance(geod, Geod)
    lon, lat = (corners * degrees_of(crs)).T
    return abs(geod.polygon_area_perimeter(lon, lat)[0])


def local_area(crs: CRS, corners: np.ndarray) -> float:
    """Return the area of a small triangle from the two radii of curvature at its latitude."""
    ellipsoid = crs.ellipsoid
    assert ellipsoid is not None
    a, b = ellipsoid.semi_major_metre, ellipsoid.semi_minor_metre
    lon, lat = np.radians(corners * degrees_of(crs)).T
    square = 1 - (b / a) ** 2
    w = 1 - square * math.sin(lat.mean()) ** 2
    meridian, normal = a * (1 - square) / w**1.5, a / math.sqrt(w)
    x, y = (lon - lon[0]) * normal * math.cos(lat.mean()), (lat - lat[0]) * meridian
    return abs(x[1] * y[2] - x[2] * y[1]) / 2


def map_areas(crs: CRS, corners: np.ndarray) -> np.ndarray:
    """Return the areas of triangles (T, 3, 2) of map coordinates. A pixel of the grid is 1 unit."""
    nodes = corners.reshape(-1, 2)
    triangles = np.arange(len(nodes), dtype=np.int32).reshape(-1, 3)
    return Grid(360, 180, Affine.identity(), crs).areas(nodes, triangles)


def small_triangle(crs: CRS, lon: float, lat: float, turn: float) -> np.ndarray:
    angles = np.radians(turn + np.array([0, 110, 230]))
    ring = np.column_stack([np.cos(angles), np.sin(angles)]) * SMALL
    return (ring + np.array([lon, lat])) / degrees_of(crs)


@pytest.mark.parametrize("crs", GEOGRAPHIC)
@given(lon=st.floats(-179, 179), lat=st.floats(-60, 60), turn=st.floats(0, 360))
def test_small_geographic_areas_agree_with_radii_of_curvature(
    crs: CRS, lon: float, lat: float, turn: float
) -> None:
    corners = small_triangle(crs, lon, lat, turn)
    (found,) = map_areas(crs, corners[None])
    # The distance from a straight line in longitude and latitude to the great circle is
    # (side / R) tan(latitude) / 8 of the side: 2e-6 at 60 degrees.
    assert found == pytest.approx(local_area(crs, corners), rel=1e-5)


@pytest.mark.parametrize("crs", GEOGRAPHIC[:-1])  # PROJ's series are for small flattening
@given(lon=st.floats(-179, 179), lat=st.floats(-89, 89), turn=st.floats(0, 360))
def test_small_geographic_areas_agree_with_geodesics(
    crs: CRS, lon: float, lat: float, turn: float
) -> None:
    corners = small_triangle(crs, lon, lat, turn)
    (found,) = map_areas(crs, corners[None])
    assert found == pytest.approx(geodesic_area(crs, corners), rel=1e-6)


def test_many_small_triangles_add_up_to_the_area_between_parallels() -> None:
    count = 40
    line = np.arange(count + 1) * SMALL
    x, y = np.meshgrid(-120 + line, 45 + line)
    grid = Grid(count, count, Affine.identity(), CRS(4326))
    first = (np.arange(count)[:, None] * (count + 1) + np.arange(count)).ravel()
    triangles = np.concatenate(
        [
            np.column_stack([first, first + 1, first + count + 2]),
            np.column_stack([first, first + count + 2, first + count + 1]),
        ]
    )
    areas = grid.areas(np.column_stack([x.ravel(), y.ravel()]), triangles)
    # Short sides along a parallel differ from geodesics by 1e-9 of the area.
    a, e = 6378137.0, math.sqrt(0.0066943799901413165)

    def belt(latitude: float) -> float:
        s = math.sin(math.radians(latitude))
        return a * a * (1 - e * e) / 2 * (s / (1 - (e * s) ** 2) + math.atanh(e * s) / e)

    expected = (belt(45 + line[-1]) - belt(45)) * math.radians(line[-1])
    assert areas.sum() == pytest.approx(expected, rel=1e-7)


LARGE = [
    pytest.param([(10, 45), (11, 45), (10, 46)], id="mid latitude"),
    pytest.param([(10, -0.5), (11, -0.5), (10, 0.5)], id="across the equator"),
    pytest.param([(10, 0), (11, 0), (10, 1)], id="on the equator"),
    pytest.param([(0, 88), (30, 88.5), (10, 89.9)], id="near the north pole"),
    pytest.param([(0, -88), (30, -88.5), (10, -89.9)], id="near the south pole"),
    pytest.param([(10, 89), (20, 89), (10, 90)], id="at the pole"),
    pytest.param([(179.5, 10), (180.5, 10), (179.5, 11)], id="across 180 E"),
    pytest.param([(-180.5, 60), (-179.5, 60), (-180, 61)], id="across 180 W"),
    pytest.param([(-60, -30), (-59, -31), (-61, -30.5)], id="south"),
]


@pytest.mark.parametrize("crs", [CRS(4326), CRS(4269), MARS])
@pytest.mark.parametrize("corners", LARGE)
def test_large_geographic_triangles_agree_with_geodesics(
    crs: CRS, corners: list[tuple[float, float]]
) -> None:
    # The sides are great circles of the authalic sphere, not geodesics. On a side of length s,
    # the distance between the two is about f (s / R)^2 of s, where f is the flattening
    # (Mars: 1/170). For a few degrees, this is about 1e-5 of the area.
    place = np.array(corners, float)
    (found,) = map_areas(crs, place[None])
    assert found == pytest.approx(geodesic_area(crs, place), rel=5e-5)


@given(
    st.floats(-85, 85),
    st.lists(st.tuples(st.floats(-1, 1), st.floats(-1, 1)), min_size=3, max_size=3),
)
def test_triangles_of_a_degree_agree_with_geodesics_at_any_latitude(
    lat: float, ring: list[tuple[float, float]]
) -> None:
    place = np.array(ring) + np.array([10, lat])
    expected = geodesic_area(CRS(4326), place)
    # As above, relative to a triangle of one degree: the error of a sliver is that of its sides.
    degree = geodesic_area(CRS(4326), np.array([(10, lat), (11, lat), (10, lat + 1)]))
    assert map_areas(CRS(4326), place[None])[0] == pytest.approx(expected, abs=5e-5 * degree)


def test_longitudes_may_be_counted_past_180() -> None:
    place = np.array([(179.5, 10), (180.5, 10), (179.5, 11)], float)
    turned = place - (360, 0)
    one, other = map_areas(CRS(4326), np.stack([place, turned]))
    assert one == pytest.approx(other, rel=1e-9)


def test_an_octant_of_a_sphere_is_an_eighth_of_it() -> None:
    crs = CRS("+proj=longlat +R=1000 +type=crs")
    octant = np.array([[(0, 0), (90, 0), (0, 90)]], float)
    assert map_areas(crs, octant) == pytest.approx([4 * math.pi * 1000**2 / 8], rel=1e-12)


def test_two_triangles_over_the_whole_world_add_up_to_it() -> None:
    # Sides of 360 degrees follow the map, not the shortest way around the ellipsoid.
    a, e = 6378137.0, math.sqrt(0.0066943799901413165)
    surface = 2 * math.pi * a * a * (1 + (1 - e * e) / e * math.atanh(e))
    west_south, east_south, east_north, west_north = (-180, -90), (180, -90), (180, 90), (-180, 90)
    halves = [(west_south, east_south, east_north), (west_south, east_north, west_north)]
    assert map_areas(CRS(4326), np.array(halves, float)).sum() == pytest.approx(surface, rel=1e-6)


def test_areas_do_not_depend_on_the_orientation() -> None:
    place = np.array([(10, 45), (11, 45), (10, 46)], float)
    one, other = map_areas(CRS(4326), np.stack([place, place[::-1]]))
    assert one == pytest.approx(other, rel=1e-12)
    assert one > 0


@pytest.mark.parametrize("crs", [None, CRS(32618), CRS(4326)])
def test_no_triangles_have_no_areas(crs: CRS | None) -> None:
    assert Grid(5, 5, NORTH_UP, crs).areas([], np.empty((0, 3), np.int32)).shape == (0,)
