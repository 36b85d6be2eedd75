"""Bad output paths, full disks and interrupted runs: either everything or nothing is written.

If signals, limits or pipes of the process are tested, the command line runs as a separate program.
"""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import tempfile
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import geopandas as gpd
import pytest
import shapely

import geomesh
from geomesh.errors import GeomeshError, OutputError
from geomesh.io.atomic import staged
from geomesh.io.read import read_mesh
from support.commands import OLD, PROGRAM, Geomesh, Run, assert_refused, run_program, snapshot
from support.rasters import NORTH_UP, UTM, picture, write_raster

if TYPE_CHECKING:
    from collections.abc import Mapping

# Where to write, beside the raster "scene.tif": OUT, more arguments, and the expected error.
PLACES: dict[str, tuple[str, tuple[str, ...], str]] = {
    "missing folder": ("no/mesh.gpkg", (), "folder of .*no/mesh.gpkg does not exist; create it"),
    "folder that is a file": ("scene.tif/mesh.gpkg", (), "does not exist; create it"),
    "no place for files": ("/proc/mesh.gpkg", (), "cannot be written: .*; choose another folder"),
    "name too long": ("x" * 300 + ".gpkg", (), "cannot be written: .*too long"),
    "device": ("/dev/null", ("-f", "GPKG"), "not a regular file; choose another name"),
    "unknown extension": ("mesh.shp", (), "no extension that names a format; choose from .gpkg"),
    "no extension": ("mesh", (), "no extension that names a format; choose from .gpkg"),
    "unknown driver": ("mesh.gpkg", ("-f", "Shapefile"), "'Shapefile'; choose from GPKG, GeoJSON"),
    "layers as geojson": (
        "mesh.geojson",
        ("--layers=edges,nodes",),
        "one layer, not edges, nodes; choose one of them, or write .gpkg",
    ),
    "no layers": ("mesh.gpkg", ("--layers=",), "no layer to write; choose from triangles"),
    "the source itself": (
        "scene.tif",
        ("-f", "GPKG", "--overwrite"),
        "scene.tif is the input .*scene.tif; choose another name",
    ),
    "a link to the source": (
        "link.gpkg",
        ("-f", "GPKG", "--overwrite"),
        "link.gpkg is the input .*scene.tif; choose another name",
    ),
    "the mask itself": (
        "aoi.gpkg",
        ("--mask=aoi.gpkg", "--overwrite"),
        "aoi.gpkg is the input .*aoi.gpkg; choose another name",
    ),
    "the recipe itself": (
        "recipe.json",
        ("--recipe=recipe.json", "--overwrite"),
        "recipe.json is the input .*recipe.json; choose another name",
    ),
    "folder that is a file, for several": ("scene.tif", ("other.tif",), "is a file; .* a folder"),
    "folder in a file, for several": ("scene.tif/x", ("other.tif",), "cannot be created"),
}

NAMES = (
    "a b",
    "größe 水 \N{SATELLITE}",
    "quo'te",
    'dou"ble',
    "per%20cent#?&",
    "brackets [1] {2} *",
    "semi;colon, --x",
    "$HOME `ls`",
    ":colon",
)


@pytest.mark.parametrize(("output", "given", "refused"), PLACES.values(), ids=PLACES)
def test_bad_places_are_refused_and_nothing_is_lost(
    tmp_path: Path,
    output: str,
    given: tuple[str, ...],
    refused: str,
    command: Geomesh,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("scene.tif", "other.tif"):
        write_raster(tmp_path, name)
    Path("link.gpkg").symlink_to("scene.tif")
    area = shapely.box(NORTH_UP.c, NORTH_UP.f - 600, NORTH_UP.c + 600, NORTH_UP.f)
    gpd.GeoSeries([area], crs=UTM).to_file("aoi.gpkg")
    Path("recipe.json").write_text(json.dumps({"nodes": 50}))
    before = snapshot(tmp_path)
    error = command("mesh", "scene.tif", *given, "-o", output).error()
    assert re.search(refused, error), error
    assert snapshot(tmp_path) == before


def test_an_exclamation_mark_is_fine_in_a_name_and_refused_in_a_folder(
    tmp_path: Path, command: Geomesh
) -> None:
    source, output = write_raster(tmp_path), tmp_path / "wow!.gpkg"
    assert command("mesh", source, "-o", output).code == 0
    assert read_mesh(output).certify().passed
    folder = tmp_path / "so! sharp"
    folder.mkdir()
    error = command("mesh", source, "-o", folder / "mesh.gpkg").error()
    assert "choose a folder without '!'" in error
    assert list(folder.iterdir()) == []


@pytest.mark.slow
@pytest.mark.parametrize("extension", [".gpkg", ".geojson", ".fgb", ".parquet"])
def test_existing_output_is_kept_or_replaced_whole(
    tmp_path: Path, extension: str, command: Geomesh
) -> None:
    source, output = write_raster(tmp_path), tmp_path / f"mesh{extension}"
    output.write_bytes(OLD)
    error = command("mesh", source, "-o", output).error()
    assert "exists; use --overwrite" in error
    assert output.read_bytes() == OLD
    run = command("mesh", source, "-o", output, "--overwrite")
    assert (run.code, run.err) == (0, "")
    assert sorted(snapshot(tmp_path)) == sorted([output.name, "scene.tif"])
    read = (
        gpd.read_parquet if extension == ".parquet" else partial(gpd.read_file, layer="triangles")
    )
    assert len(read(output)) > 10


def test_folder_takes_the_mesh_of_one_source(tmp_path: Path, command: Geomesh) -> None:
    source = write_raster(tmp_path)
    (tmp_path / "mesh.gpkg").mkdir()
    assert command("mesh", source, "-o", tmp_path / "mesh.gpkg").code == 0
    assert read_mesh(tmp_path / "mesh.gpkg" / "scene.gpkg").certify().passed
    with pytest.raises(OutputError, match="is a folder; name a file inside it"):
        geomesh.mesh_raster(source).to_file(tmp_path / "mesh.gpkg")


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_odd_names_are_names(tmp_path: Path, name: str, command: Geomesh) -> None:
    folder = tmp_path / name
    source = write_raster(folder, f"{name}.tif")
    for extension in (".gpkg", ".geojson"):
        output = folder / f"{name}{extension}"
        run = command("mesh", "-o", output, source)
        assert (run.code, run.err) == (0, "")
        assert run.out.startswith(f"{output}: ")
    assert sorted(snapshot(folder)) == sorted(name + end for end in (".geojson", ".gpkg", ".tif"))
    assert read_mesh(folder / f"{name}.gpkg").certify().passed
    error = assert_refused(command, f"{source}x", folder=folder, output=folder / "new.gpkg")
    assert error == f"{source}x: no such file; check the path"


@pytest.mark.parametrize("name", ["-o", "--help", "-"])
def test_names_that_look_like_options_follow_two_dashes(
    tmp_path: Path, name: str, command: Geomesh, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    write_raster(tmp_path, name)
    assert command("mesh", "-o", "mesh.gpkg", "--", name).code == 0
    assert read_mesh("mesh.gpkg").certify().passed


@pytest.mark.parametrize(
    "name", ["two\nlines.tif", os.fsdecode(b"\xff.tif")], ids=["two lines", "no text"]
)
def test_names_that_are_no_line_of_text_are_told_in_one(
    tmp_path: Path, name: str, command: Geomesh
) -> None:
    (tmp_path / name).write_text("not a raster")
    before = snapshot(tmp_path)
    with pytest.raises(GeomeshError) as refusal:
        geomesh.mesh_raster(tmp_path / name)
    assert len(str(refusal.value).splitlines()) == 1
    command("mesh", "-o", tmp_path / "mesh.gpkg", tmp_path / name).error()
    assert snapshot(tmp_path) == before


# ---------------------------------------------------------------- separate programs


@pytest.mark.slow
@pytest.mark.parametrize("extension", [".gpkg", ".geojson"])
def test_full_disk_is_told_in_one_line(
    tmp_path: Path, small_disk: tuple[Path, Mapping[str, Any]], extension: str
) -> None:
    folder, options = small_disk
    source = write_raster(tmp_path, data=picture(3, 300, 300))
    output = folder / f"mesh{extension}"
    output.write_bytes(OLD)
    error = run_program("mesh", source, "-o", output, "--overwrite", **options).error()
    assert f"{output} could not be written: " in error
    assert "free some space or choose another folder" in error
    assert snapshot(folder) == {output.name: OLD}


def test_program_tells_errors_in_one_line(tmp_path: Path) -> None:
    """The program prints what a user sees. No test fixture captures the text of libraries."""
    source = Path(write_raster(tmp_path, data=picture(3, 600, 700), tiled=True, compress="deflate"))
    source.write_bytes(source.read_bytes()[:200_000])
    before = snapshot(tmp_path)
    error = run_program("mesh", source, "-o", tmp_path / "mesh.gpkg").error()
    assert re.search(r"scene.tif: cannot read columns \d+ to \d+, rows \d+ to \d+", error)
    assert snapshot(tmp_path) == before


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> str:
    """A raster of several tiles. Writing its mesh takes some time."""
    folder = tmp_path_factory.mktemp("scene")
    return write_raster(folder, data=picture(3, 1200, 1200), photometric="rgb")


def stop_when(message: str, number: int, source: str, output: Path) -> Run:
    """Run until the message `message` appears, send a signal, and return the result."""
    process = subprocess.Popen(
        [*PROGRAM, "mesh", source, "-o", str(output), "--overwrite", "--progress=jsonl"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    with process:
        assert process.stdout is not None
        seen = []
        for line in process.stdout:
            event = json.loads(line)
            if event["event"] == "progress" and event["message"].startswith(message):
                process.send_signal(number)
                break
            seen.append(line)
        else:
            pytest.fail(f"no event told of {message!r}: {seen}")
        out, err = process.communicate(timeout=60)
    return Run(process.returncode, out, err)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("message", "number", "code"),
    [
        ("Detecting", signal.SIGINT, 130),
        ("Measuring", signal.SIGTERM, 143),
        ("Writing", signal.SIGTERM, 143),
    ],
    ids=lambda value: getattr(value, "name", str(value)),
)
def test_stopped_run_leaves_the_old_file_and_nothing_else(
    tmp_path: Path, scene: str, message: str, number: signal.Signals, code: int
) -> None:
    output = tmp_path / "mesh.gpkg"
    output.write_bytes(OLD)
    run = stop_when(message, number, scene, output)
    assert (run.code, [line for line in run.out.splitlines() if '"result"' in line]) == (code, [])
    assert "Traceback" not in run.err
    assert run.err.strip() in ("", "Interrupted: the unfinished output was not written.")
    assert snapshot(tmp_path) == {"mesh.gpkg": OLD}


@pytest.mark.slow
def test_interrupt_at_any_moment_of_writing_comes_through(tmp_path: Path, scene: str) -> None:
    """It raises KeyboardInterrupt, not an error of the library that was interrupted."""
    mesh, output = geomesh.mesh_raster(scene), tmp_path / "mesh.gpkg"
    output.write_bytes(OLD)
    delays = [0.001 * 2**k for k in range(10)]

    def interrupt(*_: Any) -> NoReturn:
        raise KeyboardInterrupt

    def begin(fraction: float, message: str) -> None:
        if fraction == 0:
            signal.setitimer(signal.ITIMER_REAL, delays[len(outcomes)])

    before = signal.signal(signal.SIGALRM, interrupt)
    outcomes = []
    try:
        while len(outcomes) < len(delays):
            try:
                mesh.to_file(output, overwrite=True, progress=begin)
                signal.setitimer(signal.ITIMER_REAL, 0)
                break  # it was written before the alarm
            except BaseException as error:
                outcomes.append(type(error).__name__)
            assert snapshot(tmp_path) == {output.name: OLD}
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
    assert set(outcomes) == {"KeyboardInterrupt"}, outcomes


@pytest.mark.slow
def test_killed_run_leaves_the_old_file(tmp_path: Path, scene: str) -> None:
    output = tmp_path / "mesh.gpkg"
    output.write_bytes(OLD)
    run = stop_when("Writing", signal.SIGKILL, scene, output)
    assert run.code == -signal.SIGKILL
    assert output.read_bytes() == OLD
    # The killed run leaves only a hidden folder. It does not disturb the next run.
    assert [path.name[:9] for path in tmp_path.iterdir() if path != output] == [".geomesh-"]
    assert run_program("mesh", write_raster(tmp_path), "-o", output, "--overwrite").code == 0


@pytest.mark.slow
@pytest.mark.parametrize("style", ["none", "jsonl"])
def test_reader_of_the_output_may_stop_reading(tmp_path: Path, style: str) -> None:
    """This happens in `geomesh mesh ... | head -0`."""
    source, output = write_raster(tmp_path), tmp_path / "mesh.gpkg"
    reading, writing = os.pipe()
    os.close(reading)
    done = subprocess.run(
        [*PROGRAM, "mesh", source, "-o", str(output), f"--progress={style}"],
        stdout=writing,
        stderr=subprocess.PIPE,
        text=True,
        check=False,
    )
    os.close(writing)
    assert done.stderr == ""
    assert done.returncode in (0, 1)
    assert snapshot(tmp_path).keys() <= {"scene.tif", "mesh.gpkg"}
    if output.exists():
        assert read_mesh(output).certify().passed
    else:
        assert done.returncode == 1


@pytest.mark.parametrize("step", ["rmtree", "mkdtemp"])
def test_request_to_end_does_not_interrupt_the_cleaning_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    """A killed QGIS causes a broken pipe, and then a signal while the folder is removed."""
    module = shutil if step == "rmtree" else tempfile
    done = getattr(module, step)

    def disturbed(*arguments: Any, **options: Any) -> Any:
        signal.raise_signal(signal.SIGINT)
        made = done(*arguments, **options)
        signal.raise_signal(signal.SIGINT)
        return made

    monkeypatch.setattr(module, step, disturbed)
    with pytest.raises(KeyboardInterrupt), staged(tmp_path / "a.gpkg", ".gpkg", overwrite=False):
        raise BrokenPipeError
    assert list(tmp_path.iterdir()) == []
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler
