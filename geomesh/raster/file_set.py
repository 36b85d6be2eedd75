"""Rasters of several files: name the file that is missing, is broken, or was meant.

Only local files are looked for. GDAL itself opens a mosaic without its tiles, and a file beside
a raster in place of the raster.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from geomesh.errors import SourceError
from geomesh.raster.vrt import NO_PATH, list_parts

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator

    from geomesh.raster.grid import Window

# Extension of a file of pixels to that of the file that describes them.
_HEADERS = {
    **dict.fromkeys((".bil", ".bip", ".bsq", ".dat", ".flt", ".raw", ".bin", ".img"), ".hdr"),
    ".sdat": ".sgrd",  # SAGA
    ".rst": ".rdc",  # Idrisi
    ".gri": ".grd",  # R
}

# Extension of a file that is opened by its description to that of its pixels.
_PIXELS = {".grd": ".gri", ".ers": "", ".mrf": ".idx"}

# Endings of files beside a raster, and what they have. They take the place of its extension or are
# appended to it.
_BESIDE = {
    ".ovr": "the overviews",
    ".msk": "the mask",
    ".aux.xml": "the statistics and other metadata",
    ".prj": "the CRS",
    **dict.fromkeys((".tfw", ".tifw", ".jgw", ".pgw", ".j2w", ".wld"), "the georeference"),
    **dict.fromkeys((".stx", ".clr", ".idx"), "other metadata"),
    ".gri": "the pixels",
}

# Of these, the endings that are always appended: scene.msk may be a raster of its own.
_APPENDED = (".ovr", ".msk", ".aux.xml")

# The pixels that may lie beside such a file, the likely ones first.
_RASTERS = (
    *(".tif", ".tiff", ".img", ".bil", ".bip", ".bsq", ".dat", ".flt", ".raw", ".bin", ".jp2"),
    *(".png", ".jpg", ".jpeg", ".asc", ".sdat", ".rst", ".grd", ".mrf", ".vrt", ""),
)

# Files of an ArcInfo grid without which it is not one.
_ARC_GRID = ("hdr.adf", "w001001.adf", "w001001x.adf")

# A path in a message of GDAL.
_PATH = re.compile(r"[^\s`'\",]*[/\\][^`'\",:]+")


def check_source(name: str) -> None:
    """Raise an error if a path is that of a file beside a raster, or no text.

    Raises
    ------
    SourceError
    """
    try:
        name.encode()
    except UnicodeEncodeError as error:
        raise SourceError(
            f"{name}: its path is not valid UTF-8, so GDAL cannot open it; rename it, or set "
            "PYTHONUTF8=1"
        ) from error
    path = _local(name)
    for ending, content in _BESIDE.items() if path is not None and path.is_file() else ():
        if path is not None and path.name.lower().endswith(ending):
            main = _main_file(path, ending)
            if main is not None:
                raise SourceError(f"{name} has {content} of {main.name}; give {main.name} instead")


def explain_failure(name: str) -> str | None:
    """Return why GDAL cannot open a local path: a file of its set is missing. None if unknown."""
    path = _local(name)
    if path is None or not path.exists():
        return None
    if path.is_dir():
        return _explain_folder(path)
    explain = _EXPLANATIONS.get(path.suffix.lower())
    return None if explain is None else explain(path)


def require_parts(name: str, window: Window, bands: Collection[int]) -> None:
    """Raise an error if a mosaic lacks a tile that the window and bands need.

    Parameters
    ----------
    name : str
        Name of a VRT; of another raster nothing is required.
    window : Window
        In pixels of the mosaic.
    bands : collection of int
        1-based numbers.

    Raises
    ------
    SourceError
    """
    path = _local(name)
    for part in list_parts(path, window, bands) if path is not None and path.is_file() else ():
        if not part.exists():
            raise SourceError(f"{name}: {_missing(part)}")


def find_culprit(name: str, message: str) -> str | None:
    """Return which file of a set is missing or broken, if GDAL's message names it."""
    path = _local(name)
    if path is None:
        return None
    for part in list_parts(path) if path.suffix.lower() == ".vrt" else ():
        if part.name in message:
            return f"its tile {part} is truncated or damaged; download or export that again"
    for found in _PATH.findall(message):
        if not Path(found.strip()).exists():
            return f"its file {found.strip()} is missing; put it there"
    return None


def _missing(part: Path) -> str:
    return f"its file {part} is missing; put it there, or make the mosaic again without it"


def _local(name: str) -> Path | None:
    return None if NO_PATH.match(name) and not Path(name).exists() else Path(name)


def _files(path: Path, extensions: Collection[str], appended: str) -> Iterator[Path]:
    """Yield the files beside a path with one of the extensions, in any case of letters.

    The extension takes the place of that of `path` without `appended`, or is appended to it.
    """
    stem = path.name[: len(path.name) - len(appended)] if appended else path.stem
    beside = {each.name.lower(): each for each in path.parent.iterdir() if each.is_file()}
    for extension in extensions:
        for name in (f"{stem}{extension}", f"{path.name}{extension}"):
            found = beside.get(name.lower())
            if found is not None and found.name != path.name:
                yield found


def _main_file(path: Path, ending: str) -> Path | None:
    """Return the raster beside which a file lies: scene.tif of scene.tif.ovr or scene.tfw."""
    whole = path.with_name(path.name[: -len(ending)])
    if ending in _APPENDED or (whole.is_file() and whole.suffix):
        return whole if whole.is_file() else None
    return next(_files(path, _RASTERS, ending), None)


def _lacking(path: Path, extension: str, role: str) -> str | None:
    if next(_files(path, [extension], ""), None) is not None:
        return None
    return f"its file {path.stem}{extension}, {role}, is missing; put it beside"


def _explain_folder(folder: Path) -> str | None:
    names = {each.name.lower() for each in folder.iterdir()}
    if not any(name.endswith(".adf") for name in names):
        return None
    lacking = [name for name in _ARC_GRID if name not in names]
    return f"its file {lacking[0]} is missing; put it into {folder}" if lacking else None


def _explain_mosaic(path: Path) -> str | None:
    missing = next((part for part in list_parts(path) if not part.exists()), None)
    return None if missing is None else _missing(missing)


def _explain_header(path: Path) -> str:
    described = [data for data, header in _HEADERS.items() if header == path.suffix.lower()]
    main = next(_files(path, described, ""), None)
    if main is None:
        return "it describes a raster whose file of pixels is missing; put it beside"
    return f"it describes {main.name}; give {main.name} instead"


def _explain_pixels(path: Path) -> str | None:
    suffix = path.suffix.lower()
    lacking = _lacking(path, _HEADERS[suffix], "that describes it")
    return f"if it is an ENVI image, {lacking}" if lacking and suffix == ".img" else lacking


def _explain_dimap(path: Path) -> str | None:
    """Explain a BEAM-DIMAP: its bands are ENVI images in a folder beside it."""
    folder = path.with_suffix(".data")
    if not folder.is_dir():
        return f"its folder {folder.name} is missing; put it beside"
    band = min((each.name for each in folder.glob("*.img")), default="")
    return f"its bands are files of their own; give one, such as {folder / band}" if band else None


_EXPLANATIONS: dict[str, Callable[[Path], str | None]] = {
    ".adf": lambda path: _explain_folder(path.parent),
    ".vrt": _explain_mosaic,
    ".dim": _explain_dimap,
    **dict.fromkeys(_HEADERS, _explain_pixels),
    **dict.fromkeys(_HEADERS.values(), _explain_header),
    **{
        suffix: lambda path: _lacking(path, _PIXELS[path.suffix.lower()], "with its pixels")
        for suffix in _PIXELS
    },
}
