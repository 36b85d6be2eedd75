"""The frame of a page: the lattice in which it draws, and what that is on the map and on Earth."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from affine import Affine
from pyproj import CRS, Transformer

from geomesh.raster.crs import LONLAT, crs_label, has_angles, horizontal, is_on_earth
from geomesh.raster.grid import LATTICE
from geomesh.raster.metres import metres_per_unit

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geomesh.arrays.types import Floats, Points
    from geomesh.raster.grid import Grid

# Points along a side of the grids of longitude and latitude, from coarse to fine.
_SIDES = (9, 17, 33, 65)

# Web Mercator ends here.
_FARTHEST_LATITUDE = 85.05

# The map around the mesh that web tiles may fill, as a share of its longer side.
_AROUND = 0.25

# An axis this short on the ground is drawn as if it were longer: near a pole.
_NARROWEST = 0.05

Box = tuple[int, int, int, int]


@dataclass(frozen=True, eq=False)
class Frame:
    """The plane of a page: pixels of a grid, divided into a lattice of 1/256 pixel.

    Parameters
    ----------
    grid : Grid
        That of the first mesh of the page.
    box : (int, int, int, int)
        Least column and row, greatest column and row of what the page shows, in lattice steps.
    """

    grid: Grid
    box: Box

    @cached_property
    def affine(self) -> Affine:
        """From lattice to map coordinates."""
        return self.grid.transform @ Affine.scale(1 / LATTICE)

    @cached_property
    def metres(self) -> tuple[float, float]:
        """Metres for a unit of x and of y, in the middle."""
        x, y = metres_per_unit(self.grid.crs, self._at(np.array([0.5]), np.array([0.5])))[0]
        return float(x), float(y)

    def head(self, *, basemap: bool) -> dict[str, Any]:
        """Return the frame as plain JSON values."""
        crs = self.grid.crs
        x, y = self.metres
        places = self._places()
        return {
            "affine": list(self.affine[:6]),
            "box": list(self.box),
            "crs": crs_label(crs) if crs is not None else None,
            "name": crs.name if crs is not None else None,
            "unit": _unit(crs),
            "decimals": self._decimals(),
            "metres": y,
            # Degrees of longitude are shorter than those of latitude.
            "narrow": max(x / y, _NARROWEST),
            "down": self.grid.y_runs_down,
            "lonlat": places,
            "mercator": self._mercator(places) if basemap and places is not None else None,
        }

    def _at(self, across: Floats, down: Floats) -> Points:
        """Return map coordinates (n, 2) at shares of the box."""
        left, top, right, bottom = self.box
        a, b, c, d, e, f = self.affine[:6]
        x, y = left + across * (right - left), top + down * (bottom - top)
        return np.column_stack([a * x + b * y + c, d * x + e * y + f])

    def _decimals(self) -> int:
        """Return how many decimals show a tenth of a pixel."""
        a, b, _, d, e, _ = self.grid.transform[:6]
        pixel = min(np.hypot(a, d), np.hypot(b, e))
        return int(np.clip(np.ceil(1 - np.log10(pixel)), 0, 12))

    def _places(self) -> dict[str, Any] | None:
        """Return longitude and latitude on a grid that is fine enough; None if there are none."""
        crs = self.grid.crs
        lonlat = None if crs is None else _lonlat_of(crs)
        if crs is None or lonlat is None:
            return None
        transformer = Transformer.from_crs(crs, lonlat, always_xy=True)
        # A pixel in degrees of latitude on Earth; about that on other planets.
        a, b, _, d, e, _ = self.grid.transform[:6]
        pixel = min(np.hypot(a, d), np.hypot(b, e)) * self.metres[1] / 111_000
        found = None
        for side in _SIDES:
            values = self._lonlat(transformer, side)
            if values is None:
                return None
            error = self._error(transformer, side, values)
            found = {
                "side": side,
                "lon": values[0].round(9).ravel().tolist(),
                "lat": values[1].round(9).ravel().tolist(),
                "decimals": int(np.clip(-np.log10(max(error, pixel / 20)), 0, 8)),
                "name": "" if is_on_earth(crs) else lonlat.name,
            }
            if error < pixel / 20:
                break
        return found

    def _lonlat(
        self, transformer: Transformer, side: int, shift: float = 0.0
    ) -> tuple[NDArray[Any], NDArray[Any]] | None:
        """Return longitudes and latitudes (side, side) without a jump; None if some have none."""
        steps = (np.arange(side - (shift > 0)) + shift) / (side - 1)
        across, down = np.meshgrid(steps, steps)
        lon, lat = transformer.transform(*self._at(across.ravel(), down.ravel()).T)
        if not (np.isfinite(lon).all() and np.isfinite(lat).all()):
            return None
        turns = np.unwrap(lon.reshape(across.shape), axis=1, period=360)
        turns += 360 * np.rint((lon[0] - turns[0, 0]) / 360)
        turns[:, :] += (np.unwrap(turns[:, 0], period=360) - turns[:, 0])[:, None]
        return turns, lat.reshape(across.shape)

    def _error(
        self, transformer: Transformer, side: int, values: tuple[NDArray[Any], NDArray[Any]]
    ) -> float:
        """Return the greatest error of interpolation in the middles of the cells, in degrees."""
        middles = self._lonlat(transformer, side, 0.5)
        if middles is None:
            return np.inf
        errors = []
        for shown, true in zip(values, middles, strict=True):
            mean = (shown[:-1, :-1] + shown[1:, :-1] + shown[:-1, 1:] + shown[1:, 1:]) / 4
            away = np.abs(mean - true)
            errors.append(float(np.minimum(away, np.abs(away - 360)).max()))
        return max(errors)

    def _mercator(self, places: dict[str, Any]) -> dict[str, Any] | None:
        """Return lattice places on a grid over Web Mercator, for tiles; None if some have none."""
        side = _SIDES[2]
        lon, lat = np.array(places["lon"]), np.array(places["lat"])
        u = lon / 360 + 0.5
        clipped = np.deg2rad(np.clip(lat, -_FARTHEST_LATITUDE, _FARTHEST_LATITUDE))
        v = 0.5 - np.arcsinh(np.tan(clipped)) / (2 * np.pi)
        pad = _AROUND * max(float(np.ptp(u)), float(np.ptp(v)))
        box = [u.min() - pad, max(v.min() - pad, 0), u.max() + pad, min(v.max() + pad, 1)]
        left, top, right, bottom = map(float, box)
        us, vs = np.meshgrid(np.linspace(left, right, side), np.linspace(top, bottom, side))
        back = Transformer.from_crs(LONLAT, self.grid.crs, always_xy=True)
        degrees = np.rad2deg(np.arctan(np.sinh((0.5 - vs) * 2 * np.pi)))
        x, y = back.transform(((us - 0.5) * 360).ravel(), degrees.ravel())
        if not (np.isfinite(x).all() and np.isfinite(y).all()):
            return None
        a, b, c, d, e, f = (~self.affine)[:6]
        return {
            "box": [left, top, right, bottom],
            "side": side,
            "x": (a * x + b * y + c).round(2).tolist(),
            "y": (d * x + e * y + f).round(2).tolist(),
        }


def _lonlat_of(crs: CRS) -> CRS | None:
    """Return the CRS of longitude and latitude of the same planet; None if there is none."""
    if is_on_earth(crs):
        return CRS(LONLAT)
    return horizontal(crs).geodetic_crs


def _unit(crs: CRS | None) -> str:
    """Return the unit of x and y: that of a pixel, degrees, or the name that the CRS gives."""
    if crs is None:
        return "px"
    name = str(horizontal(crs).axis_info[0].unit_name)
    if has_angles(crs):
        return "°" if name == "degree" else name
    return {"metre": "m"}.get(name, name)
