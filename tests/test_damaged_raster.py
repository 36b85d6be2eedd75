"""Rasters whose header, tags or data are damaged: what GDAL accepts is not always a picture."""

from __future__ import annotations

import json
import re
import warnings
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import rasterio
from affine import Affine
from rasterio.control import GroundControlPoint
from rasterio.shutil import copy

import geomesh
from geomesh.errors import BandError, GeomeshError, GeomeshWarning, GeoreferenceError, SourceError
from geomesh.raster.grid import Grid
from geomesh.raster.open import open_scene
from support.commands import Geomesh, assert_refused
from support.fuzz.png import build_png, read_chunks
from support.fuzz.tiff import ASCII, Tiff
from support.rasters import COLS, NORTH_UP, ROWS, SIZE, UTM, picture, write_raster

if TYPE_CHECKING:
    from collections.abc import Mapping

WIDTH, HEIGHT, STRIP_ROWS, TILE_WIDTH, TILE_HEIGHT = 256, 257, 278, 322, 323
TILES = {"tiled": True, "blockxsize": 16, "blockysize": 16}


def edited(path: str, tags: Mapping[int, Any]) -> str:
    """Give tags of a TIFF another number or text."""
    tiff = Tiff.parse(Path(path).read_bytes())
    entries = []
    for entry in tiff.directories[0]:
        value = tags.get(entry.tag)
        if isinstance(value, bytes):
            entries.append(replace(entry, kind=ASCII, count=len(value), value=value))
        elif value is not None:
            entries.append(replace(entry, kind=4, count=1, value=tiff.pack(4, [value])))
        else:
            entries.append(entry)
    Path(path).write_bytes(tiff.with_entries(0, tuple(entries)).build())
    return path


@pytest.mark.parametrize(
    ("profile", "tags", "blocks"),
    [
        (TILES, {HEIGHT: 16_777_216}, (4 * 1_048_576, 12)),
        (TILES, {WIDTH: COLS + 1}, (15, 12)),
        (TILES, {TILE_WIDTH: 8}, (24, 12)),
        ({"blockysize": 8}, {HEIGHT: 16_777_216}, (2_097_152, 6)),
        ({"blockysize": 8}, {STRIP_ROWS: 7}, (7, 6)),
        ({"blockysize": 8, "interleave": "band"}, {HEIGHT: ROWS + 1}, (14, 12)),
        (TILES | {"bigtiff": "yes"}, {HEIGHT: 2 * ROWS}, (24, 12)),
        (TILES | {"endianness": "big"}, {HEIGHT: 2 * ROWS}, (24, 12)),
    ],
)
def test_a_size_beyond_the_index_is_refused(
    tmp_path: Path, profile: dict[str, Any], tags: dict[int, int], blocks: tuple[int, int]
) -> None:
    path = write_raster(tmp_path, data=picture(2), **profile)
    assert open_scene(path).size == (COLS, ROWS)
    with pytest.raises(SourceError) as refusal:
        geomesh.mesh_raster(edited(path, tags))
    expected = f"{path} is damaged: .* have {blocks[0]} blocks, but .* lists {blocks[1]}; download"
    assert re.match(expected, str(refusal.value))


def test_a_sparse_raster_has_a_complete_index(tmp_path: Path) -> None:
    options = {**TILES, "sparse_ok": True, "width": 4096, "height": 4096, "count": 1}
    path = tmp_path / "sparse.tif"
    with rasterio.open(path, "w", driver="GTiff", dtype="uint8", nodata=0, **options) as dataset:
        dataset.write(picture(), window=rasterio.windows.Window(160, 320, COLS, ROWS))
    assert path.stat().st_size < 4096 * 4096 / 10
    assert geomesh.mesh_raster(path, nodes=60).domain.valid_pixels == SIZE


@pytest.mark.parametrize("tags", [{TILE_WIDTH: 16384, TILE_HEIGHT: 16384}, {TILE_HEIGHT: 2**24}])
def test_a_huge_block_in_a_small_file_is_refused(tmp_path: Path, tags: dict[int, int]) -> None:
    path = edited(write_raster(tmp_path, compress="deflate", **TILES), tags)
    with pytest.raises(SourceError, match=r"are in blocks of \d+ x \d+, but the file has \d+ byte"):
        geomesh.mesh_raster(path)


def test_a_tile_of_gigabytes_around_a_small_image_is_refused(tmp_path: Path) -> None:
    noise = np.random.default_rng(1).integers(0, 255, (3, 600, 540), np.uint8)
    path = edited(write_raster(tmp_path, data=noise, **TILES), {TILE_WIDTH: 10**7})
    with pytest.raises(SourceError, match=r"600 pixels are in blocks of 10000000 x 16, but"):
        geomesh.mesh_raster(path)


def test_a_raster_of_more_pixels_than_any_is_refused(tmp_path: Path, command: Geomesh) -> None:
    copy(write_raster(tmp_path), tmp_path / "scene.vrt", driver="VRT")
    text = (tmp_path / "scene.vrt").read_text()
    for side in ("X", "Y"):
        text = re.sub(f'raster{side}Size="[0-9]+"', f'raster{side}Size="2147483647"', text)
    (tmp_path / "scene.vrt").write_text(text)
    error = assert_refused(
        command, tmp_path / "scene.vrt", folder=tmp_path, output=tmp_path / "mesh.gpkg"
    )
    assert re.search("scene.vrt has 2147483647 x 2147483647 pixels, .* with --bounds", error)
    # The advice works.
    west, north = NORTH_UP.c, NORTH_UP.f
    # Only the blocks around the box are looked at.
    box = (west, north - 30 * ROWS, west + 30 * COLS, north)
    mesh = geomesh.mesh_raster(tmp_path / "scene.vrt", bounds=box, nodes=60)
    assert mesh.domain.valid_pixels == SIZE


def test_too_many_bands_are_refused(tmp_path: Path) -> None:
    array = np.broadcast_to(picture(), (2001, ROWS, COLS))
    with pytest.raises(BandError, match=r"has 2001 bands, more than the 2000 .* with `bidx`"):
        geomesh.mesh_raster((array, NORTH_UP, UTM))
    assert open_scene((array, NORTH_UP, UTM), bidx=[2001]).bands[0].index == 2001


@pytest.mark.parametrize(
    "transform",
    [
        Affine(1e308, 0, 0, 0, -5e-324, 0),
        Affine(1e160, 0, 0, 0, -1e160, 0),
        Affine(1, 0, 1e300, 0, -1, 1e300),
    ],
)
def test_coordinates_without_an_area_are_refused(transform: Affine) -> None:
    with pytest.raises(GeoreferenceError, match="correct the georeference"):
        Grid(COLS, ROWS, transform)


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e308])
def test_control_points_that_are_not_finite(tmp_path: Path, value: float) -> None:
    corners = [(0, 0), (0, COLS), (ROWS, 0), (ROWS, COLS)]
    points = [GroundControlPoint(row, col, 30 * col, -30 * row) for row, col in corners]
    points[2].x = value
    path = write_raster(tmp_path, transform=None, gcps=points)
    try:
        with pytest.warns(GeomeshWarning, match="4 ground control points, not finite"):
            geomesh.mesh_raster(path, nodes=60)
    except GeoreferenceError:
        assert np.isfinite(value)


def test_an_error_of_gdal_on_opening_is_told_once(tmp_path: Path) -> None:
    # GDAL ignores this CRS but keeps the error, which rasterio raises in some later call.
    path = write_raster(tmp_path, "crs.tif", crs=None)
    side = '<PAMDataset><SRS>PROJCRS["lost"]</SRS></PAMDataset>'
    (tmp_path / "crs.tif.aux.xml").write_text(side)
    sound = write_raster(tmp_path, "sound.tif")
    with pytest.warns(GeomeshWarning, match=r"crs\.tif: GDAL reports an error in this file \(miss"):
        mesh = geomesh.mesh_raster(path, nodes=60)
    assert mesh.grid.crs is None
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        assert geomesh.mesh_raster(sound, nodes=60).grid.crs is not None
    assert not any("GDAL" in str(warning.message) for warning in caught)
    assert geomesh.mesh_raster(path, nodes=60, crs=UTM).grid.crs == UTM


def test_a_png_with_damaged_data_is_refused(tmp_path: Path) -> None:
    # GDAL's fast way to read a whole PNG would give what the memory happens to hold.
    path = Path(write_raster(tmp_path, "scene.png", picture(3), driver="PNG"))
    chunks = read_chunks(path.read_bytes())
    at = [kind for kind, _ in chunks].index(b"IDAT")
    chunks[at] = b"IDAT", chunks[at][1][:2] + bytes(40) + chunks[at][1][42:]
    path.write_bytes(build_png(chunks))
    with pytest.raises(GeomeshError, match=r"scene\.png: cannot read columns 0 to 64"):
        geomesh.mesh_raster(path, nodes=60)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        # A source without a size: GDAL fails without a message.
        (rb'(<SrcRect[^>]*) ySize="48"', rb"\1"),
        # A source that is missing, with a name in another encoding: rasterio loses the message.
        (rb">source.tif<", b">\xff\xfe.tif<"),
    ],
)
@pytest.mark.parametrize("band", [0, 1, 2])
def test_a_read_that_fails_in_silence_is_refused(
    tmp_path: Path, old: bytes, new: bytes, band: int
) -> None:
    copy(write_raster(tmp_path, "source.tif", picture(3)), tmp_path / "scene.vrt", driver="VRT")
    parts = re.split(rb"(?=<VRTRasterBand)", (tmp_path / "scene.vrt").read_bytes())
    parts[band + 1], times = re.subn(old, new, parts[band + 1])
    assert times == 1
    (tmp_path / "scene.vrt").write_bytes(b"".join(parts))
    with pytest.raises(SourceError, match=r"scene\.vrt: cannot read columns 0 to 64"):
        geomesh.mesh_raster(tmp_path / "scene.vrt", nodes=60)


@pytest.mark.parametrize("dtype", ["uint8", "int8", "uint64", "float32", "float64"])
@pytest.mark.parametrize("value", [101, 58])
def test_any_value_can_be_in_the_last_pixel(tmp_path: Path, dtype: str, value: int) -> None:
    data = np.full((2, ROWS, COLS), value, dtype)
    path = write_raster(tmp_path, data=data, nodata=None)
    bands, valid = open_scene(path).read(open_scene(path).window)
    np.testing.assert_array_equal(bands, data)
    assert valid.all()


@pytest.mark.parametrize("transform", [NORTH_UP, Affine(50, 0, 0, 0, -1, 0)])
def test_meters_are_no_longitudes(tmp_path: Path, transform: Affine) -> None:
    # The areas of such triangles would mean nothing.
    path = write_raster(tmp_path, crs="EPSG:4326", transform=transform)
    with pytest.raises(GeoreferenceError, match=r"WGS 84.* in angles, but x runs .* with `crs`"):
        geomesh.mesh_raster(path)
    assert geomesh.mesh_raster(path, crs=UTM, nodes=60).grid.crs == UTM


def test_a_palette_without_colours_is_no_palette(tmp_path: Path) -> None:
    path = write_raster(tmp_path, data=picture().astype(np.uint16))
    side = '<PAMRasterBand band="1"><ColorInterp>Palette</ColorInterp></PAMRasterBand>'
    (tmp_path / "scene.tif.aux.xml").write_text(f"<PAMDataset>{side}</PAMDataset>")
    with rasterio.open(path) as dataset:
        assert dataset.colorinterp == (rasterio.enums.ColorInterp.palette,)
    assert open_scene(path).bands[0].color is None


def test_info_prints_json_for_an_infinite_scale(tmp_path: Path, command: Geomesh) -> None:
    path = write_raster(tmp_path, change=lambda dataset: setattr(dataset, "offsets", [np.inf]))
    run = command("info", path, "--json")
    (band,) = json.loads(run.out, parse_constant=pytest.fail)["bands"]
    assert (band["scale"], band["offset"]) == (1, "inf")
