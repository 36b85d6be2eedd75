"""Sources of every kind, valid and broken, and the expected result of meshing each one."""

from __future__ import annotations

import zipfile
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import rasterio
from affine import Affine
from rasterio.control import GroundControlPoint
from rasterio.enums import ColorInterp
from rasterio.rpc import RPC

from support.rasters import (
    COLS,
    FLOAT32_MIN,
    GEOSTATIONARY,
    MARS,
    NORTH_UP,
    ROWS,
    SIZE,
    UTM,
    constant,
    holed,
    picture,
    raster,
    write_raster,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

NO_CRS = "has no CRS, so the mesh has no CRS either"
IN_PIXELS = "the mesh is in pixel coordinates, without a CRS"
NO_KEYPOINTS = "no keypoints found .* the outline only"
FEWER = "of the .* requested nodes: the image has no more keypoints"
NO_MORE = "nodes: no more fit where the surface differs from the raster"
IMPOSSIBLE = "no pixel of .* can have the nodata value"
NO_HULL = "span no area: the mesh covers the whole frame"
# What presets say of a raster without features, and of one that is two pixels wide.
FLAT = {"adaptive": f"only .* {NO_MORE}|^$", "features": NO_KEYPOINTS}
THIN = {"adaptive": "^$", "features": f"{NO_KEYPOINTS}|^$"}


@dataclass(frozen=True)
class Case:
    """One source with options, and the expected result.

    Parameters
    ----------
    make : callable(folder)
        Writes the source into an empty folder and returns it.
    options : mapping, or callable(folder) that returns one
        Options for mesh_raster. The test of the command line converts them.
    refused : str, optional
        Pattern of the error: its cause and the way out. None: a mesh is expected.
    names : str, optional
        Text that the error must contain. Default: the name of the source file.
    warns : tuple of str
        Patterns of the warnings. Each warning matches a pattern, and each pattern a warning.
    of_preset : mapping of str to str
        Pattern of a warning that only one preset gives.
    valid : int, optional
        Number of valid pixels.
    """

    make: Callable[[Path], Any]
    options: Mapping[str, Any] | Callable[[Path], Mapping[str, Any]] = field(default_factory=dict)
    refused: str | None = None
    names: str | None = None
    warns: tuple[str, ...] = ()
    of_preset: Mapping[str, str] = field(default_factory=dict)
    valid: int | None = None

    def warned(self, preset: str) -> tuple[str, ...]:
        """Return the patterns of the warnings that a preset gives."""
        return (*self.warns, *(text for name, text in self.of_preset.items() if name == preset))

    def prepare(self, folder: Path) -> tuple[Any, Mapping[str, Any]]:
        """Write the files of the source and the options into `folder`, and return both."""
        folder.mkdir()
        source = self.make(folder)
        return source, self.options(folder) if callable(self.options) else self.options


def truncated(share: float) -> Callable[[Path], str]:
    """Return a function that writes the first part of a tiled, compressed raster."""

    def make(folder: Path) -> str:
        path = write_raster(
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
    """Return the text of a VRT with one Byte band of `target`."""
    tag = f"<NoDataValue>{nodata}</NoDataValue>" if nodata else ""
    return (
        f'<VRTDataset rasterXSize="{size[0]}" rasterYSize="{size[1]}">'
        "<SRS>EPSG:32725</SRS><GeoTransform>288000,30,0,9120000,0,-30</GeoTransform>"
        f'<VRTRasterBand dataType="Byte" band="1">{tag}<SimpleSource>'
        f'<SourceFilename relativeToVRT="1">{target}</SourceFilename><SourceBand>1</SourceBand>'
        "</SimpleSource></VRTRasterBand></VRTDataset>"
    )


def vrt_with_nodata(nodata: str, value: int) -> Callable[[Path], str]:
    """Return a function that writes a VRT whose nodata value does not fit its data type."""

    def make(folder: Path) -> str:
        write_raster(folder, "below.tif", holed(value))
        return text_file("scene.vrt", vrt_of("below.tif", nodata=nodata))(folder)

    return make


def with_alpha(levels: int | np.ndarray, bands: int = 3) -> Callable[[Path], str]:
    """Return a function that writes `bands` bands of data and an alpha band."""
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
    """Return a function that writes a palette raster. The entry `transparent` is transparent."""
    levels = (picture() // 32).astype(np.uint8)
    levels[:, 10:22, 20:30] = transparent

    def change(dataset: Any) -> None:
        entries = {k: (30 * k, 200 - 20 * k, 5 * k, 255) for k in range(9)}
        dataset.write_colormap(1, entries | {transparent: (1, 2, 3, 0)})

    extension = {"PNG": ".png", "GTiff": ".tif"}[driver]
    return partial(
        write_raster, name=f"scene{extension}", data=levels, driver=driver, change=change
    )


def masked(*, internal: bool) -> Callable[[Path], str]:
    """Return a function that writes a raster with a mask band, internal or in a second file."""
    mask = np.full((ROWS, COLS), 255, np.uint8)
    mask[10:22, 20:30] = 0

    def make(folder: Path) -> str:
        with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=internal):
            return write_raster(folder, change=lambda dataset: dataset.write_mask(mask))

    return make


def with_gcps(*points: tuple[float, float, float, float]) -> Callable[[Path], str]:
    """Return a function that writes a raster with ground control points (row, col, x, y) only."""
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
    return write_raster(
        folder, transform=None, crs=None, change=lambda dataset: setattr(dataset, "rpcs", rpcs)
    )


def container(folder: Path) -> str:
    """Write a GeoPackage of two rasters, which has no bands of its own."""
    for table in ("one", "two"):
        write_raster(
            folder,
            "tables.gpkg",
            picture(3),
            driver="GPKG",
            raster_table=table,
            append_subdataset="YES" if table == "two" else "NO",
        )
    return str(folder / "tables.gpkg")


def pages(folder: Path) -> str:
    """Write a TIFF of two pages. GDAL opens the first page."""
    path = write_raster(folder)
    return write_raster(folder, Path(path).name, holed(255), append_subdataset=True)


def zipped(folder: Path, member: str = "scene.tif") -> str:
    path = Path(write_raster(folder))
    with zipfile.ZipFile(folder / "all.zip", "w") as archive:
        archive.write(path, path.name)
    path.unlink()
    return f"/vsizip/{folder}/all.zip/{member}"


def descriptions(*names: str) -> Callable[[Path], str]:
    return raster(
        picture(len(names)), change=lambda dataset: setattr(dataset, "descriptions", names)
    )


SOURCES: dict[str, Case] = {
    # Files that are not a raster, or only a part of one.
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
        text_file("scene.vrt", vrt_of("gone.tif")),
        refused="its file .*gone.tif is missing; put it there",
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
    "constant": Case(raster(constant(ROWS, COLS)), of_preset=FLAT, valid=SIZE),
    "constant, paper": Case(
        raster(constant(ROWS, COLS)), {"preset": "paper"}, warns=(NO_HULL,), valid=SIZE
    ),
    **{
        f"{rows} x {cols}, {preset}": Case(
            raster(picture(3, rows, cols)),
            {"preset": preset},
            warns=(f"{NO_HULL}|^$",) if preset == "paper" else (FLAT[preset],),
            valid=rows * cols,
        )
        for rows, cols in ((1, 1), (1, 7), (7, 1), (2, 2), (3, 3))
        for preset in ("adaptive", "features", "paper")
    },
    "20000 x 2": Case(raster(picture(1, 2, 20_000)), valid=40_000, of_preset=THIN),
    "2 x 20000": Case(raster(picture(1, 20_000, 2)), valid=40_000, of_preset=THIN),
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
            raster(holed(held, dtype)),
            {"nodata": value},
            warns=(IMPOSSIBLE,) if value in (-1, 300, 0.5, 1e300) else (),
            valid=SIZE - missing,
        )
        for value, dtype, held, missing in (
            (255, "uint8", 255, 120),
            (0, "uint8", 0, 120),
            # No byte is equal to a value that does not fit into a byte.
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
    "alpha as data": Case(
        with_alpha(255), {"bidx": [4]}, refused="tagged as alpha, .* leave it out, or"
    ),
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
