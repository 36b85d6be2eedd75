"""What the formats of 3-D models share: colours of nodes, texts about the place, columns."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from geomesh.formats.tin import LocalFrame, notes_on_voids, require_heights, tin_of
from geomesh.mesh.colors import parse_colors
from geomesh.raster.crs import crs_label, has_angles

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from numpy.typing import NDArray

    from geomesh.arrays.table import Table
    from geomesh.formats.tin import Tin
    from geomesh.mesh.triangle_mesh import TriangleMesh

COLOR = "color"

# Attributes that are already in the topology.
_TOPOLOGY = ("id", "n0", "n1", "n2")

# Some readers of text have buffers for 255 characters, and take the rest for a line of its own.
_LONGEST_LINE = 200

# Before each piece of the document in a comment.
_MARK = "geomesh: "


def node_colors(mesh: TriangleMesh, tin: Tin) -> NDArray[np.uint8] | None:
    """Return red, green and blue (N, 3) of the points of a TIN; None if there are no colours.

    The colour of a point is the mean of those of its triangles, weighted by their area.
    """
    colors = triangle_colors(mesh, tin)
    if colors is None:
        return None
    (ax, ay), (bx, by) = np.moveaxis(np.diff(tin.points[tin.triangles, :2], axis=1), 0, -1)
    weight = np.repeat(np.abs(ax * by - ay * bx), 3)
    corners, count = tin.triangles.ravel(), len(tin.points)
    total = np.bincount(corners, weight, count)
    sums = [
        np.bincount(corners, weight * np.repeat(channel, 3), count)
        for channel in colors.T.astype(np.float64)
    ]
    # All triangles of a node without area: none in a mesh with a certificate.
    mean = np.column_stack(sums) / np.where(total > 0, total, 1.0)[:, None]
    return np.rint(mean).astype(np.uint8)


def triangle_colors(mesh: TriangleMesh, tin: Tin) -> NDArray[np.uint8] | None:
    """Return red, green and blue (T, 3) of the triangles of a TIN; None if there are none."""
    texts = mesh.triangle_table.get(COLOR)
    if texts is None or texts.dtype.kind != "U":
        return None
    try:
        return parse_colors(texts[tin.rows])
    except ValueError:  # another program has put other texts there
        return None


def numeric(table: Table | Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return the columns with numbers, without those that repeat the topology."""
    return {
        name: values
        for name, values in table.items()
        if name not in _TOPOLOGY and values.dtype.kind in "biuf"
    }


def local_notes(mesh: TriangleMesh, driver: str, *, rounded: bool = True) -> tuple[str, ...]:
    """Return what to say of a format with local coordinates; see `Format.notes`.

    Parameters
    ----------
    mesh : TriangleMesh
    driver : str
        Name of the format.
    rounded : bool
        Whether it stores 32-bit numbers.

    Raises
    ------
    OutputError
        If the mesh has no heights.
    """
    require_heights(mesh, driver)
    frame = LocalFrame.of(mesh)
    step = float(np.spacing(np.abs(frame.to_local(tin_of(mesh).points)).max().astype("f4"))) / 2
    accuracy = f", rounded to {step:.1g} m" if rounded else ""
    return (f"{driver} holds {place_of(mesh, frame)}{accuracy}", *notes_on_voids(mesh))


def map_notes(mesh: TriangleMesh, driver: str) -> tuple[str, ...]:
    """Return what to say of a 3-D format with map coordinates; see `Format.notes`.

    Raises
    ------
    OutputError
        If the mesh has no heights.
    """
    require_heights(mesh, driver)
    crs = mesh.grid.crs
    if crs is None or not has_angles(crs):
        return notes_on_voids(mesh)
    note = (
        f"{driver} holds x and y as angles and heights as lengths, so a 3-D program shows it far "
        "too high: reproject the raster first, or write .glb, which is in metres"
    )
    return (note, *notes_on_voids(mesh))


def place_of(mesh: TriangleMesh, frame: LocalFrame) -> str:
    """Return one line that says what local coordinates are: origin, CRS and units."""
    crs, height = mesh.grid.crs, mesh.height
    where = f"{frame} ({crs_label(crs)})"
    if crs is None:
        where += ", one unit taken for a metre"
    if height is None or height.unit == "metre":
        return f"{where}, heights in metres"
    return f"{where}, heights in metres (from {height.unit})"


def comments(text: str) -> list[str]:
    """Return a text as comments of one line of ASCII each, without their mark.

    Line ends and characters of other scripts are escaped as in Python.
    """
    return [text.encode("unicode_escape").decode("ascii")]


def document_comments(document: str) -> list[str]:
    """Return the metadata document as comments of one line each; see `document_of`."""
    pieces = range(0, len(document), _LONGEST_LINE)
    return [_MARK + document[start : start + _LONGEST_LINE] for start in pieces]


def document_of(lines: Iterable[str]) -> str:
    """Return the document that `document_comments` has cut into comments.

    Raises
    ------
    KeyError
        If there is none.
    """
    found = [line.removeprefix(_MARK) for line in lines if line.startswith(_MARK)]
    if not found:
        raise KeyError("the file has no metadata document of geomesh")
    return "".join(found)
