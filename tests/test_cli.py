"""The command line as its users call it: a person, a script, a program that reads JSON lines."""

import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

import cv2
import geopandas as gpd
import numpy as np
import pyogrio
import pyproj
import pytest
import rasterio
import shapely
from click.testing import CliRunner

import geomesh
from geomesh.cli import cli
from support.commands import run_program
from support.samples import OLINDA, ROTATED, SAMPLES


def run(*arguments, code=0):
    """Run a command in this process; return its standard output and standard error."""
    result = CliRunner().invoke(cli, [str(a) for a in arguments])
    assert result.exit_code == code, result.output
    return result.stdout, result.stderr


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    path = tmp_path_factory.mktemp("made") / "olinda.gpkg"
    run("mesh", OLINDA, "-o", path, "--nodes", 300)
    return path


@pytest.mark.slow
def test_the_command_is_installed_and_keeps_data_and_messages_apart(tmp_path):
    command = Path(sys.executable).with_name("geomesh")
    out = tmp_path / "mesh.gpkg"
    done = subprocess.run(
        [command, "mesh", OLINDA, "-o", out, "--nodes", "300", "--progress", "bar"],
        capture_output=True,
        text=True,
        check=True,
    )
    mesh = geomesh.read_mesh(out)
    told = f"300 nodes, {len(mesh.triangles)} triangles, certified"
    assert done.stdout.strip().endswith(told)
    assert "%" in done.stderr
    assert mesh.certify().passed


def test_the_file_is_what_the_library_gives(made):
    mesh = geomesh.mesh_raster(OLINDA, nodes=300)
    again = geomesh.read_mesh(made)
    assert (again.nodes == mesh.nodes).all()
    assert (again.triangles == mesh.triangles).all()
    assert again.metadata["recipe"] == json.loads(json.dumps(mesh.metadata["recipe"]))


@pytest.mark.parametrize("extension", ["gpkg", "geojson", "fgb", "parquet"])
def test_every_format_by_its_extension(tmp_path, extension):
    path = tmp_path / f"mesh.{extension}"
    run("mesh", OLINDA, "-o", path, "--nodes", 200)
    options = {"layer": "triangles"} if extension == "gpkg" else {}
    frame = gpd.read_parquet(path) if extension == "parquet" else gpd.read_file(path, **options)
    assert len(frame) == len(geomesh.mesh_raster(OLINDA, nodes=200).triangles)


def test_layers_and_statistics_can_be_chosen(tmp_path):
    path = tmp_path / "nodes.geojson"
    run("mesh", OLINDA, "-o", path, "--layers", "nodes", "--nodes", 100)
    assert set(gpd.read_file(path).geom_type) == {"Point"}
    path = tmp_path / "mesh.fgb"
    run("mesh", OLINDA, "-o", path, "--stats", "mean,max", "--nodes", 100)
    columns = gpd.read_file(path).columns
    assert {"red_mean", "red_max"} <= set(columns)
    assert not {"red_std", "red_min"} & set(columns)


def test_json_lines_follow_the_protocol(tmp_path):
    out = tmp_path / "mesh.gpkg"
    stdout, _ = run("mesh", OLINDA, "-o", out, "--progress", "jsonl", "--nodes", 200)
    events = [json.loads(line) for line in stdout.splitlines()]
    kinds = [event["event"] for event in events]
    assert kinds[0] == "start"
    assert events[0]["protocol"] == 1
    assert kinds[-1] == "result"
    assert set(kinds[1:-1]) == {"progress"}
    fractions = [event["fraction"] for event in events[1:-1]]
    assert fractions == sorted(set(fractions))
    assert fractions[-1] == 1
    assert events[-1]["outputs"] == [str(out)]
    assert events[-1]["figures"]["nodes"] == 200


def test_json_lines_tell_warnings_and_errors(tmp_path):
    source = SAMPLES / "spyndex_sentinel2_4band_uint16_NOGEOREF.tif"
    stdout, stderr = run(
        "mesh", source, "-o", tmp_path / "m.geojson", "--progress", "jsonl", code=1
    )
    events = {event["event"]: event for event in map(json.loads, stdout.splitlines())}
    assert "no georeference" in events["log"]["message"]
    assert events["log"]["level"] == "warning"
    assert events["error"]["code"] == "georeference"
    assert "result" not in events
    assert stderr == ""


def test_one_bad_file_does_not_stop_the_batch(tmp_path):
    folder = tmp_path / "meshes"
    stdout, stderr = run(
        "mesh", OLINDA, "missing.tif", ROTATED, "-o", folder, "--preset", "paper", code=1
    )
    assert sorted(path.name for path in folder.iterdir()) == [
        "olinda_landsat7_rgb_rotated_gt.gpkg",
        "olinda_landsat7_rgb_uint8.gpkg",
    ]
    assert stdout.count("certified") == 2
    assert "Error: missing.tif: no such file" in stderr
    assert "2 meshed, 1 failed" in stderr


@pytest.mark.slow
@pytest.mark.parametrize("sources", [[OLINDA], [OLINDA, ROTATED]], ids=["one", "a batch"])
def test_a_mask_is_read_by_a_program_that_has_loaded_nothing_before(tmp_path, sources):
    """Reading the mask and writing use the same library, and the import order works."""
    with rasterio.open(OLINDA) as dataset:
        area = shapely.box(*dataset.bounds).buffer(-3000)
        gpd.GeoSeries([area], crs=dataset.crs).to_file(tmp_path / "aoi.gpkg")
    options = ["-o", f"{tmp_path}/out/", "--mask", tmp_path / "aoi.gpkg", "--nodes", 50]
    run = run_program("mesh", *sources, *options)
    assert run.code == 0, run.err
    for source in sources:
        made = geomesh.read_mesh(tmp_path / "out" / f"{source.stem}.gpkg")
        assert made.map_nodes.min(axis=0).tolist() >= list(area.buffer(100).bounds[:2])


def test_json_tells_of_every_source(tmp_path):
    stdout, _ = run("mesh", OLINDA, "missing.tif", "-o", f"{tmp_path}/", "--json", code=1)
    outcome = json.loads(stdout)
    assert outcome["failed"] == 1
    assert [set(result) for result in outcome["results"]] == [
        {"source", "output", "nodes", "triangles", "warnings", "skipped"},
        {"source", "error"},
    ]


def test_a_folder_takes_one_source_as_well(tmp_path):
    run("mesh", ROTATED, "-o", tmp_path, "-f", "FlatGeobuf")
    assert [path.name for path in tmp_path.iterdir()] == ["olinda_landsat7_rgb_rotated_gt.fgb"]


def test_quality_prints_a_table_and_all_figures_as_json(made):
    stdout, _ = run("quality", made)
    for word in ("ki", "min_angle", "radius_ratio", "300 nodes", "under 10 degrees", "AB"):
        assert word in stdout
    image = json.loads(run("quality", made, "--json")[0])
    assert image == geomesh.read_mesh(made).quality().summary()
    on_map = json.loads(run("quality", made, "--json", "--space", "map")[0])
    assert on_map["measures"]["ki"]["mean"] == pytest.approx(28.5 * image["measures"]["ki"]["mean"])
    assert on_map["ki_normalised"] == pytest.approx(image["ki_normalised"])


def test_info_describes_meshes_and_rasters(made):
    text = run("info", made)[0]
    for word in ("300", "EPSG:31985", "passed: True", "features"):
        assert word in text
    facts = json.loads(run("info", OLINDA, "--json")[0])
    assert facts["size"] == [349, 352]
    assert [band["description"] for band in facts["bands"]] == ["red", "green", "blue"]
    assert facts["crs"] == "EPSG:31985"


def test_the_recipe_of_a_mesh_makes_it_again(made, tmp_path):
    recipe, again = tmp_path / "recipe.json", tmp_path / "again.gpkg"
    recipe.write_text(run("info", made, "--json")[0])
    run("mesh", OLINDA, "-o", again, "--recipe", recipe)
    assert (geomesh.read_mesh(again).triangles == geomesh.read_mesh(made).triangles).all()


def test_bounds_and_mask_crop(tmp_path):
    west, south, east, north = 290000, 9112000, 294000, 9118000
    out = tmp_path / "part.gpkg"
    run("mesh", OLINDA, "-o", out, "--bounds", west, south, east, north)
    got = gpd.read_file(out, layer="triangles").total_bounds
    assert abs(got - (west, south, east, north)).max() <= 28.5
    area = gpd.GeoDataFrame(
        geometry=gpd.points_from_xy([293000], [9116000]).buffer(2000), crs="EPSG:31985"
    )
    area.to_crs(4326).to_file(tmp_path / "aoi.gpkg")
    run("mesh", OLINDA, "-o", out, "--mask", tmp_path / "aoi.gpkg", "--overwrite")
    covered = gpd.read_file(out, layer="triangles").union_all()
    assert covered.symmetric_difference(area.geometry[0]).area < 0.03 * covered.area


def test_stages_draws_a_picture(tmp_path):
    out = tmp_path / "stages.png"
    stdout, _ = run("stages", ROTATED, "-o", out, "--preset", "paper")
    assert out.read_bytes().startswith(b"\x89PNG")
    assert str(out) in stdout
    _, stderr = run("stages", ROTATED, "-o", out, code=1)
    assert "--overwrite" in stderr


def test_convert_writes_the_same_mesh_in_another_format(made, tmp_path):
    for name in ("mesh.fgb", "mesh.nc", "mesh.gpkg"):
        stdout, _ = run("convert", made, "-o", tmp_path / name)
        assert "certified" in stdout
    mesh = geomesh.read_mesh(made)
    assert len(gpd.read_file(tmp_path / "mesh.fgb")) == len(mesh.triangles)
    again = geomesh.read_mesh(tmp_path / "mesh.gpkg")
    assert (again.nodes == mesh.nodes).all()
    assert again.metadata == mesh.metadata
    told = json.loads(
        run("convert", made, "-o", tmp_path / "n.fgb", "--layers", "nodes", "--json")[0]
    )
    assert told["results"][0]["nodes"] == 300
    assert len(gpd.read_file(tmp_path / "n.fgb")) == 300
    run("convert", made, "-o", tmp_path / "n.fgb", code=1)  # the file exists


def test_quality_can_be_kept_with_the_mesh(made, tmp_path):
    path = tmp_path / "measured.gpkg"
    run("quality", made, "-o", path)
    both = tmp_path / "both.gpkg"
    run("quality", path, "-o", both, "--space", "map")
    mesh = geomesh.read_mesh(made)
    path = both
    frame = gpd.read_file(path, layer="triangles")
    for name, values in mesh.quality().table.items():
        if name != "area":  # this one is on the map, in square metres
            assert frame[name].to_numpy() == pytest.approx(values, rel=1e-12)
    for name, values in mesh.quality("map").table.items():
        assert frame[f"map_{name}"].to_numpy() == pytest.approx(values, rel=1e-12)
    assert geomesh.read_mesh(path).certify().passed


def test_quality_tells_programs_too(made, tmp_path):
    out = tmp_path / "measured.gpkg"
    for options in ([], ["-o", out]):
        stdout, _ = run("quality", made, *options, "--progress", "jsonl")
        result = json.loads(stdout.splitlines()[-1])
        assert result["event"] == "result"
        assert result["outputs"] == [str(option) for option in options[1:]]
        assert result["figures"]["triangles"] == len(geomesh.read_mesh(made).triangles)


def test_no_command_writes_over_what_it_reads(made, tmp_path):
    raster, mask, recipe = (tmp_path / name for name in ("scene.gpkg", "aoi.gpkg", "recipe.json"))
    shutil.copy(OLINDA, raster)
    shutil.copy(made, mask)
    recipe.write_text("{}")
    picture = tmp_path / "scene.png"
    shutil.copy(OLINDA, picture)
    link = tmp_path / "link.gpkg"
    link.symlink_to(mask)
    cases = [
        ("mesh", raster, "-o", raster),
        ("mesh", f"GPKG:{raster}:table", "-o", raster),
        ("mesh", f'NETCDF:"{raster}":band', "-o", raster),
        ("mesh", OLINDA, "-o", mask, "--mask", mask),
        ("mesh", OLINDA, "-o", recipe, "-f", "GeoJSON", "--recipe", recipe),
        ("stages", picture, "-o", picture),
        ("convert", mask, "-o", link, "--layers", "nodes"),
        ("quality", mask, "-o", mask),
    ]
    for arguments in cases:
        kept = {path: path.read_bytes() for path in tmp_path.iterdir()}
        _, stderr = run(*arguments, "--overwrite", code=1)
        assert re.search(r"is the input .*; choose another name", stderr)
        assert {path: path.read_bytes() for path in tmp_path.iterdir()} == kept


def test_a_source_may_be_known_by_another_name(tmp_path):
    path = tmp_path / "mesh.gpkg"
    nowhere = str(SAMPLES / "spyndex_sentinel2_4band_uint16_NOGEOREF.tif")
    _, stderr = run("mesh", nowhere, "-o", path, "--source-name", "my layer")
    assert "Warning: my layer has no georeference" in stderr
    assert geomesh.read_mesh(path).metadata["source"]["name"] == "my layer"


def test_the_users_crs_takes_the_place_of_the_files(tmp_path):
    path = tmp_path / "mesh.gpkg"
    run("mesh", OLINDA, "-o", path, "--nodes", 50, "--crs", "EPSG:32725")
    assert gpd.read_file(path, layer="triangles").crs == "EPSG:32725"
    _, stderr = run("mesh", OLINDA, "-o", path, "--crs", "EPSG:1", "--overwrite", code=1)
    assert "EPSG:1" in stderr
    assert "such as EPSG:32722" in stderr
    assert stderr.count("\n") == 1


def test_python_m_geomesh_is_the_command():
    done = subprocess.run(
        [sys.executable, "-m", "geomesh", "--version"], capture_output=True, text=True, check=True
    )
    assert done.stdout.startswith(f"geomesh, version {geomesh.__version__}\n")


def test_the_version_comes_with_those_of_the_libraries():
    """Each wheel contains its own GDAL and PROJ."""
    stdout, _ = run("--version")
    first, *others = stdout.splitlines()
    assert first == f"geomesh, version {geomesh.__version__}"
    assert (
        f"rasterio {rasterio.__version__}, GDAL {rasterio.__gdal_version__}, "
        f"PROJ {rasterio.__proj_version__}"
    ) in others
    assert f"pyogrio {pyogrio.__version__}, GDAL {pyogrio.__gdal_version_string__}" in others
    assert f"pyproj {pyproj.__version__}, PROJ {pyproj.proj_version_str}" in others
    assert f"OpenCV {cv2.__version__}" in others
    assert f"numpy {np.__version__}" in others


def test_the_version_is_told_with_a_library_that_is_broken(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyogrio", None)
    stdout, _ = run("--version")
    assert stdout.startswith(f"geomesh, version {geomesh.__version__}\n")
    assert "pyogrio cannot be imported: " in stdout


@pytest.mark.slow
def test_until_eof_ends_with_the_program_that_started_it(tmp_path):
    """The work stops when standard input ends. It continues while standard input is open."""
    arguments = [sys.executable, "-m", "geomesh", "mesh", OLINDA, "--until-eof", "--progress"]
    arguments += ["jsonl", "-o"]
    stopped = subprocess.run(
        [*arguments, tmp_path / "no.gpkg"],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        text=True,
        check=False,
    )
    assert stopped.returncode == 143
    told = [json.loads(line) for line in stopped.stdout.splitlines()]
    # There is no error event if the work had not started yet.
    assert [event["code"] for event in told if event["event"] == "error"] in ([], ["interrupted"])
    assert "result" not in [event["event"] for event in told]
    assert list(tmp_path.iterdir()) == []
    with subprocess.Popen(
        [*arguments, tmp_path / "yes.gpkg"], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as process:
        told = [json.loads(line) for line in process.stdout]
        assert process.wait() == 0
    assert told[0]["pid"] == process.pid
    assert told[-1]["event"] == "result"
    assert [path.name for path in tmp_path.iterdir()] == ["yes.gpkg"]


def test_settings_reach_the_recipe(tmp_path):
    out = tmp_path / "m.gpkg"
    run("mesh", ROTATED, "-o", out, "--set", "min_spacing=6", "--set", "stretch=[1,99]")
    recipe = geomesh.read_mesh(out).metadata["recipe"]
    assert recipe["min_spacing"] == 6
    assert tuple(recipe["stretch"]) == (1, 99)


@pytest.mark.parametrize(
    "command",
    [
        [],
        ["mesh"],
        ["stages"],
        ["quality"],
        ["evaluate"],
        ["info"],
        ["convert"],
        ["contours"],
        ["view"],
    ],
)
def test_help_shows_examples(command):
    stdout, _ = run(*command, "--help")
    assert "Examples:\n" in stdout
    assert f"geomesh {' '.join(command)}".strip() in stdout


@pytest.mark.parametrize(
    "arguments",
    [
        ["mesh"],
        ["mesh", OLINDA],
        ["mesh", OLINDA, "-o", "x.gpkg", "--bidx", "a"],
        ["mesh", OLINDA, "-o", "x.gpkg", "--progress", "jsonl", "--json"],
        ["nope"],
    ],
)
def test_wrong_usage_exits_with_2(arguments):
    done = subprocess.run(
        [Path(sys.executable).with_name("geomesh"), *arguments],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 2
    assert "Traceback" not in done.stderr


def test_debug_shows_the_traceback(tmp_path):
    command = Path(sys.executable).with_name("geomesh")
    done = subprocess.run(
        [command, "--debug", "info", tmp_path / "missing.tif"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1
    assert "Traceback" in done.stderr


@pytest.mark.slow
@pytest.mark.parametrize("there", [True, False])
def test_a_batch_that_makes_nothing_leaves_the_folders_as_they_were(tmp_path, there):
    folder = tmp_path / "meshes"
    if there:
        folder.mkdir()
    run("mesh", "missing.tif", "nowhere.tif", "-o", folder, code=1)
    run("mesh", "missing.tif", "-o", f"{folder}/", code=1)
    assert folder.exists() == there
