"""The preset adaptive: each goal is reached, as programs that know nothing of geomesh find too."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import geopandas as gpd
import numpy as np
import pytest
import rasterio
from matplotlib.tri import LinearTriInterpolator, Triangulation

import geomesh
from geomesh.errors import BandError, RecipeError
from support.samples import OLINDA, SAMPLES

if TYPE_CHECKING:
    from pathlib import Path

DEM = SAMPLES / "rmnp_dem.tif"
COLORADO = SAMPLES / "colorado_dem_float32_epsg4269.tif"
CITY = SAMPLES / "sanfrancisco_landsat7_nrg_uint8.tif"

pytestmark = pytest.mark.filterwarnings("ignore::geomesh.GeomeshWarning")


def adaptive(source: Any, **options: Any) -> geomesh.Mesh:
    return geomesh.mesh_raster(source, preset="adaptive", **options)


def drawn(nodes: gpd.GeoDataFrame, triangles: gpd.GeoDataFrame, band: str, shape: Any) -> Any:
    """Draw a band with matplotlib, from the layers of a file."""
    corners = triangles[["n0", "n1", "n2"]].to_numpy()
    x, y = np.meshgrid(np.arange(shape[1]) + 0.5, np.arange(shape[0]) + 0.5)
    surface = Triangulation(nodes["col"], nodes["row"], corners)
    values = nodes[band].to_numpy(float)
    return np.ma.filled(LinearTriInterpolator(surface, np.nan_to_num(values))(x, y), np.nan)


def smallest_angle(triangles: gpd.GeoDataFrame, nodes: gpd.GeoDataFrame) -> float:
    corners = nodes[["col", "row"]].to_numpy()[triangles[["n0", "n1", "n2"]].to_numpy()]
    one, other = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    cross = np.abs(one[..., 0] * other[..., 1] - one[..., 1] * other[..., 0])
    return float(np.degrees(np.arctan2(cross, (one * other).sum(axis=2))).min())


def layers(mesh: geomesh.Mesh, folder: Path) -> tuple[gpd.GeoDataFrame, gpd.GeoDataFrame]:
    path = mesh.to_file(folder / "mesh.gpkg", overwrite=True)
    return gpd.read_file(path, layer="nodes"), gpd.read_file(path, layer="triangles")


@pytest.mark.parametrize("nodes", [None, 300, "2%"])
@pytest.mark.parametrize("model", ["linear", "constant"])
def test_exactly_as_many_nodes_as_wanted(nodes: Any, model: str) -> None:
    mesh = adaptive(OLINDA, nodes=nodes, model=model, effort="fast")
    pixels = mesh.grid.width * mesh.grid.height
    wanted = {None: round(pixels / 100), "2%": round(pixels / 50)}.get(nodes, nodes)
    assert len(mesh.nodes) == wanted
    assert mesh.certify().passed


def test_more_nodes_and_more_effort_show_more() -> None:
    shown = [adaptive(OLINDA, nodes=n).psnr(OLINDA).overall for n in (300, 600, 1200)]
    assert shown == sorted(shown)
    efforts = [
        adaptive(OLINDA, nodes=600, effort=effort).psnr(OLINDA).overall
        for effort in ("fast", "normal", "best")
    ]
    assert efforts == sorted(efforts)
    features = geomesh.mesh_raster(OLINDA, preset="features", nodes=600).psnr(OLINDA).overall
    assert efforts[0] > features + 1.5


@pytest.mark.parametrize("source", [DEM, COLORADO, OLINDA, CITY], ids=lambda path: path.stem)
def test_no_valid_pixel_is_out_of_bounds_in_the_file(source: Path, tmp_path: Path) -> None:
    bound = {DEM: 150, COLORADO: 10, OLINDA: 60, CITY: 60}[source]
    mesh = adaptive(source, max_error=bound, effort="fast")
    assert mesh.certify().passed
    nodes, triangles = layers(mesh, tmp_path)
    with rasterio.open(source) as dataset:
        # A pixel counts if every band is valid.
        bands, valid = dataset.read().astype(float), (dataset.read_masks() > 0).all(axis=0)
    inside = None
    for name, band in zip((b.name for b in mesh.provenance.refinement.bands), bands, strict=True):
        image = drawn(nodes, triangles, name, band.shape)
        inside = valid & ~np.isnan(image)
        assert np.abs(image - band)[inside].max() <= bound
    # Small islands of data are not part of the domain.
    assert inside.sum() >= 0.98 * valid.sum()
    assert smallest_angle(triangles, nodes) > 9.999 or source == CITY


def test_a_bound_for_each_band_and_few_nodes(tmp_path: Path) -> None:
    bounds = (60.0, 40.0, 90.0)
    mesh = adaptive(OLINDA, max_error=bounds)
    nodes, triangles = layers(mesh, tmp_path)
    with rasterio.open(OLINDA) as dataset:
        bands = dataset.read().astype(float)
    for name, bound, band in zip(("red", "green", "blue"), bounds, bands, strict=True):
        worst = np.abs(drawn(nodes, triangles, name, band.shape) - band).max()
        assert worst <= bound
        assert triangles[f"{name}_max_error"].max() == pytest.approx(worst, rel=1e-6)
    assert len(mesh.nodes) < len(adaptive(OLINDA, max_error=40, effort="fast").nodes)


def test_half_of_the_nodes_of_greedy_insertion_are_enough() -> None:
    from pydelatin import Delatin

    with rasterio.open(COLORADO) as dataset:
        heights = dataset.read(1)
    for bound in (20, 10):
        greedy = len(Delatin(heights.astype(np.float32), max_error=bound).vertices)
        assert len(adaptive(COLORADO, max_error=bound).nodes) <= 0.45 * greedy


@pytest.mark.parametrize("limits", [9.0, (12.0, 9.0, 8.0)])
@pytest.mark.parametrize("model", ["linear", "constant"])
def test_the_root_mean_square_error_is_reached(limits: Any, model: str, tmp_path: Path) -> None:
    mesh = adaptive(OLINDA, rmse=limits, model=model)
    found = [band.rmse for band in mesh.provenance.refinement.bands]
    ratio = np.array(found) / limits
    assert ratio.max() <= 1
    assert ratio.max() > 0.95  # not many more nodes than needed
    if model == "linear":
        nodes, triangles = layers(mesh, tmp_path)
        with rasterio.open(OLINDA) as dataset:
            red = dataset.read(1).astype(float)
        image = drawn(nodes, triangles, "red", red.shape)
        assert np.sqrt(np.mean((image - red) ** 2)) == pytest.approx(found[0], rel=1e-9)


@pytest.mark.parametrize("goal", [{"max_error": 30.0}, {"rmse": 3.0}])
def test_nodes_limit_a_goal_and_the_error_is_said(goal: dict[str, float]) -> None:
    with pytest.warns(geomesh.GeomeshWarning, match="needs"):
        mesh = adaptive(OLINDA, nodes=400, **goal)
    assert 350 < len(mesh.nodes) <= 400
    certificate, refinement = mesh.certify(), mesh.provenance.refinement
    assert certificate.passed
    assert not refinement.reached
    assert max(getattr(b, next(iter(goal))) for b in refinement.bands) > next(iter(goal.values()))
    assert "not reached" in str(certificate.to_dict())


def test_values_are_those_of_the_best_surface() -> None:
    mesh = adaptive(OLINDA, nodes=500)
    stored = mesh.psnr(OLINDA, fit="stored").overall
    assert stored == pytest.approx(mesh.psnr(OLINDA, fit="least_squares").overall, abs=1e-6)


@pytest.mark.parametrize("angle", [0, 5, 20, 25])
def test_no_angle_is_smaller_than_wanted(angle: float, tmp_path: Path) -> None:
    mesh = adaptive(OLINDA, nodes=700, min_angle=angle, effort="fast")
    nodes, triangles = layers(mesh, tmp_path)
    assert smallest_angle(triangles, nodes) >= angle - 1e-6


def test_features_stay_where_they_were_found() -> None:
    features = geomesh.mesh_raster(OLINDA, preset="features")
    mesh = adaptive(OLINDA, nodes=1000, keep_features=True)
    kept = mesh.nodes[mesh.node_table["kind"] == "feature"]
    assert len(kept) > 300
    assert set(map(tuple, kept)) <= set(map(tuple, features.nodes))
    assert np.isfinite(mesh.node_table["response"][mesh.node_table["kind"] == "feature"]).all()


def test_breaklines_stay_edges() -> None:
    from shapely import LineString, MultiLineString

    line = LineString([(20.3, 30.7), (200.2, 260.4), (330.1, 280.9)])
    with rasterio.open(OLINDA) as dataset:
        pixels, shape = dataset.read(), dataset.shape
    mesh = adaptive((pixels, None, None), nodes=900, breaklines=line)
    edges = mesh.edges
    inner = np.isin(edges.nodes[:, 0] * 10**6 + edges.nodes[:, 1], _keys(mesh)) & (edges.uses == 2)
    found = MultiLineString(list(mesh.nodes[edges.nodes[inner]]))
    assert found.length == pytest.approx(line.length, rel=1e-2)
    assert found.hausdorff_distance(line) < 1
    assert set(mesh.node_table["kind"][edges.nodes[inner]].ravel()) <= {"breakline", "border"}
    assert shape == (mesh.grid.height, mesh.grid.width)


def _keys(mesh: geomesh.Mesh) -> np.ndarray:
    pairs = np.sort(mesh.constraints, axis=1).astype(np.int64)
    return pairs[:, 0] * 10**6 + pairs[:, 1]


def test_pixels_without_data_count_for_nothing() -> None:
    """Whatever is under a mask, the mesh is the same."""
    rng = np.random.default_rng(0)
    with rasterio.open(OLINDA) as dataset:
        pixels = dataset.read()[:, :200, :200]
    hidden = np.zeros((200, 200), bool)
    hidden[60:120, 80:150] = True
    meshes = []
    for fill in (np.zeros_like(pixels), rng.integers(0, 255, pixels.shape, np.uint8)):
        masked = np.ma.array(
            np.where(hidden, fill, pixels), mask=np.broadcast_to(hidden, (3, 200, 200))
        )
        meshes.append(adaptive((masked, None, None), nodes=400))
    one, other = meshes
    np.testing.assert_array_equal(one.nodes, other.nodes)
    np.testing.assert_array_equal(
        one.node_table["red" if "red" in one.node_table else "b1"],
        other.node_table["red" if "red" in other.node_table else "b1"],
    )
    centres = one.nodes[one.triangles].mean(axis=1).astype(int)
    assert not hidden[centres[:, 1], centres[:, 0]].any()


def test_a_node_between_pixels_has_a_height_too() -> None:
    """Else a mesh of a whole DEM had a hole there."""
    image = np.random.default_rng(8).random((60, 60)).astype("f4") * 100
    mesh = adaptive((image, None, None), nodes=1100, effort="fast", z=1)
    apart = np.ones(len(mesh.nodes), bool)
    apart[mesh.triangles[mesh.triangle_table["count"] > 0]] = False
    assert apart.sum() == 1
    (x, y), (height,) = mesh.nodes[apart][0] - 0.5, mesh.heights[apart]
    rows, cols = (np.clip([int(v), int(v) + 1], 0, 59) for v in (y, x))
    around = image[np.ix_(rows, cols)]
    assert around.min() <= height <= around.max()
    assert mesh.certify().passed


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"max_error": 1, "rmse": 1}, "one of both"),
        ({"max_error": -1}, "above 0"),
        ({"max_error": 0}, "above 0"),
        ({"rmse": float("nan")}, "above 0"),
        ({"rmse": float("inf")}, "above 0"),
        ({"max_error": (1, "x", 2)}, "above 0"),
        ({"min_angle": 26}, "0 to 25"),
        ({"max_error": 5, "model": "constant"}, "linear"),
        ({"model": "cubic"}, "linear, constant"),
        ({"effort": "much"}, "fast, normal, best"),
        ({"nodes": 0}, "nodes is 0"),
        ({"resize": (64, 64)}, "resize"),
        ({"domain": "hull"}, "domain"),
    ],
)
def test_goals_that_make_no_sense_are_refused(values: dict[str, Any], message: str) -> None:
    with pytest.raises(RecipeError, match=message):
        adaptive(OLINDA, **values)


def test_a_wrong_number_of_limits_is_refused_before_any_work() -> None:
    with pytest.raises(BandError, match="2 values and the raster 3 bands"):
        adaptive(OLINDA, max_error=(1, 2))


@pytest.mark.parametrize(
    "name", ["max_error", "rmse", "min_angle", "model", "effort", "keep_features", "time_limit"]
)
@pytest.mark.parametrize("preset", ["features", "paper"])
def test_other_presets_have_no_goal(name: str, preset: str) -> None:
    value = {"model": "constant", "effort": "fast", "keep_features": True}.get(name, 5)
    message = f"`{name}` is {value!r}, but the preset {preset} is not refined: use `preset=adapt"
    with pytest.raises(RecipeError, match=message):
        geomesh.mesh_raster(OLINDA, preset=preset, **{name: value})
