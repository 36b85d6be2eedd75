"""Find the images to evaluate: expand files, folders and patterns to a list of rasters."""

from __future__ import annotations

import glob
import os
import warnings
from os import PathLike
from typing import TYPE_CHECKING

from geomesh.errors import GeomeshWarning, SourceError, one_line

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

# Extensions of rasters in a folder. A file with another extension can be named directly.
EXTENSIONS = (
    *(".tif", ".tiff", ".jp2", ".vrt", ".img", ".png", ".jpg", ".jpeg", ".webp", ".bmp"),
    *(".gif", ".asc", ".dem", ".hgt", ".bil", ".ntf"),
)

_SHOWN = 3


def find_images(sources: Iterable[str | PathLike[str]]) -> list[str]:
    """Return the rasters that `sources` name, in order, each file once.

    Parameters
    ----------
    sources : iterable of str or PathLike
        A folder means the rasters directly in it that have one of `EXTENSIONS`, sorted by
        name. A pattern such as ``scenes/**/*.tif`` means the files that match it. Everything
        else is used as it is: a file, a URL or another name that GDAL can open.

    Raises
    ------
    SourceError
        If a folder has no raster, no file matches a pattern, or there are no sources.

    Warns
    -----
    GeomeshWarning
        If a file was named more than once, even by different paths.
    """
    found: dict[object, str] = {}
    twice: dict[object, str] = {}
    for source in sources:
        for path in _expand(os.fspath(source)):
            key = _identity(path)
            if key in found:
                twice[key] = path
            else:
                found[key] = path
    if not found:
        raise SourceError("no images: name files, folders or patterns such as 'scenes/*.tif'")
    if twice:
        names = list(twice.values())
        shown = ", ".join(names[:_SHOWN]) + (", ..." if len(names) > _SHOWN else "")
        warnings.warn(f"named more than once, but used once: {shown}", GeomeshWarning, stacklevel=2)
    return list(found.values())


def _expand(source: str) -> Iterator[str]:
    if os.path.isdir(source):  # noqa: PTH112
        yield from _rasters_in(source)
    elif glob.has_magic(source) and not os.path.lexists(source) and "://" not in source:
        matches = sorted(glob.glob(source, recursive=True))  # noqa: PTH207
        if not matches:
            raise SourceError(f"no file matches {source}; check the path")
        for match in matches:
            if os.path.isfile(match):  # noqa: PTH113
                yield match
    else:
        yield source


def _rasters_in(folder: str) -> list[str]:
    try:
        names = sorted(os.listdir(folder))  # noqa: PTH208
    except OSError as error:
        raise SourceError(f"the folder {folder} cannot be read: {one_line(error)}") from error
    paths = [os.path.join(folder, name) for name in names if name.lower().endswith(EXTENSIONS)]  # noqa: PTH118
    paths = [path for path in paths if os.path.isfile(path)]  # noqa: PTH113
    if not paths:
        raise SourceError(
            f"the folder {folder} has no images ({', '.join(EXTENSIONS)}); name a folder with "
            "images, or a pattern such as 'scenes/**/*.tif'"
        )
    return paths


def _identity(path: str) -> object:
    """Return a key that is equal for two paths of the same file."""
    try:
        status = os.stat(path)  # noqa: PTH116
    except (OSError, ValueError):  # a URL, or a file that does not exist
        return path
    return status.st_dev, status.st_ino
