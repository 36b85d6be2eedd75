"""What can go wrong, told in one line each: what, with the value, and the way out.

Every class has a `code`: the stable word that machine readers (the JSON-lines
protocol, batch scripts) see instead of the prose.
"""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator


def one_line(error: BaseException) -> str:
    """Return what an error says, or what caused it, in one line."""
    return " ".join(str(error.__cause__ or error).split()) or type(error).__name__


class GeomeshError(Exception):
    """Root of every error that geomesh raises on purpose; its text is one line."""

    code = "error"

    def __str__(self) -> str:
        # A file's name may hold a line break.
        return " ".join(super().__str__().splitlines())


class SourceError(GeomeshError):
    """The source cannot be opened or read as a raster."""

    code = "source"


class BandError(GeomeshError):
    """The bands asked for do not exist or cannot be used."""

    code = "band"


class EmptyError(GeomeshError):
    """There is no valid pixel to work on."""

    code = "empty"


class RecipeError(GeomeshError):
    """A parameter of the recipe has a value that makes no sense."""

    code = "recipe"


class GeoreferenceError(GeomeshError):
    """The georeference is missing or does not allow what was asked."""

    code = "georeference"


class OutputError(GeomeshError):
    """The output cannot be written: it exists, or its place or format is wrong."""

    code = "output"


class MeshFileError(GeomeshError):
    """A file does not hold a mesh that geomesh can read back."""

    code = "mesh-file"


class CertificateError(GeomeshError):
    """A mesh failed its own checks; it is never written."""

    code = "certificate"


class WorkerError(GeomeshError):
    """Those who should do the work cannot be reached, or were lost."""

    code = "worker"


class MissingExtraError(GeomeshError):
    """An optional library is not installed."""

    code = "missing-extra"


class GeomeshWarning(UserWarning):
    """Something the user should know; the result stands."""


@contextmanager
def extra_required(library: str, extra: str) -> Iterator[None]:
    """Raise MissingExtraError, which names the extra, if an import in the block fails."""
    try:
        yield
    except ImportError as error:
        raise MissingExtraError(
            f"{library} is not installed: pip install 'geomesh-toolkit[{extra}]'"
        ) from error
