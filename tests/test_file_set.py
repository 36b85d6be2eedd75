"""Rasters of several files: the file that is missing or broken is named, in one line.

The sets are written by GDAL itself.
"""

from __future__ import annotations

import os
import re
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest
import rasterio
import rasterio.shutil

import geomesh
from geomesh.errors import SourceError
from geomesh.pipeline import mesh_file
from geomesh.raster.open import open_scene
from support.cases import vrt_of
from support.rasters import COLS, NORTH_UP, ROWS, picture, write_raster

if TYPE_CHECKING:
    from support.commands import Geomesh

pytestmark = pytest.mark.filterwarnings("ignore::geomesh.errors.GeomeshWarning")


def refusal(source: str | Path) -> str:
    """Return the error of opening a raster, which must be one line that names it."""
    with pytest.raises(SourceError) as caught:
        open_scene(source)
    text = str(caught.value)
    assert text.startswith(f"{source}")
    assert "\n" not in text
    return text


def mosaic(folder: Path, name: str = "mosaic.vrt") -> Path:
    """Write a VRT of two tiles side by side."""
    tiles = ""
    for tile, left in (("left.tif", 0), ("right.tif", COLS)):
        write_raster(folder, tile, tiled=True, compress="deflate", blockxsize=16, blockysize=16)
        tiles += (
            f'<SimpleSource><SourceFilename relativeToVRT="1">{tile}</SourceFilename>'
            f'<SourceBand>1</SourceBand><SrcRect xOff="0" yOff="0" xSize="{COLS}" ySize="{ROWS}"/>'
            f'<DstRect xOff="{left}" yOff="0" xSize="{COLS}" ySize="{ROWS}"/></SimpleSource>'
        )
    text = vrt_of("left.tif", size=(2 * COLS, ROWS))
    (folder / name).write_text(re.sub("<SimpleSource>.*</SimpleSource>", tiles, text))
    return folder / name


def test_a_missing_tile_is_named_before_the_work(
    tmp_path: Path, command: Geomesh, monkeypatch: pytest.MonkeyPatch
) -> None:
    source = mosaic(tmp_path)
    assert len(geomesh.mesh_raster(source).nodes) > 4
    (tmp_path / "right.tif").unlink()
    monkeypatch.setattr(mesh_file, "mesh_scene", lambda *_, **__: pytest.fail("it was too late"))
    error = command("mesh", source, "-o", tmp_path / "mesh.gpkg").error()
    assert error == (
        f"{source}: its file {tmp_path / 'right.tif'} is missing; put it there, or make the mosaic "
        "again without it"
    )


def test_a_tile_that_is_not_needed_may_be_missing(tmp_path: Path) -> None:
    source = mosaic(tmp_path)
    (tmp_path / "right.tif").unlink()
    west, north = NORTH_UP.c, NORTH_UP.f
    left = (west, north - 30 * ROWS, west + 30 * COLS, north)
    scene = open_scene(source, bounds=left)
    assert (scene.read(scene.grid.extent)[0] == picture()).all()
    with pytest.raises(SourceError, match=r"right\.tif is missing"):
        open_scene(source, bounds=(left[0], left[1], left[2] + 30, left[3]))


def test_a_band_that_is_not_chosen_may_be_missing(tmp_path: Path) -> None:
    write_raster(tmp_path, "one.tif")
    band = re.findall("<VRTRasterBand.*</VRTRasterBand>", vrt_of("one.tif"))[0]
    both = band + band.replace('band="1"', 'band="2"').replace("one.tif", "two.tif")
    source = tmp_path / "bands.vrt"
    source.write_text(vrt_of("one.tif").replace(band, both))
    assert len(open_scene(source, bidx=[1]).bands) == 1
    assert "two.tif is missing" in refusal(source)


@pytest.mark.parametrize("lost", ["left.tif", "mosaic.vrt"])
def test_a_file_missing_in_a_mosaic_of_mosaics_is_named(tmp_path: Path, lost: str) -> None:
    mosaic(tmp_path)
    source = tmp_path / "outer.vrt"
    source.write_text(vrt_of("mosaic.vrt", size=(2 * COLS, ROWS)))
    open_scene(source)
    (tmp_path / lost).unlink()
    assert f"its file {tmp_path / lost} is missing" in refusal(source)


def test_a_link_to_a_mosaic_finds_the_tiles_beside_the_mosaic(tmp_path: Path) -> None:
    source = mosaic(tmp_path / "there")
    (tmp_path / "here").mkdir()
    (tmp_path / "here" / "link.vrt").symlink_to(source)
    assert len(geomesh.mesh_raster(tmp_path / "here" / "link.vrt").nodes) > 4
    (tmp_path / "there" / "left.tif").unlink()
    assert f"{tmp_path / 'there' / 'left.tif'} is missing" in refusal(
        tmp_path / "here" / "link.vrt"
    )


def test_a_mosaic_that_names_itself_comes_to_an_end(tmp_path: Path) -> None:
    source = tmp_path / "self.vrt"
    source.write_text(vrt_of("self.vrt"))
    open_scene(source)


@pytest.mark.parametrize("broken", ["truncated", "text", "empty"])
def test_a_broken_tile_is_named(tmp_path: Path, broken: str) -> None:
    source = mosaic(tmp_path)
    tile = tmp_path / "right.tif"
    whole = tile.read_bytes()
    parts = {"truncated": whole[: len(whole) // 2], "text": b"no raster", "empty": b""}
    tile.write_bytes(parts[broken])
    with pytest.raises(SourceError) as caught:
        geomesh.mesh_raster(source)
    assert f": its tile {tile} is truncated or damaged; download" in str(caught.value)


def test_remote_tiles_are_left_to_gdal(tmp_path: Path) -> None:
    source = tmp_path / "remote.vrt"
    for target in ("/vsicurl/http://127.0.0.1:9/a.tif", "http://127.0.0.1:9/a.tif"):
        source.write_text(vrt_of(target).replace('relativeToVRT="1"', 'relativeToVRT="0"'))
        open_scene(source)


# GDAL's driver, the file to give, the file to remove, and what is said of it.
SETS = {
    "EHdr": ("EHdr", "scene.bil", "scene.hdr", "its file scene.hdr, that describes it, is missing"),
    "EHdr, float": ("EHdr", "scene.flt", "scene.hdr", "its file scene.hdr, that describes it"),
    "ENVI": ("ENVI", "scene.dat", "scene.hdr", "its file scene.hdr, that describes it"),
    "ENVI, img": ("ENVI", "scene.img", "scene.hdr", "if it is an ENVI image, its file scene.hdr"),
    "ENVI, bsq": ("ENVI", "scene.bsq", "scene.hdr", "its file scene.hdr, that describes it"),
    "SAGA": ("SAGA", "scene.sdat", "scene.sgrd", "its file scene.sgrd, that describes it"),
    "Idrisi": ("RST", "scene.rst", "scene.rdc", "its file scene.rdc, that describes it"),
    "R": ("RRASTER", "scene.grd", "scene.gri", "its file scene.gri, with its pixels, is missing"),
    "ERMapper": ("ERS", "scene.ers", "scene", "its file scene, with its pixels, is missing"),
}


def write_set(folder: Path, driver: str, name: str) -> Path:
    dtype = "float32" if driver in ("SAGA", "RST") or name.endswith(".flt") else "uint8"
    write_raster(folder / "from", data=picture().astype(dtype))
    with rasterio.open(folder / "from" / "scene.tif") as dataset:
        rasterio.shutil.copy(dataset, folder / name, driver=driver)
    shutil.rmtree(folder / "from")
    open_scene(folder / name)
    return folder / name


@pytest.mark.parametrize(("driver", "name", "lost", "told"), SETS.values(), ids=SETS)
def test_the_missing_file_of_a_set_is_named(
    tmp_path: Path, driver: str, name: str, lost: str, told: str
) -> None:
    source = write_set(tmp_path, driver, name)
    (tmp_path / lost).rename(tmp_path / "elsewhere")
    assert f"{source}: {told}" in refusal(source)
    (tmp_path / "elsewhere").rename(tmp_path / lost)
    open_scene(source)


@pytest.mark.parametrize(
    ("driver", "name", "given"),
    [
        ("EHdr", "scene.bil", "scene.hdr"),
        ("ENVI", "scene.dat", "scene.hdr"),
        ("EHdr", "scene.bil", "scene.prj"),
        ("SAGA", "scene.sdat", "scene.sgrd"),
        ("RST", "scene.rst", "scene.rdc"),
        ("RRASTER", "scene.grd", "scene.gri"),
    ],
)
def test_a_file_of_a_set_given_in_its_place_is_told(
    tmp_path: Path, driver: str, name: str, given: str
) -> None:
    write_set(tmp_path, driver, name)
    assert f"give {name} instead" in refusal(tmp_path / given)
    (tmp_path / name).unlink()
    if given.endswith((".hdr", ".sgrd", ".rdc")):
        assert "file of pixels is missing" in refusal(tmp_path / given)


def test_files_beside_a_raster_are_not_rasters(tmp_path: Path) -> None:
    source = Path(write_raster(tmp_path, data=picture(1, 600, 600), tfw="yes"))
    with rasterio.Env(TIFF_USE_OVR=True), rasterio.open(source, "r+") as dataset:
        dataset.build_overviews([2])
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=False), rasterio.open(source, "r+") as dataset:
        dataset.write_mask(np.ones((600, 600), np.bool_))
    (tmp_path / "scene.tif.aux.xml").write_text("<PAMDataset/>")
    open_scene(source)
    for name in ("scene.tif.ovr", "scene.tif.msk", "scene.tif.aux.xml", "scene.tfw"):
        assert (tmp_path / name).exists(), name
        assert refusal(tmp_path / name).endswith(" of scene.tif; give scene.tif instead")
    (tmp_path / "scene.tfw").unlink()
    open_scene(source)
    shutil.copy(source, tmp_path / "scene.msk")  # a raster of its own
    open_scene(tmp_path / "scene.msk")


def test_a_file_of_pixels_that_is_missed_while_reading_is_named(tmp_path: Path) -> None:
    """An image of ERDAS may keep its pixels in a second file, which GDAL opens late."""
    with rasterio.open(write_raster(tmp_path)) as dataset:
        rasterio.shutil.copy(dataset, tmp_path / "spilled.img", driver="HFA", use_spill="yes")
    (tmp_path / "spilled.ige").unlink()
    with pytest.raises(SourceError, match=r"spilled\.ige is missing; put it there \(GDAL"):
        geomesh.mesh_raster(tmp_path / "spilled.img")


def test_an_arc_grid_without_one_of_its_files(tmp_path: Path) -> None:
    folder = tmp_path / "grid"
    folder.mkdir()
    for name in ("hdr.adf", "w001001.adf", "dblbnd.adf"):
        (folder / name).write_bytes(b"\0" * 64)
    for source in (folder, folder / "w001001.adf"):
        assert f"its file w001001x.adf is missing; put it into {folder}" in refusal(source)
    (tmp_path / "other").mkdir()
    assert "is a folder; name the raster files in it" in refusal(tmp_path / "other")


def test_a_beam_dimap_is_told_by_its_bands(tmp_path: Path) -> None:
    source = tmp_path / "product.dim"
    source.write_text("<Dimap_Document/>")
    assert "its folder product.data is missing; put it beside" in refusal(source)
    write_set(tmp_path / "product.data", "ENVI", "band_1.img")
    told = refusal(source)
    band = tmp_path / "product.data" / "band_1.img"
    assert told.endswith(f"its bands are files of their own; give one, such as {band}")
    open_scene(band)


@pytest.mark.skipif(os.name != "posix", reason="names are bytes on POSIX only")
def test_a_name_that_is_no_utf_8_is_refused_beside_rasters_that_are_meshed(
    tmp_path: Path, command: Geomesh
) -> None:
    source, odd = write_raster(tmp_path), tmp_path / os.fsdecode(b"\xff.tif")
    shutil.copy(source, odd)
    run = command("mesh", source, odd, "-o", tmp_path / "out")
    assert run.code == 1
    assert "is not valid UTF-8" in run.err
    with pytest.raises(SourceError, match="not valid UTF-8, so GDAL cannot open it; rename it"):
        open_scene(odd)
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["scene.gpkg"]
    assert command("mesh", source, "-o", tmp_path / "out" / os.fsdecode(b"\xff.gpkg")).code == 1
