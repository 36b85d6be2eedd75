"""`Mesh.refine`: any sound mesh can be the start. And runs: workers, limits of time, commands."""

from __future__ import annotations

import json
import threading
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import rasterio

import geomesh
from geomesh.arrays.table import Table
from geomesh.errors import GeoreferenceError, RecipeError
from support.samples import NODATA_EDGE, OLINDA, SAMPLES, fingerprint, write_mirrored

if TYPE_CHECKING:
    from pathlib import Path

    from support.commands import Geomesh

pytestmark = pytest.mark.filterwarnings("ignore::geomesh.GeomeshWarning")


@pytest.mark.parametrize("preset", ["features", "paper", "adaptive"])
def test_a_mesh_of_any_preset_is_refined(preset: str) -> None:
    mesh = geomesh.mesh_raster(OLINDA, preset=preset)
    refined = mesh.refine(OLINDA, nodes=600)
    assert len(refined.nodes) == 600
    assert refined.certify().passed
    assert refined.psnr(OLINDA).overall > 27


def test_a_mesh_without_provenance_is_refined() -> None:
    made = geomesh.mesh_raster(OLINDA, preset="features", nodes=200)
    bare = replace(made, provenance=None, node_table=Table({}), triangle_table=Table({}))
    refined = bare.refine(OLINDA, rmse=14)
    assert refined.certify().passed
    assert max(band.rmse for band in refined.provenance.refinement.bands) <= 14
    assert refined.provenance.canny is None
    assert refined.provenance.from_dict(json.loads(json.dumps(refined.metadata | {}))) is not None


def test_nodes_off_the_lattice_are_moved_onto_it() -> None:
    made = geomesh.mesh_raster(OLINDA, preset="features", nodes=200)
    inner = np.ones(len(made.nodes), bool)
    inner[made.constraints] = False
    moved = made.nodes + np.where(inner[:, None], 1e-3, 0)
    shaken = replace(made, nodes=moved, provenance=None, triangle_table=Table({}))
    refined = shaken.refine(OLINDA, nodes=300)
    assert (refined.nodes * 256 == np.rint(refined.nodes * 256)).all()
    assert refined.certify().passed


def test_a_mesh_that_is_not_sound_is_refused() -> None:
    made = geomesh.mesh_raster(OLINDA, preset="features", nodes=200)
    torn = replace(made, triangles=made.triangles[1:], triangle_table=Table({}))
    with pytest.raises(RecipeError, match="cannot be refined"):
        torn.refine(OLINDA, nodes=300)


def test_another_raster_is_refused() -> None:
    made = geomesh.mesh_raster(OLINDA, preset="features", nodes=200)
    with pytest.raises(GeoreferenceError):
        made.refine(SAMPLES / "rmnp_rgb.tif", nodes=300)


def test_a_refined_mesh_is_read_back_bit_for_bit(tmp_path: Path) -> None:
    mesh = geomesh.mesh_raster(OLINDA, preset="adaptive", nodes=400)
    path = mesh.to_file(tmp_path / "mesh.gpkg")
    again = geomesh.read_mesh(path)
    assert fingerprint(again) == fingerprint(mesh)
    again.verify(OLINDA)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A raster of several blocks, with nodata at one edge."""
    folder = tmp_path_factory.mktemp("scene")
    return write_mirrored(folder / "scene.tif", NODATA_EDGE, 1300, 1200)


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [{}, {"model": "constant", "effort": "fast"}, {"max_error": 2500}, {"rmse": 500}],
    ids=["nodes", "constant", "max_error", "rmse"],
)
def test_any_number_of_workers_gives_the_same_mesh(scene: Path, options: dict[str, Any]) -> None:
    one, three = (
        geomesh.mesh_raster(scene, preset="adaptive", workers=workers, **options)
        for workers in (1, 3)
    )
    assert fingerprint(one) == fingerprint(three)
    assert one.certify().passed


@pytest.mark.slow
def test_no_seam_shows_where_blocks_met(scene: Path) -> None:
    mesh = geomesh.mesh_raster(scene, preset="adaptive")
    painted = scene.parent / "painted.tif"
    mesh.render(scene, painted, overwrite=True)
    with rasterio.open(scene) as dataset:
        true, valid = dataset.read().astype(float), dataset.dataset_mask() > 0
    with rasterio.open(painted) as dataset:
        error = np.abs(dataset.read().astype(float) - true).mean(axis=0)
    # The blocks of the last two passes.
    for x, y in ((0.25, 0.75), (0.75, 0.25)):
        near = _near_lines(error.shape[1], x)[None, :] | _near_lines(error.shape[0], y)[:, None]
        assert error[near & valid].mean() <= 1.15 * error[valid].mean()


def _near_lines(size: int, shift: float) -> np.ndarray:
    place = (np.arange(size) + 0.5) / 512 + shift
    return np.abs(place - np.rint(place)) * 512 < 4


@pytest.mark.parametrize(
    "goal", [{}, {"max_error": 20}, {"rmse": 5}], ids=["nodes", "bound", "rmse"]
)
def test_the_time_limit_ends_early_with_a_sound_mesh(goal: dict[str, int]) -> None:
    with pytest.warns(geomesh.GeomeshWarning, match="time was over"):
        mesh = geomesh.mesh_raster(OLINDA, preset="adaptive", time_limit=1e-6, **goal)
    assert mesh.certify().passed
    assert not mesh.provenance.refinement.reached


@pytest.mark.parametrize("seconds", [0, -1, float("nan"), "1"])
def test_a_limit_that_is_no_time_is_refused(seconds: Any) -> None:
    with pytest.raises(RecipeError, match="time_limit"):
        geomesh.mesh_raster(OLINDA, preset="adaptive", time_limit=seconds)


def test_progress_shows_nodes_and_error_and_can_cancel() -> None:
    messages = []
    geomesh.mesh_raster(OLINDA, preset="adaptive", progress=lambda _, text: messages.append(text))
    assert any("1,228 nodes (error " in text for text in messages)

    class CancelledError(Exception):
        pass

    def cancel(_fraction: float, text: str) -> None:
        if "Refining" in text:
            raise CancelledError

    before = threading.active_count()
    with pytest.raises(CancelledError):
        geomesh.mesh_raster(OLINDA, preset="adaptive", progress=cancel)
    assert threading.active_count() <= before + 3


def test_the_command_has_every_option(command: Geomesh, tmp_path: Path) -> None:
    output = tmp_path / "mesh.gpkg"
    run = command(
        *("mesh", OLINDA, "-o", output, "--preset", "adaptive", "--max-error", "50,50,70"),
        *("--nodes", "900", "--min-angle", "12", "--effort", "fast", "--keep-features"),
        *("--breaklines", "canny", "--time-limit", "60"),
    )
    assert run.code == 0, run.err
    recipe = geomesh.read_mesh(output).provenance.recipe
    assert (recipe.max_error, recipe.nodes, recipe.min_angle) == ((50, 50, 70), 900, 12)
    assert (recipe.effort, recipe.keep_features, recipe.refine) == ("fast", True, True)
    kept = command("mesh", OLINDA, "-o", output, "--preset", "adaptive", "--skip-existing")
    assert kept.code == 1
    assert "recipe" in kept.error()


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--max-error", "1", "--rmse", "1"], "--max-error"),
        (["--max-error", "x"], "give a number such as"),
        (["--min-angle", "40"], "min_angle is 40"),
        (["--time-limit", "0"], "--time-limit"),
        (["--preset", "features", "--rmse", "3"], "--preset adaptive"),
        (
            ["--preset", "features", "--time-limit", "5"],
            "--time-limit is 5.0, but the preset features is not refined: use --preset adaptive",
        ),
    ],
)
def test_the_command_names_its_options(
    command: Geomesh, tmp_path: Path, options: list[str], message: str
) -> None:
    preset = [] if "--preset" in options else ["--preset", "adaptive"]
    run = command("mesh", OLINDA, "-o", f"{tmp_path}/meshes/", *preset, *options)
    assert run.code in (1, 2)
    assert message in run.err
    assert not list(tmp_path.iterdir())
