"""`rio geomesh ...`: the same commands inside rasterio's command, with its options for GDAL.

A test in test_packaging.py checks, with the wheel, that rio finds the commands.
"""

from __future__ import annotations

import click
import numpy as np
import pytest
import rasterio.env
from click.testing import CliRunner
from rasterio.rio.main import main_group

import geomesh
from geomesh.cli import cli
from support.samples import OLINDA


@pytest.fixture
def rio(monkeypatch):
    """Run a command of rio in this process; return its standard output and standard error."""
    monkeypatch.setitem(main_group.commands, "geomesh", cli)

    def run(*arguments, code=0):
        result = CliRunner().invoke(main_group, [str(a) for a in arguments], prog_name="rio")
        assert result.exit_code == code, result.output
        return result.stdout, result.stderr

    return run


def test_rio_makes_the_same_mesh(rio, tmp_path):
    stdout, stderr = rio("geomesh", "mesh", OLINDA, "-o", tmp_path / "mesh.gpkg", "--nodes", 300)
    expected = geomesh.mesh_raster(OLINDA, nodes=300)
    count = len(expected.triangles)
    assert stdout.strip().endswith(f"300 nodes, {count} triangles, certified")
    assert stderr == ""
    made = geomesh.read_mesh(tmp_path / "mesh.gpkg")
    assert np.array_equal(made.triangles, expected.triangles)


def test_errors_are_one_line_and_exit_with_1(rio, tmp_path):
    stdout, stderr = rio("geomesh", "mesh", "missing.tif", "-o", tmp_path / "m.gpkg", code=1)
    assert stdout == ""
    assert stderr == "Error: missing.tif: no such file; check the path\n"
    assert list(tmp_path.iterdir()) == []


def test_the_traceback_is_shown_on_demand(rio, tmp_path):
    arguments = ("mesh", "missing.tif", "-o", str(tmp_path / "m.gpkg"))
    result = CliRunner().invoke(main_group, ["geomesh", "--debug", *arguments])
    assert isinstance(result.exception, geomesh.GeomeshError)


def test_usage_names_rio(rio):
    stdout, _ = rio("geomesh", "mesh", "--help")
    assert stdout.startswith("Usage: rio geomesh mesh [OPTIONS] SRC...")
    _, stderr = rio("geomesh", "mesh", code=2)
    assert "Missing" in stderr


def test_the_options_of_rio_reach_gdal_and_end_with_the_command(rio, monkeypatch):
    seen = []

    @click.command()
    def look():
        seen.append(rasterio.env.getenv())

    monkeypatch.setitem(cli.commands, "look", look)
    rio("--aws-no-sign-requests", "geomesh", "look")
    assert seen[0]["AWS_NO_SIGN_REQUEST"] == "YES"
    assert not rasterio.env.hasenv()
    # Without rio, geomesh does not close an Env that its caller has opened.
    with rasterio.Env(GDAL_HTTP_TIMEOUT=7):
        CliRunner().invoke(cli, ["look"], catch_exceptions=False)
    assert seen[1]["GDAL_HTTP_TIMEOUT"] == 7
