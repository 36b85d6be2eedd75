"""Errors of geomesh. Each message is one line: what is wrong, the value, and the way out.

Every class has a `code`: a stable word for programs that read the JSON lines or the
results of a batch. The text of a message can change; the code does not.
"""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator


def one_line(error: BaseException) -> str:
    """Return the message of an error, or of its cause if it has one, as one line."""
    return " ".join(str(error.__cause__ or error).split()) or type(error).__name__


class GeomeshError(Exception):
    """Base class of every error that geomesh raises on purpose. The message is one line."""

    code = "error"

    def __str__(self) -> str:
        # The name of a file may contain a line break.
        return " ".join(super().__str__().splitlines())


class SourceError(GeomeshError):
    """The source cannot be opened or read as a raster."""

    code = "source"


class BandError(GeomeshError):
    """A requested band does not exist or cannot be used."""

    code = "band"


class EmptyError(GeomeshError):
    """There is no valid pixel."""

    code = "empty"


class RecipeError(GeomeshError):
    """A parameter of the recipe has an invalid value."""

    code = "recipe"


class LevelError(GeomeshError):
    """Heights at which a surface is to be cut, or the interval between them, are not valid."""

    code = "level"


class GeoreferenceError(GeomeshError):
    """The georeference is missing, or does not allow the requested operation."""

    code = "georeference"


class OutputError(GeomeshError):
    """The output cannot be written: it exists already, or its path or format is wrong."""

    code = "output"


class MeshFileError(GeomeshError):
    """A file does not contain a mesh that geomesh can read."""

    code = "mesh-file"


class CertificateError(GeomeshError):
    """A mesh failed its certificate. Such a mesh is never written."""

    code = "certificate"


class WorkerError(GeomeshError):
    """The workers cannot be reached, or a worker was lost."""

    code = "worker"


class MissingExtraError(GeomeshError):
    """An optional library is not installed."""

    code = "missing-extra"


class GeomeshWarning(UserWarning):
    """Something that the user should know. The result is still valid."""


@contextmanager
def extra_required(library: str, extra: str) -> Iterator[None]:
    """Raise MissingExtraError if an import in the block fails. The message names the extra."""
    try:
        yield
    except ImportError as error:
        raise MissingExtraError(
            f"{library} is not installed: pip install 'geomesh-toolkit[{extra}]'"
        ) from error
