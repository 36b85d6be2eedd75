"""Errors of a surface at every valid pixel, and what a file records about them."""

from __future__ import annotations

import json
import math
import sqlite3
import warnings
from contextlib import closing
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import rasterio
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.tri import LinearTriInterpolator, Triangulation

import geomesh
from geomesh.errors import BandError, CertificateError, EmptyError, GeomeshWarning, MeshFileError
from geomesh.mesh.provenance import Provenance
from geomesh.mesh.refinement import BandAccuracy, surface_digest
from geomesh.parallel.progress import silent
from geomesh.parallel.workers import open_workers
from geomesh.raster.open import open_scene
from geomesh.recipe import Recipe
from geomesh.surface import fit as surface
from geomesh.surface.accuracy import Accuracy, measure_accuracy
from geomesh.surface.paint import reconstruct
from geomesh.surface.record import limits_of
from geomesh.zonal.owners import find_owners
from support.files import assert_same
from support.geometry import rectangle_mesh
from support.rasters import picture
from support.refined import plain_mesh, refined, with_record
from support.samples import SAMPLES, mirrored

if TYPE_CHECKING:
    from pathlib import Path

    from geomesh.raster.scene import Scene
    from support.commands import Geomesh

MODELS = ("linear", "constant")
WIDTH, HEIGHT = 60, 40
BOUND = "no valid pixel is farther"
SURFACE = "the nodes, triangles and values"
SUMS = "the errors of the triangles"
FLOOR = "the smallest angle is at least"


@pytest.fixture(autouse=True)
def _quiet() -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GeomeshWarning)
        yield


def measure(
    nodes: np.ndarray,
    triangles: np.ndarray,
    values: np.ndarray,
    scene: Scene,
    model: str = "linear",
    workers: int = 1,
) -> Accuracy:
    with open_workers(workers) as pool, scene.open():
        return measure_accuracy(nodes, triangles, values, scene, pool, silent, model=model)


def random_case(
    seed: int, bands: int = 1, dtype: str = "float64", model: str = "linear", count: int = 30
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Return nodes, triangles and values of a surface, and the pixels of an image."""
    random = np.random.default_rng(seed)
    nodes, triangles = rectangle_mesh(random, WIDTH, HEIGHT, count)
    rows = len(nodes) if model == "linear" else len(triangles)
    pixels = random.uniform(0, 200, (bands, HEIGHT, WIDTH)).astype(dtype)
    return nodes, triangles, random.uniform(0, 200, (rows, bands)), pixels


# ---------------------------------------------------------------- the figures


@pytest.mark.parametrize("dtype", ["uint8", "int16", "uint32", "float32", "float64"])
def test_a_linear_surface_has_the_errors_of_matplotlib(dtype: str) -> None:
    nodes, triangles, values, pixels = random_case(1, 3, dtype)
    found = measure(nodes, triangles, values, open_scene((pixels, None, None)))
    row, col = np.mgrid[:HEIGHT, :WIDTH] + 0.5
    owners = find_owners(nodes, triangles, open_scene((pixels, None, None)).grid.extent)
    assert found.pixels == WIDTH * HEIGHT
    for band in range(3):
        plane = LinearTriInterpolator(Triangulation(*nodes.T, triangles), values[:, band])
        errors = np.abs(pixels[band].astype(float) - plane(col, row)).filled(np.nan)
        assert found.max_error[band] == pytest.approx(errors.max(), rel=1e-9)
        assert found.rmse[band] == pytest.approx(np.sqrt(np.mean(errors**2)), rel=1e-9)
        ptp = float(np.ptp(pixels[band].astype(float)))
        peak = 255 if dtype == "uint8" else ptp
        assert found.peak[band] == peak
        assert found.high[band] - found.low[band] == ptp
        assert found.psnr[band] == pytest.approx(20 * np.log10(peak / found.rmse[band]))
        for t in range(len(triangles)):
            own = errors[owners == t]
            assert found.count[t] == len(own)
            if len(own):
                assert found.triangle_max_error[band, t] == pytest.approx(own.max(), rel=1e-9)
                rmse = np.sqrt(np.mean(own**2))
                assert found.triangle_rmse[band, t] == pytest.approx(rmse, rel=1e-9)
            else:
                assert np.isnan(found.triangle_rmse[band, t])
                assert np.isnan(found.triangle_max_error[band, t])


@pytest.mark.parametrize("model", MODELS)
def test_the_greatest_error_is_that_of_the_painted_image_to_the_last_bit(model: str) -> None:
    nodes, triangles, values, pixels = random_case(2, 2, model=model)
    scene = open_scene((pixels, None, None))
    found = measure(nodes, triangles, values, scene, model)
    image = reconstruct(nodes, triangles, values, scene.grid.extent, model)
    errors = np.abs(pixels - image)
    assert found.max_error.tolist() == errors.max(axis=(1, 2)).tolist()
    np.testing.assert_allclose(found.rmse, np.sqrt((errors**2).mean(axis=(1, 2))), rtol=1e-12)


@given(st.integers(0, 2**32 - 1), st.integers(0, 60), st.sampled_from(MODELS))
def test_masked_pixels_never_count_and_all_others_do(seed: int, count: int, model: str) -> None:
    nodes, triangles, values, pixels = random_case(seed, 2, model=model, count=count)
    valid = np.random.default_rng(seed).random((HEIGHT, WIDTH)) < 0.5
    valid[0, 0] = True
    hidden = np.where(valid, pixels, 1e6)
    masked = np.ma.array(hidden, mask=np.broadcast_to(~valid, pixels.shape))
    scene = open_scene((masked, None, None))
    found = measure(nodes, triangles, values, scene, model)
    image = reconstruct(nodes, triangles, values, scene.grid.extent, model)
    errors = np.abs(pixels - image)[:, valid]
    assert found.pixels == found.count.sum() == valid.sum()
    assert found.max_error.tolist() == errors.max(axis=1).tolist()
    np.testing.assert_allclose(found.rmse, np.sqrt((errors**2).mean(axis=1)), rtol=1e-12)
    np.testing.assert_array_equal(np.nanmax(found.triangle_max_error, axis=1), found.max_error)
    squares = np.nansum(found.count * found.triangle_rmse**2, axis=1)
    np.testing.assert_allclose(np.sqrt(squares / found.pixels), found.rmse, rtol=1e-12)


@pytest.mark.parametrize("size", [1e-200, 1e200])
def test_squares_of_errors_neither_overflow_nor_vanish(size: float) -> None:
    nodes, triangles, values, pixels = random_case(3)
    usual = measure(nodes, triangles, values, open_scene((pixels, None, None)))
    scaled = measure(nodes, triangles, values * size, open_scene((pixels * size, None, None)))
    np.testing.assert_allclose(scaled.rmse / size, usual.rmse, rtol=1e-12)
    np.testing.assert_allclose(scaled.triangle_rmse / size, usual.triangle_rmse, rtol=1e-12)


def test_an_exact_surface_has_no_error() -> None:
    nodes, triangles, _, _ = random_case(4)
    pixels = np.full((1, HEIGHT, WIDTH), 0.1)
    found = measure(
        nodes, triangles, np.full((len(nodes), 1), 0.1), open_scene((pixels, None, None))
    )
    assert (found.max_error, found.rmse, found.psnr) == (0, 0, math.inf)
    assert found.of_bands()[0].psnr == math.inf


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_a_pixel_without_a_surface_is_infinitely_far_from_it(value: float) -> None:
    nodes, triangles, values, pixels = random_case(5)
    touched = (triangles == 3).any(axis=1)
    values[3] = value
    found = measure(nodes, triangles, values, open_scene((pixels, None, None)))
    assert found.max_error == found.rmse == math.inf
    own = found.count > 0
    np.testing.assert_array_equal(np.isinf(found.triangle_max_error[0]), touched & own)
    (facts,) = found.of_bands()
    assert BandAccuracy.from_dict(json.loads(json.dumps(facts.to_dict()))) == facts
    assert facts.psnr == -math.inf


def test_a_surface_beside_the_valid_pixels_is_refused() -> None:
    nodes, triangles, values, pixels = random_case(6)
    mask = np.ones_like(pixels, bool)
    mask[0, 0, 0] = False
    scene = open_scene((np.ma.array(pixels, mask=mask), None, None))
    beside = triangles[(nodes[triangles].min(axis=1) > 1).all(axis=1)]
    with pytest.raises(EmptyError, match="no valid pixel of the array is in a triangle"):
        measure(nodes, beside, values, scene)


@pytest.mark.parametrize("model", MODELS)
def test_values_of_another_shape_are_refused(model: str) -> None:
    nodes, triangles, values, pixels = random_case(7, model=model)
    with pytest.raises(ValueError, match=r"of a .* model: expected"):
        measure(nodes, triangles, values[1:], open_scene((pixels, None, None)), model)


# ---------------------------------------------------------------- tiles and workers


def columns_of(found: Accuracy) -> dict[str, np.ndarray]:
    names = ("max_error", "rmse", "peak", "count", "triangle_max_error", "triangle_rmse")
    return {name: getattr(found, name) for name in names}


@pytest.mark.parametrize("model", MODELS)
def test_workers_do_not_change_a_bit(monkeypatch: pytest.MonkeyPatch, model: str) -> None:
    monkeypatch.setattr(surface, "plan_tiles", partial(surface.plan_tiles, core=16))
    nodes, triangles, values, pixels = random_case(8, 2, model=model)
    scene = open_scene((pixels, None, None))
    one, two = (measure(nodes, triangles, values, scene, model, workers) for workers in (1, 2))
    for name, found in columns_of(one).items():
        assert found.tobytes() == columns_of(two)[name].tobytes(), name


@pytest.mark.parametrize("model", MODELS)
def test_tiles_change_only_the_last_bits_of_sums(
    monkeypatch: pytest.MonkeyPatch, model: str
) -> None:
    nodes, triangles, values, pixels = random_case(9, 2, model=model)
    scene = open_scene((pixels, None, None))
    whole = columns_of(measure(nodes, triangles, values, scene, model))
    monkeypatch.setattr(surface, "plan_tiles", partial(surface.plan_tiles, core=7))
    tiled = columns_of(measure(nodes, triangles, values, scene, model))
    for name in ("max_error", "peak", "count", "triangle_max_error"):
        np.testing.assert_array_equal(tiled[name], whole[name])
    for name in ("rmse", "triangle_rmse"):
        np.testing.assert_allclose(tiled[name], whole[name], rtol=1e-12)


# ---------------------------------------------------------------- the record in a file


@pytest.fixture(scope="module")
def source() -> tuple[np.ndarray, Any, str]:
    with rasterio.open(SAMPLES / "olinda_landsat7_rgb_uint8.tif") as dataset:
        profile = dataset.profile
    bands = mirrored(SAMPLES / "olinda_landsat7_rgb_uint8.tif", 120, 100)
    return bands, profile["transform"], profile["crs"]


def failed(mesh: geomesh.Mesh) -> set[str]:
    return {check.name for check in mesh.certify().checks if not check.passed}


def rewritten(path: Path, column: str, layer: str, row: int) -> None:
    """Add 1 to a value of a layer in a file, as another program would."""
    with closing(sqlite3.connect(path)) as database, database:
        # Triggers of the spatial index call functions of GDAL.
        triggers = database.execute(
            "SELECT name FROM sqlite_master WHERE type = 'trigger' AND tbl_name = ?", (layer,)
        ).fetchall()
        for (name,) in triggers:
            database.execute(f'DROP TRIGGER "{name}"')
        changed = database.execute(
            f"UPDATE {layer} SET {column} = {column} + 1 WHERE id = ?", (row,)
        ).rowcount
    assert changed == 1


@pytest.mark.parametrize(
    ("model", "goal"),
    [
        *((model, {}) for model in MODELS),
        *((model, {"rmse": (90.0, 80.0, 70.5)}) for model in MODELS),
        ("linear", {"max_error": 1000.0}),
    ],
)
def test_a_file_keeps_the_record_bit_for_bit(
    tmp_path: Path, source: Any, model: str, goal: dict[str, Any]
) -> None:
    mesh = refined(source, model=model, **goal)
    path = mesh.to_file(tmp_path / "mesh.gpkg")
    again = geomesh.read_mesh(path)
    assert_same(again, mesh)
    assert again.provenance.refinement == mesh.provenance.refinement
    assert again.certify() == mesh.certify()
    assert again.certify().passed
    found = again.verify(source)
    assert found.of_bands() == mesh.provenance.refinement.bands
    for k, band in enumerate(found.bands):
        stored = again.triangle_table
        assert stored[f"{band}_rmse"].tobytes() == found.triangle_rmse[k].tobytes()
        assert stored[f"{band}_max_error"].tobytes() == found.triangle_max_error[k].tobytes()


@pytest.mark.parametrize("model", MODELS)
def test_a_file_of_each_sample_shows_it_as_it_records(
    tmp_path: Path, sample: Path, model: str
) -> None:
    mesh = refined(sample, 500, model=model)
    again = geomesh.read_mesh(mesh.to_file(tmp_path / "mesh.gpkg"))
    assert_same(again, mesh)
    assert again.certify().passed
    found = again.verify(sample)
    with rasterio.open(sample) as dataset:
        bands, valid = dataset.read().astype(float), (dataset.read_masks() > 0).all(axis=0)
    table = again.node_table if model == "linear" else again.triangle_table
    names = found.bands if model == "linear" else [f"{band}_mean" for band in found.bands]
    values = np.column_stack([table[name] for name in names])
    image = reconstruct(again.nodes, again.triangles, values, again.grid.extent, model)
    compared = valid & (find_owners(again.nodes, again.triangles, again.grid.extent) >= 0)
    assert found.pixels == compared.sum()
    errors = np.abs(bands - image)[:, compared]
    assert found.max_error.tolist() == errors.max(axis=1).tolist()
    np.testing.assert_allclose(found.rmse, np.sqrt((errors**2).mean(axis=1)), rtol=1e-9)


def test_errors_come_after_the_statistics_of_their_band(source: Any) -> None:
    names = list(refined(source).triangle_table)
    each = ("mean", "std", "min", "max", "rmse", "max_error")
    bands = ("b1", "b2", "b3")
    assert names == ["count", *(f"{b}_{name}" for b in bands for name in each), "color"]
    no_mean = refined(source, model="constant", statistics=("std",))
    assert list(no_mean.triangle_table)[1:5] == ["b1_std", "b1_mean", "b1_rmse", "b1_max_error"]
    assert no_mean.certify().passed


@pytest.mark.parametrize("model", MODELS)
def test_a_palette_has_the_errors_of_its_colours(tmp_path: Path, model: str) -> None:
    path = tmp_path / "classes.tif"
    classes = (picture()[0] // 64).astype(np.uint8)
    profile = {"height": classes.shape[0], "width": classes.shape[1], "count": 1}
    with rasterio.open(path, "w", driver="GTiff", dtype="uint8", **profile) as dataset:
        dataset.write(classes, 1)
        dataset.write_colormap(1, {k: (60 * k, 255 - 50 * k, 9 * k, 255) for k in range(4)})
    mesh = refined(path, model=model)
    again = geomesh.read_mesh(mesh.to_file(tmp_path / "mesh.gpkg"))
    assert_same(again, mesh)
    assert [band.name for band in again.provenance.refinement.bands] == ["red", "green", "blue"]
    assert again.certify().passed
    assert "b1_majority" in again.triangle_table
    assert again.psnr(path).rmse == pytest.approx(again.verify(path).rmse.tolist())


@pytest.mark.parametrize("model", MODELS)
def test_one_changed_value_in_a_file_fails_the_certificate(
    tmp_path: Path, source: Any, model: str
) -> None:
    path = refined(source, model=model).to_file(tmp_path / "mesh.gpkg")
    column, layer = ("b2", "nodes") if model == "linear" else ("b2_mean", "triangles")
    rewritten(path, column, layer, 17)
    again = geomesh.read_mesh(path)
    assert {name for name in failed(again) if SURFACE in name} == failed(again) != set()
    with pytest.raises(CertificateError, match="the nodes, triangles and values are those"):
        again.to_file(tmp_path / "again.gpkg")
    with pytest.raises(CertificateError, match="does not show the array as it records: b2: great"):
        again.verify(source)


@pytest.mark.parametrize("column", ["b1_rmse", "b1_max_error", "count"])
def test_one_changed_error_in_a_file_fails_the_certificate(
    tmp_path: Path, source: Any, column: str
) -> None:
    mesh = refined(source)
    largest = int(np.nanargmax(mesh.triangle_table["b1_max_error"]))
    path = mesh.to_file(tmp_path / "mesh.gpkg")
    rewritten(path, column, "triangles", largest)
    assert all(SUMS in name for name in failed(geomesh.read_mesh(path)))
    assert len(failed(geomesh.read_mesh(path))) == 1


def test_a_column_of_the_record_that_is_missing_fails_the_certificate(source: Any) -> None:
    mesh = refined(source)
    for layer, column, part in (
        ("node_table", "b1", SURFACE),
        ("triangle_table", "b1_rmse", SUMS),
        ("triangle_table", "count", SUMS),
    ):
        table = getattr(mesh, layer)
        less = {name: values for name, values in table.items() if name != column}
        (name,) = failed(replace(mesh, **{layer: type(table)(less)}))
        assert part in name


def test_another_number_of_pixels_fails_the_certificate(source: Any) -> None:
    mesh = refined(source)
    refinement = replace(mesh.provenance.refinement, pixels=12_001)
    other = replace(mesh, provenance=replace(mesh.provenance, refinement=refinement))
    assert all(SUMS in name for name in failed(other))
    assert "12000 pixels, recorded 12001" in check_of(other, SUMS).detail


def test_each_triangle_is_verified(source: Any) -> None:
    mesh = refined(source)
    errors = mesh.triangle_table["b1_max_error"].copy()
    one, other = np.argsort(errors)[:2]
    errors[[one, other]] = errors[[other, one]]
    table = mesh.triangle_table.with_columns({"b1_max_error": errors})
    swapped = replace(mesh, triangle_table=table)
    assert swapped.certify().passed  # without the pixels this cannot be known
    with pytest.raises(CertificateError, match="records: b1_max_error of 2 triangles; use"):
        swapped.verify(source)


def test_a_moved_node_is_not_where_it_was_measured(source: Any) -> None:
    mesh = refined(source)
    inner = int(np.setdiff1d(np.arange(len(mesh.nodes)), mesh.constraints)[0])
    nodes = mesh.nodes.copy()
    nodes[inner] += 1 / 256
    assert any(SURFACE in name for name in failed(replace(mesh, nodes=nodes)))


def test_a_digest_sees_every_change_but_none_of_a_file() -> None:
    nodes, triangles, values, _ = random_case(10)
    values[0], values[1] = -0.0, np.nan
    digest = surface_digest(nodes, triangles, values)
    other = values.copy()
    other[0], other[1] = 0.0, -np.nan
    assert surface_digest(nodes, triangles, other) == digest
    for k in range(len(values)):
        changed = values.copy()
        changed[k] = 1.5 if k < 2 else np.nextafter(changed[k], 0)
        assert surface_digest(nodes, triangles, changed) != digest
    assert surface_digest(nodes, triangles[::-1], values) != digest
    assert surface_digest(nodes + 1e-12, triangles, values) != digest


def test_a_document_without_a_refinement_is_read(source: Any) -> None:
    plain = plain_mesh(source, nodes=50)
    assert "refinement" not in plain.metadata
    assert Provenance.from_dict(plain.metadata) == plain.provenance
    assert "facts" not in plain.certify().to_dict()
    with pytest.raises(MeshFileError, match="the mesh was not refined"):
        plain.verify(source)


# ---------------------------------------------------------------- bounds, angles and edges


def check_of(mesh: geomesh.Mesh, part: str) -> Any:
    (found,) = [check for check in mesh.certify().checks if part in check.name]
    return found


def test_a_bound_holds_up_to_the_greatest_error_and_not_below(source: Any) -> None:
    plain = plain_mesh(source, nodes=200)
    errors = tuple(
        band.max_error for band in with_record(plain, source).provenance.refinement.bands
    )
    held = with_record(plain, source, max_error=errors)
    assert check_of(held, BOUND).passed
    assert held.certify().passed
    less = (errors[0], np.nextafter(errors[1], 0), errors[2])
    broken = with_record(plain, source, max_error=less)
    assert {name for name in failed(broken) if BOUND in name} == failed(broken) != set()
    assert f"b2: {errors[1]:.6g} of" in check_of(broken, BOUND).detail
    one = with_record(plain, source, max_error=max(errors))
    assert one.provenance.refinement.limits == (max(errors),) * 3
    assert one.certify().passed


def test_a_bound_that_was_not_reached_is_not_claimed(source: Any) -> None:
    mesh = refined(source, max_error=1.0, reached=False, note="the limit is 200 nodes", budget=200)
    certificate = mesh.certify()
    assert certificate.passed
    assert not [check for check in certificate.checks if BOUND in check.name]
    fact = certificate.facts[0]
    assert fact.name == "the bound was not reached"
    (first, *_) = mesh.provenance.refinement.bands
    assert f"b1: {first.max_error:.6g} of 1; " in fact.detail
    assert fact.detail.endswith(": the limit is 200 nodes")
    assert {"name": fact.name, "detail": fact.detail} in certificate.to_dict()["facts"]


def test_a_goal_of_nodes_or_of_an_rmse_is_checked_if_it_was_reached(source: Any) -> None:
    plain = plain_mesh(source, nodes=200)
    assert failed(with_record(plain, source)) == set()
    (name,) = failed(with_record(plain, source, budget=199))
    assert "the number of nodes" in name
    assert failed(with_record(plain, source, budget=199, reached=False)) == set()
    (name,) = failed(with_record(plain, source, rmse=1.0))
    assert "root mean square" in name
    assert failed(with_record(plain, source, rmse=1.0, reached=False)) == set()


def test_facts_are_the_figures_of_each_band(source: Any) -> None:
    mesh = refined(source)
    facts = mesh.certify().facts
    assert [fact.name for fact in facts] == [f"accuracy of {b}" for b in ("b1", "b2", "b3")]
    stored = mesh.psnr(source)
    for fact, psnr, rmse in zip(facts, stored.psnr, stored.rmse, strict=True):
        assert f"rmse {rmse:.6g}, PSNR {psnr:.2f} dB at 12000 valid pixels" in fact.detail
    assert "accuracy of b1" in mesh._repr_html_()


def angles_of(mesh: geomesh.Mesh) -> np.ndarray:
    corners = mesh.nodes[mesh.triangles]
    sides = [np.linalg.norm(corners[:, k - 1] - corners[:, k - 2], axis=1) for k in range(3)]
    found = []
    for k in range(3):
        a, b, c = sides[k], sides[k - 1], sides[k - 2]
        found.append(np.degrees(np.arccos((b * b + c * c - a * a) / (2 * b * c))))
    return np.min(found, axis=0)


def test_a_floor_holds_up_to_the_smallest_angle(source: Any) -> None:
    plain = plain_mesh(source, nodes=200)
    least = angles_of(plain).min()
    check = check_of(with_record(plain, source, floor=least - 1e-5), FLOOR)
    assert check.passed
    assert "except" not in check.name


def test_a_thin_triangle_at_the_outline_is_told_and_one_inside_fails(source: Any) -> None:
    plain = plain_mesh(source, nodes=80)
    angles = angles_of(plain)
    outline = np.isin(plain.triangles, plain.constraints).any(axis=1)
    free = angles[~outline].min()
    floor = free - 1e-4
    thin = angles < floor
    assert thin.any()
    check = check_of(with_record(plain, source, floor=floor), FLOOR)
    assert check.passed
    assert "except next to the outline" in check.name
    count = thin.sum()
    assert check.detail.startswith(
        f"{count} of {len(angles)} triangles are below, {count} of them touch these; "
        f"the smallest angle is {angles.min():.4f} degrees, {free:.4f} in the "
    )
    # Without constraints, as a mesh of another program may be, the boundary is the outline.
    bare = replace(plain, constraints=np.empty((0, 2), np.int32))
    assert check_of(with_record(bare, source, floor=floor), FLOOR) == check
    broken = with_record(plain, source, floor=free + 1e-4)
    (name,) = failed(broken)
    assert FLOOR in name
    kept = with_record(plain, source, floor=free + 1e-4, keep_features=True)
    assert failed(kept) == set()  # all nodes inside are features


def test_a_refined_mesh_need_not_be_delaunay_but_all_else(source: Any) -> None:
    mesh = refined(source)
    names = [check.name for check in plain_mesh(source, nodes=50).certify().checks]
    without = [name for name in names if "circumcircles" not in name]
    assert len(without) == len(names) - 1
    assert [check.name for check in mesh.certify().checks][: len(without)] == without


def test_a_list_of_limits_has_one_for_each_band() -> None:
    recipe = Recipe.from_preset("adaptive").with_values(max_error=(1, 2))
    assert limits_of(recipe, 2) == (1.0, 2.0)
    with pytest.raises(BandError, match="max_error has 2 values and the raster 3 bands"):
        limits_of(recipe, 3)


# ---------------------------------------------------------------- stored values


@pytest.mark.parametrize("model", MODELS)
def test_a_refined_mesh_is_shown_by_its_own_values(tmp_path: Path, source: Any, model: str) -> None:
    random = np.random.default_rng(1)
    plain = plain_mesh(source, nodes=200)
    rows = len(plain.nodes) if model == "linear" else len(plain.triangles)
    values = random.integers(0, 255, (rows, 3)).astype(float)
    mesh = with_record(plain, source, model=model, values=values)
    expected = reconstruct(mesh.nodes, mesh.triangles, values, mesh.grid.extent, model)
    errors = source[0] - expected
    found = mesh.psnr(source)
    assert found == mesh.psnr(source, model=model, fit="stored")
    np.testing.assert_allclose(found.rmse, np.sqrt((errors**2).mean(axis=(1, 2))), rtol=1e-9)
    np.testing.assert_allclose(found.rmse, [b.rmse for b in mesh.provenance.refinement.bands])
    mesh.render(source, tmp_path / "shown.tif")
    with rasterio.open(tmp_path / "shown.tif") as dataset:
        np.testing.assert_array_equal(dataset.read(), np.rint(expected).astype(np.uint8))
    other = MODELS[1 - MODELS.index(model)]
    assert mesh.psnr(source, model=other) == plain.psnr(source, model=other)
    assert mesh.psnr(source, bidx=[2]).rmse == pytest.approx(
        plain.psnr(source, bidx=[2], model=model).rmse
    )


def test_a_mesh_without_refinement_has_its_own_values_too(source: Any) -> None:
    plain = plain_mesh(source, nodes=200)
    assert plain.psnr(source) == plain.psnr(source, fit="least_squares", model="linear")
    stored = plain.psnr(source, fit="stored").rmse
    assert stored == pytest.approx(plain.psnr(source, fit="sampled").rmse)
    means = plain.psnr(source, fit="stored", model="constant").rmse
    assert means == pytest.approx(plain.psnr(source, model="constant").rmse)
    no_mean = plain_mesh(source, nodes=50, statistics=("std",))
    with pytest.raises(MeshFileError, match="triangles of the mesh have no values in b1_mean"):
        no_mean.psnr(source, fit="stored", model="constant")
    bands = (source[0][:2], *source[1:])
    with pytest.raises(BandError):
        refined(source).psnr(bands)


def test_the_commands_show_and_verify_what_a_file_records(
    command: Geomesh, tmp_path: Path, olinda: Path
) -> None:
    mesh = refined(olinda)
    path = mesh.to_file(tmp_path / "mesh.gpkg")
    run = command("render", path, "--like", olinda, "-o", tmp_path / "a.tif", "--json")
    (result,) = json.loads(run.out)["results"]
    assert (result["model"], result["fit"]) == ("linear", "stored")
    red = mesh.provenance.refinement.bands[0]
    run = command("quality", path, "--like", olinda, "--json")
    assert json.loads(run.out)["errors"]["bands"]["red"] == pytest.approx(
        {name: value for name, value in red.to_dict().items() if name != "name"}
    )
    assert (
        f"red: greatest error {red.max_error:.6g}" in command("quality", path, "--like", olinda).out
    )
    about = command("info", path).out
    assert f"detail greatest error {red.max_error:.6g}, rmse {red.rmse:.6g}, PSNR" in about
    assert ", name accuracy of red\n" in about
    with rasterio.open(olinda) as dataset:
        profile, pixels = dataset.profile, dataset.read()
    pixels[0, 50, 50] ^= 255
    with rasterio.open(tmp_path / "other.tif", "w", **profile) as dataset:
        dataset.write(pixels)
    run = command("quality", path, "--like", tmp_path / "other.tif")
    assert run.code == 1
    assert "does not show" in run.err
