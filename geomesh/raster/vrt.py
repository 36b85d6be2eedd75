"""The files of a mosaic (VRT): which of them a window and bands need."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree import ElementTree

if TYPE_CHECKING:
    from collections.abc import Collection, Iterator

    from geomesh.raster.grid import Window

# Elements of a VRT with the name of another file, and those whose absence does no harm.
_SOURCES = ("SourceFilename", "SourceDataset")
_OPTIONAL = ("Overview", "OverviewList")

# A name of GDAL that is no path, such as a URL, NETCDF:"file.nc":band or /vsizip/all.zip/a.tif.
NO_PATH = re.compile(r"/vsi|[A-Za-z0-9_+.-]{2,}:|[<{]")


def list_parts(
    path: Path,
    window: Window | None = None,
    bands: Collection[int] | None = None,
    known: set[Path] | None = None,
) -> Iterator[Path]:
    """Yield the local files of a VRT, also those of the VRTs in it, each once."""
    known = set() if known is None else known
    try:
        root = ElementTree.parse(path).getroot()
    except (OSError, ElementTree.ParseError, UnicodeError):
        return
    if root.tag != "VRTDataset":
        return
    for source in _needed(root, window, bands):
        text = (source.text or "").strip()
        if not text or NO_PATH.match(text):
            continue
        relative = source.get("relativeToVRT", source.get("relativetoVRT", "0")) == "1"
        # As GDAL does, follow a link to the VRT first.
        part = path.resolve().parent / text if relative else Path(text)
        if part in known:
            continue
        known.add(part)
        yield part
        if part.suffix.lower() == ".vrt" and _is_whole(root, window):
            yield from list_parts(part, known=known)


def _is_whole(root: ElementTree.Element, window: Window | None) -> bool:
    """Return whether the window is all of a mosaic: then all of the mosaics in it are read."""
    size = (root.get("rasterXSize", ""), root.get("rasterYSize", ""))
    return window is None or size == (str(window.width), str(window.height))


def _needed(
    element: ElementTree.Element, window: Window | None, bands: Collection[int] | None
) -> Iterator[ElementTree.Element]:
    """Yield the elements that name a file that is read in the window and bands."""
    for child in element:
        if child.tag in _SOURCES:
            yield child
        elif child.tag == "VRTRasterBand" and bands is not None and not _is_chosen(child, bands):
            continue
        elif child.tag not in _OPTIONAL and (window is None or _overlaps(child, window)):
            yield from _needed(child, window, bands)


def _is_chosen(band: ElementTree.Element, bands: Collection[int]) -> bool:
    number = band.get("band", "")
    is_mask = not number.isdecimal() or band.findtext("ColorInterp") == "Alpha"
    return is_mask or int(number) in bands


def _overlaps(source: ElementTree.Element, window: Window) -> bool:
    place = source.find("DstRect")
    if place is None:
        return True
    try:
        left, top, width, height = (
            float(place.get(name, "nan")) for name in ("xOff", "yOff", "xSize", "ySize")
        )
    except ValueError:
        return True
    beside = left >= window.stop_col or left + width <= window.col
    return not (beside or top >= window.stop_row or top + height <= window.row)
