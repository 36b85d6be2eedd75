"""Rows of numbers as text, and the metadata document in comments: for formats that are text."""

from __future__ import annotations

import re
from itertools import chain
from typing import TYPE_CHECKING

import numpy as np

from geomesh.formats.batch_stream import BATCH_ROWS
from geomesh.formats.document import KEY

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence
    from typing import Any, BinaryIO

    from numpy.typing import NDArray

    from geomesh.mesh.triangle_mesh import TriangleMesh

# Programs with buffers of fixed size read lines of 255 characters.
_LONGEST_LINE = 240

# Control characters and halves of characters: no line of text, and no XML, may have them.
_UNFIT = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff\ufffe\uffff]")


def write_rows(
    out: BinaryIO,
    template: str,
    columns: Sequence[NDArray[Any]],
    advance: Callable[[int], None] | None = None,
) -> None:
    """Write rows of numbers as text.

    Parameters
    ----------
    out : binary file
    template : str
        Text of a row: ``%d`` for a whole number, ``%r`` for the shortest text that gives back
        every bit of a float.
    columns : sequence of arrays (N,)
        As many as the template has numbers.
    advance : callable(rows), optional
        Called after each batch.
    """
    total = len(columns[0])
    for start in range(0, total, BATCH_ROWS):
        rows = slice(start, start + BATCH_ROWS)
        count = min(BATCH_ROWS, total - start)
        # One formatting of many rows: several times faster than one for each row.
        numbers = chain.from_iterable(
            zip(*(column[rows].tolist() for column in columns), strict=True)
        )
        out.write(((template * count) % tuple(numbers)).encode("ascii"))
        if advance is not None:
            advance(count)


def read_rows(lines: Iterable[str], columns: Sequence[int], kind: type) -> NDArray[Any]:
    """Return columns (N, C) of lines of numbers; raise ValueError if a line has no such number."""
    first = next(iter(lines := iter(lines)), None)
    if first is None:
        return np.empty((0, len(columns)), kind)
    rows: NDArray[Any] = np.loadtxt(
        chain([first], lines), kind, comments=None, usecols=columns, ndmin=2
    )
    return rows


def check_corners(corners: NDArray[Any], points: int, driver: str) -> None:
    """Raise OSError if a triangle has a point that is not one of those from 1 to `points`."""
    if len(corners) and not 1 <= corners.min() <= corners.max() <= points:
        raise OSError(f"the {driver} file is damaged: a triangle has a point that does not exist")


def one_line_of(text: str) -> str:
    """Return a text without characters that would end a line or are not allowed in XML."""
    return _UNFIT.sub("_", text)


def name_of(mesh: TriangleMesh) -> str:
    """Return the name of the raster of a mesh, without its folder, or "surface"."""
    source = "" if mesh.provenance is None else mesh.provenance.source.name
    name = re.split(r"[/\\]", source)[-1]
    return one_line_of(name).strip() or "surface"


def document_lines(document: str, mark: str) -> list[str]:
    """Return the metadata document as lines of comments, each of them short."""
    # The text is JSON in ASCII: blanks at the ends of lines may be lost, so none is put there.
    parts = re.findall(f".{{1,{_LONGEST_LINE}}}(?<! )(?! )|.+", document)
    return [f"{mark}{KEY} {part}" for part in parts]


def document_of(lines: Iterable[str], mark: str) -> str:
    """Return the metadata document from the comments of a file; raise KeyError if it has none."""
    start = f"{mark}{KEY} "
    document = "".join(
        line.rstrip("\r\n").removeprefix(start) for line in lines if line.startswith(start)
    )
    if not document:
        raise KeyError(KEY)
    return document
