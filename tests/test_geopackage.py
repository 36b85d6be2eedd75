"""A GeoPackage that is joined from a file for each layer is the same as one written by GDAL."""

from __future__ import annotations

import shutil
import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyogrio
import pytest
import shapely

import geomesh
from geomesh.formats import geopackage, registry
from geomesh.formats.format import PENDING
from geomesh.formats.geopackage import FORMAT as GPKG
from geomesh.io.gdal_process import WriterPool
from geomesh.io.write import open_writer
from support.files import contents
from support.samples import OLINDA

if TYPE_CHECKING:
    from collections.abc import Iterator

LAYERS = ("triangles", "edges", "nodes")


@pytest.fixture(scope="module")
def mesh() -> geomesh.Mesh:
    return geomesh.mesh_raster(OLINDA, nodes=900)


def write(mesh: geomesh.Mesh, path: Path, count: int, layers: Any = LAYERS) -> Path:
    """Write a mesh as the command does: with a writer_pool, and edges first."""
    with (
        WriterPool(count) as writer_pool,
        open_writer(path, layers=layers, writer_pool=writer_pool) as writer,
    ):
        writer.begin(mesh)
        writer.finish(mesh, lambda _fraction, _message: None)
    return path


@pytest.fixture(scope="module")
def joined(mesh: geomesh.Mesh, tmp_path_factory: pytest.TempPathFactory) -> Path:
    assert GPKG.joining.is_possible()
    return write(mesh, tmp_path_factory.mktemp("joined") / "mesh.gpkg", 3)


@pytest.fixture(scope="module")
def plain(mesh: geomesh.Mesh, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The file that GDAL alone writes, layer after layer."""
    return mesh.to_file(tmp_path_factory.mktemp("plain") / "mesh.gpkg")


def rows(path: Path, query: str) -> list[Any]:
    with closing(sqlite3.connect(path)) as database:
        return database.execute(query).fetchall()


def test_rows_and_metadata_are_the_same(joined: Path, plain: Path) -> None:
    assert contents(joined) == contents(plain)
    assert PENDING not in str(rows(joined, "SELECT metadata FROM gpkg_metadata"))
    first, second = (geomesh.read_mesh(path) for path in (joined, plain))
    assert first.metadata == second.metadata
    np.testing.assert_array_equal(first.nodes, second.nodes)


def test_tables_indexes_and_triggers_are_the_same(joined: Path, plain: Path) -> None:
    query = "SELECT type, name, tbl_name, sql FROM sqlite_master ORDER BY type, name"
    assert rows(joined, query) == rows(plain, query)
    triggers = [name for kind, name, *_ in rows(joined, query) if kind == "trigger"]
    assert all(any(layer in name for name in triggers) for layer in LAYERS)


@pytest.mark.parametrize(
    ("table", "columns"),
    [
        ("gpkg_contents", "table_name, data_type, identifier, description, srs_id"),
        ("gpkg_contents", "table_name, min_x, min_y, max_x, max_y"),
        ("gpkg_geometry_columns", "*"),
        ("gpkg_spatial_ref_sys", "*"),
        ("gpkg_extensions", "*"),
        ("gpkg_ogr_contents", "*"),
        ("gpkg_metadata", "*"),
        ("gpkg_metadata_reference", "reference_scope, table_name, md_file_id, md_parent_id"),
        ("sqlite_sequence", "*"),
    ],
)
def test_registers_say_the_same(joined: Path, plain: Path, table: str, columns: str) -> None:
    found = rows(joined, f"SELECT {columns} FROM {table} ORDER BY 1, 2")
    assert found == rows(plain, f"SELECT {columns} FROM {table} ORDER BY 1, 2")
    assert found


@pytest.mark.parametrize("pragma", ["application_id", "user_version", "page_size", "encoding"])
def test_file_is_a_geopackage_of_the_same_kind(joined: Path, plain: Path, pragma: str) -> None:
    assert rows(joined, f"PRAGMA {pragma}") == rows(plain, f"PRAGMA {pragma}")


def test_file_is_sound(joined: Path) -> None:
    assert rows(joined, "PRAGMA integrity_check") == [("ok",)]
    assert rows(joined, "PRAGMA foreign_key_check") == []
    for layer in LAYERS:
        assert rows(joined, f"SELECT rtreecheck('rtree_{layer}_geom')") == [("ok",)]


@pytest.mark.parametrize("layer", LAYERS)
def test_index_finds_what_a_look_at_all_finds(joined: Path, layer: str) -> None:
    _, ids, shapes, _ = pyogrio.raw.read(joined, layer=layer, return_fids=True, columns=[])
    boxes = shapely.bounds(shapely.from_wkb(shapes))
    west, south, east, north = shapely.total_bounds(shapely.from_wkb(shapes))
    part = tuple(
        float(number)
        for number in (
            west + 0.30 * (east - west),
            south + 0.45 * (north - south),
            west + 0.42 * (east - west),
            south + 0.50 * (north - south),
        )
    )
    apart = (
        (boxes[:, 0] > part[2])
        | (boxes[:, 2] < part[0])
        | (boxes[:, 1] > part[3])
        | (boxes[:, 3] < part[1])
    )
    expected = set(ids[~apart])
    assert 0 < len(expected) < len(ids) / 4
    # This is how QGIS searches. The index contains float32 values, rounded outwards.
    query = (
        f"SELECT id FROM rtree_{layer}_geom WHERE maxx >= {part[0]!r} AND minx <= {part[2]!r} "
        f"AND maxy >= {part[1]!r} AND miny <= {part[3]!r}"
    )
    found = {number for (number,) in rows(joined, query)}
    assert expected <= found
    assert len(found) <= len(expected) + 20
    # GDAL also compares the geometries.
    _, met, *_ = pyogrio.raw.read(joined, layer=layer, bbox=part, return_fids=True, columns=[])
    touching = shapely.intersects(shapely.from_wkb(shapes), shapely.box(*part))
    assert set(met) == set(ids[touching])


@pytest.fixture
def opened(joined: Path, tmp_path: Path) -> Iterator[sqlite3.Connection]:
    """A copy to change. The triggers use functions that GDAL and QGIS add to SQLite."""
    path = Path(shutil.copy(joined, tmp_path / "copy.gpkg"))
    with closing(sqlite3.connect(path)) as database:

        def bound(position: int) -> Any:
            def of(blob: bytes) -> float:
                envelope = (0, 32, 48, 48, 64)[(blob[3] >> 1) & 7]
                return float(shapely.bounds(shapely.from_wkb(blob[8 + envelope :]))[position])

            return of

        for position, name in enumerate(("MinX", "MinY", "MaxX", "MaxY")):
            database.create_function(f"ST_{name}", 1, bound(position), deterministic=True)
        database.create_function("ST_IsEmpty", 1, lambda _blob: 0, deterministic=True)
        yield database


@pytest.mark.parametrize("layer", LAYERS)
def test_triggers_keep_index_and_count(opened: sqlite3.Connection, layer: str) -> None:
    def state() -> tuple[int, int]:
        (indexed,) = opened.execute(f"SELECT count(*) FROM rtree_{layer}_geom").fetchone()
        (counted,) = opened.execute(
            "SELECT feature_count FROM gpkg_ogr_contents WHERE table_name = ?", (layer,)
        ).fetchone()
        return indexed, counted

    before = state()
    (key,) = opened.execute(f"SELECT name FROM pragma_table_info('{layer}') WHERE pk").fetchone()
    opened.execute(f"DELETE FROM {layer} WHERE {key} IN (SELECT {key} FROM {layer} LIMIT 3)")
    assert state() == tuple(number - 3 for number in before)
    opened.execute(f"INSERT INTO {layer} (geom) SELECT geom FROM {layer} LIMIT 1")
    assert state() == tuple(number - 2 for number in before)
    assert opened.execute(f"SELECT rtreecheck('rtree_{layer}_geom')").fetchone() == ("ok",)


@pytest.mark.parametrize("layer", LAYERS)
def test_gdal_adds_rows(joined: Path, tmp_path: Path, layer: str) -> None:
    path = Path(shutil.copy(joined, tmp_path / "copy.gpkg"))
    some = pyogrio.read_dataframe(path, layer=layer, max_features=2)
    count = pyogrio.read_info(path, layer=layer)["features"]
    pyogrio.write_dataframe(some, path, layer=layer, append=True)
    assert pyogrio.read_info(path, layer=layer)["features"] == count + 2
    assert rows(path, f"SELECT count(*) FROM rtree_{layer}_geom") == [(count + 2,)]


@pytest.mark.slow
@pytest.mark.parametrize("count", [1, 2])
@pytest.mark.parametrize("layers", [LAYERS, ("edges",), ("triangles", "nodes"), ("edges", "nodes")])
def test_any_layers_by_any_number_of_writers_are_the_same(
    mesh: geomesh.Mesh, tmp_path: Path, layers: Any, count: int
) -> None:
    one = mesh.to_file(tmp_path / "one.gpkg", layers=layers)
    other = write(mesh, tmp_path / "other.gpkg", count, layers)
    query = "SELECT type, name, tbl_name, sql FROM sqlite_master ORDER BY type, name"
    assert rows(one, query) == rows(other, query)
    for layer in layers:
        query = f"SELECT * FROM {layer}"
        assert rows(one, query) == rows(other, query)


@pytest.mark.parametrize("count", [1, 2, 3])
def test_layers_are_listed_in_their_order(mesh: geomesh.Mesh, tmp_path: Path, count: int) -> None:
    """Programs open the first layer. This is triangles, although edges were written first."""
    path = write(mesh, tmp_path / "mesh.gpkg", count)
    assert [name for name, _ in pyogrio.list_layers(path)] == list(LAYERS)
    with pytest.warns(UserWarning, match="default"):
        assert pyogrio.read_info(path)["geometry_type"] == "Polygon"


def test_without_r_trees_in_pythons_sqlite_one_file_is_written(
    mesh: geomesh.Mesh, plain: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    joining = replace(GPKG.joining, is_possible=lambda: False)
    monkeypatch.setattr(registry, "FORMATS", (replace(GPKG, joining=joining),))
    monkeypatch.setattr(geopackage, "_copy_layer", None)
    assert contents(write(mesh, tmp_path / "mesh.gpkg", 2)) == contents(plain)
