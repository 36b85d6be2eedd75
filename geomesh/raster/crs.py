"""Coordinate reference systems (CRSs): told by GDAL, by files and by users, and what they mean.

rasterio, pyogrio and pyproj each bring a PROJ database of their own, of different versions. A
code that one knows may be unknown to another, or be defined in another way. So a CRS passes
between them by its definition (WKT2). The code is used only where it means the same.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import rasterio.crs
from pyproj import CRS, Transformer
from pyproj.exceptions import CRSError, ProjError
from rasterio.errors import CRSError as RasterioCRSError

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

LONLAT = "OGC:CRS84"

# The first word of the names that a GeoPackage gives where there is no CRS.
_UNDEFINED = "Undefined"

# Names that say nothing.
_NAMELESS = ("unknown", "undefined", "unnamed")

# PROJ takes a body with this semi-major axis, in metres, for the Earth; so do we.
_EARTH = 6375000.0
_EARTH_TOLERANCE = 0.005

# Two definitions that agree so far (in degrees, a tenth of a millimetre) at this many points
# along each side of the area of use place a raster alike.
_SAME_DEGREES = 1e-9
_SAMPLES = 4

_WKT2 = "WKT2_2019"


def to_pyproj(crs: Any) -> CRS | None:
    """Convert a CRS of any kind to pyproj.

    A code that pyproj's database lacks is looked up in that of rasterio. A shift of the datum
    (TOWGS84) that a definition brings is kept, as a bound CRS.

    Parameters
    ----------
    crs : rasterio.crs.CRS, pyproj.CRS, str, int, or None
        A text is a code such as EPSG:32633 (as pyogrio names the CRS of a layer), WKT, PROJ
        string or PROJJSON; anything else that `pyproj.CRS` takes will do.

    Returns
    -------
    pyproj.CRS or None
        None where there is no CRS: None, an empty one, and the "undefined" ones of GeoPackage.

    Raises
    ------
    pyproj.exceptions.CRSError
        If no database knows it, or it is not a CRS.
    """
    if crs is None or (isinstance(crs, str | rasterio.crs.CRS) and not crs):
        return None
    found = _from_rasterio(crs) if isinstance(crs, rasterio.crs.CRS) else _from_user(crs)
    return None if found.name.startswith(_UNDEFINED) else found


def horizontal(crs: CRS) -> CRS:
    """Return the part of a CRS that x and y are in: without a shift, without heights."""
    while True:
        if crs.is_bound and crs.source_crs is not None:
            crs = crs.source_crs
        elif crs.is_compound:
            crs = crs.sub_crs_list[0]
        else:
            return crs


def is_lonlat(crs: CRS | None) -> bool:
    """Return whether x is a longitude and y a latitude on Earth, in whatever unit.

    The coordinates of a rotated pole are not, though its CRS is geographic; nor are those of
    another planet.
    """
    if crs is None:
        return False
    plain = horizontal(crs)
    return bool(plain.is_geographic) and not is_rotated(plain) and is_on_earth(plain)


def is_on_earth(crs: CRS) -> bool:
    """Return whether a CRS is of places on Earth: not of another planet, not of a building site."""
    ellipsoid = crs.ellipsoid
    return (
        ellipsoid is not None
        and abs(ellipsoid.semi_major_metre - _EARTH) < _EARTH_TOLERANCE * _EARTH
    )


def has_angles(crs: CRS) -> bool:
    """Return whether x and y are angles: of any planet, of a rotated pole too."""
    plain = horizontal(crs)
    return bool(plain.is_geographic) or _is_planetocentric(plain)


def full_turn(crs: CRS) -> float:
    """Return 360 degrees in the unit of a CRS that has angles."""
    return float(2 * math.pi / horizontal(crs).axis_info[0].unit_conversion_factor)


def is_rotated(crs: CRS) -> bool:
    """Return whether x and y are angles of a grid with poles of its own."""
    plain = horizontal(crs)
    return bool(plain.is_geographic and plain.is_derived)


def is_of_map(crs: CRS) -> bool:
    """Return whether a CRS is one of x and y; a geocentric or a vertical one is not."""
    plain = horizontal(crs)
    return bool(plain.is_projected or plain.is_engineering) or has_angles(plain)


def to_geodetic(crs: CRS) -> Callable[[NDArray[np.float64]], NDArray[np.float64]] | None:
    """Return what converts a CRS's own angles to longitude and geodetic latitude.

    Parameters
    ----------
    crs : pyproj.CRS
        One with angles, on any planet.

    Returns
    -------
    callable, or None if they are longitude and geodetic latitude
        From float64 (..., 2) to the same shape, in radians; not finite where PROJ knows no place.
    """
    plain = horizontal(crs)
    if _is_planetocentric(plain) and plain.ellipsoid is not None:
        squares = (plain.ellipsoid.semi_major_metre / plain.ellipsoid.semi_minor_metre) ** 2

        def convert(angles: NDArray[np.float64]) -> NDArray[np.float64]:
            return np.stack([angles[..., 0], np.arctan(squares * np.tan(angles[..., 1]))], axis=-1)

        return convert
    if not is_rotated(plain) or plain.source_crs is None:
        return None
    unit, base_unit = (
        each.axis_info[0].unit_conversion_factor for each in (plain, plain.source_crs)
    )
    transformer = Transformer.from_crs(plain, plain.source_crs, always_xy=True)

    def transform(angles: NDArray[np.float64]) -> NDArray[np.float64]:
        lon, lat = transformer.transform(angles[..., 0] / unit, angles[..., 1] / unit)
        return np.stack([lon, lat], axis=-1) * base_unit

    return transform


def _is_planetocentric(plain: CRS) -> bool:
    system = plain.coordinate_system
    return system is not None and system.name == "spherical"


def same_crs(one: CRS | None, other: CRS | None) -> bool:
    """Return whether two CRSs place x and y alike, whatever their names and axis order."""
    if one is None or other is None:
        return one is other
    return one == other or one.equals(other, ignore_axis_order=True) or _places_alike(one, other)


def crs_label(crs: CRS | None) -> str:
    """Return what a message calls a CRS: its code, or else its name."""
    if crs is None:
        return "no CRS"
    if crs.is_bound and crs.source_crs is not None:
        return f"{crs_label(crs.source_crs)} with its own datum shift"
    code = _own_code(crs)
    if code:
        return ":".join(code)
    if crs.name.lower() not in _NAMELESS:
        return str(crs.name)
    made = crs.coordinate_operation
    return f"an unnamed CRS ({made.method_name if made is not None else crs.type_name})"


def is_known(crs: CRS) -> bool:
    """Return whether the code of a CRS says it all, to pyproj at least."""
    if crs.is_bound:  # PROJ would take ten seconds to look for its like
        return False
    coded = _by_code(crs)
    return coded is not None and same_crs(crs, coded)


def _from_user(crs: Any) -> CRS:
    try:
        return _without_needless_shift(CRS.from_user_input(crs))
    except CRSError:
        if not isinstance(crs, str | int):
            raise
        try:
            with rasterio.Env():  # GDAL's own message would go to stderr
                known = rasterio.crs.CRS.from_user_input(crs)
        except RasterioCRSError:
            known = None
        if not known:
            raise
        return _from_rasterio(known)


def _from_rasterio(crs: rasterio.crs.CRS) -> CRS:
    try:
        own = CRS.from_wkt(crs.to_wkt(version=_WKT2))
    except (CRSError, RasterioCRSError):
        # WKT2 knows more kinds of CRS than WKT1, but not all that GDAL reads.
        own = CRS.from_wkt(crs.to_wkt())
    if own.is_bound:
        return _without_needless_shift(own)
    coded = _by_code(own)
    return coded if coded is not None and _means(own, coded) else own


def _without_needless_shift(crs: CRS) -> CRS:
    """Return a bound CRS without its shift, if PROJ shifts its datum by as much itself."""
    if not crs.is_bound or crs.source_crs is None:
        return crs
    coded = _by_code(crs.source_crs)
    return coded if coded is not None and same_crs(crs, coded) else crs


def _by_code(crs: CRS) -> CRS | None:
    """Return what pyproj's database has under the code of a CRS."""
    authority = _own_code(crs) or crs.to_authority()
    try:
        return CRS.from_authority(*authority) if authority else None
    except CRSError:
        return None


def _own_code(crs: CRS) -> tuple[str, str] | None:
    """Return authority and code as the definition states them, which no database may know."""
    identifier = crs.to_json_dict().get("id", {})
    if "authority" in identifier and "code" in identifier:
        return str(identifier["authority"]), str(identifier["code"])
    return None


def _means(own: CRS, coded: CRS) -> bool:
    """Return whether a definition from another database is that of a code in pyproj's.

    Between two versions of a database a datum may be renamed. Under its new name pyproj has no
    shift for it, but under the code it has.
    """
    if same_crs(own, coded):
        return True
    try:
        Transformer.from_crs(own, LONLAT, always_xy=True, allow_ballpark=False)
    except ProjError:
        return _places_alike(own, coded, shifted=False)
    return False


def _places_alike(one: CRS, other: CRS, *, shifted: bool = True) -> bool:
    """Return whether both give the same longitude and latitude throughout the area of use.

    These are of WGS 84, or of the datum of each if not `shifted`.
    """
    plain, there = horizontal(one), horizontal(other)
    area = other.area_of_use or one.area_of_use
    if area is None or plain.type_name != there.type_name or plain.ellipsoid != there.ellipsoid:
        return False
    pairs: tuple[tuple[CRS, Any], ...] = ((one, LONLAT), (other, LONLAT))
    if not shifted:
        pairs = ((plain, plain.geodetic_crs), (there, there.geodetic_crs))
    west, south, east, north = area.bounds
    shares = np.linspace(0, 1, _SAMPLES)
    lon, lat = np.meshgrid(west + shares * ((east - west) % 360), south + shares * (north - south))
    try:
        first, second = (Transformer.from_crs(*pair, always_xy=True) for pair in pairs)
        x, y = second.transform(lon, lat, direction="INVERSE")
        (lon, lat), (lon_too, lat_too) = first.transform(x, y), second.transform(x, y)
    except ProjError:
        return False
    known = np.isfinite(x) & np.isfinite(y)
    turn = (lon - lon_too + 180) % 360 - 180
    return bool(
        known.any()
        and (np.abs(turn[known]) < _SAME_DEGREES).all()
        and (np.abs(lat - lat_too)[known] < _SAME_DEGREES).all()
    )
