"""The height of a mesh: which band it is, by what it is multiplied, and in which unit it is."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from geomesh.errors import BandError
from geomesh.raster.bands import Band
from geomesh.raster.metres import vertical_unit

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from pyproj import CRS

    from geomesh.arrays.table import Table
    from geomesh.mesh.provenance import SourceBand

# Names of units as rasters have them, and the unit.
_SPELLINGS: dict[str, tuple[str, ...]] = {
    "metre": ("m", "metre", "metres", "meter", "meters"),
    "foot": ("ft", "foot", "feet", "international foot", "international feet", "ift"),
    "US survey foot": ("us-ft", "ftus", "us_ft", "us survey foot", "us survey feet", "foot_us"),
    "centimetre": ("cm", "centimetre", "centimetres", "centimeter", "centimeters"),
    "millimetre": ("mm", "millimetre", "millimetres", "millimeter", "millimeters"),
    "kilometre": ("km", "kilometre", "kilometres", "kilometer", "kilometers"),
}
METRES: Mapping[str, float] = {
    "metre": 1.0,
    "foot": 0.3048,
    "US survey foot": 1200 / 3937,
    "centimetre": 0.01,
    "millimetre": 0.001,
    "kilometre": 1000.0,
}

# Bands that a message names.
_MOST_TOLD = 8

# Two units are the same if their ratio differs from 1 by less: feet differ by 2e-6.
_SAME = 2e-7


@dataclass(frozen=True)
class Height:
    """Which column of the nodes is their height.

    Parameters
    ----------
    band : str
        Name of the column.
    factor : float
        By which its values are multiplied.
    unit : str
        Of the product: a key of `METRES`, or the name in the CRS.
    metres : float
        Size of the unit.
    assumed : bool
        Whether neither the raster nor its CRS says in which unit the heights are.
    """

    band: str
    factor: float = 1.0
    unit: str = "metre"
    metres: float = 1.0
    assumed: bool = True

    @property
    def plural(self) -> str:
        """The name of the unit for several of it."""
        return self.unit.replace("foot", "feet") if "foot" in self.unit else f"{self.unit}s"

    def to_dict(self) -> dict[str, Any]:
        """Return the fields as plain JSON values."""
        return asdict(self)


def find_height(
    bands: Sequence[Band], z: int | str | None, factor: float, crs: CRS | None, *, name: str
) -> Height:
    """Return the height that a band of a raster is.

    The unit is that of the band; if it has none, that of the vertical part of the CRS; if there
    is none, the metre. With a factor it is the unit to which the factor converts, if there is
    such a unit, or else the metre.

    Parameters
    ----------
    bands : sequence of Band
        The bands of the mesh.
    z : int, str or None
        Number of a band in the raster (the first is 1), or its name. None: the only one.
    factor : float
    crs : pyproj.CRS, optional
    name : str
        Of the raster, for messages.

    Raises
    ------
    BandError
        If there is no such band, or its values are classes.
    """
    band = _choose(bands, z, name)
    if band.is_class:
        raise BandError(
            f"band {band.index} of {name} has classes, which are no heights: choose another `z`"
        )
    known = unit_of(band.unit) or (vertical_unit(crs) if crs is not None else None)
    unit, metres = known or ("metre", 1.0)
    if factor != 1.0:
        unit, metres = _converted(metres / factor)
    return Height(band.name, float(factor), unit, metres, assumed=known is None)


def bands_with_values(known: Sequence[SourceBand], nodes: Table) -> tuple[Band, ...]:
    """Return the bands of a source of which the nodes of a mesh have values."""
    return tuple(
        Band(
            *(band.index, band.description, None, band.name),
            is_class=nodes[band.name].dtype.kind in "iu",
            unit=band.unit,
        )
        for band in known
        if band.name in nodes
    )


def unit_of(text: str | None) -> tuple[str, float] | None:
    """Return name and size in metres of a unit of length; None if the text names none."""
    plain = (text or "").strip().lower()
    for unit, spellings in _SPELLINGS.items():
        if plain in spellings:
            return unit, METRES[unit]
    return None


def short_unit(unit: str) -> str:
    """Return the sign of a unit, such as "m"; the name itself if it has none."""
    return _SPELLINGS.get(unit, (unit,))[0]


def same_unit(one: float, other: float) -> bool:
    """Return whether two sizes in metres are those of the same unit."""
    return abs(one / other - 1) < _SAME


def _converted(metres: float) -> tuple[str, float]:
    for unit, size in METRES.items():
        if same_unit(metres, size):
            return unit, size
    return "metre", 1.0


def _choose(bands: Sequence[Band], z: int | str | None, name: str) -> Band:
    if z is None and len(bands) == 1:
        return bands[0]
    for band in bands:
        if str(z).strip() in (str(band.index), band.name):
            return band
    names = ", ".join(f"{band.index} ({band.name})" for band in bands[:_MOST_TOLD])
    more = ", ..." if len(bands) > _MOST_TOLD else ""
    if not bands:
        raise BandError(f"{name} has no values at its nodes that could be heights")
    if z is None:
        raise BandError(
            f"{name} has several bands: choose that of the heights with `z`: {names}{more}"
        )
    raise BandError(f"{name} has no band {z!r} for `z`; it has {names}{more}")
