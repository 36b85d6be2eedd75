"""CRSs as files state them, so that programs with another PROJ database find the same."""

from __future__ import annotations

from typing import Any

from pyproj import CRS
from pyproj.exceptions import CRSError

from geomesh.raster.crs import is_known

# Whose codes programs know.
_AUTHORITIES = ("EPSG", "ESRI", "OGC")


def portable_wkt(crs: CRS) -> str:
    """Return the WKT2 of a CRS, with its code only if the code says it all.

    Of a CRS with a code GDAL states little more than the code. A program whose database lacks
    the code would not find the CRS, and a datum shift would be lost. QGIS 3.22 finds none by the
    codes of planets.
    """
    authority = crs.to_json_dict().get("id", {}).get("authority")
    kept = authority in _AUTHORITIES and is_known(crs)
    wkt: str = (crs if kept else without_code(crs)).to_wkt()
    return wkt


def wkt1_or_wkt2(crs: CRS) -> str:
    """Return WKT1, which older programs read too, if it can express the CRS; else WKT2."""
    plain = without_code(crs)
    try:
        wkt: str = plain.to_wkt("WKT1_GDAL")
    except CRSError:
        wkt = plain.to_wkt()
    return wkt


def without_code(crs: CRS) -> CRS:
    """Return a CRS of the same definition, without a code of its own."""
    definition = crs.to_json_dict()
    named = definition["source_crs"] if crs.is_bound else definition
    return crs if named.pop("id", None) is None else CRS.from_json_dict(definition)


def cf_attributes(crs: CRS) -> dict[str, Any]:
    """Return the attributes of a grid mapping (CF conventions, appendix F), with WKT2.

    WKT2 only if CF does not know the projection.
    """
    wkt = {"crs_wkt": crs.to_wkt()}
    try:
        attributes = crs.to_cf()
    except KeyError:  # a rotated pole with other parameters than those of CF
        return wkt
    return attributes | wkt if "grid_mapping_name" in attributes else wkt
