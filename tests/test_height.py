"""Heights: the band that becomes the third coordinate, its unit, and every layer and format."""

from __future__ import annotations

import json
import sqlite3
from contextlib import closing
from typing import TYPE_CHECKING, Any

import geopandas as gpd
import numpy as np
import pytest
import rasterio
import shapely
import xarray
from affine import Affine
from pyproj import CRS
from scipy.io import netcdf_file

import geomesh
from geomesh.errors import BandError, GeomeshWarning, MeshFileError
from geomesh.mesh.height import find_height, unit_of
from geomesh.raster.bands import Band
from support.samples import OLINDA, SAMPLES

if TYPE_CHECKING:
    from pathlib import Path

    from support.commands import Geomesh

DEM = SAMPLES / "rmnp_dem.tif"
UNKNOWN = "the raster does not say in which unit its heights are: metres are assumed"
COMPOUND = "EPSG:32613+8228"  # UTM and heights in feet


def hills(size: int = 60) -> Any:
    """Return smooth heights from -20 to 60."""
    y, x = np.mgrid[:size, :size] / size
    return 20 + 40 * np.sin(5 * x) * np.cos(4 * y)


def write_dem(path: Path, crs: Any = 32613, unit: str | None = None, **profile: Any) -> Path:
    """Write hills as a GeoTIFF."""
    values = profile.pop("values", hills())
    bands = values if values.ndim == 3 else values[None]
    size = {"count": len(bands), "height": bands.shape[1], "width": bands.shape[2]}
    transform = profile.pop("transform", Affine(10, 0, 400_000, 0, -10, 4_400_000))
    with rasterio.open(
        path, "w", driver="GTiff", dtype="float64", crs=crs, transform=transform, **size, **profile
    ) as dataset:
        dataset.write(bands)
        if unit is not None:
            dataset.units = [unit] * len(bands)
    return path


def test_every_layer_and_format_has_the_heights(command: Geomesh, tmp_path: Path) -> None:
    made = command("mesh", DEM, "-o", tmp_path / "a.gpkg", "--z", "1", "--nodes", "150")
    assert made.warnings() == [UNKNOWN]
    mesh = geomesh.read_mesh(tmp_path / "a.gpkg")
    assert mesh.heights is not None
    assert np.array_equal(mesh.heights, mesh.attributes("nodes")["b1"])
    for layer, vertices in (
        ("nodes", np.arange(150)[:, None]),
        ("edges", mesh.edges.nodes),
        ("triangles", mesh.triangles[:, [0, 1, 2, 0]]),
    ):
        expected = mesh.heights[vertices]
        frames = {"gpkg": gpd.read_file(tmp_path / "a.gpkg", layer=layer)}
        frames["own"] = mesh.to_geodataframe(layer)
        for ending in ("geojson", "fgb", "parquet"):
            path = tmp_path / f"{layer}.{ending}"
            done = command("convert", tmp_path / "a.gpkg", "-o", path, "--layers", layer)
            assert done.code == 0, done.err
            read = gpd.read_parquet if ending == "parquet" else gpd.read_file
            frames[ending] = read(path).sort_values("id")
        for name, frame in frames.items():
            assert frame.has_z.all(), name
            found = shapely.get_coordinates(frame.geometry, include_z=True)[:, 2]
            found = np.sort(found.reshape(expected.shape), axis=1)
            tolerance = 1e-3 if name == "geojson" else 0
            assert np.abs(found - np.sort(expected, axis=1)).max() <= tolerance, name
    with closing(sqlite3.connect(tmp_path / "a.gpkg")) as database:
        assert {z for (z,) in database.execute("SELECT z FROM gpkg_geometry_columns")} == {1}
    column = json.loads(_geo(tmp_path / "nodes.parquet"))["columns"]["geometry"]
    assert column["geometry_types"] == ["Point Z"]


def _geo(path: Path) -> bytes:
    import pyarrow.parquet as pq

    geo: bytes = pq.read_schema(path).metadata[b"geo"]
    return geo


def test_ugrid_has_the_heights_where_mdal_looks_for_them(tmp_path: Path) -> None:
    mesh = geomesh.mesh_raster(write_dem(tmp_path / "a.tif", unit="ft"), z=1, nodes=60)
    mesh.to_file(tmp_path / "a.nc")
    with netcdf_file(tmp_path / "a.nc", mmap=False) as dataset:
        variable = dataset.variables["mesh_node_z"]
        assert variable.standard_name == b"altitude"
        assert (variable.mesh, variable.location, variable.units) == (b"mesh", b"node", b"foot")
        assert np.array_equal(variable.data, mesh.heights)
        assert dataset.variables["slope"].units == b"degree"


@pytest.mark.parametrize(
    ("crs", "unit", "factor", "expected", "assumed"),
    [
        (32613, None, 1.0, ("metre", 1.0), True),
        (32613, "m", 1.0, ("metre", 1.0), False),
        (32613, "Feet", 1.0, ("foot", 0.3048), False),
        (32613, "US survey foot", 1.0, ("US survey foot", 1200 / 3937), False),
        (32613, "ft", 0.3048, ("metre", 1.0), False),
        (32613, "m", 1 / 0.3048, ("foot", 0.3048), False),
        (32613, "cm", 0.01, ("metre", 1.0), False),
        (32613, None, 0.1, ("metre", 1.0), True),
        (32613, "kelvin", 1.0, ("metre", 1.0), True),
        (COMPOUND, None, 1.0, ("foot", 0.3048), False),
        (COMPOUND, "m", 1.0, ("metre", 1.0), False),
        (None, None, 1.0, ("metre", 1.0), True),
    ],
)
def test_the_unit_is_that_of_the_band_or_of_the_crs(
    crs: Any, unit: str | None, factor: float, expected: tuple[str, float], assumed: bool
) -> None:
    bands = [Band(1, None, None, "b1", unit=unit or "")]
    found = find_height(bands, 1, factor, None if crs is None else CRS(crs), name="a.tif")
    assert (found.unit, found.metres) == pytest.approx(expected)
    assert found.assumed == assumed


def test_units_are_read_from_files_and_dataarrays(tmp_path: Path) -> None:
    path = write_dem(tmp_path / "a.tif", unit="ft")
    mesh = geomesh.mesh_raster(path, z="b1", nodes=60)
    assert mesh.height is not None
    assert (mesh.height.unit, mesh.height.assumed) == ("foot", False)
    mesh.to_file(tmp_path / "a.gpkg")
    read = geomesh.read_mesh(tmp_path / "a.gpkg")
    assert read.height == mesh.height
    assert np.array_equal(read.heights, mesh.heights)
    with xarray.open_dataset(path, engine="rasterio") as dataset:
        array = dataset["band_data"].assign_attrs(units="feet")
        assert geomesh.mesh_raster(array, z=1, nodes=60).height.unit == "foot"  # type: ignore[union-attr]
    # Slopes are of true metres.
    metres = mesh.with_height(1, 0.3048)
    assert metres.height.unit == "metre"  # type: ignore[union-attr]
    assert metres.attributes("triangles")["slope"] == pytest.approx(
        mesh.attributes("triangles")["slope"]
    )


def test_a_compound_crs_is_kept(tmp_path: Path) -> None:
    mesh = geomesh.mesh_raster(write_dem(tmp_path / "a.tif", COMPOUND), z=1, nodes=60)
    assert mesh.height is not None
    assert mesh.height.unit == "foot"
    assert mesh.grid.crs is not None
    assert mesh.grid.crs.is_compound
    assert not mesh.height.assumed


def test_a_factor_multiplies(command: Geomesh, tmp_path: Path) -> None:
    flat = command("mesh", DEM, "-o", tmp_path / "a.gpkg", "--nodes", "100")
    assert flat.warnings() == []
    mesh = geomesh.read_mesh(tmp_path / "a.gpkg")
    assert mesh.heights is None
    assert "slope" not in mesh.attributes("triangles")
    assert json.loads(command("info", tmp_path / "a.gpkg", "--json").out)["height"] is None
    lifted = command(
        "convert", tmp_path / "a.gpkg", "-o", tmp_path / "b.gpkg", "--z", "1", "--z-factor", "2"
    )
    assert lifted.code == 0, lifted.err
    high = geomesh.read_mesh(tmp_path / "b.gpkg")
    described = json.loads(command("info", tmp_path / "b.gpkg", "--json").out)
    assert (described["height"]["band"], described["height"]["factor"]) == ("b1", 2.0)
    assert high.heights == pytest.approx(2 * mesh.attributes("nodes")["b1"])
    assert high.with_height().heights is high.heights
    assert set(high.attributes("triangles")) - set(mesh.attributes("triangles")) == {
        "slope",
        "aspect",
        "area_3d",
    }


def test_a_height_survives_refinement() -> None:
    mesh = geomesh.mesh_raster(DEM, z=1, preset="features", nodes=100)
    refined = mesh.refine(DEM, nodes=100)
    assert refined.height == mesh.height
    assert np.array_equal(refined.heights, refined.attributes("nodes")["b1"])


@pytest.mark.parametrize("preset", ["features", "paper", "adaptive"])
def test_nodata_has_no_height(tmp_path: Path, preset: str) -> None:
    values = hills()
    values[20:35, 10:30] = -9999
    path = write_dem(tmp_path / "a.tif", values=values, nodata=-9999, unit="m")
    mesh = geomesh.mesh_raster(path, z=1, preset=preset)
    assert np.nanmin(mesh.heights) > -30
    mesh.to_file(tmp_path / "a.gpkg")
    assert np.array_equal(
        geomesh.read_mesh(tmp_path / "a.gpkg").heights, mesh.heights, equal_nan=True
    )


def test_a_file_without_its_voids_is_complete(command: Geomesh, tmp_path: Path) -> None:
    values = hills()
    values[:, 25:] = -9999
    source = write_dem(tmp_path / "a.tif", values=values, nodata=-9999, unit="m")
    options = ("--z", "1", "--domain", "image", "--nodes", "300", "--overwrite")
    made = command("mesh", source, "-o", tmp_path / "a.2dm", *options)
    assert made.code == 0
    assert any("have no heights and are left out" in each for each in made.warnings())
    again = command("mesh", source, "-o", tmp_path / "a.2dm", *options, "--skip-existing")
    assert "skipped" in again.out


def test_across_the_antimeridian_pieces_keep_their_heights(tmp_path: Path) -> None:
    transform = Affine(0.05, 0, 178.5, 0, -0.05, 10)
    path = write_dem(tmp_path / "a.tif", 4326, "m", transform=transform)
    mesh = geomesh.mesh_raster(path, z=1, nodes=80)
    mesh.to_file(tmp_path / "a.geojson")
    frame = gpd.read_file(tmp_path / "a.geojson")
    cut = frame[frame.geometry.geom_type == "MultiPolygon"]
    assert len(cut) > 3
    planes = np.column_stack([mesh.map_nodes, mesh.heights])[mesh.triangles]
    for _, row in cut.iterrows():
        corners = planes[row["id"]]
        plane = np.linalg.solve(np.column_stack([corners[:, :2], np.ones(3)]), corners[:, 2])
        for x, y, z in shapely.get_coordinates(row.geometry, include_z=True):
            longitude = x + 360 if x < 0 else x
            assert z == pytest.approx(plane @ [longitude, y, 1], abs=1e-3)


def test_what_is_no_height_is_refused_in_one_line(tmp_path: Path) -> None:
    palette = tmp_path / "classes.tif"
    with rasterio.open(
        palette, "w", driver="GTiff", dtype="uint8", count=1, width=20, height=20
    ) as dataset:
        dataset.write(np.arange(400).reshape(1, 20, 20).astype(np.uint8) % 3)
        dataset.write_colormap(1, {0: (0, 0, 0, 255), 1: (255, 0, 0, 255), 2: (0, 255, 0, 255)})
    for source, z, words in (
        (OLINDA, 4, "no band 4 for `z`; it has 1 .red., 2 .green., 3 .blue."),
        (OLINDA, "height", "no band 'height' for `z`"),
        (palette, 1, "has classes, which are no heights: choose another `z`"),
    ):
        with pytest.raises(BandError, match=words) as caught:
            geomesh.mesh_raster(source, z=z)
        assert "\n" not in str(caught.value)
    with pytest.raises(BandError, match="several bands: choose that of the heights"):
        geomesh.mesh_raster(OLINDA, nodes=50).with_height()
    for value, words in ((0.0, "z_factor is 0"), (np.nan, "z_factor is nan")):
        with pytest.raises(geomesh.GeomeshError, match=words):
            geomesh.mesh_raster(DEM, z=1, z_factor=value)


def test_heights_that_another_program_changed_are_not_read(tmp_path: Path) -> None:
    with pytest.warns(GeomeshWarning, match="metres are assumed"):
        mesh = geomesh.mesh_raster(DEM, z=1, nodes=60)
    mesh.to_file(tmp_path / "a.gpkg")
    frame = gpd.read_file(tmp_path / "a.gpkg", layer="nodes")
    moved = frame.geometry.iloc[7]
    frame.loc[7, "geometry"] = shapely.Point(moved.x, moved.y, moved.z + 5)
    with closing(sqlite3.connect(tmp_path / "a.gpkg")) as database:
        row = database.execute("SELECT geom FROM nodes WHERE id = 7").fetchone()[0]
        changed = row[:-8] + np.float64(moved.z + 5).tobytes()
        for (name,) in database.execute(
            "SELECT name FROM sqlite_master WHERE type = 'trigger'"
        ).fetchall():
            database.execute(f"DROP TRIGGER {name}")
        database.execute("UPDATE nodes SET geom = ? WHERE id = 7", (changed,))
        database.commit()
    with pytest.raises(MeshFileError, match="not where geomesh put them"):
        geomesh.read_mesh(tmp_path / "a.gpkg")


def test_a_column_named_slope_of_a_flat_mesh_is_kept(tmp_path: Path) -> None:
    mesh = geomesh.mesh_raster(OLINDA, nodes=60)
    mesh.to_file(tmp_path / "a.gpkg")
    with closing(sqlite3.connect(tmp_path / "a.gpkg")) as database:
        database.execute("ALTER TABLE triangles ADD COLUMN slope REAL DEFAULT 4")
        database.commit()
    assert (geomesh.read_mesh(tmp_path / "a.gpkg").attributes("triangles")["slope"] == 4).all()


@pytest.mark.parametrize(
    ("text", "unit"),
    [(" M ", "metre"), ("", None), (None, None), ("degC", None), ("us-ft", "US survey foot")],
)
def test_names_of_units(text: str | None, unit: str | None) -> None:
    found = unit_of(text)
    assert (found[0] if found else None) == unit
