"""Window: a block of pixels. Grid: the lattice of a raster's pixels, and its map coordinates."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from affine import Affine

from geomesh.errors import GeoreferenceError
from geomesh.raster.areas import ellipsoidal_areas, signed_areas
from geomesh.raster.crs import has_angles, to_geodetic

if TYPE_CHECKING:
    from numpy.typing import ArrayLike, NDArray
    from pyproj import CRS

    from geomesh.arrays.types import Points

IDENTITY = Affine.identity()

# At least this many float64 numbers must lie within a pixel; else triangles would have no area.
_LEAST_STEPS = 1024

# The square of a coordinate up to this is finite in float64, and so is the area of a triangle.
_FARTHEST = 1e150

# Nodes lie on a lattice of 1/256 pixel. This is exact in float64 and in the predicates.
LATTICE = 256.0


@dataclass(frozen=True, slots=True)
class Window:
    """A block of whole pixels: upper left pixel, width and height."""

    col: int
    row: int
    width: int
    height: int

    @property
    def stop_col(self) -> int:
        """First column right of the window."""
        return self.col + self.width

    @property
    def stop_row(self) -> int:
        """First row below the window."""
        return self.row + self.height

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width), the order of numpy."""
        return self.height, self.width

    def clip(self, other: Window) -> Window:
        """Return the intersection with `other`. If it is empty, width or height is 0."""
        col, row = max(self.col, other.col), max(self.row, other.row)
        width = max(min(self.stop_col, other.stop_col) - col, 0)
        height = max(min(self.stop_row, other.stop_row) - row, 0)
        return Window(col, row, width, height)

    def pad(self, pixels: int) -> Window:
        """Return the window extended by `pixels` on every side."""
        return Window(
            self.col - pixels,
            self.row - pixels,
            self.width + 2 * pixels,
            self.height + 2 * pixels,
        )

    def slices(self, within: Window | None = None) -> tuple[slice, slice]:
        """Return the (row, column) slices of this window in an array that covers `within`."""
        row = self.row - (within.row if within else 0)
        col = self.col - (within.col if within else 0)
        return slice(row, row + self.height), slice(col, col + self.width)


@dataclass(frozen=True)
class Grid:
    """Size, affine transform and CRS of a raster.

    Pixel coordinates are *pixel-edge* coordinates: x runs to the right, y runs down. The
    raster covers [0, width] x [0, height], and the centre of pixel (row, col) is
    (col + 0.5, row + 0.5). Map coordinates are in the CRS, x first.

    Parameters
    ----------
    width, height : int
        Number of columns and rows, at least 1.
    transform : Affine
        From pixel-edge to map coordinates. It may be rotated or flipped.
    crs : pyproj.CRS, optional
        None for a raster without a CRS.
    """

    width: int
    height: int
    transform: Affine = IDENTITY
    crs: CRS | None = None

    def __post_init__(self) -> None:
        if not (isinstance(self.width, int) and isinstance(self.height, int)):
            raise TypeError(f"width is {self.width!r} and height {self.height!r}: expected int")
        if self.width < 1 or self.height < 1:
            raise GeoreferenceError(f"a grid of {self.width} x {self.height} pixels has no area")
        if not all(math.isfinite(value) for value in self.transform[:6]):
            raise GeoreferenceError(f"the transform {tuple(self.transform[:6])} is not finite")
        if self.transform.determinant == 0:
            raise GeoreferenceError(
                f"the transform {tuple(self.transform[:6])} maps every pixel onto a line: correct "
                "the georeference"
            )
        with np.errstate(over="ignore", invalid="ignore"):
            reach = float(np.abs(self.bounds()).max())
        if not reach < _FARTHEST:
            raise GeoreferenceError(
                f"the transform {tuple(self.transform[:6])} leads to coordinates that are too "
                "large to measure areas: correct the georeference"
            )
        a, b, _, d, e, _ = self.transform[:6]
        pixel = min(math.hypot(a, d), math.hypot(b, e))
        if pixel < _LEAST_STEPS * np.spacing(reach):
            raise GeoreferenceError(
                f"pixels of {pixel:g} map units are smaller than float64 coordinates can resolve "
                f"at {self.transform.c:g}, {self.transform.f:g}: correct the georeference"
            )

    @property
    def extent(self) -> Window:
        """The window of all pixels."""
        return Window(0, 0, self.width, self.height)

    @property
    def flips(self) -> bool:
        """Whether a counter-clockwise triangle on the map is clockwise in pixel coordinates.

        True for a usual north-up raster, because its rows run down.
        """
        return bool(self.transform.determinant < 0)

    @property
    def is_rectilinear(self) -> bool:
        """Whether rows and columns run along the map's axes (no rotation or shear)."""
        return bool(self.transform.b == 0 and self.transform.d == 0)

    @property
    def y_runs_down(self) -> bool:
        """Whether a plot must show y downwards: without a CRS, y is the number of the row."""
        return bool(self.crs is None and self.transform.e > 0)

    @property
    def aspect(self) -> float:
        """Length of one unit of y divided by one unit of x, on the ground, for plots.

        Not 1 for a geographic CRS: there a degree of longitude is shorter than one of latitude.
        """
        if self.crs is None or not has_angles(self.crs):
            return 1.0
        _, south, _, north = self.bounds()
        middle = (south + north) / 2 * self.crs.axis_info[0].unit_conversion_factor
        return float(1 / max(np.cos(middle), 0.1))

    def window(self, window: Window) -> Grid:
        """Return the grid of the pixels in `window`."""
        a, b, _, d, e, _ = self.transform[:6]
        x, y = self.to_map([(window.col, window.row)])[0]
        transform = Affine(a, b, float(x), d, e, float(y))
        return Grid(window.width, window.height, transform, self.crs)

    def scaled(self, width: int, height: int) -> Grid:
        """Return the grid of the same area with another number of pixels."""
        sx, sy = self.width / width, self.height / height
        a, b, c, d, e, f = self.transform[:6]
        return Grid(width, height, Affine(a * sx, b * sy, c, d * sx, e * sy, f), self.crs)

    def to_map(self, points: ArrayLike) -> Points:
        """Convert pixel-edge coordinates (N, 2) to map coordinates (N, 2)."""
        return _apply(self.transform, points)

    def to_pixel(self, points: ArrayLike) -> Points:
        """Convert map coordinates (N, 2) to pixel-edge coordinates (N, 2)."""
        return _apply(~self.transform, points)

    def bounds(self) -> tuple[float, float, float, float]:
        """Return (west, south, east, north) of the smallest map box around the raster."""
        w, h = self.width, self.height
        corners = self.to_map([(0, 0), (w, 0), (w, h), (0, h)])
        (west, south), (east, north) = corners.min(axis=0), corners.max(axis=0)
        return float(west), float(south), float(east), float(north)

    def areas(self, points: ArrayLike, triangles: NDArray[np.integer]) -> NDArray[np.float64]:
        """Return the area of each triangle on the ground.

        Parameters
        ----------
        points : float (N, 2)
            Pixel-edge coordinates.
        triangles : int (T, 3)

        Returns
        -------
        float64 (T,)
            Square metres: planar in a projected CRS; on the ellipsoid, of whatever planet, in
            a geographic one, of a rotated pole too. Without a CRS, square pixels.
        """
        places = self.to_map(points)
        if self.crs is None:
            return np.abs(signed_areas(places, triangles))
        # 0 stands for an unknown unit.
        x_unit, y_unit = (axis.unit_conversion_factor or 1.0 for axis in self.crs.axis_info[:2])
        if not has_angles(self.crs):
            return np.abs(signed_areas(places, triangles)) * (x_unit * y_unit)
        ellipsoid = self.crs.ellipsoid
        if ellipsoid is None:
            raise GeoreferenceError(
                f"the CRS {self.crs.name!r} has no ellipsoid, so areas cannot be measured: "
                "give another CRS"
            )
        return ellipsoidal_areas(
            places * x_unit,
            triangles,
            ellipsoid.semi_major_metre,
            ellipsoid.semi_minor_metre,
            to_geodetic(self.crs),
        )


def snap(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return points rounded to the lattice of 1/256 pixel."""
    snapped: NDArray[np.float64] = np.rint(points * LATTICE) / LATTICE
    return snapped


def _apply(transform: Affine, points: ArrayLike) -> Points:
    xy = np.asarray(points, dtype=np.float64).reshape(-1, 2)
    a, b, c, d, e, f = transform[:6]
    x, y = xy[:, 0], xy[:, 1]
    return np.column_stack([a * x + b * y + c, d * x + e * y + f])
