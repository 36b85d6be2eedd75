"""The compiled loop that paints a linear surface at pixel centres."""

from __future__ import annotations

from typing import TYPE_CHECKING

from geomesh.arrays.jit import float64, int32, int64, kernel, reads, void, writes
from geomesh.surface.kernels import barycentric, barycentric_matrix
from geomesh.zonal.rasterize import column_range, row_range, sort_corners

if TYPE_CHECKING:
    from geomesh.arrays.types import Floats, Points, Triangles


@kernel(
    void(reads(float64, 2), reads(int32, 2), reads(float64, 2), int64, int64, writes(float64, 3))
)
def paint_linear(
    nodes: Points, triangles: Triangles, values: Floats, row: int, col: int, image: Floats
) -> None:
    """Fill `image` (B, h, w), whose first pixel is (row, col), from node values (N, B)."""
    count, height, width = image.shape
    for t in range(len(triangles)):
        a, b, c = triangles[t, 0], triangles[t, 1], triangles[t, 2]
        one = nodes[a, 0], nodes[a, 1], nodes[b, 0], nodes[b, 1], nodes[c, 0], nodes[c, 1]
        corners, weights = sort_corners(*one), barycentric_matrix(*one)
        top, bottom = row_range(corners, row, row + height)
        for r in range(top, bottom):
            first, last = column_range(corners, r, col, col + width)
            for k in range(first, last):
                u, v = barycentric(weights, r, k)
                for band in range(count):
                    start = values[a, band]
                    image[band, r - row, k - col] = (
                        start + u * (values[b, band] - start) + v * (values[c, band] - start)
                    )
