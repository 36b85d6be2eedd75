"""The small rasters that are mutated: every kind of pixels, layout and georeference."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np
import rasterio
from affine import Affine
from rasterio.control import GroundControlPoint
from rasterio.enums import Resampling
from rasterio.shutil import copy

from support.rasters import COLS, NORTH_UP, ROWS, UTM, picture, write_raster

TILES = {"tiled": True, "blockxsize": 16, "blockysize": 16}


@dataclass(frozen=True)
class Original:
    """A raster: the file to open, the file to change, and all its files."""

    kind: Literal["tiff", "text", "png"]
    opened: Path
    changed: Path

    @property
    def files(self) -> list[Path]:
        return sorted(self.opened.parent.iterdir())


Writer = Callable[[Path], Original]


def _tiff(data: np.ndarray, **options: Any) -> Writer:
    def write(folder: Path) -> Original:
        path = Path(write_raster(folder, "scene.tif", data, **options))
        return Original("tiff", path, path)

    return write


def _cog(folder: Path) -> Original:
    with rasterio.MemoryFile() as memory:
        with memory.open(
            driver="GTiff", width=540, height=600, count=3, dtype="uint8", crs=UTM,
            transform=NORTH_UP,
        ) as dataset:  # fmt: skip
            dataset.write(picture(3, 600, 540))
        with memory.open() as dataset:
            path = folder / "scene.tif"
            copy(dataset, path, driver="COG", BLOCKSIZE=256, COMPRESS="DEFLATE")
    return Original("tiff", path, path)


def _side_file(folder: Path) -> Original:
    path = write_raster(folder, "scene.tif", picture(3), nodata=3)
    with rasterio.open(path, "r+", IGNORE_COG_LAYOUT_BREAK="YES") as dataset:
        dataset.update_tags(1, ns="xml:side", text="<a/>")
    side = folder / "scene.tif.aux.xml"
    copy(path, folder / "scene.png", driver="PNG", WORLDFILE="YES")
    side.write_bytes((folder / "scene.png.aux.xml").read_bytes())
    (folder / "scene.png.aux.xml").unlink()
    (folder / "scene.png").unlink()
    (folder / "scene.wld").unlink()
    return Original("text", Path(path), side)


def _vrt(folder: Path) -> Original:
    source = write_raster(folder, "source.tif", picture(3), nodata=3)
    copy(source, folder / "scene.vrt", driver="VRT")
    return Original("text", folder / "scene.vrt", folder / "scene.vrt")


_SOURCE = """
    <{kind}Source>
      <SourceFilename relativeToVRT="1">{name}.tif</SourceFilename>
      <SourceBand>1</SourceBand>
      <SrcRect xOff="0" yOff="0" xSize="64" ySize="48" />
      <DstRect xOff="{left}" yOff="0" xSize="{width}" ySize="48" />{more}
    </{kind}Source>"""


def _mosaic(folder: Path) -> Original:
    """Two files side by side, one of them scaled and with half as many pixels."""
    write_raster(folder, "source.tif", picture(), nodata=3)
    write_raster(folder, "other.tif", picture() // 2)
    more = "<ScaleOffset>2</ScaleOffset><ScaleRatio>1.5</ScaleRatio><NODATA>9</NODATA>"
    sources = _SOURCE.format(kind="Simple", name="source", left=0, width=64, more="")
    sources += _SOURCE.format(kind="Complex", name="other", left=64, width=32, more=more)
    path = folder / "scene.vrt"
    path.write_text(
        f"""<VRTDataset rasterXSize="96" rasterYSize="48">
  <SRS>{UTM}</SRS>
  <GeoTransform>288000, 30, 0, 9120000, 0, -30</GeoTransform>
  <VRTRasterBand dataType="Float32" band="1">
    <NoDataValue>-5</NoDataValue>
    <Scale>0.5</Scale>{sources}
  </VRTRasterBand>
</VRTDataset>
"""
    )
    return Original("text", path, path)


def _png(folder: Path) -> Original:
    path = Path(write_raster(folder, "scene.png", picture(3), driver="PNG", crs=None))
    return Original("png", path, path)


def _envi(folder: Path) -> Original:
    data = picture(2).astype(np.uint16)
    path = Path(write_raster(folder, "scene.img", data, driver="ENVI", nodata=3))
    (folder / "scene.img.aux.xml").unlink()  # repeats the nodata value of the header
    return Original("text", path, path.with_suffix(".hdr"))


def _with_nan() -> np.ndarray:
    data = picture().astype(np.float32) / 7
    data[:, 10:22, 20:30] = np.nan
    return data


def _describe(dataset: Any) -> None:
    dataset.descriptions = ("blue", "green", "red", "near infrared", "Höhe 北京")
    dataset.scales, dataset.offsets = [0.1] * 5, [-5.0] * 5
    dataset.units = ["m"] * 5
    dataset.update_tags(AREA_OR_POINT="Point", TIFFTAG_DATETIME="2026:01:01 00:00:00")
    dataset.update_tags(1, STATISTICS_MINIMUM=1, STATISTICS_MAXIMUM=200)


def _mask(dataset: Any) -> None:
    mask = np.full((ROWS, COLS), 255, np.uint8)
    mask[5:30, 8:20] = 0
    dataset.write_mask(mask)


def _palette(dataset: Any) -> None:
    dataset.write_colormap(1, {n: (n, 255 - n, n // 2, 255 * (n > 20)) for n in range(256)})


def _overviews(dataset: Any) -> None:
    dataset.build_overviews([2, 4], Resampling.average)


_RPC = {
    "LINE_OFF": "24", "SAMP_OFF": "32", "LAT_OFF": "-8", "LONG_OFF": "-35", "HEIGHT_OFF": "0",
    "LINE_SCALE": "24", "SAMP_SCALE": "32", "LAT_SCALE": "0.1", "LONG_SCALE": "0.1",
    "HEIGHT_SCALE": "100", "LINE_NUM_COEFF": "0 0 1" + " 0" * 17,
    "LINE_DEN_COEFF": "1" + " 0" * 19, "SAMP_NUM_COEFF": "0 1" + " 0" * 18,
    "SAMP_DEN_COEFF": "1" + " 0" * 19,
}  # fmt: skip


def _rpc(dataset: Any) -> None:
    dataset.update_tags(ns="RPC", **_RPC)


_GCPS = [
    GroundControlPoint(row, col, 288_000 + 30 * col, 9_120_000 - 30 * row, 0)
    for row in (0, ROWS)
    for col in (0, COLS)
]

WRITERS: dict[str, Writer] = {
    "strips": _tiff(picture(3), compress="lzw", blockysize=7),
    "nodata": _tiff(
        picture().astype(np.uint16) * 9, compress="deflate", predictor=2, nodata=45, **TILES
    ),
    "uint32": _tiff(picture().astype(np.uint32) * 99_999, blockysize=5),
    "float": _tiff(_with_nan(), compress="deflate", predictor=3, **TILES),
    "double": _tiff(_with_nan().astype(np.float64), nodata=-9999, compress="zstd", **TILES),
    "plain floats": _tiff(_with_nan(), nodata=-9999, blockysize=8),
    "plain doubles": _tiff(_with_nan().astype(np.float64), blockysize=8),
    "signed": _tiff(picture().astype(np.int16) - 90, compress="packbits", nodata=-32768),
    "jpeg": _tiff(picture(3), compress="jpeg", photometric="ycbcr", interleave="pixel", **TILES),
    "palette": _tiff(picture(), photometric="palette", change=_palette),
    "alpha": _tiff(picture(4), photometric="rgb", alpha="yes", compress="deflate", **TILES),
    "mask": _tiff(picture(), change=_mask, **TILES),
    "overviews": _tiff(picture(3, 200, 150), change=_overviews, compress="lzw", **TILES),
    "rotated": _tiff(picture(2), transform=NORTH_UP @ Affine.rotation(20)),
    "gcps": _tiff(picture(), transform=None, gcps=_GCPS, crs=UTM),
    "rpc": _tiff(picture(), transform=None, crs=None, change=_rpc),
    "degrees": _tiff(
        picture(), crs="EPSG:4326", transform=Affine(0.01, 0, -35, 0, -0.01, -8), compress="lerc"
    ),
    "bands": _tiff(
        picture(5).astype(np.float32), change=_describe, interleave="band", compress="lzw"
    ),
    "big": _tiff(picture(3), bigtiff="yes", compress="webp", webp_lossless=True, **TILES),
    "big-endian": _tiff(
        picture(2).astype(np.uint16), endianness="big", predictor=2, compress="lzw"
    ),
    "bits": _tiff((picture() > 60).astype(np.uint8), nbits=1, compress="ccittfax4"),
    "complex": _tiff(picture().astype(np.complex64)),
    "cog": _cog,
    "side file": _side_file,
    "vrt": _vrt,
    "mosaic": _mosaic,
    "png": _png,
    "envi": _envi,
}


def write_originals(folder: Path) -> dict[str, Original]:
    """Write each original into a folder of its own below `folder`."""
    found = {}
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True):
        for name, write in WRITERS.items():
            (folder / name).mkdir(parents=True)
            found[name] = write(folder / name)
    return found
