"""The fidelity benchmark: equal numbers of nodes, one scorer, vertices counted right."""

from __future__ import annotations

import math

import numpy as np
import pytest
import rasterio.features
from click.testing import CliRunner
from shapely.geometry import shape

pytest.importorskip("pydelatin")
pytest.importorskip("skimage")

from benchmarks import fidelity
from benchmarks.bounded import Bounded, BoundedPair, greedy, largest_error
from benchmarks.fidelity_tables import ADAPTIVE, Findings, Record, checks, tables, write_markdown
from benchmarks.peers import PEERS, place, triangulate, with_corners
from benchmarks.scoring import Raster, spread
from benchmarks.superpixels import TOLERANCE, count_vertices, segment, superpixels
from support.samples import NODATA_EDGE, OLINDA, write_mirrored

SIDE = 64


@pytest.fixture(scope="module", params=[OLINDA.name, NODATA_EDGE])
def raster(request, tmp_path_factory):
    """The corner of a sample: uint8 and complete, or uint16; both with a hole of nodata."""
    folder = tmp_path_factory.mktemp("fidelity")
    with rasterio.open(OLINDA.with_name(request.param)) as dataset:
        window = rasterio.windows.Window(dataset.width - SIDE, dataset.height - SIDE, SIDE, SIDE)
        bands = dataset.read(window=window)
        profile = dataset.profile
    profile |= {"width": SIDE, "height": SIDE, "nodata": 0, "tiled": False}
    bands = np.maximum(bands, 1)
    bands[:, 20:36, 12:40] = 0
    with rasterio.open(folder / "part.tif", "w", **profile) as dataset:
        dataset.write(bands)
    return Raster.read(folder / "part.tif")


@pytest.mark.parametrize("method", PEERS)
@pytest.mark.parametrize("count", [40, 200])
def test_a_peer_has_the_number_of_nodes_and_a_mesh_over_all_valid_pixels(raster, method, count):
    sets = list(place(method, raster, count))
    assert len(sets) == (2 if method in ("Yang error diffusion", "greedy insertion") else 1)
    for points in sets:
        nodes, triangles = triangulate(points)
        assert len(points) == len(nodes) == count
        _, missing = raster.score(raster.show(nodes, triangles, "linear"))
        assert missing == 0


def test_corners_are_those_of_the_valid_pixels_and_each_point_is_there_once():
    valid = np.zeros((9, 9), np.bool_)
    valid[2:5, 3:8] = True
    found = with_corners(np.array([[5.5, 3.5], [3, 2]]), valid)
    assert sorted(map(tuple, found)) == [(3, 2), (3, 5), (5.5, 3.5), (8, 2), (8, 5)]


def test_the_scorer_is_the_psnr_of_plain_numpy_over_all_valid_pixels(raster):
    rng = np.random.default_rng(0)
    image = raster.bands + rng.normal(0, 3, raster.bands.shape)
    image[:, ~raster.valid] = np.nan
    total, count = 0.0, 0
    for shown, true in zip(image, raster.bands, strict=True):
        pixels = true[raster.valid]
        peak = 255 if raster.scene.dtype == np.uint8 else pixels.max() - pixels.min()
        total += (((shown[raster.valid] - pixels) / peak) ** 2).sum()
        count += len(pixels)
    assert raster.score(image) == (pytest.approx(10 * math.log10(count / total)), 0)
    assert raster.score(raster.bands) == (math.inf, 0)


def test_a_pixel_in_no_triangle_has_the_value_of_the_nearest(raster):
    image = raster.bands.copy()
    row, col = np.argwhere(raster.valid)[-1]
    image[:, row, col] = np.nan
    worse = raster.bands.copy()
    worse[:, row, col] = worse[:, row, col - 1]
    known = raster.valid.copy()
    known[:] = True
    known[row, col] = False
    filled = spread(image, known)
    assert raster.score(image) == (raster.score(filled)[0], 1)
    neighbours = [raster.bands[:, row, col - 1], raster.bands[:, row - 1, col]]
    assert any((filled[:, row, col] == each).all() for each in neighbours)


def test_vertices_of_a_typed_example():
    labels = np.array(
        [
            [1, 1, 2, 2],
            [1, 1, 2, 2],
            [1, 3, 3, 2],
            [4, 3, 3, 2],
        ]
    )
    # On the frame: between 1 and 2, 1 and 4, 4 and 3, 3 and 2. Inside: where 1, 2 and 3 meet,
    # where 1, 3 and 4 meet, and the two turns of 3 at (1, 2) and (3, 2).
    assert count_vertices(labels) == 8
    # Two halves: only both ends of their border, which goes straight on between them.
    assert count_vertices(np.repeat([[1, 1, 2, 2]], 4, axis=0)) == 2
    assert count_vertices(np.ones((4, 4), int)) == 0
    # The outline of the valid pixels turns, but no border between superpixels ends there.
    assert count_vertices(np.array([[1, 1, 0], [1, 1, 1], [0, 0, 1]])) == 0
    assert count_vertices(np.array([[1, 2, 0], [1, 2, 2], [0, 0, 2]])) == 2


def test_vertices_are_those_of_the_polygons_of_rasterio(raster):
    labels = segment(raster, 40, 1.0)
    labels = np.where(labels > 0, labels, labels.max() + 1).astype(np.int32)
    corners = set()
    for polygon, _ in rasterio.features.shapes(labels, connectivity=4):
        area = shape(polygon)
        for ring in (area.exterior, *area.interiors):
            points = np.array(ring.coords[:-1])
            before, after = (
                points - np.roll(points, 1, axis=0),
                np.roll(points, -1, axis=0) - points,
            )
            turns = before[:, 0] * after[:, 1] != before[:, 1] * after[:, 0]
            corners |= set(map(tuple, points[turns]))
    assert count_vertices(labels) == len(corners - {(x, y) for x in (0, SIDE) for y in (0, SIDE)})


def test_superpixels_have_about_as_many_vertices_as_wanted(raster):
    found = superpixels(raster, 200)
    assert 100 < found.vertices <= 200 * (1 + TOLERANCE)
    decibels, missing = raster.score(found.image)
    assert missing == 0
    assert decibels > raster.score(np.ones_like(raster.bands) * raster.bands.mean())[0]


def test_the_largest_error_is_that_of_plain_interpolation():
    points = np.array([[0, 0], [8, 0], [0, 8], [8, 8]], float)
    triangles = np.array([[0, 1, 2], [3, 2, 1]])
    y, x = np.indices((8, 8)) + 0.5
    band = 2 * x - y
    band[5, 6] += 3
    values = 2 * points[:, 0] - points[:, 1]
    valid = np.ones((8, 8), np.bool_)
    assert largest_error(points, triangles, values, band, valid) == (pytest.approx(3), 0)
    valid[5, 6] = False
    assert largest_error(points, triangles, values, band, valid) == (pytest.approx(0), 0)
    error, missing = largest_error(points, triangles[:1], values, band, np.ones((8, 8), np.bool_))
    assert (round(error, 9), missing) == (0, 28)


def test_greedy_insertion_keeps_its_bound(raster):
    bound = float(np.ptp(raster.bands[0][raster.valid]) / 10)
    found = greedy(raster, bound)
    assert found.holds(bound * (1 + 1e-5))
    assert 4 < found.nodes < raster.pixels
    assert not Bounded(4, 0.0, bound, 1).holds(bound)
    assert not Bounded(4, 0.0, bound * 1.001, 0).holds(bound)


def test_goals_are_judged_against_the_best_triangulated_peer(tmp_path):
    group = {"random": 20.0, "greedy insertion": 24.0, ADAPTIVE: 26.4}
    made = [Record("a", "1 %", "linear", name, 9, 9, decibels) for name, decibels in group.items()]
    found = Findings((1.0,), made)
    same, linear = checks(found)
    assert same.holds
    assert linear.found.startswith("2.40 (a, 1 %)")
    assert not linear.holds
    made[-1] = Record("a", "1 %", "linear", ADAPTIVE, 9, 8, 26.6)
    same, linear = checks(found)
    assert linear.holds
    assert not same.holds
    assert same.found == "a 1 % adaptive: 8 of 9"
    made[-1] = Record("a", "1 %", "linear", ADAPTIVE, 9, why="too few")
    assert [one.holds for one in checks(found)] == [False, False]
    write_markdown(found, tmp_path / "found.md")
    assert "| a | 1 % | 0 | - |" in (tmp_path / "found.md").read_text()
    assert [table.rich().row_count for table in tables(found)] == [1, 0]


@pytest.mark.slow
def test_the_command_writes_tables_and_a_picture(tmp_path):
    source = write_mirrored(tmp_path / "small.tif", OLINDA.name, 96, 96)
    arguments = [str(source), "--quick", "-o", str(tmp_path / "out")]
    result = CliRunner().invoke(fidelity.main, arguments)
    assert result.exit_code == 0, result.output
    assert "PSNR in dB, linear model" in result.output
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert written == {"small.png", "fidelity.csv", "bounded.csv", "fidelity.md"}


def test_a_mesh_that_breaks_the_bound_has_no_ratio_and_more_nodes_give_no_lead():
    theirs = Bounded(100, 0.1, 5.0, 0)
    good = BoundedPair("dem", 5.0, Bounded(40, 1.0, 5.0, 0), theirs, 12.0)
    bad = BoundedPair("dem", 5.0, Bounded(20, 1.0, 5.1, 0), theirs, 12.0)
    assert good.ratio == 0.4
    assert bad.ratio == math.inf
    assert [one.holds for one in checks(Findings((), [], [good]))] == [True] * 5
    assert [one.holds for one in checks(Findings((), [], [bad]))] == [True, *[False] * 3, True]
    more = [
        Record("a", "1 %", "linear", "random", 9, 9, 20.0),
        Record("a", "1 %", "linear", ADAPTIVE, 9, 10, 40.0),
    ]
    assert [one.holds for one in checks(Findings((1.0,), more))] == [False, False]
