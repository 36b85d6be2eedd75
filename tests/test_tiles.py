"""Tiles of a mesh, read by other libraries: complete at every zoom, and without a gap."""

from __future__ import annotations

import gzip
import json
import signal
import sqlite3
import subprocess
from collections import defaultdict
from dataclasses import replace
from functools import cache
from io import BytesIO
from itertools import pairwise
from typing import TYPE_CHECKING

import mapbox_vector_tile
import numpy as np
import pytest
import rasterio.features
import shapely
from affine import Affine
from pmtiles.reader import MemorySource, Reader, all_tiles
from pmtiles.tile import zxy_to_tileid
from pyproj import CRS

import geomesh
from geomesh.arrays.table import Table
from geomesh.errors import CertificateError, GeoreferenceError, OutputError
from geomesh.formats.mercator import HALF_SIDE, tile_ids, to_lonlat, to_world
from geomesh.formats.pmtiles import Archive, ArchiveWriter, Place
from geomesh.io import tile_check, tiles
from geomesh.pipeline.tiles import tile_layer
from geomesh.raster.grid import Grid, Window
from geomesh.zonal.rings import fill_rings
from support.commands import OLD, PROGRAM, run_program, snapshot
from support.meshes import GEOREFERENCES, ORIENTATIONS, frame_mesh, lattice_mesh, two_triangles
from support.rasters import picture
from support.samples import OLINDA, SAMPLES

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = pytest.mark.filterwarnings("ignore::geomesh.errors.GeomeshWarning")

UTM = Affine(30, 0, 600_000, 0, -30, 4_900_000)
SIZE = 256  # pixels along the side of a tile, other than geomesh itself looks at


def read(path: Path) -> dict[int, dict[tuple[int, int], dict]]:
    """Return the layer of each tile, by zoom and place, as other libraries read the file."""
    found = defaultdict(dict)
    for (zoom, x, y), data in all_tiles(MemorySource(path.read_bytes())):
        options = {"y_coord_down": True}
        decoded = mapbox_vector_tile.decode(gzip.decompress(data), default_options=options)
        found[zoom][x, y] = decoded["triangles"]
    return dict(sorted(found.items()))


def properties(levels: dict, zoom: int) -> dict[int, dict]:
    """Return the attributes of each triangle at a zoom; they must be the same in all tiles."""
    found = {}
    for layer in levels[zoom].values():
        for feature in layer["features"]:
            values = feature["properties"]
            assert found.setdefault(values["id"], values) == values
    return found


def count_gaps(levels: dict, zoom: int, mesh: geomesh.Mesh) -> tuple[int, int]:
    """Return the pixels inside a mesh at a zoom, and those that no triangle covers.

    GDAL decides which pixels a polygon covers. Of the outline, which is rounded, the pixels whose
    centre is within an eighth of a pixel do not count.
    """
    outline = shapely.union_all(mesh.to_geodataframe().to_crs(3857).geometry.to_numpy())
    side = 2 * HALF_SIDE / 2**zoom
    inside = gaps = 0
    west, south, east, north = outline.bounds
    columns = range(int((west + HALF_SIDE) // side), int((east + HALF_SIDE) // side) + 1)
    rows = range(int((HALF_SIDE - north) // side), int((HALF_SIDE - south) // side) + 1)
    for x, y in ((x, y) for x in columns for y in rows):
        place = Affine(
            *(side / SIZE, 0, x * side - HALF_SIDE),
            *(0, -side / SIZE, HALF_SIDE - y * side),
        )
        expected = rasterio.features.rasterize([outline], (SIZE, SIZE), transform=place)
        if not expected.any():
            continue
        layer = levels[zoom].get((x, y), {"features": [], "extent": 1})
        shapes = [shapely.geometry.shape(each["geometry"]) for each in layer["features"]]
        pixel = Affine.scale(layer["extent"] / SIZE)
        shown = np.zeros((SIZE, SIZE), np.uint8)
        if shapes:
            rasterio.features.rasterize(shapes, out=shown, transform=pixel)
        missing = np.argwhere((expected == 1) & (shown == 0))
        places = shapely.points(*(place @ (missing[:, 1] + 0.5, missing[:, 0] + 0.5)))
        distance = shapely.distance(places, outline.boundary)
        inside += int(expected.sum())
        gaps += int(np.count_nonzero(distance > side / SIZE / 8))
    return inside, gaps


def ragged() -> np.ma.MaskedArray:
    """Return a picture with a round outline, with islands and holes."""
    pixels = picture(3, 300, 300)
    y, x = np.mgrid[:300, :300] - 150
    hidden = (x**2 + y**2 > 140**2) | ((np.sin(x / 9) * np.cos(y / 11)) > 0.8)
    return np.ma.MaskedArray(pixels, np.broadcast_to(hidden, pixels.shape))


MESHES = {
    "landsat": lambda: geomesh.mesh_raster(OLINDA, nodes=3000, effort="fast"),
    "ragged": lambda: geomesh.mesh_raster((ragged(), UTM, "EPSG:32618"), effort="fast"),
    "collar": lambda: geomesh.mesh_raster(
        SAMPLES / "bahamas_landsat7_rgb_nodata_collar.tif", effort="fast"
    ),
    "rotated": lambda: geomesh.mesh_raster(
        (picture(3, 200, 260), Affine(20, 15, 6e5, 15, -20, 4.9e6), "EPSG:32618"), effort="fast"
    ),
    "degrees": lambda: geomesh.mesh_raster(
        SAMPLES / "colorado_dem_float32_epsg4269.tif", effort="fast"
    ),
    "hull": lambda: geomesh.mesh_raster(
        (picture(3, 300, 300), UTM, "EPSG:32618"), preset="paper", nodes=300
    ),
}


@cache
def scene_mesh(name: str) -> geomesh.Mesh:
    return MESHES[name]()


@pytest.mark.parametrize(
    "scene", [pytest.param(name, marks=[pytest.mark.slow] * (name != "ragged")) for name in MESHES]
)
def test_every_zoom_is_complete_and_without_a_gap(scene, tmp_path):
    mesh = scene_mesh(scene)
    path = tmp_path / "map.pmtiles"
    summary = mesh.to_tiles(path)
    levels = read(path)
    assert [level.zoom for level in summary.levels] == list(levels)
    assert len(levels) >= 2
    for level in summary.levels:
        shown = properties(levels, level.zoom)
        assert level.check.gap_pixels == level.check.missing == 0
        assert level.check.shown == len(shown)
        assert level.check.tiles == len(levels[level.zoom])
        # A triangle that is thinner than a step of the tiles has no area there.
        assert level.triangles * 0.99 < len(shown) <= level.triangles
        inside, gaps = count_gaps(levels, level.zoom, mesh)
        assert inside * 4 == pytest.approx(level.check.pixels, rel=0.05)
        assert gaps == 0
    nearest = properties(levels, summary.levels[-1].zoom)
    assert summary.levels[-1].own
    assert len(nearest) > len(mesh.triangles) * 0.99


def test_the_nearest_zoom_has_the_attributes_of_the_mesh_and_others_have_their_means(tmp_path):
    mesh = scene_mesh("landsat")
    summary = mesh.to_tiles(tmp_path / "map.pmtiles")
    levels = read(tmp_path / "map.pmtiles")
    table = mesh.attributes("triangles")
    names = ["id", "area", "count", "red_mean", "green_mean", "blue_mean", "color"]
    nearest = properties(levels, summary.levels[-1].zoom)
    assert set(nearest) == set(range(len(mesh.triangles)))
    # The mean of a triangle without pixels is not there: NaN is no value.
    assert sorted(nearest[5]) == sorted(names)
    for name in names:
        found = [nearest[k].get(name, np.nan) for k in range(len(nearest))]
        if name == "color":
            assert found == table[name].tolist()
        else:
            np.testing.assert_allclose(found, table[name], rtol=1e-6)
    own = float(np.nansum(table["red_mean"] * table["count"]))
    for level in summary.levels[:-1]:
        values = properties(levels, level.zoom).values()
        # Each pixel of the raster is counted in one triangle, at every zoom.
        assert sum(each["count"] for each in values) == table["count"].sum()
        total = sum(each.get("red_mean", 0) * each["count"] for each in values)
        assert total == pytest.approx(own, rel=1e-5)
        area = sum(each["area"] for each in values)
        assert area == pytest.approx(table["area"].sum(), rel=1e-5)
        assert all(len(each["color"]) == 7 for each in values)


def test_a_smaller_mesh_has_the_colours_of_the_pixels_below_it(tmp_path):
    """Left half dark, right half bright: so is every zoom."""
    pixels = np.full((3, 256, 256), 30, np.uint8)
    pixels[:, :, 128:] = 220
    pixels[:, ::2, ::2] += 5
    mesh = geomesh.mesh_raster((pixels, UTM, "EPSG:32618"), nodes=3000, effort="fast")
    summary = mesh.to_tiles(tmp_path / "map.pmtiles")
    levels = read(tmp_path / "map.pmtiles")
    assert not summary.levels[0].own
    for level in summary.levels:
        reds = [int(each["color"][1:3], 16) for each in properties(levels, level.zoom).values()]
        dark, bright = int(table_red(mesh).min()), int(table_red(mesh).max())
        assert min(reds) >= dark - 1
        assert max(reds) <= bright + 1
        assert {red < 128 for red in reds} == {True, False}
        between = sum(60 < red < 190 for red in reds)
        assert between < 0.1 * len(reds)


def table_red(mesh: geomesh.Mesh) -> np.ndarray:
    return np.array([int(color[1:3], 16) for color in mesh.attributes("triangles")["color"]])


@pytest.mark.parametrize("name", ["north-up", "south-up", "mirrored", "rotated", "sheared"])
def test_maps_of_every_orientation(name, tmp_path):
    mesh = frame_mesh(ORIENTATIONS[name])
    summary = mesh.to_tiles(tmp_path / "map.pmtiles")
    levels = read(tmp_path / "map.pmtiles")
    for level in summary.levels:
        assert len(properties(levels, level.zoom)) == level.triangles
        assert count_gaps(levels, level.zoom, mesh)[1] == 0


@pytest.mark.parametrize("grid", ["geographic", "custom CRS", "flipped"])
def test_every_kind_of_crs(grid, tmp_path):
    mesh = frame_mesh(GEOREFERENCES[grid])
    summary = mesh.to_tiles(tmp_path / "map.pmtiles")
    levels = read(tmp_path / "map.pmtiles")
    assert all(count_gaps(levels, level.zoom, mesh)[1] == 0 for level in summary.levels)


def test_a_mesh_over_the_antimeridian_is_on_both_sides(tmp_path):
    grid = Affine(0.5, 0, 175, 0, -0.5, -10)
    mesh = lattice_mesh("EPSG:4326", grid)
    summary = mesh.to_tiles(tmp_path / "map.pmtiles")
    levels = read(tmp_path / "map.pmtiles")
    for level in summary.levels:
        count = 2**level.zoom
        columns = {x for x, _ in levels[level.zoom]}
        if count > 1:
            assert columns <= {*range(count // 2, count)} | {*range(count // 2)}
            assert {0, count - 1} <= columns
        assert len(properties(levels, level.zoom)) == level.triangles
        # Moved away from the antimeridian, the same tiles would be elsewhere: count the area.
        area = sum(
            shapely.clip_by_rect(shapely.geometry.shape(each["geometry"]), 0, 0, 4096, 4096).area
            for layer in levels[level.zoom].values()
            for each in layer["features"]
        )
        corners = to_world(np.array([[175, -10], [185, -20]])) * 4096 * count
        assert area == pytest.approx(np.prod(np.abs(np.diff(corners, axis=0))), rel=0.005)
    header = Reader(MemorySource((tmp_path / "map.pmtiles").read_bytes())).header()
    assert (header["min_lon_e7"], header["max_lon_e7"]) == (-1_800_000_000, 1_800_000_000)


@pytest.mark.parametrize("crs", ["EPSG:3413", "EPSG:3031"])
def test_a_mesh_over_a_pole_ends_where_web_mercator_does(crs, tmp_path):
    mesh = lattice_mesh(crs, Affine(2e5, 0, -2e6, 0, -2e5, 2e6))
    summary = mesh.to_tiles(tmp_path / "map.pmtiles", max_zoom=2)
    levels = read(tmp_path / "map.pmtiles")
    assert summary.levels[-1].check.gap_pixels == 0
    # Around the pole, all longitudes are covered up to the end of the map.
    edge = 0 if crs == "EPSG:3413" else 3
    assert {x for x, y in levels[2] if y == edge} == {0, 1, 2, 3}
    for (_, y), layer in levels[2].items():
        if y == edge:
            shapes = [shapely.geometry.shape(each["geometry"]) for each in layer["features"]]
            shown = rasterio.features.rasterize(shapes, (64, 64), transform=Affine.scale(64))
            assert shown[0 if edge == 0 else -1].all()


def test_a_mesh_without_colours_or_values(tmp_path):
    mesh = two_triangles(corner=40)
    summary = mesh.to_tiles(tmp_path / "map.pmtiles", page=tmp_path / "map.html")
    levels = read(tmp_path / "map.pmtiles")
    for level in summary.levels:
        assert {tuple(sorted(each)) for each in properties(levels, level.zoom).values()} == {
            ("area", "id")
        }
    assert (tmp_path / "map.html").exists()


def test_a_dense_mesh_without_colours_gets_smaller_meshes_too(tmp_path):
    mesh = lattice_mesh("EPSG:32618", UTM, 60, 60)
    summary = mesh.to_tiles(tmp_path / "map.pmtiles")
    levels = read(tmp_path / "map.pmtiles")
    assert not summary.levels[0].own
    for level in summary.levels:
        assert count_gaps(levels, level.zoom, mesh)[1] == 0


def test_missing_values_are_left_out(tmp_path):
    mesh = frame_mesh(GEOREFERENCES["north-up"])
    values = mesh.triangle_table["b1_mean"].copy()
    values[::3] = np.nan
    columns = {"b1_mean": values, "kind": np.array(["a"] * len(values))}
    changed = geomesh.Mesh(
        *(mesh.nodes, mesh.triangles, mesh.grid, mesh.domain, mesh.constraints),
        triangle_table=Table({**mesh.triangle_table, **columns}),
    )
    changed.to_tiles(tmp_path / "map.pmtiles", columns=["b1_mean", "kind"])
    levels = read(tmp_path / "map.pmtiles")
    shown = properties(levels, max(levels))
    for k, value in enumerate(values):
        assert shown[k]["kind"] == "a"
        assert shown[k].get("b1_mean", np.nan) == pytest.approx(value, rel=1e-6, nan_ok=True)
        assert ("b1_mean" in shown[k]) == (k % 3 > 0)


def test_one_triangle(tmp_path):
    grid = GEOREFERENCES["north-up"]
    whole = two_triangles(grid, 40.0)
    mesh = geomesh.Mesh(
        *(whole.nodes[[0, 1, 3]], np.array([[0, 2, 1]], np.int32), grid, whole.domain)
    )
    facts = replace(mesh.domain, area=800.0, kind="hull")
    mesh = replace(mesh, domain=facts)
    summary = mesh.to_tiles(tmp_path / "map.pmtiles")
    assert [level.triangles for level in summary.levels] == [1] * len(summary.levels)


def test_zooms_and_columns_that_were_asked_for(tmp_path):
    mesh = scene_mesh("landsat")
    summary = mesh.to_tiles(tmp_path / "map.pmtiles", min_zoom=9, max_zoom=11, columns=["count"])
    assert [level.zoom for level in summary.levels] == [9, 10, 11]
    levels = read(tmp_path / "map.pmtiles")
    assert set(properties(levels, 11)[0]) == {"id", "count"}
    metadata = Reader(MemorySource((tmp_path / "map.pmtiles").read_bytes())).metadata()
    assert metadata["vector_layers"][0]["fields"] == {"id": "Number", "count": "Number"}
    assert metadata["geomesh"]["source"] == OLINDA.name
    for wrong, message in (
        ({"min_zoom": 5, "max_zoom": 4}, "`min_zoom` is 5 and `max_zoom` is 4"),
        ({"max_zoom": 23}, "`max_zoom` is 23: give a zoom from 0 to 22"),
        ({"columns": ["nothing"]}, "no attribute 'nothing'"),
    ):
        with pytest.raises(OutputError, match=message):
            mesh.to_tiles(tmp_path / "other.pmtiles", **wrong)
    assert not (tmp_path / "other.pmtiles").exists()


@pytest.mark.parametrize(
    ("grid", "message"),
    [
        (GEOREFERENCES["no CRS"], "tiles need a place on Earth, but the mesh has no CRS"),
        (GEOREFERENCES["Mars"], "tiles need a place on Earth, and 'Mars"),
        (GEOREFERENCES["geostationary"], "tiles need longitude and latitude, but"),
        (
            Grid(50, 40, Affine(100, 0, -2500, 0, -100, 2000), CRS(3413)),
            "Web Mercator, which ends at 85.05 degrees of latitude",
        ),
        (
            Grid(50, 40, Affine(1, 0, 0, 0, -1, 120), CRS(4326)),
            "tiles need longitude and latitude, but",
        ),
    ],
)
def test_a_mesh_without_a_place_on_the_map_is_refused(grid, message, tmp_path):
    with pytest.raises(GeoreferenceError, match=message):
        frame_mesh(grid).to_tiles(tmp_path / "map.pmtiles")
    assert list(tmp_path.iterdir()) == []


def test_a_file_with_a_gap_is_not_written(tmp_path, monkeypatch):
    """With a limit on triangles of a tile, GDAL leaves some out; an older file stays."""
    mesh, path = scene_mesh("landsat"), tmp_path / "map.pmtiles"
    path.write_text("older")
    monkeypatch.setattr(tiles, "_NO_LIMIT", 2000)
    with pytest.raises(CertificateError, match=r"triangles are missing and [1-9]\d* of \d+ pixels"):
        mesh.to_tiles(path, overwrite=True)
    assert path.read_text() == "older"
    assert [each.name for each in tmp_path.iterdir()] == ["map.pmtiles"]


def test_a_gap_is_found_even_if_no_triangle_is_missing(tmp_path):
    """Take a piece out of one of the tiles: the pixels of that piece are counted."""
    mesh = scene_mesh("landsat")
    path = tmp_path / "map.pmtiles"
    summary = mesh.to_tiles(path)
    zoom = summary.levels[-1].zoom
    layer = tile_layer(mesh, ["id"])
    with path.open("rb") as file:
        archive = Archive(file)
        shift = np.array([[0.3, 0.0]]) / (512 << zoom)
        outline = list(layer.rings())
        check = tile_check.check_level(archive, zoom, layer, outline)
        assert check.gap_pixels == 0
        # An outline that reaches three pixels farther to the east is not covered there.
        wider = [tile_check.Rings(r.points + 10 * shift, r.starts, r.rows) for r in outline]
        found = tile_check.check_level(archive, zoom, layer, wider)
    height = np.ptp(
        to_world(np.array(mesh.to_geodataframe().to_crs(4326).total_bounds).reshape(2, 2))[:, 1]
    )
    assert found.gap_pixels == pytest.approx(3 * height * (512 << zoom), rel=0.05)


def test_rings_are_filled_as_gdal_fills_them():
    random = np.random.default_rng(3)
    window = Window(5, 7, 40, 30)
    for _ in range(50):
        points = random.uniform(0, 50, (7, 2))
        ring = np.vstack([points, points[:1]])
        found = np.zeros(window.shape, np.uint8)
        fill_rings(ring, np.array([0, len(ring)]), window, found)
        expected = np.zeros(window.shape, np.uint8)
        centres = shapely.points(*(np.mgrid[5.5:45, 7.5:37].reshape(2, -1)))
        # Even-odd: a centre is inside if a ray from it crosses the ring an odd number of times.
        crossed = np.zeros(len(centres), int)
        x, y = shapely.get_coordinates(centres).T
        for (xa, ya), (xb, yb) in pairwise(ring):
            spans = (ya > y) != (yb > y)
            crossed += spans & (x < (xb - xa) * (y - ya) / (yb - ya) + xa)
        expected = (crossed % 2).reshape(40, 30).T
        assert (found == expected).all()


def test_numbers_of_tiles_are_those_of_pmtiles():
    random = np.random.default_rng(1)
    for zoom in range(20):
        x, y = random.integers(0, 2**zoom, (2, 40))
        expected = [zxy_to_tileid(zoom, int(a), int(b)) for a, b in zip(x, y, strict=True)]
        assert tile_ids(zoom, x, y).tolist() == expected


@pytest.mark.parametrize("count", [1, 3, 5000, 60_000])
def test_an_archive_of_any_size(count):
    """With many tiles, the directory has leaves."""
    random = np.random.default_rng(count)
    ids = np.sort(random.choice(4**9, count, replace=False)) + (4**9 - 1) // 3
    blobs = [random.bytes(int(size)) for size in random.integers(1, 40, count)]
    file = BytesIO()
    writer = ArchiveWriter(file)
    for number, data in zip(ids.tolist(), blobs, strict=True):
        writer.add(number, data)
    writer.finish(Place(9, 9, (-1.5, -2, 3, 4)), {"name": "é"})
    source = MemorySource(file.getvalue())
    assert [data for _, data in all_tiles(source)] == blobs
    assert Reader(source).metadata() == {"name": "é"}
    assert Reader(source).header()["min_lon_e7"] == -15_000_000
    file.seek(0)
    archive = Archive(file)
    assert (archive.directory.ids == ids).all()
    assert all(archive.tile(k) == blobs[k] for k in range(0, count, 97))


def test_a_file_of_another_kind_is_not_an_archive():
    with pytest.raises(ValueError, match="not a PMTiles file"):
        Archive(BytesIO(b"PK\x03\x04"))


def test_places_in_the_world_and_back():
    lonlat = np.array([[-180.0, 85.0], [0, 0], [12.5, -33], [180, -85]])
    np.testing.assert_allclose(to_lonlat(to_world(lonlat)), lonlat, atol=1e-12)


def test_the_command(tmp_path, command):
    mesh = tmp_path / "mesh.gpkg"
    scene_mesh("landsat").to_file(mesh)
    page, path = tmp_path / "map.html", tmp_path / "map.pmtiles"
    done = command("tiles", mesh, "-o", path, "--page", page)
    lines = done.out.splitlines()
    assert done.code == 0
    assert lines[0].startswith(f"{path}: zooms 10 to 12, ")
    assert lines[0].endswith(" MB, complete")
    assert lines[1].endswith(" triangles, 1 tile, 0 gap pixels")
    assert ", the mesh itself, " in lines[3]
    assert lines[4] == f"{page}: holds the tiles"
    facts = json.loads(
        command("tiles", OLINDA, "-o", path, "--nodes", "400", "--overwrite", "--json").out
    )
    (found,) = facts["results"]
    assert found["gap_pixels"] == 0
    assert found["levels"][-1]["nodes"] == 400
    assert found["bytes"] == path.stat().st_size


def test_what_the_command_refuses(tmp_path, command):
    mesh, output = tmp_path / "mesh.gpkg", tmp_path / "map.pmtiles"
    two_triangles(corner=40).to_file(mesh)
    assert "is not named as tiles" in command("tiles", mesh, "-o", tmp_path / "a.mbtiles").error()
    assert (
        "is not named as a page"
        in command("tiles", mesh, "-o", output, "--page", tmp_path / "a.txt").error()
    )
    refused = command("tiles", mesh, "-o", output, "--nodes", "5").error()
    assert refused == f"--nodes is for a raster, and {mesh} is a mesh: leave it out"
    absent = SAMPLES / "spyndex_sentinel2_4band_uint16_NOGEOREF.tif"
    assert "no CRS" in command("tiles", absent, "-o", output).error()
    foreign = tmp_path / "foreign.gpkg"
    two_triangles(corner=40).to_geodataframe().to_file(foreign)
    assert str(foreign) in command("tiles", foreign, "-o", output).error()
    assert not output.exists()


def test_tiles_are_made_one_zoom_at_a_time_and_joined(tmp_path, monkeypatch):
    """The files of zooms are those of GDAL, and are gone afterwards."""
    kept = {}

    def keep(levels, path, place, metadata):
        for level in levels:
            with sqlite3.connect(level.path) as file:
                kept[level.zoom] = file.execute("SELECT count(*) FROM tiles").fetchone()[0]
        return tiles.join_levels(levels, path, place, metadata)

    monkeypatch.setattr("geomesh.pipeline.tiles.join_levels", keep)
    summary = scene_mesh("landsat").to_tiles(tmp_path / "map.pmtiles")
    assert {level.zoom: level.check.tiles for level in summary.levels} == kept
    assert [each.name for each in tmp_path.iterdir()] == ["map.pmtiles"]


@pytest.mark.slow
def test_a_full_disk_is_told_in_one_line(tmp_path, small_disk):
    folder, options = small_disk
    scene_mesh("landsat").to_file(tmp_path / "mesh.gpkg")
    output = folder / "map.pmtiles"
    output.write_bytes(OLD)
    error = run_program(
        "tiles", tmp_path / "mesh.gpkg", "-o", output, "--overwrite", **options
    ).error()
    assert f"{output} could not be written: " in error
    assert "free some space or choose another folder" in error
    assert snapshot(folder) == {output.name: OLD}


@pytest.mark.slow
@pytest.mark.parametrize("message", ["Zoom 11: Refining", "Writing tiles", "Checking zoom 11"])
def test_a_stopped_run_leaves_the_old_file_and_nothing_else(message, tmp_path):
    scene_mesh("landsat").to_file(tmp_path / "mesh.gpkg")
    folder = tmp_path / "out"
    folder.mkdir()
    output = folder / "map.pmtiles"
    output.write_bytes(OLD)
    command = ("tiles", tmp_path / "mesh.gpkg", "-o", output, "--overwrite", "--progress=jsonl")
    with subprocess.Popen(
        [*PROGRAM, *map(str, command)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        for line in process.stdout:
            event = json.loads(line)
            if event["event"] == "progress" and event["message"].startswith(message):
                process.send_signal(signal.SIGTERM)
                break
        else:
            pytest.fail(f"no event told of {message!r}")
        out, err = process.communicate(timeout=60)
    assert process.returncode == 143, err
    assert [json.loads(each) for each in out.splitlines()][-1]["code"] == "interrupted"
    assert snapshot(folder) == {output.name: OLD}
