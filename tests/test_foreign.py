"""Mesh files that another program changed: read as before, or refused in one line."""

from __future__ import annotations

import shutil
import sqlite3
import subprocess
import warnings
from contextlib import closing
from typing import TYPE_CHECKING, Any

import geopandas as gpd
import numpy as np
import pandas as pd
import pyogrio
import pytest
import rasterio
import shapely

from geomesh.errors import GeomeshWarning, MeshFileError
from geomesh.io.read import read_mesh
from geomesh.io.write import write_mesh
from support.files import assert_same, read_layer
from support.meshes import random_mesh

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from support.commands import Geomesh

BOX = gpd.GeoSeries([shapely.box(0, 0, 1, 1)], crs=32633)


def execute(path: Path, *statements: str) -> None:
    """Run SQL without the triggers, which need functions of GDAL."""
    with closing(sqlite3.connect(path)) as database:
        triggers = "SELECT name FROM sqlite_master WHERE type = 'trigger'"
        for (name,) in database.execute(triggers).fetchall():
            database.execute(f'DROP TRIGGER "{name}"')
        for statement in statements:
            database.execute(statement)
        database.commit()


def add_raster(path: Path) -> None:
    size = {"width": 8, "height": 8, "count": 1, "dtype": "uint8", "crs": "EPSG:3857"}
    options = {"append_subdataset": "YES", "raster_table": "a_picture"}
    transform = rasterio.transform.from_origin(0, 8, 1, 1)
    with rasterio.open(path, "w", driver="GPKG", transform=transform, **size, **options) as dataset:
        dataset.write(np.ones((1, 8, 8), np.uint8))


# What other programs add to a GeoPackage, without a change of the mesh.
ADDED: dict[str, Callable[[Path], Any]] = {
    "layer": lambda path: BOX.to_file(path, layer="aoi", mode="a"),
    "layer listed last": lambda path: BOX.to_file(path, layer="zones", mode="a"),
    "table": lambda path: pyogrio.write_dataframe(pd.DataFrame({"a": [1]}), path, layer="a_table"),
    "styles of QGIS": lambda path: execute(
        path, "CREATE TABLE layer_styles (id INTEGER PRIMARY KEY, f_table_name TEXT, styleQML TEXT)"
    ),
    "raster": add_raster,
    "index": lambda path: execute(path, "CREATE INDEX by_id ON triangles (id)"),
    "vacuum": lambda path: execute(path, "PRAGMA user_version = 10300"),
}


@pytest.mark.parametrize("add", ADDED.values(), ids=ADDED)
def test_what_others_add_changes_nothing(
    tmp_path: Path, add: Callable[[Path], Any], command: Geomesh
) -> None:
    mesh, path = random_mesh(), tmp_path / "mesh.gpkg"
    write_mesh(mesh, path)
    add(path)
    assert_same(read_mesh(path), mesh)
    quality = command("quality", path, "-o", tmp_path / "measured.gpkg")
    assert (quality.code, quality.err) == (0, "")
    info = command("info", path)
    assert (info.code, info.out.splitlines()[0]) == (0, f"mesh: {path}")
    converted = command("convert", path, "-o", tmp_path / "mesh.parquet")
    assert (converted.code, converted.err) == (0, "")
    assert len(read_layer(tmp_path / "mesh.parquet")) == len(mesh.triangles)


@pytest.mark.skipif(shutil.which("ogr2ogr") is None, reason="ogr2ogr is not installed")
def test_a_copy_by_ogr2ogr_is_a_mesh_and_a_part_or_another_crs_is_not(tmp_path: Path) -> None:
    mesh, path = random_mesh(), tmp_path / "mesh.gpkg"
    write_mesh(mesh, path)

    def copied(*options: str) -> Path:
        copy = tmp_path / "copy.gpkg"
        copy.unlink(missing_ok=True)
        subprocess.run(["ogr2ogr", "-f", "GPKG", copy, path, *options], check=True)
        return copy

    assert_same(read_mesh(copied()), mesh)
    with pytest.raises(MeshFileError, match="rows were removed or added; use the file"):
        read_mesh(copied("-where", "id < 9"))
    with pytest.raises(MeshFileError, match="moved or reprojected them; use the file"):
        read_mesh(copied("-t_srs", "EPSG:4326"))


@pytest.mark.parametrize("offset", [1e-3, -1e6])
def test_moved_nodes_are_refused(tmp_path: Path, offset: float) -> None:
    path = write_mesh(random_mesh(), tmp_path / "mesh.gpkg")
    nodes = gpd.read_file(path, layer="nodes")
    nodes.loc[7, "geometry"] = shapely.affinity.translate(nodes.geometry[7], offset)
    kept = pyogrio.read_info(path, layer="nodes")["layer_metadata"]
    pyogrio.write_dataframe(nodes, path, layer="nodes", layer_metadata=kept)
    with pytest.raises(MeshFileError, match="not where geomesh put them"):
        read_mesh(path)


COLUMNS = {
    "text": ("TEXT", "'é ' || id"),
    "empty": ("TEXT", "''"),
    "whole": ("INTEGER", "id + 9007199254740993"),
    "short": ("SMALLINT", "id"),
    "real": ("REAL", "id * 0.5"),
    "truth": ("BOOLEAN", "id % 2"),
    "day": ("DATE", "'2020-02-29'"),
    "time": ("DATETIME", "'2020-02-29T12:13:14.567Z'"),
    "absent": ("TEXT", "NULL"),
}


@pytest.mark.parametrize("some", [True, False], ids=["with nulls", "complete"])
def test_columns_that_others_added_stay(tmp_path: Path, some: bool) -> None:
    mesh, path = random_mesh(), tmp_path / "mesh.gpkg"
    write_mesh(mesh, path)
    where = "WHERE id % 3 != 1" if some else ""
    execute(
        path,
        *(
            statement
            for layer in ("nodes", "triangles")
            for name, (kind, value) in COLUMNS.items()
            for statement in (
                f"ALTER TABLE {layer} ADD COLUMN {name} {kind}",
                f"UPDATE {layer} SET {name} = {value} {where}",
            )
        ),
    )
    found = read_mesh(path)
    again = read_mesh(write_mesh(found, tmp_path / "again.gpkg"))
    assert_same(again, found)
    for layer, table, old in (
        ("nodes", found.node_table, mesh.node_table),
        ("triangles", found.triangle_table, mesh.triangle_table),
    ):
        assert list(table) == [*old, *COLUMNS]
        expected = read_layer(path, layer)
        expected["time"] = expected["time"].dt.tz_localize(None)  # both in UTC
        for name in COLUMNS:
            wanted = expected[name].astype(object).where(expected[name].notna(), None)
            values = pd.Series(table[name]).astype(object)
            values = values.where(values.notna(), None)
            pd.testing.assert_series_equal(values, wanted, check_names=False, check_dtype=False)
    ids = np.arange(len(mesh.triangles)) + 9007199254740993
    kept = np.arange(len(ids)) % 3 != 1 if some else np.ones(len(ids), bool)
    assert found.triangle_table["whole"][kept].tolist() == ids[kept].tolist()
    assert found.triangle_table["day"].dtype == "datetime64[D]"
    for extension in (".geojson", ".fgb", ".parquet"):
        written = read_layer(write_mesh(found, tmp_path / f"mesh{extension}"))
        assert written["text"].isna().sum() == (~kept).sum()
        assert written["text"].dropna().tolist() == [f"é {k}" for k in np.flatnonzero(kept)]
    write_mesh(found, tmp_path / "mesh.nc")  # which has numbers only


def test_columns_that_a_mesh_cannot_keep_are_told(tmp_path: Path) -> None:
    mesh, path = random_mesh(), tmp_path / "mesh.gpkg"
    write_mesh(mesh, path)
    execute(
        path,
        "ALTER TABLE triangles ADD COLUMN photo BLOB",
        "UPDATE triangles SET photo = x'00ff'",
        "ALTER TABLE edges ADD COLUMN river TEXT",
    )
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        found = read_mesh(path)
    assert_same(found, mesh)
    told = sorted(str(each.message) for each in caught if each.category is GeomeshWarning)
    assert len(told) == 2
    assert "in its edges that are left out (river): a mesh has no table of edges" in told[0]
    assert "in its triangles that are left out (photo): a mesh can keep numbers" in told[1]


def test_a_layer_replaced_with_more_columns_is_read(tmp_path: Path) -> None:
    """geopandas replaces the layer, whose metadata is lost; that of the others is left."""
    mesh, path = random_mesh(), tmp_path / "mesh.gpkg"
    write_mesh(mesh, path)
    triangles = gpd.read_file(path, layer="triangles")
    triangles["slope"] = np.arange(len(triangles)) / 3
    pyogrio.write_dataframe(triangles, path, layer="triangles")
    found = read_mesh(path)
    assert found.triangle_table["slope"].tolist() == (np.arange(len(triangles)) / 3).tolist()
    assert found.certify() == mesh.certify()
