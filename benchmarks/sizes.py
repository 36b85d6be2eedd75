"""Bytes a triangle of the same mesh in every format: the table in docs/formats.md."""

from __future__ import annotations

import gzip
import warnings
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, NamedTuple

import rasterio
from rasterio.vrt import WarpedVRT
from rasterio.windows import Window

import geomesh
from geomesh.errors import GeomeshWarning
from geomesh.formats.registry import FORMATS

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from geomesh import Mesh

# A DEM, because most formats need heights, in metres, because some cannot have degrees.
SAMPLE = Path(__file__).parent.parent / "data_samples" / "colorado_dem_float32_epsg4269.tif"
_CRS = "EPSG:26913"
_NODES = 20_000

# The map is turned by a degree: so many pixels at its sides have no height.
_MARGIN = 20

# Choices that make files for the web smaller.
_SMALLER: Mapping[str, tuple[Mapping[str, Any], ...]] = {
    "GPKG": ({"layers": "triangles"},),
    "GeoJSON": (
        {"columns": ("color", "area")},
        {"columns": ("color", "area"), "precision": 5},
        {"columns": (), "precision": 5},
    ),
    "FlatGeobuf": ({"columns": ("color", "area")},),
    "Parquet": ({"columns": ("color", "area")},),
}


class Size(NamedTuple):
    """The size of one file.

    Attributes
    ----------
    name : str
        The format.
    how : str
        The options with which it was written.
    plain, packed : float
        Bytes a triangle, as it is and compressed by gzip.
    """

    name: str
    how: str
    plain: float
    packed: float


def sample_mesh() -> Mesh:
    """Return a mesh with heights in a map of metres, without voids."""
    with rasterio.open(SAMPLE) as dem, WarpedVRT(dem, crs=_CRS) as warped:
        inner = Window(_MARGIN, _MARGIN, warped.width - 2 * _MARGIN, warped.height - 2 * _MARGIN)
        heights, place = warped.read(window=inner), warped.window_transform(inner)
    with warnings.catch_warnings():
        warnings.simplefilter(
            "ignore", GeomeshWarning
        )  # an array does not say that it is in metres
        return geomesh.mesh_raster((heights, place, _CRS), nodes=_NODES, z=1)


def measure(mesh: Mesh) -> Iterator[Size]:
    """Write a mesh in every format, and yield the sizes."""
    count = len(mesh.triangles)
    with TemporaryDirectory() as folder, warnings.catch_warnings():
        warnings.simplefilter("ignore", GeomeshWarning)
        for known in FORMATS:
            for options in ({}, *_SMALLER.get(known.driver, ())):
                path = Path(folder, f"mesh{known.extensions[0]}")
                mesh.to_file(path, overwrite=True, **options)
                content = path.read_bytes()
                packed = len(gzip.compress(content, 6, mtime=0))
                yield Size(known.driver, _spell(options), len(content) / count, packed / count)


def _spell(options: Mapping[str, Any]) -> str:
    """Return options as the command has them."""
    words = []
    for name, value in options.items():
        text = value if isinstance(value, str | int) else ",".join(value) or "none"
        words.append(f"--{name} {text}")
    return " ".join(words)


def main() -> None:
    """Print the table."""
    mesh = sample_mesh()
    print(f"{len(mesh.triangles):,} triangles, {len(mesh.nodes):,} nodes\n")
    print("| format | options | bytes a triangle | with gzip |\n|---|---|---:|---:|")
    for size in measure(mesh):
        how = f"`{size.how}`" if size.how else ""
        print(f"| {size.name} | {how} | {size.plain:.0f} | {size.packed:.0f} |")


if __name__ == "__main__":
    main()
