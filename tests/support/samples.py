"""The real rasters of data_samples, and larger images made from them."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path
from typing import Any

import numpy as np
import rasterio

ROOT = Path(__file__).parents[2]
SAMPLES = ROOT / "data_samples"
OLINDA = SAMPLES / "olinda_landsat7_rgb_uint8.tif"
ROTATED = SAMPLES / "olinda_landsat7_rgb_rotated_gt.tif"
# Only the name, for `write_mirrored`.
NODATA_EDGE = "parana_landsat8_rgb_uint16_nodata_edge.tif"


def mirrored(path: Path, width: int, height: int) -> np.ndarray:
    """Return bands (B, height, width) of a raster, extended by reflection at its borders."""
    with rasterio.open(path) as dataset:
        bands = dataset.read()
    _, rows, cols = bands.shape
    row = np.abs((np.arange(height) + rows) % (2 * rows) - rows)
    col = np.abs((np.arange(width) + cols) % (2 * cols) - cols)
    return bands[:, np.minimum(row, rows - 1)[:, None], np.minimum(col, cols - 1)]


def write_mirrored(target: Path, name: str, width: int, height: int, **profile: Any) -> Path:
    """Write a sample, extended by reflection, as a tiled GeoTIFF, and return its path."""
    with rasterio.open(SAMPLES / name) as dataset:
        profile = dataset.profile | {
            "width": width,
            "height": height,
            "tiled": True,
            "blockxsize": 256,
            "blockysize": 256,
            "compress": "deflate",
            **profile,
        }
    with rasterio.open(target, "w", **profile) as dataset:
        dataset.write(mirrored(SAMPLES / name, width, height))
    return target


def fingerprint(mesh: Any) -> dict[str, str]:
    """Return hashes of the arrays of a mesh, of its grid and domain, and of its metadata."""
    arrays = {"nodes": mesh.nodes, "triangles": mesh.triangles, "constraints": mesh.constraints}
    for layer in ("triangles", "edges", "nodes"):
        arrays |= {f"{layer}.{name}": column for name, column in mesh.attributes(layer).items()}
    texts = {
        "metadata": json.dumps(dict(mesh.metadata), sort_keys=True),
        "shape": f"{mesh.grid} {mesh.domain} {mesh.plane_size}",
    }
    hashed = {name: hashlib.sha256(text.encode()).hexdigest() for name, text in texts.items()}
    for name, column in arrays.items():
        array = np.ascontiguousarray(column)
        about = f"{array.dtype.str}{array.shape}".encode()
        content = json.dumps(array.tolist()).encode() if array.dtype == object else array.tobytes()
        hashed[name] = hashlib.sha256(about + content).hexdigest()
    return hashed
