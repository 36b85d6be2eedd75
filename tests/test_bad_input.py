"""Bad input is normal input: whatever file is given, a sound mesh or one line that helps.

Every case is a real file, and goes through the library and through the command
line. It ends in one of two ways:

- a mesh that passes its certificate, with exactly the warnings expected;
- a GeomeshError whose text is one line that names the culprit, what is wrong with
  it and the way out; on the command line, exit code 1 and nothing else changed.
"""

from __future__ import annotations

import json
import re
import signal
import sys
import warnings
import zipfile
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from functools import cache, partial
from pathlib import Path
from typing import Any, NamedTuple

import geopandas as gpd
import numpy as np
import pytest
import rasterio
import shapely
import shapely.affinity
from affine import Affine
from pyproj import Geod
from rasterio.control import GroundControlPoint
from rasterio.enums import ColorInterp
from rasterio.io import MemoryFile
from rasterio.rpc import RPC
from rasterio.vrt import WarpedVRT

import geomesh
from geomesh.cli import main
from geomesh.errors import GeomeshError, GeomeshWarning
from geomesh.io.read import read_mesh

SAMPLES = Path(__file__).parent.parent / "data_samples"
ROWS, COLS = 48, 64
SIZE = ROWS * COLS
UTM = "EPSG:32725"
NORTH_UP = Affine(30, 0, 288_000, 0, -30, 9_120_000)
MARS = "IAU_2015:49900"
GEOSTATIONARY = "+proj=geos +lon_0=-75 +h=35786023 +sweep=x"
FLOAT32_MIN = float(np.finfo(np.float32).min)

NO_CRS = "has no CRS: the mesh has none either"
IN_PIXELS = "the mesh is in pixel coordinates, without a CRS"
NO_KEYPOINTS = "no keypoints found .* the outline only"
FEWER = "nodes of the .* asked for: the image has no more keypoints"
NO_HULL = "span no area: the mesh covers the whole frame"


@dataclass(frozen=True)
class Case:
    """One source with options, and how it should end.

    Parameters
    ----------
    make : callable(folder)
        Writes the source into an empty folder and returns it.
    options : mapping, or callable(folder) that returns one
        For mesh_raster, and in another form for the command line.
    refused : str, optional
        Pattern of the error: its cause and the way out. None: a mesh is expected.
    names : str, optional
        Text the error must hold; the name of the source file by default.
    warns : tuple of str
        Patterns of the warnings; each warning fits one, and each one is met.
    valid : int, optional
        Number of pixels that hold data.
    """

    make: Callable[[Path], Any]
    options: Mapping[str, Any] | Callable[[Path], Mapping[str, Any]] = field(default_factory=dict)
    refused: str | None = None
    names: str | None = None
    warns: tuple[str, ...] = ()
    valid: int | None = None

    def prepare(self, folder: Path) -> tuple[Any, Mapping[str, Any]]:
        """Return source and options, with their files written into `folder`."""
        folder.mkdir()
        source = self.make(folder)
        return source, self.options(folder) if callable(self.options) else self.options


# ---------------------------------------------------------------- writing rasters


@cache
def landsat() -> np.ndarray:
    with rasterio.open(SAMPLES / "olinda_landsat7_rgb_uint8.tif") as dataset:
        return dataset.read()


def picture(bands: int = 1, rows: int = ROWS, cols: int = COLS) -> np.ndarray:
    """Real data of any size, without the value 0: uint8 (bands, rows, cols)."""
    source = landsat()
    down, across = (reflected(*sizes) for sizes in zip((rows, cols), source.shape[1:], strict=True))
    return np.maximum(source[np.arange(bands) % 3][:, down[:, None], across], 1)


def reflected(count: int, size: int) -> np.ndarray:
    """`count` indices that run to and fro over 0..size-1, from 0 on."""
    turn = np.arange(count) % (2 * size)
    return np.where(turn < size, turn, 2 * size - 1 - turn)


def write(
    folder: Path,
    name: str = "scene.tif",
    data: np.ndarray | None = None,
    *,
    change: Callable[[Any], None] | None = None,
    **profile: Any,
) -> str:
    """Write a raster (UTM, 30 m, unless `profile` says otherwise) and return its path."""
    data = picture() if data is None else data
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    profile = {
        "driver": "GTiff",
        "crs": UTM,
        "transform": NORTH_UP,
        "count": len(data),
        "height": data.shape[1],
        "width": data.shape[2],
        "dtype": data.dtype,
    } | profile
    with rasterio.open(path, "w", **profile) as dataset:
        dataset.write(data)
        if change is not None:
            change(dataset)
    return str(path)


def raster(data: np.ndarray | None = None, **options: Any) -> Callable[[Path], str]:
    """Return what writes the raster: see `write`."""
    return partial(write, data=data, **options)


def holed(value: float, dtype: str = "uint8", bands: int = 1) -> np.ndarray:
    """The picture with 12 x 10 = 120 pixels of `value`, which occurs nowhere else."""
    data = picture(bands).clip(2, 200).astype(dtype)
    data[:, 10:22, 20:30] = value
    return data


def constant(rows: int, cols: int) -> np.ndarray:
    return np.full((1, rows, cols), 7, np.uint8)


def truncated(share: float) -> Callable[[Path], str]:
    """Return what writes a tiled, compressed raster of which only a part has arrived."""

    def make(folder: Path) -> str:
        path = write(
            folder, data=picture(3, 1200, 1500), tiled=True, compress="deflate", photometric="rgb"
        )
        whole = Path(path).read_bytes()
        Path(path).write_bytes(whole[: int(len(whole) * share)])
        return path

    return make


def text_file(name: str, content: str = "") -> Callable[[Path], str]:
    def make(folder: Path) -> str:
        (folder / name).write_text(content)
        return str(folder / name)

    return make


def vrt_of(target: str, *, nodata: str = "", size: tuple[int, int] = (COLS, ROWS)) -> str:
    """A VRT of one Byte band of `target`."""
    tag = f"<NoDataValue>{nodata}</NoDataValue>" if nodata else ""
    return (
        f'<VRTDataset rasterXSize="{size[0]}" rasterYSize="{size[1]}">'
        "<SRS>EPSG:32725</SRS><GeoTransform>288000,30,0,9120000,0,-30</GeoTransform>"
        f'<VRTRasterBand dataType="Byte" band="1">{tag}<SimpleSource>'
        f'<SourceFilename relativeToVRT="1">{target}</SourceFilename><SourceBand>1</SourceBand>'
        "</SimpleSource></VRTRasterBand></VRTDataset>"
    )


def vrt_with_nodata(nodata: str, value: int) -> Callable[[Path], str]:
    """Return what writes a VRT that declares a nodata value its type cannot hold."""

    def make(folder: Path) -> str:
        write(folder, "below.tif", holed(value))
        return text_file("scene.vrt", vrt_of("below.tif", nodata=nodata))(folder)

    return make


def with_alpha(levels: int | np.ndarray, bands: int = 3) -> Callable[[Path], str]:
    """Return what writes `bands` of data and one of alpha."""
    alpha = np.broadcast_to(np.uint8(levels), (1, ROWS, COLS)).astype(np.uint8)
    colors = ("red", "green", "blue") if bands == 3 else ("gray",)
    tags = [ColorInterp[color] for color in (*colors, "alpha")]
    return raster(
        np.concatenate([picture(bands), alpha]),
        photometric="rgb" if bands == 3 else "minisblack",
        alpha="yes",
        change=lambda dataset: setattr(dataset, "colorinterp", tags),
    )


def palette(driver: str, transparent: int) -> Callable[[Path], str]:
    """Return what writes a palette raster of 8 entries, one of them transparent."""
    levels = (picture() // 32).astype(np.uint8)
    levels[:, 10:22, 20:30] = transparent

    def change(dataset: Any) -> None:
        entries = {k: (30 * k, 200 - 20 * k, 5 * k, 255) for k in range(9)}
        dataset.write_colormap(1, entries | {transparent: (1, 2, 3, 0)})

    extension = {"PNG": ".png", "GTiff": ".tif"}[driver]
    return partial(write, name=f"scene{extension}", data=levels, driver=driver, change=change)


def masked(*, internal: bool) -> Callable[[Path], str]:
    """Return what writes a raster with a mask band, inside the file or beside it."""
    mask = np.full((ROWS, COLS), 255, np.uint8)
    mask[10:22, 20:30] = 0

    def make(folder: Path) -> str:
        with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=internal):
            return write(folder, change=lambda dataset: dataset.write_mask(mask))

    return make


def with_gcps(*points: tuple[float, float, float, float]) -> Callable[[Path], str]:
    """Return what writes a raster placed by (row, col, x, y) alone."""
    gcps = [GroundControlPoint(*point) for point in points]
    return raster(
        transform=None, crs=None, change=lambda dataset: setattr(dataset, "gcps", (gcps, UTM))
    )


def with_rpcs(folder: Path) -> str:
    rpcs = RPC(
        height_off=100.0,
        height_scale=500.0,
        lat_off=-8.0,
        lat_scale=0.1,
        long_off=-34.9,
        long_scale=0.1,
        line_off=24.0,
        line_scale=24.0,
        samp_off=32.0,
        samp_scale=32.0,
        line_num_coeff=[0.0, 0.0, -1.0] + [0.0] * 17,
        line_den_coeff=[1.0] + [0.0] * 19,
        samp_num_coeff=[0.0, 1.0] + [0.0] * 18,
        samp_den_coeff=[1.0] + [0.0] * 19,
    )
    return write(
        folder, transform=None, crs=None, change=lambda dataset: setattr(dataset, "rpcs", rpcs)
    )


def container(folder: Path) -> str:
    """A GeoPackage of two rasters, which has no bands of its own."""
    for table in ("one", "two"):
        write(
            folder,
            "tables.gpkg",
            picture(3),
            driver="GPKG",
            raster_table=table,
            append_subdataset="YES" if table == "two" else "NO",
        )
    return str(folder / "tables.gpkg")


def pages(folder: Path) -> str:
    """A TIFF of two pages; GDAL takes the first one."""
    path = write(folder)
    return write(folder, Path(path).name, holed(255), append_subdataset=True)


def zipped(folder: Path, member: str = "scene.tif") -> str:
    path = Path(write(folder))
    with zipfile.ZipFile(folder / "all.zip", "w") as archive:
        archive.write(path, path.name)
    path.unlink()
    return f"/vsizip/{folder}/all.zip/{member}"


def descriptions(*names: str) -> Callable[[Path], str]:
    return raster(
        picture(len(names)), change=lambda dataset: setattr(dataset, "descriptions", names)
    )


# ------------------------------------------------------------------------- cases

SOURCES: dict[str, Case] = {
    # Files that are no raster, or not all of one.
    "missing file": Case(
        lambda folder: str(folder / "scene.tif"), refused="no such file; check the path"
    ),
    "folder": Case(str, refused="is a folder; name the raster files in it"),
    "text file": Case(text_file("scene.tif", "not a raster\n"), refused="not a raster that GDAL"),
    "empty file": Case(text_file("scene.tif"), refused="not a raster that GDAL"),
    "vrt that is not xml": Case(
        text_file("scene.vrt", "<VRTDataset"), refused="not a raster that GDAL"
    ),
    "vrt of a missing file": Case(
        text_file("scene.vrt", vrt_of("gone.tif")), refused="cannot read columns .*gone.tif"
    ),
    **{
        f"truncated at {share:.0%}": Case(
            truncated(share), refused=r"cannot read columns \d+ to \d+, rows \d+ to \d+: .* damaged"
        )
        for share in (0.3, 0.6, 0.95)
    },
    "zip": Case(zipped, valid=SIZE),
    "zip without that file": Case(
        partial(zipped, member="other.tif"), names="other.tif", refused="all.zip"
    ),
    "container": Case(container, refused="no bands of its own; name one of its subdatasets: GPKG"),
    "one raster of a container": Case(
        lambda folder: f"GPKG:{container(folder)}:two", options={"bidx": [1]}
    ),
    "raster that a container lacks": Case(
        lambda folder: f"GPKG:{container(folder)}:three",
        names="three",
        refused="not a raster that GDAL",
    ),
    "pages": Case(pages, valid=SIZE),
    "second page": Case(
        lambda folder: f"GTIFF_DIR:2:{pages(folder)}", options={"nodata": 255}, valid=SIZE - 120
    ),
    # Bands.
    **{
        f"band {bidx}": Case(raster(), {"bidx": bidx}, refused="has bands 1 to 1")
        for bidx in ([0], [-1], [2], [10**12])
    },
    "band twice": Case(raster(picture(2)), {"bidx": [2, 2]}, refused="each band once"),
    "complex values": Case(
        raster(picture().astype(np.complex64)), refused="complex64: .* take the magnitude"
    ),
    "gray of a band not chosen": Case(
        raster(picture(3)), {"bidx": [1, 2], "gray": "band:3"}, names="band:3", refused="1, 2"
    ),
    "luma of two bands": Case(
        raster(picture(2)), {"gray": "luma"}, names="luma", refused="choose three with --bidx"
    ),
    "60 bands": Case(raster(picture(60)), valid=SIZE),
    "descriptions": Case(
        descriptions(
            *("id", "count", "rowid", "rowid", "drop table nodes; --", "'\"`[]", "\N{SATELLITE}"),
            *("select", "Größe", "x" * 300, "x" * 300, "", "1", "b1", "geom", "NDVI (10 m)"),
        ),
        valid=SIZE,
    ),
    # Values.
    "all nodata": Case(
        raster(constant(ROWS, COLS), nodata=7), refused="no valid pixel .* or override .* --nodata"
    ),
    "all nan": Case(
        raster(np.full((1, ROWS, COLS), np.nan, np.float32)), refused="no valid pixel .* --nodata"
    ),
    "constant": Case(raster(constant(ROWS, COLS)), warns=(NO_KEYPOINTS,), valid=SIZE),
    "constant, paper": Case(
        raster(constant(ROWS, COLS)), {"preset": "paper"}, warns=(NO_HULL,), valid=SIZE
    ),
    **{
        f"{rows} x {cols}, {preset}": Case(
            raster(picture(3, rows, cols)),
            {"preset": preset},
            warns=(NO_KEYPOINTS if preset == "features" else f"{NO_HULL}|^$",),
            valid=rows * cols,
        )
        for rows, cols in ((1, 1), (1, 7), (7, 1), (2, 2), (3, 3))
        for preset in ("features", "paper")
    },
    "20000 x 2": Case(raster(picture(1, 2, 20_000)), valid=40_000, warns=(f"{NO_KEYPOINTS}|^$",)),
    "2 x 20000": Case(raster(picture(1, 20_000, 2)), valid=40_000, warns=(f"{NO_KEYPOINTS}|^$",)),
    **{
        f"{value} among float32": Case(raster(holed(value, "float32")), valid=SIZE - 120)
        for value in (np.nan, np.inf, -np.inf)
    },
    **{
        f"nodata {value:g} of {dtype}": Case(
            raster(holed(value, dtype), nodata=value), valid=SIZE - 120
        )
        for value, dtype in (
            (1, "uint8"),
            (255, "uint8"),
            (np.nan, "float32"),
            (FLOAT32_MIN, "float32"),
            (-128, "int8"),
            (-9999, "int16"),
            (2.0**32 - 1, "uint32"),
            (-9999.0, "float64"),
        )
    },
    "nodata as 32 bits in a file of 64": Case(
        raster(holed(FLOAT32_MIN, "float64"), nodata=FLOAT32_MIN), valid=SIZE - 120
    ),
    "nodata -9999 declared for bytes": Case(vrt_with_nodata("-9999", 241), valid=SIZE),
    "nodata nan declared for bytes": Case(vrt_with_nodata("nan", 0), valid=SIZE),
    **{
        f"--nodata {value:g} of {dtype}": Case(
            raster(holed(held, dtype)), {"nodata": value}, valid=SIZE - missing
        )
        for value, dtype, held, missing in (
            (255, "uint8", 255, 120),
            (0, "uint8", 0, 120),
            # What bytes cannot hold no byte is equal to.
            (-1, "uint8", 255, 0),
            (300, "uint8", 44, 0),
            (0.5, "uint8", 0, 0),
            (np.nan, "uint8", 0, 0),
            (np.inf, "int16", 0, 0),
            (-9999, "float32", -9999, 120),
            (FLOAT32_MIN, "float32", FLOAT32_MIN, 120),
            (np.nan, "float32", np.nan, 120),
            (1e300, "float32", 201, 0),
        )
    },
    "--nodata in place of the file's own": Case(
        raster(holed(255), nodata=255), {"nodata": 254}, valid=SIZE
    ),
    **{
        f"values of {dtype}": Case(raster(picture(3).astype(dtype)), valid=SIZE)
        for dtype in ("int8", "uint16", "int16", "uint32", "int32", "uint64", "int64", "float64")
    },
    "values around 1e12": Case(raster(picture() * 1e-3 + 1e12), valid=SIZE),
    "values up to 1e300": Case(raster(picture() * 1e298), valid=SIZE),
    "values down to 1e-300": Case(raster(picture() * 1e-300), valid=SIZE),
    "int64 to its limits": Case(
        raster(np.where(picture() > 60, np.iinfo(np.int64).max, np.iinfo(np.int64).min)), valid=SIZE
    ),
    "one bit": Case(raster((picture() > 60).astype(np.uint8), nbits=1), valid=SIZE),
    # Masks.
    "alpha": Case(with_alpha(np.where(np.arange(COLS) < 16, 0, 255)), valid=ROWS * (COLS - 16)),
    "half-transparent everywhere": Case(with_alpha(127), valid=SIZE),
    "alpha of 1": Case(with_alpha(np.where(np.arange(COLS) < 16, 0, 1)), valid=ROWS * (COLS - 16)),
    "transparent everywhere": Case(with_alpha(0), refused="no valid pixel"),
    "alpha as data": Case(with_alpha(255), {"bidx": [4]}, refused="alpha .* leave it out"),
    "one band beside alpha": Case(
        with_alpha(np.where(np.arange(COLS) < 16, 0, 255)),
        {"bidx": [2]},
        valid=ROWS * (COLS - 16),
    ),
    "gray and alpha": Case(
        with_alpha(np.where(np.arange(COLS) < 16, 0, 255), 1), valid=ROWS * (COLS - 16)
    ),
    "palette": Case(palette("GTiff", 8), valid=SIZE),
    "palette with a transparent entry": Case(palette("PNG", 8), valid=SIZE - 120),
    "internal mask": Case(masked(internal=True), valid=SIZE - 120),
    "mask beside the file": Case(masked(internal=False), valid=SIZE - 120),
    # Georeference.
    "no crs": Case(raster(crs=None), warns=(NO_CRS,)),
    "no georeference": Case(raster(crs=None, transform=None), warns=(IN_PIXELS,)),
    "local crs": Case(raster(crs='LOCAL_CS["site grid",UNIT["metre",1]]')),
    "gcps": Case(
        with_gcps(
            (0, 0, 288_000, 9_120_000),
            (0, 64, 289_920, 9_120_000),
            (48, 64, 289_920, 9_118_560),
            (48, 0, 288_000, 9_118_570),
        ),
        warns=(r"4 ground control points: .* residual 2\.5 map units RMS \(0\.083 pixels\)",),
    ),
    "two gcps": Case(
        with_gcps((0, 0, 288_000, 9_120_000), (0, 64, 289_920, 9_120_000)), warns=(IN_PIXELS,)
    ),
    "gcps on a line": Case(
        with_gcps(*((k, k, 288_000.1 + 30 * k, 9_120_000.7 - 30 * k) for k in (0, 16, 32, 48))),
        warns=(IN_PIXELS,),
    ),
    "gcps at one place": Case(
        with_gcps(*((5, 5, 288_000 + k, 9_120_000) for k in range(4))), warns=(IN_PIXELS,)
    ),
    "rpc": Case(with_rpcs, warns=(f"RPC.* orthorectify it .*{IN_PIXELS}",)),
    "rotated": Case(raster(transform=NORTH_UP @ Affine.rotation(30))),
    "sheared": Case(raster(transform=NORTH_UP @ Affine.shear(20, 10))),
    "south up": Case(raster(transform=Affine(30, 0, 288_000, 0, 30, 9_118_560))),
    "east left": Case(raster(transform=Affine(-30, 0, 289_920, 0, -30, 9_120_000))),
    "turned around": Case(raster(transform=Affine(-30, 0, 289_920, 0, 30, 9_118_560))),
    "rows to the east": Case(raster(transform=Affine(0, 30, 288_000, 30, 0, 9_118_560))),
    "pixels 20 : 1": Case(raster(transform=Affine(200, 0, 288_000, 0, -10, 9_120_000))),
    "huge pixels": Case(
        raster(transform=Affine(1e15, 0, 0, 0, -1e15, 0), crs=None), warns=(NO_CRS,)
    ),
    "tiny pixels": Case(raster(transform=Affine(1e-9, 0, 3, 0, -1e-9, 4))),
    "pixels finer than coordinates": Case(
        raster(transform=Affine(1e-10, 0, 288_000, 0, -1e-10, 9_120_000)), refused="pixel"
    ),
    "flat pixels": Case(
        raster(transform=Affine(30, 0, 288_000, 0, 0, 9_120_000)), refused="maps every pixel onto"
    ),
    "geographic": Case(raster(crs="EPSG:4326", transform=Affine(0.01, 0, -35, 0, -0.01, -8))),
    "half a pixel beyond the poles": Case(
        raster(
            crs="EPSG:4326",
            transform=Affine(360 / COLS, 0, -180, 0, -180 / (ROWS - 1), 90 * 48 / 47),
        )
    ),
    "antimeridian": Case(
        raster(crs="EPSG:4326", transform=Affine(2 / COLS, 0, 179, 0, -2 / COLS, 1))
    ),
    "antimeridian, projected": Case(
        raster(crs="EPSG:3832", transform=Affine(3e3, 0, 3_339_584 - 9e4, 0, -3e3, 8e4))
    ),
    "geostationary": Case(
        raster(crs=GEOSTATIONARY, transform=Affine(175e3, 0, -5.6e6, 0, -233e3, 5.6e6))
    ),
    "Mars": Case(raster(crs=MARS, transform=Affine(0.01, 0, 10, 0, -0.01, 20))),
}


def vector(
    *shapes: Any, name: str = "aoi.gpkg", crs: Any = UTM
) -> Callable[[Path], dict[str, Any]]:
    """Return what writes a mask and returns the option that names it."""

    def make(folder: Path) -> dict[str, Any]:
        with warnings.catch_warnings():
            warnings.simplefilter(
                "ignore", UserWarning
            )  # that there is no CRS, where none is meant
            gpd.GeoDataFrame(geometry=list(shapes), crs=crs).to_file(folder / name)
        return {"mask": str(folder / name)}

    return make


def file_option(name: str, content: str) -> Callable[[Path], dict[str, Any]]:
    """Return what writes a text file that is given as a mask."""
    return lambda folder: {"mask": text_file(name, content)(folder)}


WEST, NORTH = NORTH_UP.c, NORTH_UP.f
LEFT_HALF = shapely.box(WEST, NORTH - 30 * ROWS, WEST + 30 * COLS / 2, NORTH)
LONLAT_HALF = gpd.GeoSeries([LEFT_HALF], crs=UTM).to_crs("EPSG:4326").iloc[0]
BOW_TIE = shapely.Polygon(
    [
        (WEST, NORTH),
        (WEST + 30 * COLS, NORTH - 30 * ROWS),
        (WEST + 30 * COLS, NORTH),
        (WEST, NORTH - 30 * ROWS),
    ]
)


def bounds(west: float, south: float, east: float, north: float, **rest: Any) -> Case:
    return Case(raster(), {"bounds": (west, south, east, north)}, **rest)


def setting(name: str, value: Any, **rest: Any) -> Case:
    """A value of the recipe, refused under its name unless `rest` says otherwise."""
    return Case(raster(), {name: value}, **({"refused": name, "names": name} | rest))


OPTIONS: dict[str, Case] = {
    "--bounds of a part": bounds(WEST, NORTH - 300, WEST + 600, NORTH, valid=200),
    "--bounds within a pixel": bounds(
        WEST + 31, NORTH - 39, WEST + 39, NORTH - 31, valid=1, warns=(NO_KEYPOINTS,)
    ),
    "--bounds wider than all": bounds(-1e300, -1e300, 1e300, 1e300, valid=SIZE),
    "--bounds beside": bounds(0, 0, 1, 1, refused="--bounds lies outside .* whose bounds are"),
    "--bounds inverted": bounds(
        WEST + 600, NORTH, WEST, NORTH - 300, names="bounds", refused="expected west < east"
    ),
    "--bounds nan": bounds(np.nan, 0, 1, 1, names="bounds", refused="expected west < east"),
    "--bounds infinite": bounds(-np.inf, -np.inf, np.inf, np.inf, names="bounds", refused="bounds"),
    "--mask missing": Case(
        raster(),
        lambda folder: {"mask": str(folder / "aoi.gpkg")},
        names="aoi.gpkg",
        refused="cannot be read as a vector file",
    ),
    "--mask of text": Case(
        raster(),
        file_option("aoi.gpkg", "no polygons\n"),
        names="aoi.gpkg",
        refused="cannot be read as a vector file",
    ),
    "--mask is the raster": Case(
        raster(),
        lambda folder: {"mask": str(folder / "scene.tif")},
        refused="cannot be read as a vector file",
    ),
    "--mask of a table": Case(
        raster(), file_option("aoi.csv", "a,b\n1,2\n"), names="aoi.csv", refused="polygon"
    ),
    "--mask of points": Case(
        raster(), vector(shapely.Point(WEST, NORTH)), names="aoi.gpkg", refused="give polygons"
    ),
    "--mask without rows": Case(
        raster(),
        file_option("aoi.geojson", '{"type": "FeatureCollection", "features": []}'),
        names="aoi.geojson",
        refused="give polygons",
    ),
    "--mask of empty polygons": Case(
        raster(), vector(shapely.Polygon()), names="aoi.gpkg", refused="give polygons"
    ),
    "--mask of a null and a polygon": Case(raster(), vector(None, LEFT_HALF), valid=SIZE // 2),
    "--mask in longitude and latitude": Case(
        raster(), vector(LONLAT_HALF, crs="EPSG:4326"), valid=SIZE // 2
    ),
    "--mask without crs": Case(raster(), vector(LEFT_HALF, crs=None), valid=SIZE // 2),
    "--mask beside": Case(
        raster(), vector(shapely.box(0, 0, 1, 1)), refused="--mask lies outside .* whose bounds are"
    ),
    "--mask between pixel centres": Case(
        raster(), vector(shapely.box(WEST + 1, NORTH - 5, WEST + 5, NORTH - 1)), refused="--mask"
    ),
    "--mask crossing itself": Case(raster(), vector(BOW_TIE)),
    "--mask twice crossing itself": Case(
        raster(), vector(BOW_TIE, shapely.affinity.translate(BOW_TIE, 45, 60))
    ),
    "--mask of the world": Case(
        raster(crs="EPSG:3857"),
        vector(shapely.box(-180, -90, 180, 90), crs="EPSG:4326"),
        valid=SIZE,
    ),
    "--mask on another planet": Case(
        raster(), vector(shapely.box(0, 0, 1, 1), crs=MARS), names="aoi.gpkg", refused="CRS"
    ),
    "--mask with crs for a raster without": Case(
        raster(crs=None), vector(LEFT_HALF), refused="georeference the raster, or give a mask"
    ),
    **{
        f"--nodes {value!r}": setting("nodes", value, refused="give a number such as 5000")
        for value in (0, -5, "abc", "0%", "-1%", "nan%", "inf%", "%", "", 2.5, True, "1e9")
    },
    "--nodes 1": setting(
        "nodes", 1, refused=None, warns=("the outline alone takes .* more than the 1 asked for",)
    ),
    "--nodes 200%": setting("nodes", "200%", refused=None, warns=(FEWER,), valid=SIZE),
    "--nodes 10**18": setting("nodes", 10**18, refused=None, warns=(FEWER,), valid=SIZE),
    "--set of an unknown name": setting("cany_low", 50, refused="choose from .*canny_low"),
    **{
        f"--set {name}={json.dumps(value)}": setting(name, value)
        for name, value in (
            ("canny_low", "abc"),
            ("canny_low", -1),
            ("canny_low", [50]),
            ("canny_high", True),
            ("canny_l2", "no"),
            ("sobel", "no"),
            ("resize", 5),
            ("resize", [256]),
            ("resize", [256, 0]),
            ("resize", [2.5, 3]),
            ("resize", "256x256"),
            ("stretch", [98, 2]),
            ("stretch", [2]),
            ("stretch", 5),
            ("stretch", ["2", "98"]),
            ("min_hole", -1),
            ("min_hole", "few"),
            ("min_spacing", None),
            ("nodes", True),
            ("nodes", [5]),
            ("nodes", {"max": 5}),
            ("gray", 5),
            ("gray", None),
            ("gray", "band:0"),
            ("gray", "sepia"),
            ("domain", "sea"),
            ("domain", ["valid"]),
            ("statistics", 5),
            ("statistics", ["median"]),
            ("sift_octave_layers", 2.5),
            ("sift_octave_layers", "3"),
            ("sift_max_octave", "two"),
            ("sift_sigma", 0),
            ("sift_source", None),
            ("edge_distance", "near"),
            ("border_spacing", float("inf")),
        )
    },
}

CASES = SOURCES | OPTIONS


# What only the library takes: callables that get a folder and an ExitStack.
Open = Callable[[Path, ExitStack], Any]


def opened(folder: Path, stack: ExitStack, mode: str = "r", **options: Any) -> Any:
    return stack.enter_context(rasterio.open(write(folder, **options), mode))


def in_memory(folder: Path, stack: ExitStack) -> Any:
    memory = stack.enter_context(MemoryFile(Path(write(folder)).read_bytes()))
    return stack.enter_context(memory.open())


def warped(folder: Path, stack: ExitStack) -> Any:
    dataset = opened(folder, stack)
    return stack.enter_context(WarpedVRT(dataset, crs="EPSG:4326", add_alpha=True))


def closed(folder: Path, stack: ExitStack) -> Any:
    dataset = opened(folder, stack)
    dataset.close()
    return dataset


def array(data: Any, transform: Any = NORTH_UP, crs: Any = UTM) -> Open:
    return lambda _folder, _stack: (data, transform, crs)


HIDDEN = np.zeros((2, ROWS, COLS), np.bool_)
HIDDEN[1, 10:22, 20:30] = True

OBJECTS: dict[str, tuple[Open, tuple[str, ...], int | None]] = {
    "path": (lambda folder, _stack: Path(write(folder)), (), SIZE),
    "dataset": (opened, (), SIZE),
    "dataset open for changes": (partial(opened, mode="r+"), (), SIZE),
    "file in memory": (in_memory, (), SIZE),
    "warped dataset": (warped, (), None),
    "array": (array(picture(3)), (), SIZE),
    "array of one band": (array(picture()[0]), (), SIZE),
    "array without a place": (
        array(picture(), None, None),
        ("the array has no georeference",),
        SIZE,
    ),
    "array with an epsg number": (array(picture(), crs=32725), (), SIZE),
    "array, masked in one band": (array(np.ma.array(picture(2), mask=HIDDEN)), (), SIZE - 120),
    "array, masked nowhere": (array(np.ma.array(picture(2))), (), SIZE),
    "array of lists": (array(picture()[0].tolist()), (), SIZE),
    "array of halves": (array(picture().astype(np.float16)), (), SIZE),
    "array of long doubles": (array(picture().astype(np.longdouble)), (), SIZE),
    "array of big-endian floats": (array(picture().astype(">f4")), (), SIZE),
    "array in columns": (array(np.asfortranarray(picture(3))), (), SIZE),
    "array that is a view": (array(picture(3, ROWS, 2 * COLS)[::-1, :, ::2]), (), SIZE),
}

NO_OBJECTS: dict[str, tuple[Open, str]] = {
    "closed dataset": (closed, "closed"),
    "array of size 0": (array(np.zeros((3, 0, 5))), r"\(3, 0, 5\) is no raster"),
    "array without bands": (array(np.zeros((0, 4, 5))), r"\(0, 4, 5\) is no raster"),
    "array of 4 dimensions": (array(np.zeros((1, 2, 3, 4))), r"\(1, 2, 3, 4\) is no raster"),
    "array of 1 dimension": (array(np.zeros(4)), r"\(4,\) is no raster"),
    "array of truths": (array(picture() > 60), "bool"),
    "array of texts": (array(np.full((1, 4, 4), "water")), "<U5"),
    "array of objects": (array(np.full((1, 4, 4), None)), "object"),
    "array of complex numbers": (array(picture() * 1j), "complex128"),
    "array, all masked": (array(np.ma.masked_all((1, 4, 4))), "no valid pixel"),
    "array in an unknown crs": (array(picture(), crs="EPSG:999999"), "EPSG:999999"),
    "array with gdal's transform": (array(picture(), NORTH_UP.to_gdal()), "transform"),
    "array with half a transform": (array(picture(), (30, 0, 0)), "transform"),
    "array with a flat transform": (array(picture(), Affine.scale(1, 0)), "maps every pixel onto"),
    "array with a nan in its transform": (array(picture(), Affine.scale(np.nan)), "not finite"),
    "array alone": (lambda _folder, _stack: picture(), r"\(array, transform, crs\)"),
    "array alone in a tuple": (lambda _folder, _stack: (picture(),), r"\(array, transform, crs\)"),
    "nothing": (lambda _folder, _stack: None, r"\(array, transform, crs\)"),
    "list of paths": (lambda folder, _stack: [write(folder)], r"\(array, transform, crs\)"),
}

# Sources of above as GeoJSON: None if it must work, or else how it is refused.
AS_GEOJSON: dict[str, str | None] = {
    "geographic": None,
    "rotated": None,
    "south up": None,
    "east left": None,
    "rows to the east": None,
    "gcps": None,
    "antimeridian": None,
    "antimeridian, projected": None,
    "no crs": "the mesh has no CRS: georeference the raster, or write .gpkg",
    "no georeference": "the mesh has no CRS: georeference the raster, or write .gpkg",
    "rpc": "the mesh has no CRS: georeference the raster, or write .gpkg",
    "local crs": "no way to them from 'site grid': write .gpkg",
    "Mars": "no way to them from .*Mars.*: write .gpkg",
    "geostationary": "nodes have none: leave them out with --bounds or --mask, or write .gpkg",
    "half a pixel beyond the poles": "nodes have none: leave them out with --bounds or --mask",
}

# Wrong usage: exit code 2, before anything is looked at. SRC is a raster.
USAGE: dict[str, Sequence[str]] = {
    "bands that are no numbers": ("SRC", "--bidx=red"),
    "bands with a gap": ("SRC", "--bidx=1,,2"),
    "three bounds": ("SRC", "--bounds", "1", "2", "3"),
    "bounds that are no numbers": ("SRC", "--bounds", "w", "s", "e", "n"),
    "nodata that is no number": ("SRC", "--nodata=none"),
    "unknown preset": ("SRC", "--preset=best"),
    "unknown layer": ("SRC", "--layers=faces"),
    "unknown statistic": ("SRC", "--stats=median"),
    "setting without a value": ("SRC", "--set=canny_low"),
    "unknown option": ("SRC", "--best"),
    "recipe that is a folder": ("SRC", "--recipe=."),
    "no source": (),
}

RECIPES: dict[str, tuple[bytes | None, str]] = {
    "missing": (None, "no such file"),
    "empty": (b"", "not a recipe in JSON"),
    "no json": (b"canny_low = 5", "not a recipe in JSON"),
    "list": (b"[1, 2]", "not a recipe in JSON"),
    "number": (b"5", "not a recipe in JSON"),
    "recipe that is a list": (b'{"recipe": [1]}', "is no recipe"),
    "utf-16": ('{"canny_low": 5}'.encode("utf-16"), "not a recipe in JSON"),
    "unknown name": (b'{"cany_low": 5}', "cany_low.* choose from"),
    "wrong type": (b'{"canny_low": "abc"}', "canny_low"),
    "wrong value": (b'{"recipe": {"canny_low": -5}}', "canny_low.* 0 or more"),
}


# --------------------------------------------------------------------- how to check


def mesh_of(source: Any, options: Mapping[str, Any]) -> tuple[geomesh.Mesh, list[str]]:
    """Return the mesh and what was warned of; no library may warn in geomesh's place."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warnings.simplefilter("ignore", DeprecationWarning)
        mesh = geomesh.mesh_raster(source, **options)
    foreign = [str(item.message) for item in caught if item.category is not GeomeshWarning]
    assert foreign == []
    return mesh, [str(item.message) for item in caught]


def assert_warned(told: Sequence[str], patterns: Sequence[str]) -> None:
    """Each message fits a pattern, and each pattern (that is not optional: "|^$") is met."""
    unexpected = [text for text in told if not any(re.search(p, text) for p in patterns)]
    missed = [p for p in patterns if not any(re.search(p, text) for text in (*told, ""))]
    assert (unexpected, missed) == ([], [])
    assert all(len(text.splitlines()) == 1 for text in told)


def assert_sound(mesh: geomesh.Mesh, valid: int | None = None) -> None:
    """The certificate holds, and what it says is true on the map and of the pixels too."""
    certificate = mesh.certify()
    assert [check for check in certificate.checks if not check.passed] == []
    assert len(mesh.triangles) >= 1
    corners = mesh.map_nodes[mesh.triangles]
    ab, ac = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    assert (ab[:, 0] * ac[:, 1] > ab[:, 1] * ac[:, 0]).all()
    if valid is not None:
        assert mesh.domain.valid_pixels == valid
    if mesh.domain.kind != "hull" and not mesh.domain.islands_dropped:
        assert mesh.triangle_table["count"].sum() == mesh.domain.valid_pixels
    areas = mesh.attributes("triangles")["area"]
    assert np.isfinite(areas).all()
    assert areas.min() >= 0 < areas.sum()  # two corners may be one pole


def assert_helpful(text: str, case: Case, source: Any) -> None:
    assert case.refused is not None
    assert len(text.splitlines()) == 1
    assert re.search(case.refused, text), text
    assert (case.names or Path(source).name) in text, text


class Run(NamedTuple):
    """What a command left: exit code, standard output, standard error."""

    code: int
    out: str
    err: str

    def warnings(self) -> list[str]:
        """The warnings, if there is nothing but warnings on standard error."""
        lines = self.err.splitlines()
        assert [line for line in lines if not line.startswith("Warning: ")] == []
        return [line.removeprefix("Warning: ") for line in lines]

    def error(self) -> str:
        """The one error of a refused run, if it told nothing else but warnings."""
        assert self.code == 1, self
        assert self.out == ""
        lines = [line for line in self.err.splitlines() if not line.startswith("Warning: ")]
        assert len(lines) == 1, self.err
        assert lines[0].startswith("Error: ")
        assert "Traceback" not in self.err
        assert "defect of geomesh" not in self.err
        return lines[0].removeprefix("Error: ")


Geomesh = Callable[..., Run]


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Geomesh:
    """The command line in this process; what C libraries print is seen as well."""
    terminate = signal.getsignal(signal.SIGTERM)
    monkeypatch.setattr(sys, "argv", sys.argv)

    def run(*arguments: str | Path) -> Run:
        sys.argv = ["geomesh", *map(str, arguments)]
        capfd.readouterr()
        try:
            with pytest.raises(SystemExit) as stop:
                main()
        finally:
            signal.signal(signal.SIGTERM, terminate)
        return Run(int(stop.value.code or 0), *capfd.readouterr())

    return run


def snapshot(folder: Path) -> dict[str, bytes | None]:
    """Everything in a folder, hidden or not: None for folders, else the content."""
    return {
        str(path.relative_to(folder)): None if path.is_dir() else path.read_bytes()
        for path in sorted(folder.rglob("*"))
    }


def arguments(options: Mapping[str, Any]) -> list[str]:
    """The options of mesh_raster as the command line has them."""
    found = []
    for name, value in options.items():
        if name == "bidx":
            found.append(f"--bidx={','.join(map(str, value))}")
        elif name == "bounds":
            found += ["--bounds", *(f"{number!r}" for number in map(float, value))]
        elif name in ("mask", "nodata", "preset") or (
            name in ("nodes", "gray") and isinstance(value, str)
        ):
            found.append(f"--{name}={value}")
        else:
            found.append(f"--set={name}={json.dumps(value)}")
    return found


OLD = b"an older mesh"


def assert_refused(run: Geomesh, *arguments: str | Path, folder: Path, output: Path) -> str:
    """Run a command that must fail, with and without an old output; return its error.

    Nothing in `folder` may change: no output, no leftover, the old output as it was.
    """
    before = snapshot(folder)
    error = run("mesh", "-o", output, *arguments).error()
    assert snapshot(folder) == before
    output.write_bytes(OLD)
    assert run("mesh", "--overwrite", "-o", output, *arguments).error() == error
    assert snapshot(folder) == before | {str(output.relative_to(folder)): OLD}
    return error


# --------------------------------------------------------------------------- tests


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_library_gives_a_sound_mesh_or_one_helpful_line(tmp_path: Path, case: Case) -> None:
    source, options = case.prepare(tmp_path / "in")
    if case.refused is None:
        mesh, told = mesh_of(source, options)
        assert_sound(mesh, case.valid)
        assert_warned(told, case.warns)
    else:
        with pytest.raises(GeomeshError) as refusal:
            mesh_of(source, options)
        assert_helpful(str(refusal.value), case, source)


@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_command_line_writes_a_mesh_or_changes_nothing(
    tmp_path: Path, case: Case, command: Geomesh
) -> None:
    source, options = case.prepare(tmp_path / "in")
    output = tmp_path / "mesh.gpkg"
    given = [*arguments(options), "--", source]
    if case.refused is None:
        before = snapshot(tmp_path)
        run = command("mesh", "-o", output, *given)
        assert run.code == 0, run.err
        assert_warned(run.warnings(), case.warns)
        assert snapshot(tmp_path).keys() - before.keys() == {"mesh.gpkg"}
        assert_sound(read_mesh(output), case.valid)
    else:
        error = assert_refused(command, *given, folder=tmp_path, output=output)
        assert_helpful(error, case, source)


@pytest.mark.parametrize(
    "case",
    [pytest.param(c, id=name) for name, c in SOURCES.items() if c.refused and not c.options],
)
def test_info_refuses_what_cannot_be_meshed(tmp_path: Path, case: Case, command: Geomesh) -> None:
    source, _ = case.prepare(tmp_path / "in")
    before = snapshot(tmp_path)
    assert_helpful(command("info", source).error(), case, source)
    assert snapshot(tmp_path) == before


@pytest.mark.parametrize(("make", "warns", "valid"), OBJECTS.values(), ids=OBJECTS)
def test_objects_become_sound_meshes(
    tmp_path: Path, make: Open, warns: tuple[str, ...], valid: int | None
) -> None:
    with ExitStack() as stack:
        mesh, told = mesh_of(make(tmp_path, stack), {})
    assert_sound(mesh, valid)
    assert_warned(told, warns)


@pytest.mark.parametrize(("make", "refused"), NO_OBJECTS.values(), ids=NO_OBJECTS)
def test_objects_that_are_no_raster_are_refused(tmp_path: Path, make: Open, refused: str) -> None:
    with ExitStack() as stack, pytest.raises(GeomeshError, match=refused) as refusal:
        mesh_of(make(tmp_path, stack), {})
    assert len(str(refusal.value).splitlines()) == 1


@pytest.mark.parametrize(("name", "refused"), AS_GEOJSON.items(), ids=AS_GEOJSON)
def test_geojson_lies_on_earth_or_is_refused(
    tmp_path: Path, name: str, refused: str | None, command: Geomesh
) -> None:
    source, _ = SOURCES[name].prepare(tmp_path / "in")
    output = tmp_path / "mesh.geojson"
    if refused is not None:
        error = assert_refused(command, source, folder=tmp_path, output=output)
        assert re.search(refused, error), error
        return
    run = command("mesh", "-o", output, source)
    assert run.code == 0, run.err
    found = gpd.read_file(output)
    west, south, east, north = found.total_bounds
    assert -180 <= west < east <= 180
    assert -90 <= south < north <= 90
    geod = Geod(ellps="WGS84")
    ground = sum(geod.geometry_area_perimeter(shape)[0] for shape in found.geometry)
    assert ground == pytest.approx(found["area"].sum(), rel=0.01)


def test_areas_on_mars_are_those_of_mars(tmp_path: Path) -> None:
    source, _ = SOURCES["Mars"].prepare(tmp_path / "in")
    mesh, _ = mesh_of(source, {})
    west, south, east, north = np.radians(mesh.grid.bounds())
    expected = 3_396_190**2 * (east - west) * (np.sin(north) - np.sin(south))
    assert mesh.attributes("triangles")["area"].sum() == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("given", USAGE.values(), ids=USAGE)
def test_wrong_usage_exits_with_2(tmp_path: Path, given: Sequence[str], command: Geomesh) -> None:
    source = write(tmp_path)
    before = snapshot(tmp_path)
    run = command(
        "mesh", "-o", tmp_path / "mesh.gpkg", *(source if word == "SRC" else word for word in given)
    )
    assert run.code == 2
    assert run.out == ""
    assert [line for line in run.err.splitlines() if line.startswith("Error: ")] == [
        run.err.splitlines()[-1]
    ]
    assert snapshot(tmp_path) == before


@pytest.mark.parametrize(("content", "refused"), RECIPES.values(), ids=RECIPES)
def test_recipe_that_is_none_is_refused(
    tmp_path: Path, content: bytes | None, refused: str, command: Geomesh
) -> None:
    source, recipe = write(tmp_path), tmp_path / "recipe.json"
    if content is not None:
        recipe.write_bytes(content)
    error = assert_refused(
        command, source, f"--recipe={recipe}", folder=tmp_path, output=tmp_path / "mesh.gpkg"
    )
    assert re.search(refused, error), error
    assert "recipe.json" in error


@pytest.mark.parametrize("bad", ["missing.tif", "scene [2].tif", "x[/y].tif"])
def test_batch_goes_on_after_a_bad_source(
    tmp_path: Path, bad: str, command: Geomesh, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("one.tif", "two [1].tif"):
        write(tmp_path, name)
    run = command("mesh", "-o", "meshes", "one.tif", bad, "two [1].tif")
    assert run.code == 1
    found = sorted(path.name for path in Path("meshes").iterdir())
    assert found == ["one.gpkg", "two [1].gpkg"]
    assert "Traceback" not in run.err
    errors = [line for line in run.err.splitlines() if line.startswith("Error: ")]
    assert errors == [f"Error: {bad}: no such file; check the path"]
    _, _, table = run.err.partition("2 meshed, 1 failed")
    for name in ("one.tif", bad, "two [1].tif"):
        assert name in table


@pytest.mark.parametrize("names", [("a/scene.tif", "b/scene.tif"), ("scene.tif", "scene.png")])
def test_sources_of_one_name_are_refused(
    tmp_path: Path, names: tuple[str, str], command: Geomesh
) -> None:
    sources = [
        write(tmp_path, name, driver="PNG" if name.endswith("png") else "GTiff") for name in names
    ]
    before = snapshot(tmp_path)
    error = command("mesh", "-o", f"{tmp_path}/meshes/", *sources).error()
    assert re.search("called 'scene': .* mesh them into different folders", error)
    assert snapshot(tmp_path) == before
