"""Batches: small rasters in parallel, results in order, and continued batches."""

from __future__ import annotations

import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import geopandas as gpd
import pytest
import shapely

import geomesh
from support.commands import OLD, PROGRAM, Run, run_program, snapshot
from support.files import contents, hidden
from support.rasters import COLS, NORTH_UP, ROWS, UTM, picture, write_raster
from support.samples import write_mirrored

if TYPE_CHECKING:
    import numpy as np

CHIPS = 6


@pytest.fixture(scope="module")
def chips(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Small rasters. The third is not a raster, and the fifth has no valid pixel."""
    folder = tmp_path_factory.mktemp("chips")
    paths = [folder / f"chip{number}.tif" for number in range(CHIPS)]
    for number, path in enumerate(paths):
        save(path, picture(3, ROWS + number, COLS))
    paths[2].write_text("no raster")
    save(paths[4], picture(3) * 0, nodata=0)
    return paths


@pytest.fixture(scope="module")
def large(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A raster of more than one tile."""
    folder = tmp_path_factory.mktemp("large")
    return write_mirrored(folder / "large.tif", "olinda_landsat7_rgb_uint8.tif", 1100, 300)


def save(path: Path, data: np.ndarray, **profile: object) -> Path:
    return Path(write_raster(path.parent, path.name, data, **profile))


def mesh(*arguments: str | Path, **options: object) -> Run:
    return run_program("mesh", *arguments, **options)


def outcomes(run: Run) -> list[dict[str, object]]:
    found: list[dict[str, object]] = json.loads(run.out)["results"]
    return found


@pytest.mark.slow
def test_outcomes_and_their_order_do_not_depend_on_the_workers(
    chips: list[Path], large: Path, tmp_path: Path
) -> None:
    sources = [*chips[:4], large, *chips[4:]]
    told = {}
    for workers in ("1", "3"):
        folder = tmp_path / workers
        run = mesh(*sources, "-o", folder, "--workers", workers, "--json")
        assert run.code == 1
        told[workers] = run.err.replace(str(folder), ""), run.out.replace(str(folder), "")
        assert hidden(folder) == []
    assert told["1"] == told["3"]
    results = json.loads(told["1"][1])["results"]
    assert [Path(str(each["source"])) for each in results] == sources
    assert ["error" in each for each in results] == [path in chips[2:5:2] for path in sources]
    errors = [line for line in told["1"][0].splitlines() if line.startswith("Error: ")]
    assert [path.name in line for path, line in zip(chips[2:5:2], errors, strict=True)] == [
        True
    ] * 2
    for path in (*chips[:2], large):
        one, other = (tmp_path / workers / f"{path.stem}.gpkg" for workers in ("1", "3"))
        assert geomesh.read_mesh(one).metadata == geomesh.read_mesh(other).metadata
        if path == large:
            assert contents(one) == contents(other)


def test_events_come_in_the_order_of_the_sources(chips: list[Path], tmp_path: Path) -> None:
    run = mesh(*chips, "-o", tmp_path, "--workers", "2", "--progress", "jsonl")
    events = [json.loads(line) for line in run.out.splitlines()]
    told = [event for event in events if event["event"] in ("start", "result", "error")]
    assert [event["event"] for event in told[::2]] == ["start"] * CHIPS
    assert [event["source"] for event in told[::2]] == list(map(str, chips))
    assert [event["event"] for event in told[1::2]] == [
        *("result", "result", "error", "result", "error", "result")
    ]


def test_warnings_name_their_raster(tmp_path: Path) -> None:
    paths = [tmp_path / f"{name}.tif" for name in "abc"]
    for path in paths:
        save(path, picture(1), crs=None, transform=None)
    run = mesh(*paths, "-o", tmp_path / "out", "--workers", "2")
    assert run.code == 0
    warned = [line for line in run.err.splitlines() if line.startswith("Warning: ")]
    assert [path.name in line for path, line in zip(paths, warned, strict=True)] == [True] * 3


def test_masks_and_bounds_reach_the_processes(chips: list[Path], tmp_path: Path) -> None:
    area = shapely.box(*NORTH_UP @ (4, 30), *NORTH_UP @ (40, 4))
    gpd.GeoDataFrame(geometry=[area], crs=UTM).to_file(tmp_path / "area.gpkg")
    options = ("--mask", tmp_path / "area.gpkg", "--workers", "2", "--json")
    results = outcomes(mesh(*chips[:2], "-o", tmp_path / "out", *options))
    for result in results:
        made = geomesh.read_mesh(str(result["output"]))
        assert (made.grid.width, made.grid.height) == (36, 26)


# Continued batches


@pytest.fixture
def made(chips: list[Path], tmp_path: Path) -> Path:
    """A folder with the meshes of two chips."""
    folder = tmp_path / "made"
    assert mesh(*chips[:2], "-o", folder, "--nodes", "60").code == 0
    return folder


def again(chips: list[Path], folder: Path, *options: str | Path) -> Run:
    return mesh(*chips[:2], "-o", folder, "--json", "--skip-existing", *options)


def test_what_is_there_is_left_and_what_is_missing_is_made(chips: list[Path], made: Path) -> None:
    first, second = sorted(made.iterdir())
    second.unlink()
    before = first.stat().st_mtime_ns, first.read_bytes()
    run = again(chips, made, "--nodes", "60")
    assert run.code == 0
    assert [result["skipped"] for result in outcomes(run)] == [True, False]
    assert outcomes(run)[0]["nodes"] == len(geomesh.read_mesh(first).nodes)
    assert (first.stat().st_mtime_ns, first.read_bytes()) == before
    assert second.exists()


def truncated(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def without_rows(path: Path) -> None:
    frame = gpd.read_file(path, layer="triangles")
    geomesh.read_mesh(path).to_file(path.with_suffix(".geojson"))
    import sqlite3
    from contextlib import closing

    with closing(sqlite3.connect(path)) as database:
        for (name,) in database.execute(
            "SELECT name FROM sqlite_master WHERE type = 'trigger' AND tbl_name = 'triangles'"
        ).fetchall():
            database.execute(f'DROP TRIGGER "{name}"')
        database.execute(f"DELETE FROM triangles WHERE fid = {len(frame)}")
        database.commit()
    path.with_suffix(".geojson").unlink()


def another_source(path: Path) -> None:
    shutil.copy(path.with_name("chip1.gpkg"), path)


def not_ours(path: Path) -> None:
    path.write_bytes(OLD)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("spoil", "options", "why"),
    [
        (
            truncated,
            ("--nodes", "60"),
            "is not a complete mesh file|is damaged|does not have all its",
        ),
        (without_rows, ("--nodes", "60"), "does not have all its triangles"),
        (another_source, ("--nodes", "60"), "was not made from the same pixels"),
        (not_ours, ("--nodes", "60"), "is not a complete mesh file of geomesh"),
        (None, ("--nodes", "70"), "was made with another recipe"),
        (None, ("--nodes", "60", "--bidx", "1"), "was not made from the same pixels"),
        (None, ("--nodes", "60", "--nodata", "7"), "was not made from the same pixels"),
        (None, ("--nodes", "60", "--crs", "EPSG:32724"), "was not made from the same pixels"),
    ],
)
def test_what_would_not_be_the_same_is_refused_or_replaced(
    chips: list[Path], made: Path, spoil: object, options: tuple[str, ...], why: str
) -> None:
    output = made / "chip0.gpkg"
    if callable(spoil):
        spoil(output)
    before = snapshot(made)["chip0.gpkg"]
    run = again(chips, made, *options)
    assert run.code == 1
    error = str(outcomes(run)[0]["error"])
    assert "use --overwrite to replace it" in error
    assert any(words in error for words in why.split("|")), error
    assert snapshot(made)["chip0.gpkg"] == before
    replaced = again(chips, made, *options, "--overwrite")
    assert replaced.code == 0, replaced.err
    assert outcomes(replaced)[0]["skipped"] is False
    assert geomesh.read_mesh(output).certify().passed


@pytest.mark.slow
def test_an_output_that_another_process_is_writing_is_no_output_yet(
    chips: list[Path], made: Path
) -> None:
    output = made / "chip0.gpkg"
    unfinished = made / ".geomesh-1-abc"
    unfinished.mkdir()
    (unfinished / "output.gpkg").write_bytes(output.read_bytes()[:5000])
    output.unlink()
    assert outcomes(again(chips, made, "--nodes", "60"))[0]["skipped"] is False
    assert unfinished.exists()


@pytest.mark.slow
@pytest.mark.parametrize("extension", ["geojson", "fgb", "parquet", "nc"])
def test_every_format_is_found_again(chips: list[Path], tmp_path: Path, extension: str) -> None:
    output = tmp_path / f"mesh.{extension}"
    for skipped in (False, True):
        run = mesh(chips[0], "-o", output, "--json", "--skip-existing")
        assert [result["skipped"] for result in outcomes(run)] == [skipped], run.err
    truncated(output)
    assert mesh(chips[0], "-o", output, "--skip-existing").code == 1


# Processes that are stopped or killed


def children(pid: int) -> list[int]:
    return [int(child) for child in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]


@pytest.fixture(scope="module")
def many(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Rasters that need some time each."""
    folder = tmp_path_factory.mktemp("many")
    first = write_mirrored(folder / "0.tif", "olinda_landsat7_rgb_uint8.tif", 600, 600)
    paths = [folder / f"{number}.tif" for number in range(1, 12)]
    for path in paths:
        shutil.copy(first, path)
    return [first, *paths]


def started(sources: list[Path], folder: Path) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [*PROGRAM, "mesh", *map(str, sources), "-o", str(folder), "--workers", "2"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def first_line(process: subprocess.Popen[str]) -> str:
    assert process.stdout is not None
    return process.stdout.readline()


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="children are found in /proc")
def test_a_process_that_is_lost_costs_one_raster(many: list[Path], tmp_path: Path) -> None:
    with started(many, tmp_path / "out") as process:
        assert first_line(process)
        os.kill(children(process.pid)[0], signal.SIGKILL)
        _, errors = process.communicate(timeout=180)
    assert process.returncode == 1
    lost = [line for line in errors.splitlines() if line.startswith("Error: ")]
    assert len(lost) == 1
    assert "the process that meshed it ended unexpectedly" in lost[0]
    assert len(list((tmp_path / "out").glob("*.gpkg"))) == len(many) - 1


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="children are found in /proc")
@pytest.mark.parametrize(("number", "code"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_batch_that_is_stopped_leaves_whole_meshes_only(
    many: list[Path], tmp_path: Path, number: int, code: int
) -> None:
    with started(many, tmp_path / "out") as process:
        assert first_line(process)
        workers = children(process.pid)
        assert workers
        process.send_signal(number)
        _, errors = process.communicate(timeout=60)
    assert process.returncode == code
    assert errors.strip().splitlines()[-1] == "Interrupted: the unfinished output was not written."
    assert hidden(tmp_path / "out") == []
    done = list((tmp_path / "out").glob("*.gpkg"))
    assert 0 < len(done) < len(many)
    assert all(geomesh.read_mesh(path).certify().passed for path in done)
    for _ in range(50):
        if not any(Path(f"/proc/{pid}").exists() for pid in workers):
            break
        time.sleep(0.1)
    assert not [pid for pid in workers if Path(f"/proc/{pid}").exists()]


@pytest.mark.slow
def test_hundreds_of_rasters_some_of_which_are_broken(tmp_path: Path) -> None:
    folder = tmp_path / "in"
    folder.mkdir()
    first = save(folder / "0000.tif", picture(1, 16, 16))
    for number in range(1, 300):
        path = folder / f"{number:04}.tif"
        if number % 50 == 7:
            path.write_bytes(first.read_bytes()[:100])
        else:
            shutil.copy(first, path)
    run = mesh(*sorted(folder.iterdir()), "-o", tmp_path / "out", "--preset", "paper", "--json")
    assert run.code == 1
    broken = [Path(str(each["source"])).stem for each in outcomes(run) if "error" in each]
    assert broken == [f"{number:04}" for number in range(7, 300, 50)]
    assert len(list((tmp_path / "out").glob("*.gpkg"))) == 300 - len(broken)
