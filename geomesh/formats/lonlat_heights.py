"""Heights of geometry in longitude and latitude that was cut, or follows a curve."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import shapely
from pyproj import Transformer

from geomesh.raster.crs import LONLAT, full_turn, has_angles

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from pyproj import CRS

    from geomesh.arrays.types import Floats, Points


@dataclass(frozen=True, eq=False)
class Lift:
    """Gives the points of a geometry the heights that the mesh has there.

    A surface is linear on the map, not in longitude and latitude. So the points go back there.

    Parameters
    ----------
    crs : pyproj.CRS
    places : float64 (N, 2)
        The nodes on the map.
    heights : float64 (N,)
        Of the nodes.
    """

    crs: CRS
    places: Points
    heights: Floats

    def __call__(self, flat: bytes, corners: NDArray[np.int32]) -> bytes:
        """Return the WKB of a geometry with heights.

        Parameters
        ----------
        flat : bytes
            WKB of pieces of a triangle, edge or node, in degrees.
        corners : int (3,), (2,) or (1,)
            Its nodes.
        """
        heights = self.heights[corners]

        def lifted(places: NDArray[np.float64]) -> NDArray[np.float64]:
            degrees = places[:, :2]
            shares = _shares(self._to_map(degrees, corners), self.places[corners])
            shares[~np.isfinite(shares).all(axis=1)] = 1 / len(corners)
            return np.column_stack([degrees, shares @ heights])

        encoded: bytes = shapely.to_wkb(
            shapely.transform(shapely.force_3d(shapely.from_wkb(flat)), lifted, include_z=True),
            byte_order=1,
            flavor="iso",
        )
        return encoded

    def _to_map(self, degrees: NDArray[np.float64], corners: NDArray[np.int32]) -> Points:
        transformer = Transformer.from_crs(LONLAT, self.crs, always_xy=True)
        x, y = transformer.transform(*degrees.T)
        if has_angles(self.crs):
            turn = full_turn(self.crs)
            x += turn * np.rint((self.places[corners, 0].mean() - x) / turn)
        return np.column_stack([x, y])


def _shares(points: Points, corners: Points) -> NDArray[np.float64]:
    """Return by which shares (P, C) of one to three corners (C, 2) points (P, 2) are made up."""
    shares = np.ones((len(points), len(corners)))
    if len(corners) > 1:
        sides = (corners[1:] - corners[0]).T
        with np.errstate(invalid="ignore"):
            shares[:, 1:] = (points - corners[0]) @ np.linalg.pinv(sides).T
        shares[:, 0] = 1 - shares[:, 1:].sum(axis=1)
    return shares
