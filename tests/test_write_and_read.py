"""Files: geopandas can read every format, and a failed write leaves nothing behind."""

from __future__ import annotations

import errno
import json
import os
import pickle
import signal
import sqlite3
import subprocess
import sys
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import geopandas as gpd
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pyogrio
import pytest
import shapely
from affine import Affine
from pyogrio.errors import DataLayerError
from pyproj import CRS, Transformer

from geomesh.arrays.plain import plain_json
from geomesh.arrays.table import Table
from geomesh.errors import CertificateError, GeoreferenceError, MeshFileError, OutputError
from geomesh.formats import arrow, batch_stream
from geomesh.formats.registry import find_format
from geomesh.io.atomic import writing_to
from geomesh.io.read import read_mesh
from geomesh.io.write import check_output, write_mesh
from geomesh.mesh.provenance import CannyThresholds, PixelCounts
from geomesh.mesh.topology import boundary_edges, edge_keys
from geomesh.parameters import LAYERS
from geomesh.raster.grid import Grid
from support.files import assert_same, hidden, mounted, read_layer
from support.meshes import GEOREFERENCES, lattice_mesh, provenance, random_mesh, two_triangles
from support.rasters import GEOSTATIONARY
from support.samples import SAMPLES

if TYPE_CHECKING:
    from collections.abc import Iterator

    from geomesh import Mesh

NORTH_UP, UTM = GEOREFERENCES["north-up"].transform, GEOREFERENCES["north-up"].crs
EXTENSIONS = (".gpkg", ".geojson", ".fgb", ".parquet")


@pytest.fixture(params=EXTENSIONS)
def extension(request: pytest.FixtureRequest) -> str:
    return str(request.param)


@pytest.fixture(params=GEOREFERENCES)
def any_mesh(request: pytest.FixtureRequest) -> Mesh:
    return random_mesh(GEOREFERENCES[request.param])


def run(code: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=False
    )


# --- content of the files --------------------------------------------------------------


@pytest.mark.parametrize("layer", LAYERS)
def test_attributes_and_rows_are_read_back(
    tmp_path: Path, extension: str, layer: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(batch_stream, "BATCH_ROWS", 64)
    mesh = random_mesh()
    frame = read_layer(write_mesh(mesh, tmp_path / f"mesh{extension}", layers=[layer]), layer)
    expected = mesh.attributes(layer)
    assert [name for name in frame.columns if name not in ("geometry", "bbox")] == list(expected)
    for name, values in expected.items():
        found = frame[name].to_numpy()
        if values.dtype.kind == "f":
            # Numbers in GeoJSON have 7 significant digits.
            tolerance = 5e-7 if extension == ".geojson" else 0
            np.testing.assert_allclose(found, values, rtol=tolerance, err_msg=name)
        else:
            assert found.tolist() == values.tolist(), name


@pytest.mark.parametrize("layer", LAYERS)
def test_geometry_is_exact_on_the_map(tmp_path: Path, any_mesh: Mesh, layer: str) -> None:
    expected = any_mesh.to_geodataframe(layer).geometry.values
    for extension in (".gpkg", ".fgb", ".parquet"):
        frame = read_layer(
            write_mesh(any_mesh, tmp_path / f"mesh{extension}", layers=[layer]), layer
        )
        assert shapely.equals_identical(frame.geometry.values, expected).all()
        if layer == "triangles":
            assert frame.geometry.is_valid.all()
            assert shapely.is_ccw(shapely.get_exterior_ring(frame.geometry.values)).all()


def test_crs_keeps_its_authority_and_none_stays_none(tmp_path: Path) -> None:
    for extension in (".gpkg", ".fgb", ".parquet"):
        for crs in (UTM, CRS("EPSG:4326"), CRS("EPSG:2180"), None):
            mesh = two_triangles(Grid(50, 40, NORTH_UP, crs))
            path = write_mesh(mesh, tmp_path / f"mesh{extension}", overwrite=True)
            frame = read_layer(path)
            assert frame.crs == crs
            if crs is not None:
                assert frame.crs.to_authority() == crs.to_authority()


def test_geojson_is_rfc_7946(tmp_path: Path) -> None:
    mesh = random_mesh(GEOREFERENCES["rotated"])
    path = write_mesh(mesh, tmp_path / "mesh.json")
    document = json.loads(path.read_text())
    assert "crs" not in document
    assert document["geomesh"]["recipe"] == mesh.metadata["recipe"]
    frame = read_layer(path)
    assert frame.crs == "EPSG:4326"
    assert frame.geometry.is_valid.all()
    assert shapely.is_ccw(shapely.get_exterior_ring(frame.geometry.values)).all()
    expected = mesh.to_geodataframe().to_crs("EPSG:4326").geometry.values
    found = frame.geometry.values
    worst = shapely.hausdorff_distance(found, expected).max()
    assert worst < 1e-7
    coordinates = shapely.get_coordinates(found)
    np.testing.assert_array_equal(coordinates, coordinates.round(7))


def test_geojson_keeps_slivers_triangles(tmp_path: Path) -> None:
    # 0.1 mm wide and along a meridian: with 7 decimals, both triangles would become lines.
    mesh = two_triangles(Grid(50, 40, Affine(0.000025, 0, 5e5, 0, -1000, 7e6), UTM))
    frame = read_layer(write_mesh(mesh, tmp_path / "mesh.geojson"))
    assert set(frame.geom_type) == {"Polygon"}
    assert frame.geometry.is_valid.all()
    assert (shapely.area(frame.geometry.values) > 0).all()


def test_geopackage_is_version_1_2_with_spatial_indexes(tmp_path: Path) -> None:
    mesh = random_mesh()
    path = write_mesh(mesh, tmp_path / "mesh.gpkg")
    with closing(sqlite3.connect(path)) as database:
        assert database.execute("PRAGMA user_version").fetchone() == (10_200,)
        assert database.execute("PRAGMA application_id").fetchone() == (0x47504B47,)
        for layer in LAYERS:
            rows = database.execute(f"SELECT count(*) FROM rtree_{layer}_geom").fetchone()
            assert rows == (len(mesh.attributes(layer)["id"]),)
        described = dict(
            database.execute("SELECT table_name, description FROM gpkg_contents").fetchall()
        )
    assert list(pyogrio.list_layers(path)[:, 0]) == list(LAYERS)
    assert described["edges"].startswith("Edges of a mesh of 200 nodes")


def test_metadata_travels_in_every_format(tmp_path: Path, extension: str) -> None:
    mesh = random_mesh()
    path = write_mesh(mesh, tmp_path / f"mesh{extension}", layers=["nodes"])
    if extension == ".parquet":
        text = pq.read_schema(path).metadata[b"geomesh"]
    elif extension == ".geojson":
        text = json.dumps(json.loads(path.read_text())["geomesh"])
    else:
        text = pyogrio.read_info(path, layer="nodes")["layer_metadata"]["geomesh"]
    document = json.loads(text)
    assert document["source"] == mesh.metadata["source"]
    assert document["warnings"] == mesh.metadata["warnings"]
    assert document["certificate"]["passed"] is True
    assert document["mesh"]["counts"]["nodes"] == 200


def test_metadata_is_valid_json_whatever_numbers_it_holds(tmp_path: Path) -> None:
    made = provenance(
        pixels=PixelCounts(np.int64(16), np.int64(16)),
        canny=CannyThresholds(np.float32(0.5), float("inf")),
        window=(np.int64(3), 0, 4, 4),
        nodata=float("nan"),
    )
    path = write_mesh(replace(two_triangles(), provenance=made), tmp_path / "mesh.geojson")
    document = json.loads(path.read_text(), parse_constant=pytest.fail)["geomesh"]
    assert document["pixels"] == {"covered": 16, "counted": 16}
    assert document["canny"] == {"low": 0.5, "high": None}
    assert document["source"]["window"] == [3, 0, 4, 4]
    assert document["source"]["nodata"] == "nan"


def test_plain_values_are_those_of_json() -> None:
    values = {"nodata": float("nan"), "size": np.int64(3), 5: (np.float32(0.5), float("inf"))}
    assert plain_json(values) == {"nodata": None, "size": 3, "5": [0.5, None]}


def test_geoparquet_can_be_read_by_box(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batch_stream, "BATCH_ROWS", 50)
    mesh = random_mesh()
    path = write_mesh(mesh, tmp_path / "mesh.parquet")
    west, south, east, north = mesh.grid.bounds()
    box = (west, south, (west + east) / 2, (south + north) / 2)
    expected = mesh.to_geodataframe()
    boxes = expected.geometry.intersects(shapely.box(*box).envelope)
    found = gpd.read_parquet(path, bbox=box)
    assert 0 < len(found) < len(expected)
    assert set(expected["id"][boxes]) <= set(found["id"])
    geo = json.loads(pq.read_schema(path).metadata[b"geo"])
    assert geo["version"] == "1.1.0"
    column = geo["columns"][geo["primary_column"]]
    np.testing.assert_array_equal(column["bbox"], expected.total_bounds)
    assert pq.read_metadata(path).row_group(0).column(0).compression == "ZSTD"
    missing = np.isnan(mesh.triangle_table["b1_mean"]).sum()
    assert pq.read_table(path)["b1_mean"].null_count == missing


# --- longitude and latitude ------------------------------------------------------------

ASLANT = Affine.rotation(10)
AROUND_THE_WORLD = {
    "179 to 181": lattice_mesh("EPSG:4326", Affine(0.1, 0, 179, 0, -0.1, 20)),
    "-190 to -170": lattice_mesh("EPSG:4326", Affine(1, 0, -190, 0, -1, 20)),
    "0 to 360, pole to pole": lattice_mesh("EPSG:4326", Affine(18, 0, 0, 0, -9, 90)),
    "NAD27": lattice_mesh("EPSG:4267", Affine(0.1, 0, 179.03, 0, -0.1, 60)),
    "Mercator of the Pacific": lattice_mesh("EPSG:3832", Affine(2e4, 0, 3.1e6, 0, -2e4, 2e5)),
    "UTM 1": lattice_mesh("EPSG:32601", Affine(1e4, 0, 2.53e5, 0, -1e4, 7e6)),
    "Robinson of the Pacific": lattice_mesh(
        "+proj=robin +lon_0=150", Affine(1e6, 0, -1e7, 0, -5e5, 5e6)
    ),
    "beside the pole": lattice_mesh("EPSG:3413", ASLANT @ Affine(1e5, 0, -1.05e6, 0, -1e5, 2.55e6)),
    "pole in a node": lattice_mesh("EPSG:3413", ASLANT @ Affine(1e5, 0, -1e6, 0, -1e5, 1e6)),
    "pole in an edge": lattice_mesh("EPSG:3413", ASLANT @ Affine(1e5, 0, -1e6, 0, -1e5, 1.05e6)),
    "pole in a triangle": lattice_mesh("EPSG:3413", Affine(1e5, 0, -1.02e6, 0, -1e5, 1.03e6)),
    "south pole": lattice_mesh("EPSG:3031", Affine(1e5, 0, -1.02e6, 0, -1e5, 1.03e6)),
}


@pytest.mark.parametrize("place", AROUND_THE_WORLD)
def test_geojson_is_cut_at_the_antimeridian(tmp_path: Path, place: str) -> None:
    mesh = AROUND_THE_WORLD[place]
    frame = read_layer(write_mesh(mesh, tmp_path / "mesh.geojson"))
    found = frame.geometry.values
    assert shapely.is_valid(found).all()
    assert set(frame.geom_type) <= {"Polygon", "MultiPolygon"}
    west, south, east, north = frame.total_bounds
    assert (west, east) == (-180, 180)
    assert south >= -90
    assert north <= 90
    # Each triangle contains its own centre, and no two triangles overlap. Centres near a pole are
    # left out: a straight edge on the map is not straight there in longitude and latitude.
    centres = mesh.map_nodes[mesh.triangles].mean(axis=1)
    to_lonlat = Transformer.from_crs(mesh.grid.crs, "OGC:CRS84", always_xy=True)
    lon, lat = to_lonlat.transform(*centres.T)
    near = np.abs(lat) < 88
    lon = (lon + 180) % 360 - 180
    assert shapely.contains_xy(found, lon, lat)[near].all()
    total = shapely.area(found).sum()
    assert shapely.union_all(found).area == pytest.approx(total, rel=1e-9)


def test_whole_world_is_covered_once(tmp_path: Path) -> None:
    mesh = AROUND_THE_WORLD["0 to 360, pole to pole"]
    frame = read_layer(write_mesh(mesh, tmp_path / "mesh.geojson"))
    assert shapely.area(frame.geometry.values).sum() == pytest.approx(360 * 180)


@pytest.mark.parametrize("layer", ["edges", "nodes"])
def test_edges_and_nodes_stay_within_180_degrees(tmp_path: Path, layer: str) -> None:
    mesh = AROUND_THE_WORLD["Mercator of the Pacific"]
    frame = read_layer(write_mesh(mesh, tmp_path / "mesh.geojson", layers=[layer]), layer)
    widths = np.ptp(frame.explode().bounds[["minx", "maxx"]].to_numpy(), axis=1)
    assert widths.max() < 1
    assert np.abs(frame.total_bounds[[0, 2]]).max() <= 180
    assert ("MultiLineString" in set(frame.geom_type)) == (layer == "edges")


def test_triangle_that_spans_the_world_is_no_antimeridian_case(tmp_path: Path) -> None:
    mesh = two_triangles(Grid(4, 4, Affine(89.5, 0, -179, 0, -40, 80), CRS("EPSG:4326")))
    frame = read_layer(write_mesh(mesh, tmp_path / "mesh.geojson"))
    areas = shapely.area(frame.geometry.values)
    assert areas.tolist() == pytest.approx([358 * 160 / 2] * 2)


@pytest.mark.parametrize(
    ("grid", "message"),
    [
        (Grid(50, 40), "no CRS: georeference the raster, or write .gpkg"),
        (GEOREFERENCES["Mars"], "no transformation from 'Mars"),
        (Grid(50, 40, NORTH_UP, CRS('LOCAL_CS["shop floor",UNIT["metre",1]]')), "'shop floor'"),
        (
            Grid(50, 40, Affine(3e5, 0, -7.5e6, 0, -3e5, 6e6), CRS(GEOSTATIONARY)),
            r"of 200 nodes have none: leave them out with `bounds` or `mask`, or write .gpkg",
        ),
        (
            Grid(50, 40, Affine(1, 0, 0, 0, -1, 95), CRS("EPSG:4326")),
            "lie beyond a pole: mesh the raster again with `bounds` 0 55 50 90, or write .gpkg",
        ),
    ],
    ids=["no CRS", "Mars", "local", "geostationary", "beyond the pole"],
)
def test_geojson_refuses_what_has_no_longitude(tmp_path: Path, grid: Grid, message: str) -> None:
    with pytest.raises(GeoreferenceError, match=message) as caught:
        write_mesh(random_mesh(grid), tmp_path / "mesh.geojson")
    assert "\n" not in str(caught.value)
    assert list(tmp_path.iterdir()) == []


# --- read_mesh -------------------------------------------------------------------------


def test_read_mesh_loses_nothing(tmp_path: Path, any_mesh: Mesh) -> None:
    found = read_mesh(write_mesh(any_mesh, tmp_path / "mesh.gpkg"))
    assert_same(found, any_mesh)
    assert found.certify() == any_mesh.certify()


@pytest.mark.parametrize("name", ["north-up", "flipped"])
def test_constraints_are_restored_with_and_without_edges(tmp_path: Path, name: str) -> None:
    mesh = two_triangles(GEOREFERENCES[name])
    for layers in (None, ["nodes", "triangles"]):
        path = write_mesh(mesh, tmp_path / "mesh.gpkg", layers=layers, overwrite=True)
        found = read_mesh(path)
        assert_same(found, mesh)
        assert found.constraints.tolist() == [[0, 1], [0, 3], [1, 2], [2, 3]]
    hull = replace(mesh, domain=replace(mesh.domain, kind="hull"), constraints=[[1, 3]])
    assert_same(read_mesh(write_mesh(hull, tmp_path / "hull.gpkg")), hull)
    path = write_mesh(hull, tmp_path / "none.gpkg", layers=["nodes", "triangles"])
    with pytest.raises(MeshFileError, match="0 of 1 constrained edges"):
        read_mesh(path)


def test_read_mesh_does_not_depend_on_the_order_of_rows(tmp_path: Path) -> None:
    mesh = random_mesh()
    path = write_mesh(mesh, tmp_path / "mesh.gpkg")
    with closing(sqlite3.connect(path)) as database:
        for layer in LAYERS:
            # Remove the triggers: those of the spatial index need functions of GDAL.
            for (trigger,) in database.execute(
                f"SELECT name FROM sqlite_master WHERE type = 'trigger' AND tbl_name = '{layer}'"
            ).fetchall():
                database.execute(f'DROP TRIGGER "{trigger}"')
            database.execute(f"UPDATE {layer} SET fid = -fid")
        database.commit()
    assert read_layer(path)["id"].is_monotonic_increasing  # read_layer() sorts the rows
    assert gpd.read_file(path, layer="triangles")["id"].is_monotonic_decreasing
    assert_same(read_mesh(path), mesh)


def test_read_mesh_tells_what_is_wrong(tmp_path: Path) -> None:
    mesh = two_triangles()
    with pytest.raises(MeshFileError, match="does not exist"):
        read_mesh(tmp_path / "missing.gpkg")
    text = tmp_path / "text.gpkg"
    text.write_text("not a database")
    with pytest.raises(MeshFileError, match="cannot be read as a GeoPackage"):
        read_mesh(text)
    with pytest.raises(MeshFileError, match=r"not a GeoPackage \(GeoJSON\)"):
        read_mesh(write_mesh(mesh, tmp_path / "mesh.geojson"))
    with pytest.raises(MeshFileError, match="no layer nodes"):
        read_mesh(write_mesh(mesh, tmp_path / "part.gpkg", layers=["triangles"]))
    foreign = tmp_path / "foreign.gpkg"
    for layer in ("nodes", "triangles"):
        mesh.to_geodataframe(layer).to_file(foreign, layer=layer)
    with pytest.raises(MeshFileError, match="no metadata of geomesh"):
        read_mesh(foreign)


@pytest.mark.parametrize(
    ("statement", "message"),
    [
        ("DELETE FROM nodes WHERE id = 2", "should have 4 nodes with ids from 0"),
        ("UPDATE triangles SET n0 = NULL WHERE id = 0", "triangles without a value of 'n0'"),
        ("UPDATE triangles SET n0 = 99 WHERE id = 0", "nodes that do not exist"),
        ("ALTER TABLE nodes RENAME COLUMN row TO line", "has no columns row in nodes"),
    ],
)
def test_read_mesh_refuses_an_edited_file(tmp_path: Path, statement: str, message: str) -> None:
    path = write_mesh(two_triangles(), tmp_path / "mesh.gpkg")
    with closing(sqlite3.connect(path)) as database:
        for (trigger,) in database.execute(
            "SELECT name FROM sqlite_master WHERE type = 'trigger'"
        ).fetchall():
            database.execute(f'DROP TRIGGER "{trigger}"')
        database.execute(statement)
        database.commit()
    with pytest.raises(MeshFileError, match=message):
        read_mesh(path)


# --- errors before any work ------------------------------------------------------------


@pytest.mark.parametrize("name", ["mesh.shp", "mesh", "mesh.gpkg.bak"])
def test_unknown_extension_is_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(OutputError, match=r"\.gpkg, \.geojson, \.fgb, \.parquet"):
        write_mesh(two_triangles(), tmp_path / name)
    path = write_mesh(two_triangles(), tmp_path / name, driver="gpkg")
    assert_same(read_mesh(path.rename(tmp_path / "named.gpkg")), two_triangles())


def test_unknown_driver_and_layers_are_refused(tmp_path: Path) -> None:
    mesh = two_triangles()
    path = tmp_path / "mesh.fgb"
    with pytest.raises(OutputError, match="'shape'; choose from GPKG, GeoJSON"):
        write_mesh(mesh, path, driver="shape")
    with pytest.raises(OutputError, match="no layer 'faces'; choose from triangles, edges"):
        write_mesh(mesh, path, layers=["faces"])
    with pytest.raises(OutputError, match="no layer to write"):
        write_mesh(mesh, path, layers=[])
    with pytest.raises(OutputError, match=r"one layer, not triangles, nodes; .* write \.gpkg"):
        write_mesh(mesh, path, layers=["nodes", "triangles"])
    assert list(tmp_path.iterdir()) == []


def test_existing_output_is_kept_without_overwrite(tmp_path: Path, extension: str) -> None:
    path = tmp_path / f"mesh{extension}"
    path.write_text("mine")
    with pytest.raises(OutputError, match=f"mesh{extension} exists; use `overwrite=True`"):
        write_mesh(two_triangles(), path)
    with pytest.raises(OutputError, match="exists"):
        check_output(path)
    assert path.read_text() == "mine"
    write_mesh(two_triangles(), path, overwrite=True)
    assert len(read_layer(path)) == 2
    assert [entry.name for entry in tmp_path.iterdir()] == [path.name]


def test_places_that_cannot_be_written_are_refused(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"folder of .* does not exist; create it"):
        check_output(tmp_path / "missing" / "mesh.gpkg")
    folder = tmp_path / "folder.gpkg"
    folder.mkdir()
    with pytest.raises(OutputError, match="is a folder"):
        check_output(folder, overwrite=True)
    with pytest.raises(OutputError, match="not a regular file"):
        check_output("/dev/null", overwrite=True, driver="GPKG")
    with pytest.raises(OutputError, match="cannot be written: file name too long"):
        check_output(tmp_path / f"{'n' * 300}.gpkg")


def test_unwritable_folder_is_refused(tmp_path: Path) -> None:
    locked = tmp_path / "locked"
    locked.mkdir()
    locked.chmod(0o500)
    # Permission bits do not stop a superuser, but nobody can write to /proc.
    folder = Path("/proc") if os.geteuid() == 0 else locked
    with pytest.raises(OutputError, match=r"cannot be written: .*; choose another folder"):
        check_output(folder / "mesh.gpkg")


@pytest.mark.parametrize(
    ("error", "way_out"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), "free some space or choose another"),
        (OSError(errno.EDQUOT, "Disk quota exceeded"), "free some space or choose another folder"),
        (OSError(errno.EFBIG, "File too large"), "free some space or choose another folder"),
        (OSError(errno.EACCES, "Permission denied"), "denied; choose another folder"),
        (OSError(errno.EROFS, "Read-only file system"), "system; choose another folder"),
        (OSError(errno.ENAMETOOLONG, "File name too long"), "long; give it a shorter name"),
        (OSError(errno.EMFILE, "Too many open files"), "files; allow more open files, as with ul"),
        (OSError("the file has only 2 of 3 rows"), "rows; choose another format"),
        (DataLayerError("database or disk is full"), "full; free some space or choose another"),
        (DataLayerError("Unknown type of field"), "field; choose another format"),
    ],
    ids=str,
)
def test_the_way_out_is_that_of_the_cause(tmp_path: Path, error: Exception, way_out: str) -> None:
    target = tmp_path / "mesh.gpkg"
    with (
        pytest.raises(OutputError, match=f"mesh.gpkg could not be written: .*{way_out}"),
        writing_to(target, "pyogrio", way_out="choose another format"),
    ):
        raise error
    assert list(tmp_path.iterdir()) == []


def test_two_slashes_at_the_start_are_one(tmp_path: Path) -> None:
    """pyogrio would take the first folder for a host."""
    path = write_mesh(random_mesh(), f"/{tmp_path}/mesh.gpkg")
    assert_same(read_mesh(path), random_mesh())


@pytest.mark.parametrize("name", ["two\nlines.gpkg", "tab\t.gpkg", "semi;colon!.gpkg", " a.gpkg"])
def test_odd_names_are_read_as_they_were_written(tmp_path: Path, name: str) -> None:
    assert_same(read_mesh(write_mesh(random_mesh(), tmp_path / name)), random_mesh())


@pytest.mark.skipif(os.name != "posix", reason="names are bytes on POSIX only")
def test_paths_that_pyogrio_cannot_open_are_refused_in_advance(tmp_path: Path) -> None:
    for folder in ("wow!", "two\nlines", "tab\t"):
        (tmp_path / folder).mkdir()
        with pytest.raises(OutputError, match="choose a folder without"):
            check_output(tmp_path / folder / "mesh.gpkg")
    odd = tmp_path / os.fsdecode(b"\xff.gpkg")
    with pytest.raises(OutputError, match="is not valid UTF-8; choose another name"):
        check_output(odd)
    write_mesh(random_mesh(), tmp_path / "mesh.gpkg").rename(odd)
    with pytest.raises(MeshFileError, match="is not valid UTF-8; rename it"):
        read_mesh(odd)


def test_columns_that_a_format_cannot_hold_are_refused(tmp_path: Path) -> None:
    def with_columns(*names: str) -> Mesh:
        table = Table({name: np.zeros(4) for name in names})
        return replace(two_triangles(), node_table=table)

    for mesh, name in ((with_columns("fid"), "fid"), (with_columns("nir", "NIR"), "NIR")):
        with pytest.raises(OutputError, match=f"cannot store the column '{name}' of the nodes"):
            write_mesh(mesh, tmp_path / "mesh.gpkg")
        write_mesh(mesh, tmp_path / f"{name}.parquet", layers=["nodes"])


def test_mesh_without_certificate_is_never_written(tmp_path: Path) -> None:
    mesh = two_triangles()
    wrong = replace(mesh, domain=replace(mesh.domain, area=17.0))
    path = tmp_path / "mesh.gpkg"
    path.write_text("mine")
    with pytest.raises(CertificateError, match="areas add up"):
        write_mesh(wrong, path, overwrite=True)
    assert path.read_text() == "mine"


# --- all or nothing --------------------------------------------------------------------


class StopError(Exception):
    pass


@pytest.mark.parametrize("exception", [StopError, KeyboardInterrupt, BrokenPipeError])
def test_stopping_midway_leaves_the_old_file(
    tmp_path: Path, extension: str, exception: type, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(batch_stream, "BATCH_ROWS", 50)
    path = tmp_path / f"mesh{extension}"
    path.write_text("mine")
    for when in (0.0, 0.5, 1.0):

        def stop(fraction: float, message: str, when: float = when) -> None:
            if fraction >= when:
                raise exception(message)

        with pytest.raises(exception, match="Writ"):
            write_mesh(random_mesh(), path, overwrite=True, progress=stop)
        assert path.read_text() == "mine"
        assert hidden(tmp_path) == []


def test_failure_while_making_a_batch_is_told_as_it_is(
    tmp_path: Path, extension: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(self: arrow.Layer, rows: slice, *names: str, **options: str | None) -> object:
        if rows.start:
            raise MemoryError("no more")
        return whole(self, rows, *names, **options)

    whole = arrow.Layer.batch
    monkeypatch.setattr(batch_stream, "BATCH_ROWS", 50)
    monkeypatch.setattr(arrow.Layer, "batch", fail)
    with pytest.raises(MemoryError, match="no more"):
        write_mesh(random_mesh(), tmp_path / f"mesh{extension}")
    assert list(tmp_path.iterdir()) == []


def test_progress_runs_from_0_to_1(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batch_stream, "BATCH_ROWS", 100)
    told: list[tuple[float, str]] = []
    write_mesh(random_mesh(), tmp_path / "mesh.gpkg", progress=lambda *step: told.append(step))
    fractions = [fraction for fraction, _ in told]
    assert fractions == sorted(fractions)
    assert told[0] == (0.0, "Writing")
    assert any("edges" in message for _, message in told)
    assert told[-1] == (1.0, "Written")
    assert len(told) > 10


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="needs signals")
def test_killed_run_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "mesh.gpkg"
    path.write_text("mine")
    pickled = tmp_path / "mesh.pickle"
    pickled.write_bytes(pickle.dumps(random_mesh()))
    code = """
import os, pickle, signal, sys
from geomesh.formats import batch_stream
from geomesh.io.write import write_mesh
batch_stream.BATCH_ROWS = 50
def stop(fraction, message):
    if fraction > 0.5:
        os.kill(os.getpid(), signal.SIGKILL)
with open(sys.argv[1], "rb") as file:
    mesh = pickle.load(file)
write_mesh(mesh, sys.argv[2], overwrite=True, progress=stop)
"""
    assert run(code, str(pickled), str(path)).returncode == -signal.SIGKILL
    assert path.read_text() == "mine"
    assert write_mesh(random_mesh(), path, overwrite=True) == path
    assert len(read_layer(path)) > 0


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="needs resource limits")
def test_limit_on_file_size_is_told_in_one_line(tmp_path: Path) -> None:
    pickled = tmp_path / "mesh.pickle"
    pickled.write_bytes(pickle.dumps(random_mesh()))
    code = """
import pickle, resource, sys
from geomesh.errors import OutputError
from geomesh.io.write import write_mesh
with open(sys.argv[1], "rb") as file:
    mesh = pickle.load(file)
resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, 30_000))
for path in sys.argv[2:]:
    try:
        write_mesh(mesh, path, overwrite=True)
    except OutputError as error:
        print(error)
"""
    paths = [tmp_path / f"mesh{extension}" for extension in (*EXTENSIONS, ".nc")]
    for path in paths:
        path.write_text("mine")
    done = run(code, str(pickled), *map(str, paths))
    assert done.returncode == 0, done.stderr
    lines = done.stdout.splitlines()
    assert len(lines) == len(paths)
    for path, line in zip(paths, lines, strict=True):
        assert line.startswith(f"{path} could not be written: ")
        assert path.read_text() == "mine"
    assert hidden(tmp_path) == []


@pytest.fixture
def disk(tmp_path: Path) -> Iterator[Path]:
    """A disk of 1 MiB. Only a superuser may mount one."""
    folder = tmp_path / "disk"
    folder.mkdir()
    with mounted(folder, "1m") as done:
        if not done:
            pytest.skip(
                "only a superuser may mount; test_limit_on_file_size_is_told_in_one_line stands in"
            )
        yield folder


@pytest.mark.parametrize("extension", [*EXTENSIONS, ".nc"])
def test_full_disk_leaves_the_old_file(disk: Path, extension: str) -> None:
    path = write_mesh(two_triangles(), disk / f"mesh{extension}")
    before = path.read_bytes()
    with pytest.raises(OutputError, match=r"could not be written: .*; free some space") as caught:
        write_mesh(random_mesh(count=20_000), path, overwrite=True)
    assert "\n" not in str(caught.value)
    assert path.read_bytes() == before
    assert [entry.name for entry in disk.iterdir()] == [path.name]


def test_lost_rows_are_noticed(tmp_path: Path, extension: str) -> None:
    mesh = random_mesh(count=2000)
    path = write_mesh(mesh, tmp_path / f"mesh{extension}", layers=["triangles"])
    count_rows = find_format(path).count_rows
    rows = len(mesh.triangles)
    assert count_rows(path, "triangles") == rows
    whole = path.read_bytes()
    # The last bytes of a database are unused.
    for kept in (len(whole) // 2, len(whole) - (5000 if extension == ".gpkg" else 3)):
        path.write_bytes(whole[:kept])
        try:
            found = count_rows(path, "triangles")
        except Exception:
            continue
        assert found < rows, f"{kept} of {len(whole)} bytes"


def test_journal_of_the_old_database_is_not_replayed_into_the_new_one(tmp_path: Path) -> None:
    path = write_mesh(two_triangles(), tmp_path / "mesh.gpkg")
    with closing(sqlite3.connect(path)) as viewer:
        viewer.execute("PRAGMA journal_mode = WAL")
        viewer.execute("CREATE TABLE notes AS SELECT * FROM triangles")
        viewer.commit()
        assert (tmp_path / "mesh.gpkg-wal").stat().st_size > 0
        mesh = random_mesh()
        write_mesh(mesh, path, overwrite=True)
        assert [entry.name for entry in tmp_path.iterdir()] == ["mesh.gpkg"]
        assert_same(read_mesh(path), mesh)
    assert_same(read_mesh(path), mesh)


def test_journal_stays_if_the_file_cannot_be_replaced(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write_mesh(two_triangles(), tmp_path / "mesh.gpkg")
    journal = tmp_path / "mesh.gpkg-wal"
    journal.write_text("changes")
    move = Path.replace

    def refuse(self: Path, target: Path) -> Path:
        if self.name == "output.gpkg":
            raise PermissionError(13, "in use")
        return move(self, target)

    monkeypatch.setattr(Path, "replace", refuse)
    with pytest.raises(OutputError, match="in use"):
        write_mesh(random_mesh(), path, overwrite=True)
    assert journal.read_text() == "changes"
    assert hidden(tmp_path) == []


def test_file_that_appears_meanwhile_is_kept(tmp_path: Path) -> None:
    path = tmp_path / "mesh.fgb"

    def intrude(fraction: float, message: str) -> None:
        path.write_text("theirs")

    with pytest.raises(OutputError, match="created by another program in the meantime"):
        write_mesh(random_mesh(), path, progress=intrude)
    assert path.read_text() == "theirs"


def test_symbolic_link_stays_a_link(tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()
    link = tmp_path / "mesh.gpkg"
    link.symlink_to(tmp_path / "data" / "real.gpkg")
    write_mesh(two_triangles(), link)
    assert link.is_symlink()
    assert_same(read_mesh(tmp_path / "data" / "real.gpkg"), two_triangles())


def test_boundary_of_the_hand_made_mesh_is_its_outline() -> None:
    mesh = two_triangles()
    assert set(edge_keys(boundary_edges(mesh.triangles))) == set(edge_keys(mesh.constraints))


@pytest.mark.parametrize("name", ["a;b\"c'd", "x!y", "é 海 (1) #2 50%25 &$HOME", "GPKG:x", "a,b=c"])
def test_names_that_others_stumble_over(tmp_path: Path, name: str) -> None:
    mesh = two_triangles()
    path = write_mesh(mesh, tmp_path / f"{name}.gpkg")
    assert path.is_file()
    assert np.array_equal(read_mesh(path).nodes, mesh.nodes)


@pytest.mark.parametrize(
    "values",
    [
        np.array([1, -2, 3], np.int32),
        np.array([1.5, np.nan, -np.inf]),
        np.array([0.25, 0.5], np.float32)[::-1],
        np.array([True, False, True] * 7),
        np.array(["", "feature", "border"]),
        np.array(["straße", "b"]),
        np.array([], np.float64),
        np.array([], "U3"),
    ],
    ids=lambda values: f"{values.dtype.str}-{len(values)}",
)
def test_columns_are_the_arrow_arrays_that_pyarrow_makes(values):
    column = arrow._attribute(values)
    column.validate(full=True)

    assert column.equals(pa.array(values, from_pandas=values.dtype.kind == "f"))


def test_the_command_does_without_pandas(tmp_path):
    """pandas takes half a second, and pyarrow imports it when it is asked for an array."""
    command = [sys.executable, "-X", "importtime", "-m", "geomesh", "mesh"]
    files = [SAMPLES / "rmnp_dem.tif", "-o", tmp_path / "mesh.gpkg"]
    run = subprocess.run([*command, *files], capture_output=True, text=True, check=False)
    modules = {line.rpartition("|")[2].strip() for line in run.stderr.splitlines()}
    assert run.returncode == 0, run.stderr
    assert "pyarrow" in modules
    # A name alone may appear, from an import that was refused.
    assert not [name for name in modules if name.startswith(("pandas.", "geopandas."))]
