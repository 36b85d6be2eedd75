"""Placed shapes: how coordinates go from shapes to the pixels of a grid, and back."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import shapely
from pyproj import Transformer
from pyproj.enums import TransformDirection
from pyproj.exceptions import ProjError

from geomesh.errors import GeoreferenceError
from geomesh.raster.crs import crs_label, full_turn, has_angles, same_crs

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pyproj import CRS

    from geomesh.arrays.types import Mask, Points
    from geomesh.raster.grid import Grid
    from geomesh.raster.shapes import Shapes

# Longitudes may differ by a few whole turns: one source counts from -180, another to 360.
_MOST_TURNS = 3


@dataclass(frozen=True, eq=False)
class Placed:
    """Polygons or lines on the pixels of a grid.

    Parameters
    ----------
    area : Polygons
    grid : Grid
    transformer : pyproj.Transformer, optional
        From the CRS of the grid to that of the area. None if they are the same.
    """

    area: Shapes
    grid: Grid
    transformer: Transformer | None

    @classmethod
    def of(cls, area: Shapes, grid: Grid, name: str) -> Placed:
        """Place an area on the grid of the raster `name`.

        Raises
        ------
        GeoreferenceError
            If there is no transformation from one CRS to the other.
        """
        if area.crs is None or same_crs(area.crs, grid.crs):
            return cls(area, grid, None)
        if grid.crs is None:
            raise GeoreferenceError(
                f"{area.name} is in {crs_label(area.crs)} but {name} has no CRS; georeference the "
                f"raster, or give a {area.parameter} without a CRS in the raster's coordinates"
            )
        try:
            transformer = Transformer.from_crs(grid.crs, area.crs, always_xy=True)
        except ProjError as error:
            raise GeoreferenceError(
                f"{area.name} is in the CRS {area.crs.name!r}, and there is no transformation to "
                f"it from the CRS of {name}, {grid.crs.name!r}; save it in that CRS"
            ) from error
        return cls(area, grid, transformer)

    def from_pixel(self, pixels: Points) -> Points:
        """Convert pixel-edge coordinates (N, 2) to coordinates of the area; inf if impossible."""
        xy = self.grid.to_map(pixels)
        if self.transformer is not None:
            xy = np.column_stack(self.transformer.transform(*xy.T))
        return xy

    def is_defined(self, pixels: Points) -> bool:
        """Return whether all points (N, 2) have a place in the CRS of the area."""
        return self.transformer is None or bool(np.isfinite(self.from_pixel(pixels)).all())

    def contains(self, pixels: Points) -> Mask:
        """Return which points, in pixel-edge coordinates (N, 2), are in the area or on its border.

        A point without a place in the CRS of the area is outside.
        """
        xy, shape = self.from_pixel(pixels), self.area.shape
        found = np.zeros(len(xy), np.bool_)
        known = np.isfinite(xy).all(axis=1)
        x, y = xy[known].T
        if len(x):
            shapely.prepare(shape)
            west, _, east, _ = shape.bounds
            inside = np.zeros(len(x), np.bool_)
            for turn in _turns(self.area.crs, (x.min(), x.max()), (west, east)):
                inside |= shapely.intersects_xy(shape, x + turn, y)
            found[known] = inside
        return found

    def turns(self) -> Iterator[float]:
        """Yield the whole turns to add to x so that sides of the area come to lie on the grid."""
        west, _, east, _ = self.area.shape.bounds
        if self.transformer is not None and self.grid.crs is not None:
            half = full_turn(self.grid.crs) / 2
            west, east = -half, half
        left, _, right, _ = self.grid.bounds()
        return _turns(self.grid.crs, (west, east), (left, right))

    def to_pixel(self, xy: Points, turn: float) -> Points:
        """Convert coordinates (N, 2) of the area to pixel-edge coordinates; inf if impossible."""
        if self.transformer is not None:
            inverse = TransformDirection.INVERSE
            xy = np.column_stack(self.transformer.transform(xy[:, 0], xy[:, 1], direction=inverse))
        with np.errstate(invalid="ignore"):
            return self.grid.to_pixel(xy + np.array([turn, 0.0]))


def _turns(crs: CRS | None, x: tuple[float, float], to: tuple[float, float]) -> Iterator[float]:
    """Yield the multiples of a whole turn by which the range `x` can be moved to touch `to`."""
    if crs is None or not has_angles(crs):
        yield 0.0
        return
    full = full_turn(crs)
    first = max(math.ceil((to[0] - x[1]) / full), -_MOST_TURNS)
    last = min(math.floor((to[1] - x[0]) / full), _MOST_TURNS)
    for turn in range(first, last + 1):
        yield turn * full
