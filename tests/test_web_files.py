"""Smaller files for the web: fewer decimals, chosen columns, compressed GeoJSON."""

from __future__ import annotations

import gzip
import json
import re
import shutil
import subprocess
from dataclasses import replace
from decimal import Decimal
from typing import TYPE_CHECKING

import geopandas as gpd
import numpy as np
import pyarrow.parquet as pq
import pytest
import shapely
from pyproj import Transformer

import geomesh
from benchmarks import sizes
from geomesh.errors import GeomeshWarning, OutputError
from geomesh.formats.format import MOST_DECIMALS
from geomesh.formats.registry import DRIVERS, EXTENSIONS, find_format
from geomesh.mesh.topology import edge_keys
from support.files import hidden, mounted, read_layer
from support.meshes import GEOREFERENCES, frame_mesh, random_mesh, two_triangles
from support.samples import OLINDA, ROOT
from support.terrain import small_tin

if TYPE_CHECKING:
    from pathlib import Path

    from geomesh import Mesh
    from support.commands import Geomesh

GRID = GEOREFERENCES["north-up"]
_NUMBER = re.compile(r"-?\d[\d.e-]*")


def coordinates_of(path: Path) -> list[str]:
    """Return the texts of the coordinates, of every feature."""
    lines = [line for line in path.read_text().splitlines() if '"type": "Feature"' in line]
    return ["".join(line.partition('"coordinates":')[2:]) for line in lines]


def most_decimals(text: str) -> int:
    exponents = (Decimal(found).as_tuple().exponent for found in _NUMBER.findall(text))
    return max(-exponent for exponent in exponents if isinstance(exponent, int))


# Precision


@pytest.mark.parametrize("precision", [4, 5, 7, 9, 12, 13])
def test_coordinates_have_so_many_decimals_and_are_the_nearest(
    tmp_path: Path, precision: int
) -> None:
    mesh = frame_mesh(GRID)
    path = mesh.to_file(tmp_path / "mesh.geojson", precision=precision)
    assert max(map(most_decimals, coordinates_of(path))) == precision
    to_lonlat = Transformer.from_crs(mesh.grid.crs, 4326, always_xy=True)
    expected = np.column_stack(to_lonlat.transform(*mesh.map_nodes.T)).round(precision)
    found = read_layer(path).geometry.values
    order = mesh.triangles[:, [0, 1, 2, 0]]
    assert shapely.equals(found, shapely.polygons(expected[order])).all()
    assert shapely.is_ccw(shapely.get_exterior_ring(found)).all()


def test_without_precision_nothing_changes(tmp_path: Path) -> None:
    plain = random_mesh().to_file(tmp_path / "plain.geojson")
    assert max(map(most_decimals, coordinates_of(plain))) == 7
    assert "options" not in json.loads(plain.read_text())["geomesh"]


@pytest.mark.parametrize(
    ("place", "precision"),
    [
        *((place, k) for place in ("north-up", "rotated", "flipped", "custom CRS") for k in (0, 3)),
        *(("north-up", k) for k in (1, 2, 4)),
        *(("geographic", k) for k in (0, 1, 2)),
    ],
)
def test_triangles_that_would_collapse_get_more_decimals(
    tmp_path: Path, place: str, precision: int
) -> None:
    # 500 m wide: with 3 decimals, most of its 400 triangles would be flat or turned over.
    mesh = random_mesh(GEOREFERENCES[place])
    path = tmp_path / "mesh.geojson"
    with pytest.warns(GeomeshWarning, match=f"`precision={precision}`, ") as caught:
        mesh.to_file(path, precision=precision)
    (told,) = [str(each.message) for each in caught if "precision" in str(each.message)]
    more, count, most = map(int, re.findall(r"(?<![=\d])\d+", told))
    found = read_layer(path).geometry.values
    assert shapely.is_valid(found).all()
    assert shapely.is_ccw(shapely.get_exterior_ring(found)).all()
    # Still one coverage: nothing overlaps, and each inner edge is in two triangles.
    assert shapely.coverage_is_valid(found)
    places = shapely.get_coordinates(found).reshape(-1, 4, 2)[:, :3]
    nodes, at = np.unique(places.reshape(-1, 2), axis=0, return_inverse=True)
    assert len(nodes) == len(mesh.nodes) == count
    sides = at.reshape(-1, 3)[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
    assert len(np.unique(edge_keys(sides))) == len(mesh.edges.nodes)
    assert (nodes != nodes.round(precision)).any(axis=1).sum() <= more
    text = " ".join(coordinates_of(path))
    assert most_decimals(text) == most > precision
    # None has more than it needs: the default is 7.
    assert most <= 7


def test_each_layer_has_the_same_nodes(tmp_path: Path) -> None:
    mesh = random_mesh()
    found = {}
    for layer in ("triangles", "edges", "nodes"):
        path = tmp_path / f"{layer}.geojson"
        with pytest.warns(GeomeshWarning, match="precision"):
            mesh.to_file(path, layers=[layer], precision=3)
        found[layer] = np.unique(
            shapely.get_coordinates(read_layer(path, layer).geometry.values), axis=0
        )
    assert (found["triangles"] == found["nodes"]).all()
    assert (found["edges"] == found["nodes"]).all()


@pytest.mark.parametrize("precision", [-1, MOST_DECIMALS + 1, 2.5])
def test_other_numbers_of_decimals_are_refused(tmp_path: Path, precision: float) -> None:
    with pytest.raises(OutputError, match=r"`precision` is .*: choose .* from 0 to 13$"):
        random_mesh().to_file(tmp_path / "mesh.geojson", precision=precision)


@pytest.mark.parametrize("name", [f"mesh{each}" for each in EXTENSIONS if "json" not in each])
def test_precision_is_for_geojson(tmp_path: Path, name: str) -> None:
    with pytest.raises(OutputError, match=r"^`precision` is for \.geojson, not for .*mesh\."):
        random_mesh().to_file(tmp_path / name, precision=5)
    assert list(tmp_path.iterdir()) == []


# Columns


@pytest.mark.parametrize("extension", [".geojson", ".geojson.gz", ".fgb", ".parquet"])
@pytest.mark.parametrize("columns", [("color", "area"), ("id",), ()])
def test_only_the_chosen_columns_are_written(
    tmp_path: Path, extension: str, columns: tuple[str, ...]
) -> None:
    mesh = frame_mesh(GRID)
    path = mesh.to_file(tmp_path / f"mesh{extension}", columns=columns)
    if extension == ".parquet":
        frame = gpd.read_parquet(path)
        assert pq.read_schema(path).names == [*columns, "geometry", "bbox"]
    else:
        frame = gpd.read_file(f"/vsigzip/{path}" if extension.endswith(".gz") else path)
    assert [name for name in frame.columns if name not in ("geometry", "bbox")] == list(columns)
    assert len(frame) == len(mesh.triangles)
    file_format = find_format(path)
    assert file_format.count_rows(path, "triangles") == len(mesh.triangles)
    document = json.loads(file_format.read_document(path))
    assert document["options"] == {"columns": list(columns)}
    if "area" in columns:
        # FlatGeobuf sorts rows by place.
        expected = np.sort(mesh.attributes("triangles")["area"])
        np.testing.assert_allclose(np.sort(frame["area"]), expected, rtol=5e-7)
        assert set(frame["color"]) == {"#102030"}


def test_columns_are_those_of_the_layer(tmp_path: Path) -> None:
    mesh = frame_mesh(GRID)
    path = mesh.to_file(tmp_path / "nodes.geojson", layers="nodes", columns="kind")
    assert list(gpd.read_file(path).columns) == ["kind", "geometry"]
    with pytest.raises(
        OutputError, match=r"^the nodes have no column 'area': choose `columns` from id, kind, col"
    ):
        mesh.to_file(tmp_path / "more.geojson", layers="nodes", columns=["area"])
    assert [entry.name for entry in tmp_path.iterdir()] == ["nodes.geojson"]


def test_a_name_may_have_a_comma_and_a_long_list_is_cut(tmp_path: Path) -> None:
    mesh = frame_mesh(GRID)
    table = mesh.triangle_table.with_columns({"a, b": np.arange(len(mesh.triangles))})
    wide = table.with_columns({f"x{k}": np.arange(table.length) for k in range(100)})
    path = replace(mesh, triangle_table=wide).to_file(tmp_path / "mesh.gpkg")
    read = geomesh.read_mesh(path)
    found = read.to_file(tmp_path / "mesh.fgb", columns=["a, b"])
    assert list(gpd.read_file(found).columns) == ["a, b", "geometry"]
    with pytest.raises(OutputError, match=r"x0, .*, and \d+ more$"):
        read.to_file(tmp_path / "more.fgb", columns=["a"])


def test_a_geopackage_keeps_all_columns(tmp_path: Path) -> None:
    with pytest.raises(
        OutputError, match=r"^`columns` is for \.geojson, \.fgb and \.parquet, not for .*\.gpkg$"
    ):
        random_mesh().to_file(tmp_path / "mesh.gpkg", columns=["id"])


# Compressed


def test_a_compressed_file_has_the_content_of_the_plain_one(tmp_path: Path) -> None:
    mesh = frame_mesh(GRID)
    plain = mesh.to_file(tmp_path / "mesh.geojson").read_bytes()
    for name in ("mesh.geojson.gz", "MESH.JSON.GZ"):
        path = mesh.to_file(tmp_path / name)
        assert gzip.decompress(path.read_bytes()) == plain
        assert path.stat().st_size < len(plain) / 2
    named = mesh.to_file(tmp_path / "other.gz", driver="GeoJSON")
    assert gzip.decompress(named.read_bytes()) == plain


def test_compressed_bytes_are_the_same_again(tmp_path: Path) -> None:
    mesh = random_mesh(count=5000)
    one, other = (mesh.to_file(tmp_path / f"{k}.geojson.gz").read_bytes() for k in range(2))
    assert one == other
    assert one[4:8] == bytes(4)  # no time (RFC 1952, section 2.3)


def test_other_programs_read_it(tmp_path: Path) -> None:
    mesh = frame_mesh(GRID)
    path = mesh.to_file(tmp_path / "mesh.geojson.gz", precision=5, columns=["id", "color"])
    with gzip.open(path, "rt") as file:
        collection = json.load(file)
    assert len(collection["features"]) == len(mesh.triangles)
    assert collection["geomesh"]["options"] == {"columns": ["id", "color"], "precision": 5}
    with gzip.open(path) as file:
        frame = gpd.read_file(file)
    for row, feature in zip(frame.itertuples(), collection["features"], strict=True):
        assert feature["properties"] == {"id": row.id, "color": row.color}
        assert shapely.geometry.mapping(row.geometry)["coordinates"][0] == tuple(
            map(tuple, feature["geometry"]["coordinates"][0])
        )


@pytest.mark.skipif(shutil.which("ogr2ogr") is None, reason="needs GDAL's programs")
def test_ogr2ogr_reads_it(tmp_path: Path) -> None:
    mesh = frame_mesh(GRID)
    path = mesh.to_file(tmp_path / "mesh.geojson.gz", columns=["color", "area"])
    target = tmp_path / "found.gpkg"
    subprocess.run(["ogr2ogr", target, f"/vsigzip/{path}"], check=True, capture_output=True)
    frame = gpd.read_file(target)
    assert [*frame.columns] == ["color", "area", "geometry"]
    assert frame.crs == "EPSG:4326"
    assert shapely.equals(
        frame.geometry.values, gpd.read_file(f"/vsigzip/{path}").geometry.values
    ).all()


def test_a_damaged_file_is_noticed(tmp_path: Path) -> None:
    mesh = random_mesh(count=2000)
    path = mesh.to_file(tmp_path / "mesh.geojson.gz")
    count_rows = find_format(path).count_rows
    assert count_rows(path, "triangles") == len(mesh.triangles)
    whole = path.read_bytes()
    turned = whole[: len(whole) // 2] + bytes([whole[len(whole) // 2] ^ 1])
    for damaged in (
        whole[: len(whole) // 2],
        whole[:-3],
        turned + whole[len(turned) :],
        whole[:-8] + bytes(8),
    ):
        path.write_bytes(damaged)
        with pytest.raises(OSError, match=r"damaged|CRC|length"):
            count_rows(path, "triangles")


def test_a_full_disk_leaves_the_old_file(tmp_path: Path) -> None:
    folder = tmp_path / "disk"
    folder.mkdir()
    with mounted(folder, "256k") as done:
        if not done:
            pytest.skip("only a superuser may mount")
        path = two_triangles().to_file(folder / "mesh.geojson.gz")
        before = path.read_bytes()
        with pytest.raises(OutputError, match=r"could not be written: .*; free some space"):
            random_mesh(count=20_000).to_file(path, overwrite=True)
        assert path.read_bytes() == before
        assert hidden(folder) == []


# The command


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("made") / "mesh.gpkg"
    return geomesh.mesh_raster(OLINDA, nodes=300).to_file(path)


def test_the_command_writes_what_the_library_writes(
    made: Path, tmp_path: Path, command: Geomesh
) -> None:
    options = ("--precision", "5", "--columns", "color, area")
    assert command("convert", made, "-o", tmp_path / "web.geojson.gz", *options).code == 0
    mesh: Mesh = geomesh.read_mesh(made)
    library = mesh.to_file(tmp_path / "lib.geojson.gz", precision=5, columns=["color", "area"])
    assert (tmp_path / "web.geojson.gz").read_bytes() == library.read_bytes()
    frame = gpd.read_file(f"/vsigzip/{library}")
    assert [*frame.columns] == ["color", "area", "geometry"]


def test_the_command_tells_of_decimals_and_columns(
    made: Path, tmp_path: Path, command: Geomesh
) -> None:
    told = command("convert", made, "-o", tmp_path / "a.geojson", "--precision", "2")
    assert told.code == 0
    (warning,) = told.warnings()
    assert "with --precision 2, " in warning
    none = command("convert", made, "-o", tmp_path / "b.geojson", "--columns", "none")
    assert none.code == 0
    features = json.loads((tmp_path / "b.geojson").read_text())["features"]
    assert all(feature["properties"] == {} for feature in features)
    error = command("convert", made, "-o", tmp_path / "c.fgb", "--columns", "colour").error()
    assert "the triangles have no column 'colour': choose --columns from id, n0, n1" in error
    assert command("convert", made, "-o", tmp_path / "c.fgb", "--columns", ",").code == 2
    assert command("convert", made, "-o", tmp_path / "c.json", "--precision", "14").code == 2


def test_a_column_that_will_not_be_is_refused_before_the_work(
    tmp_path: Path, command: Geomesh, monkeypatch: pytest.MonkeyPatch
) -> None:
    from geomesh.pipeline import mesh_file

    monkeypatch.setattr(mesh_file, "mesh_scene", lambda *_, **__: pytest.fail("it was worked on"))
    output = tmp_path / "web.geojson"
    error = command("mesh", OLINDA, "-o", output, "--columns", "b1_mean").error()
    assert "the triangles have no column 'b1_mean': choose --columns from id, " in error
    assert "red_mean, red_std" in error


def test_a_compressed_file_can_be_skipped_if_it_has_the_same_options(
    tmp_path: Path, command: Geomesh
) -> None:
    output = tmp_path / "web.geojson.gz"
    how = ("mesh", OLINDA, "-o", output, "--nodes", "300", "--skip-existing", "--precision", "5")
    assert command(*how, "--columns", "color").code == 0
    assert ", skipped" in command(*how, "--columns", "color").out
    assert "exists, but was written with other options" in command(*how).error()


def test_several_rasters_need_a_folder(tmp_path: Path, command: Geomesh) -> None:
    output = tmp_path / "web.geojson.gz"
    error = command("mesh", OLINDA, OLINDA, "-o", output).error()
    assert "is the name of one file; for several rasters give a folder" in error


def test_contours_can_be_compressed(tmp_path: Path, command: Geomesh) -> None:
    tin = small_tin().to_file(tmp_path / "tin.gpkg")
    plain, packed = tmp_path / "lines.geojson", tmp_path / "lines.geojson.gz"
    for path in (plain, packed):
        assert command("contours", tin, "-o", path, "--interval", "500").code == 0
    assert gzip.decompress(packed.read_bytes()) == plain.read_bytes()


@pytest.mark.slow
def test_the_sizes_in_the_documents_are_measured() -> None:
    text = (ROOT / "docs" / "formats.md").read_text().split("\n## Sizes\n")[1].split("\n## ")[0]
    rows = re.findall(r"^\| ([\w]+) \| `?(.*?)`? \| (\d+) \| (\d+) \|$", text, re.MULTILINE)
    told = {(name, how): (int(plain), int(packed)) for name, how, plain, packed in rows}
    mesh = sizes.sample_mesh()
    assert f"{len(mesh.triangles):,} triangles and one band" in text
    assert f"{len(mesh.attributes('triangles'))} attributes" in text
    found = {(size.name, size.how): (size.plain, size.packed) for size in sizes.measure(mesh)}
    assert told.keys() == found.keys()
    assert {name for name, _ in told} == set(DRIVERS)
    for key, measured in found.items():
        # Versions of the libraries differ by a little.
        assert told[key] == pytest.approx(measured, rel=0.03, abs=1), key
