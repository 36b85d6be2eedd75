"""Find out what a source says about its bands: descriptions, and the tags of GRIB and NetCDF."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING
from xml.etree import ElementTree

import numpy as np
import rasterio
import rasterio.shutil

from geomesh.raster.band_names import BandText

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

# Tags with the name of a band, the best one first. GDAL's NetCDF driver writes the last three.
_NAMES = ("bandname", "long_name", "standard_name", "netcdf_varname")

# Names that programs give to a band or a variable without a name.
_MEANINGLESS = re.compile(r"GDAL Band Number \d+|band_data|__xarray_dataarray_variable__")

# The name of a dataset that is one array of a file: ZARR:"file":/group/name.
_ARRAY = re.compile(r'(?:HDF4|HDF5|ZARR)\w*:.*[:/]([^:/"]+)"?', re.IGNORECASE)

# What GDAL writes for the element of a message whose parameter it does not know.
_NO_ELEMENT = ("", "unknown", "reserved", "missing", "undefined")
_MISSING = "255"

_DIMENSION = "NETCDF_DIM_"
_SINCE = re.compile(r"(second|minute|hour|day)s? since (\d{4}-\d\d?-\d\d?)(?:[T ]+([\d:.]+))?\s*Z?")
_CALENDARS = ("standard", "gregorian", "proleptic_gregorian")
_SECONDS = {"second": 1, "minute": 60, "hour": 3600, "day": 86400}


def dataset_texts(dataset: rasterio.DatasetReader) -> list[BandText]:
    """Return what a dataset says about each of its bands."""
    tags, array = dataset.tags(), _ARRAY.fullmatch(dataset.name)
    return [
        _grib_text(own, description)
        if "GRIB_ELEMENT" in own
        else BandText(
            known_texts(
                (
                    _tag(own, _NAMES[0]),
                    description,
                    *(_tag(own, key) for key in _NAMES[1:]),
                    array and array[1],
                )
            ),
            tuple(
                _value(text, tags, name.removeprefix(_DIMENSION))
                for name, text in own.items()
                if name.startswith(_DIMENSION)
            ),
        )
        for own, description in zip(
            map(dataset.tags, dataset.indexes), read_descriptions(dataset), strict=True
        )
    ]


def read_descriptions(dataset: rasterio.DatasetReader) -> tuple[str | None, ...]:
    """Return the descriptions of the bands. Bytes that are not UTF-8 become U+FFFD."""
    try:
        return tuple(dataset.descriptions)
    except UnicodeDecodeError:
        return _read_in_vrt(dataset, "Description")


def read_units(dataset: rasterio.DatasetReader) -> tuple[str | None, ...]:
    """Return the units of the bands. Bytes that are not UTF-8 become U+FFFD."""
    try:
        return tuple(dataset.units)
    except UnicodeDecodeError:
        return _read_in_vrt(dataset, "UnitType")


def _read_in_vrt(dataset: rasterio.DatasetReader, element: str) -> tuple[str | None, ...]:
    """Return a text of each band from a VRT of the dataset, which contains its bytes.

    rasterio cannot return texts in an old encoding, such as those of some ENVI headers.
    """
    with rasterio.MemoryFile(ext=".vrt") as memory:
        rasterio.shutil.copy(dataset, memory.name, driver="VRT")
        document = memory.read().decode(errors="replace")
    try:
        bands = ElementTree.fromstring(document).findall("VRTRasterBand")
    except ElementTree.ParseError:  # a control character
        return (None,) * int(dataset.count)
    return tuple(band.findtext(element) for band in bands)


def known_texts(texts: Sequence[str | None]) -> tuple[str, ...]:
    """Return the texts that say something, each once."""
    said = (text for text in texts if text and not _MEANINGLESS.fullmatch(text.strip()))
    return tuple(dict.fromkeys(said))


def time_text(time: np.datetime64) -> str:
    """Return a time as in 20200101 or 20200101T0630."""
    text = np.datetime_as_string(time.astype("datetime64[s]"))
    return re.sub("[-:]", "", text.removesuffix("T00:00:00").removesuffix(":00"))


def number_text(number: str) -> str:
    """Return a number without a needless decimal, and with m as its sign if it is negative."""
    return re.sub("^-", "m", re.sub(r"\.0+$", "", number))


def _tag(tags: Mapping[str, str], key: str) -> str | None:
    return next((text for name, text in tags.items() if name.lower() == key), None)


def _grib_text(tags: Mapping[str, str], description: str | None) -> BandText:
    """Return the element and the level of a GRIB message; several of them differ in time."""
    own = description if description and not re.search(r"\[.*\] ?\S+=\"", description) else None
    level = tags.get("GRIB_SHORT_NAME", "")
    level = re.sub(r"^0-(?=[A-Za-z]+$)", "", level)  # a surface has no height: 0-SFC
    level = "" if level.endswith("RESERVED") else level
    name = " ".join(filter(None, (_grib_element(tags), level)))
    seconds = re.search(r"-?\d+", tags.get("GRIB_VALID_TIME", ""))
    time = (time_text(np.datetime64(int(seconds[0]), "s")),) if seconds else ()
    return BandText(known_texts((own, name)), time)


def _grib_element(tags: Mapping[str, str]) -> str:
    if tags["GRIB_ELEMENT"].lower() not in _NO_ELEMENT:
        return tags["GRIB_ELEMENT"]
    # A parameter that GDAL's tables do not have, by its discipline, category and number.
    discipline = re.match(r"\d+", tags.get("GRIB_DISCIPLINE", ""))
    numbers = tags.get("GRIB_PDS_TEMPLATE_NUMBERS", "").split()[:2]
    if discipline is None or len(numbers) < 2 or numbers[1] == _MISSING:
        return ""
    return " ".join(("param", discipline[0], *numbers))


def _value(text: str, tags: Mapping[str, str], dimension: str) -> str:
    """Return a coordinate as GDAL stores it, or as a date if its unit says that it is a time."""
    try:
        number = float(text)
    except ValueError:
        return text
    unit = _SINCE.match(tags.get(f"{dimension}#units", ""))
    calendar = tags.get(f"{dimension}#calendar", "standard")
    if unit is None or calendar.lower() not in _CALENDARS:
        return number_text(text)
    return _time_since(number * _SECONDS[unit[1]], unit) or number_text(text)


def _time_since(seconds: float, unit: re.Match[str]) -> str | None:
    year, month, day = unit[2].split("-")
    try:
        start = np.datetime64(f"{year}-{month:0>2}-{day:0>2}", "s")
        for size, part in zip((3600, 60, 1), (unit[3] or "0").split(":"), strict=False):
            start += np.timedelta64(round(float(part) * size), "s")
        return time_text(start + np.timedelta64(round(seconds), "s"))
    except (ValueError, OverflowError):
        return None
