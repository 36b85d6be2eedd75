"""Layers written by separate processes: the same file, and no remains when they fail."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

import pyarrow as pa
import pyogrio
import pytest

import geomesh
from geomesh.errors import OutputError
from geomesh.io.gdal_process import WriterPool
from geomesh.io.read import read_mesh
from geomesh.io.write import open_writer, write_mesh
from geomesh.parallel import processes
from geomesh.parallel.processes import _FOLDER as FOLDER
from geomesh.parallel.processes import Process
from support.files import assert_same, hidden
from support.meshes import random_mesh


def silent(_fraction: float, _message: str) -> None:
    pass


def write(mesh, path: Path, writer_pool: WriterPool, **options) -> None:
    with open_writer(path, writer_pool=writer_pool, **options) as writer:
        writer.finish(mesh, silent)


@pytest.mark.parametrize("extension", [".gpkg", ".geojson", ".fgb", ".parquet", ".nc"])
def test_the_file_is_that_of_one_process(tmp_path: Path, extension: str) -> None:
    mesh = random_mesh()
    one, other = tmp_path / f"one{extension}", tmp_path / f"other{extension}"
    write_mesh(mesh, one)
    with WriterPool(2) as writer_pool:
        write(mesh, other, writer_pool)
        write(mesh, other, writer_pool, overwrite=True)  # with the same processes
    if extension == ".gpkg":
        assert_same(read_mesh(other), mesh)
        for layer in ("triangles", "edges", "nodes"):
            (_, first), (_, second) = (pyogrio.read_arrow(p, layer=layer) for p in (one, other))
            assert first.equals(second)
    else:
        assert one.read_bytes() == other.read_bytes()


def test_a_process_that_is_lost_is_told_and_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "mesh.gpkg"
    path.write_text("mine")
    with WriterPool(1) as writer_pool:
        writer_pool.warm()
        for each in writer_pool._idle:
            each.kill()
        with pytest.raises(OutputError, match=r"could not be written: the process .* code -?\d+"):
            write(random_mesh(), path, writer_pool, overwrite=True, layers=["triangles"])
        assert path.read_text() == "mine"
        assert hidden(tmp_path) == []
        write(random_mesh(), path, writer_pool, overwrite=True)  # with a new process


def test_what_the_library_says_comes_through(tmp_path: Path) -> None:
    rows = pa.table({"geometry": pa.array([b""], pa.binary())})
    options = {"path": str(tmp_path / "no" / "a.gpkg"), "driver": "GPKG", "layer": "a"}
    options |= {"geometry_name": "geometry", "geometry_type": "Point", "crs": None}
    with WriterPool(0) as writer_pool, pytest.raises(OSError, match="no"):
        writer_pool.write(rows.schema, iter(rows.to_batches()), options)


def test_those_that_are_stopped_stop_at_once(tmp_path: Path) -> None:
    def rows():
        yield from table.to_batches()
        writer_pool.stop(Process.kill)
        yield from table.to_batches()

    table = pa.table({"geometry": pa.array([b"\1\1\0\0\0" + bytes(16)], pa.binary())})
    options = {"path": str(tmp_path / "a.gpkg"), "driver": "GPKG", "layer": "a"}
    options |= {"geometry_name": "geometry", "geometry_type": "Point", "crs": None}
    with WriterPool(1) as writer_pool:
        with pytest.raises(OSError, match="ended with code"):
            writer_pool.write(table.schema, rows(), options)
        assert writer_pool._busy == set()


def test_processes_end_with_the_one_that_started_them(tmp_path: Path) -> None:
    code = (
        "import sys; from geomesh.io.gdal_process import WriterPool; s = WriterPool(1); s.warm();"
        "print(s._idle[0].pid, flush=True); import os; os._exit(0)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    folder = Path("/proc") / done.stdout.strip()
    if sys.platform == "linux":
        for _ in range(100):
            if not folder.exists() or "zombie" in (folder / "status").read_text():
                break
            time.sleep(0.1)
        else:
            pytest.fail("it still runs")


def test_modules_in_the_working_folder_are_not_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "pyogrio.py").write_text("raise SystemExit(7)")
    (tmp_path / "json.py").write_text("raise SystemExit(7)")
    monkeypatch.chdir(tmp_path)
    with WriterPool(1) as writer_pool:
        write(random_mesh(), tmp_path / "mesh.gpkg", writer_pool)
    assert read_mesh(tmp_path / "mesh.gpkg").certify().passed


def test_the_program_is_found_wherever_the_package_lies(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Only the process that starts it searches that path, for example its working folder."""
    folder = tmp_path / "it's here"
    folder.mkdir()
    (folder / "elsewhere.py").write_text("def main(): print('found', flush=True)")
    monkeypatch.setattr(processes, "_FOLDER", str(folder))
    process = Process("elsewhere", quiet=True)
    assert process.answers.readline().split() == [b"found"]
    process.end()
    assert Path(geomesh.__file__).is_relative_to(FOLDER)
