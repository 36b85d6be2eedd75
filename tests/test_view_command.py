"""The command `geomesh view`."""

from __future__ import annotations

import json

import pytest

import geomesh
from support.samples import OLINDA


@pytest.fixture(scope="module")
def mesh_file(tmp_path_factory):
    path = tmp_path_factory.mktemp("view") / "mesh.gpkg"
    return geomesh.mesh_raster(OLINDA, nodes=200).to_file(path)


def test_a_map_is_written_and_told(command, mesh_file, tmp_path):
    out = tmp_path / "map.html"
    done = command("view", mesh_file, "-o", out, "--embed", OLINDA, "--title", "A & B")
    assert done.code == 0, done
    assert done.err == ""
    size = out.stat().st_size
    count = len(geomesh.read_mesh(mesh_file).triangles)
    told = f"{out}: a map of {count} triangles, {size / 1e6:.2f} MB; open it in a browser"
    assert done.out.strip() == told
    text = out.read_text(encoding="utf-8")
    assert "<title>A &amp; B</title>" in text
    assert f'"name":"{mesh_file.name}"' in text
    assert 'id="image"' in text


def test_the_result_as_json(command, mesh_file, tmp_path):
    out = tmp_path / "map.html"
    options = ("--columns", "none", "--column", "red_std", "--json")
    done = command("view", mesh_file, mesh_file, "-o", out, *options)
    (result,) = json.loads(done.out)["results"]
    assert result["sources"] == [str(mesh_file)] * 2
    assert result["bytes"] == out.stat().st_size
    assert result["triangles"] == 2 * len(geomesh.read_mesh(mesh_file).triangles)
    text = out.read_text(encoding="utf-8")
    assert '"column":"red_std"' in text
    assert "red_min" not in text


def test_what_cannot_be_shown(command, mesh_file, tmp_path):
    old = tmp_path / "map.html"
    old.write_text("old")

    def refusal(*arguments, out="map.html"):
        error = command("view", *arguments, "-o", tmp_path / out, "--overwrite").error()
        assert [path.read_text() for path in tmp_path.iterdir()] == ["old"]
        return error

    missing = tmp_path / "missing.gpkg"
    assert refusal(missing) == f"{missing} does not exist; check the path"
    assert "cannot be read as a GeoPackage" in refusal(__file__)
    assert "not named as a page: name it .html" in refusal(mesh_file, out="map.pdf")
    assert "no column 'nope': choose from id" in refusal(mesh_file, "--columns", "count,nope")
    assert "is not an address of web tiles" in refusal(mesh_file, "--basemap", "osm")
    assert "two meshes and a raster" in refusal(mesh_file, mesh_file, "--embed", OLINDA)
    done = command("view", mesh_file, mesh_file, mesh_file, "-o", tmp_path / "map.html")
    assert done.code == 2
    assert "one or two meshes make a map, not 3" in done.err
    done = command("view", mesh_file, "-o", mesh_file, "--overwrite")
    assert "is the input" in done.error()
