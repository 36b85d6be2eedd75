"""Band statistics of triangles: compare geomesh.zonal with rasterio + numpy and exactextract."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import geopandas as gpd
import numpy as np
import shapely
from exactextract import exact_extract  # type: ignore[import-untyped]
from exactextract.raster import NumPyRasterSource  # type: ignore[import-untyped]
from numpy.typing import NDArray
from rasterio.features import rasterize

from benchmarks import inputs
from benchmarks.timing import Row, alternate
from geomesh.raster.grid import Grid
from geomesh.zonal.owners import find_owners

if TYPE_CHECKING:
    from collections.abc import Iterator

    from geomesh.zonal.statistics import Statistics

EXPECTED = 20.0
OPERATIONS = ["count", "mean", "stdev", "min", "max"]

Bands = NDArray[np.uint16]
Polygons = NDArray[Any]


def run(*, quick: bool) -> Iterator[Row]:
    size, triangles, subset = (512, 20_000, 1_000) if quick else (2048, 200_000, 5_000)
    bands, mesh = inputs.image(size), inputs.mesh(triangles, size)
    nodes, faces = mesh.nodes, mesh.triangles
    # The peers get finished polygons, in pixel coordinates.
    polygons = shapely.polygons(nodes[faces[:, [0, 1, 2, 0]]])
    every = len(faces) // subset
    chosen = np.arange(0, len(faces), every)
    frame = gpd.GeoDataFrame(geometry=polygons[chosen], crs=mesh.grid.crs)
    wkt = frame.crs.to_wkt()
    # In exactextract, y goes up: flip the raster, not the polygons.
    sources = [
        NumPyRasterSource(band[::-1].copy(), 0, 0, size, size, name=f"b{k}", srs_wkt=wkt)
        for k, band in enumerate(bands)
    ]
    times, results = alternate(
        3,
        lambda: inputs.statistics(nodes, faces, bands),
        lambda: _rasterized(polygons, bands),
        lambda: exact_extract(sources, frame, OPERATIONS, output="pandas"),
    )
    ours, (labels, *moments), table = results
    expected = None if quick else EXPECTED
    what = f"{len(faces):,} triangles, {size} x {size} x {len(bands)}"
    owners = find_owners(nodes, faces, Grid(size, size).extent)
    agree, evidence = _compare_owned(ours, owners, labels, moments)
    peer = "rasterize + bincount (mean, std)"
    yield Row(what, peer, times[0], times[1], expected, agree, evidence)
    scaled = [seconds * len(faces) / len(chosen) for seconds in times[2]]
    agree, evidence = _compare_exact(ours, chosen, shapely.area(polygons), table)
    peer = f"exactextract, {len(chosen):,} triangles SCALED x{len(faces) / len(chosen):.3g}"
    yield Row(what, peer, times[0], scaled, expected, agree, evidence)


def _rasterized(polygons: Polygons, bands: Bands) -> tuple[NDArray[Any], ...]:
    """Return labels, and the count (T,), mean and std (B, T) of the pixels under each label."""
    shapes = zip(polygons, range(len(polygons)), strict=True)
    labels = rasterize(shapes, out_shape=bands.shape[1:], fill=-1, dtype="int32")
    inside = labels >= 0
    flat, total = labels[inside], len(polygons)
    count = np.bincount(flat, minlength=total)
    mean, std = np.empty((2, len(bands), total))
    with np.errstate(invalid="ignore"):
        for k, band in enumerate(bands):
            values = band[inside].astype(np.float64)
            mean[k] = np.bincount(flat, values, total) / count
            squares = np.bincount(flat, values * values, total) / count
            std[k] = np.sqrt(np.maximum(squares - mean[k] ** 2, 0))
    return labels, count, mean, std


def _compare_owned(
    ours: Statistics, owners: NDArray[np.int32], labels: NDArray[np.int32], moments: list[Any]
) -> tuple[bool, str]:
    count, mean, std = moments
    differ = owners != labels
    same = count > 0
    same[owners[differ]] = False
    same[labels[differ & (labels >= 0)]] = False
    equal = (
        np.array_equal(ours.count[same], count[same])
        and np.allclose(ours.mean[:, same], mean[:, same], rtol=1e-12)
        and np.allclose(ours.std[:, same], std[:, same], rtol=1e-6, atol=1e-2)
    )
    enough = differ.sum() < 1e-4 * labels.size
    return equal and enough, f"same owner of all but {differ.sum()} pixels; count, mean, std there"


def _compare_exact(
    ours: Statistics, chosen: NDArray[np.intp], areas: NDArray[np.float64], table: Any
) -> tuple[bool, str]:
    """Compare with exactextract, which weights pixels by their share in the triangle.

    Every pixel whose centre is in a triangle has a share in it. So minimum and maximum of
    exactextract enclose those of geomesh.
    """
    mean, low, high = (
        np.stack([table[f"b{k}_{operation}"] for k in range(len(ours.mean))])
        for operation in ("mean", "min", "max")
    )
    some = ours.count[chosen] > 0
    inside = (low <= ours.min[:, chosen]) & (ours.max[:, chosen] <= high)
    covered = np.allclose(table["b0_count"], areas[chosen], rtol=1e-6)
    large = ours.count[chosen] >= 10
    alike = np.corrcoef(mean[:, large].ravel(), ours.mean[:, chosen[large]].ravel())[0, 1]
    agree = covered and bool(inside[:, some].all()) and bool(alike > 0.99)
    return agree, f"pixel shares: min, max enclose ours, means correlate {alike:.4f}"
