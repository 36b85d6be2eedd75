"""2DM, the mesh format of SMS, which QGIS opens as a mesh layer with heights.

Nodes and elements are counted from 1. Lines that begin with # are comments: readers pass over
cards that they do not know. The last line tells the counts, so that a file cut short is noticed.
"""

from __future__ import annotations

from itertools import groupby, takewhile
from typing import TYPE_CHECKING

from geomesh.formats.format import Format, LayerFile, WriteOptions, WriteRows, layer_with_heights

if TYPE_CHECKING:
    from pathlib import Path

    from geomesh.formats.arrow import Layer
    from geomesh.formats.batch_stream import BatchStream
    from geomesh.mesh.triangle_mesh import TriangleMesh

_DRIVER = "2DM"
_MARK = "# "


def _notes(mesh: TriangleMesh, options: WriteOptions) -> tuple[str, ...]:  # noqa: ARG001
    from geomesh.formats.tin import notes_on_voids, require_heights

    require_heights(mesh, _DRIVER)
    return notes_on_voids(mesh)


def _write(layer: Layer, file: LayerFile, stream: BatchStream, by_gdal: WriteRows) -> None:  # noqa: ARG001
    import numpy as np

    from geomesh.formats.tin import tin_of
    from geomesh.formats.tin_text import document_lines, name_of, write_rows
    from geomesh.formats.tin_units import told_crs

    tin = tin_of(file.mesh)
    nodes, triangles = len(tin.points), len(tin.triangles)
    about = [name_of(file.mesh), told_crs(file.mesh)]
    comments = [f"{_MARK}{text}" for text in about]
    comments += document_lines(file.document, _MARK)
    with file.path.open("wb") as out:
        out.write("\n".join(["MESH2D", *comments, ""]).encode())
        ids = np.arange(1, nodes + 1)
        write_rows(out, "ND %d %r %r %r\n", (ids, *tin.points.T))
        ids = np.arange(1, triangles + 1)
        write_rows(out, "E3T %d %d %d %d 1\n", (ids, *(tin.triangles + 1).T), stream.advance)
        out.write(_end(nodes, triangles).encode())


def _count_rows(path: Path, layer: str) -> int:  # noqa: ARG001
    import numpy as np

    from geomesh.formats.tin_text import check_corners, read_rows

    nodes, triangles, last = np.empty((0, 4)), np.empty((0, 4), np.int64), ""
    try:
        with path.open(encoding="utf-8", newline="\n") as lines:
            # One block of lines after the other, so that a large file need not fit in memory.
            for card, block in groupby(lines, lambda line: line.partition(" ")[0]):
                if card == "ND":
                    nodes = read_rows(block, (1, 2, 3, 4), float)
                elif card == "E3T":
                    triangles = read_rows(block, (1, 2, 3, 4), int)
                else:
                    last = [*block][-1]
    except ValueError as error:
        raise OSError(f"the 2DM file is damaged: {error}") from error
    if last != _end(len(nodes), len(triangles)):
        raise OSError("the 2DM file is damaged: its last line does not tell what it has")
    check_corners(triangles[:, 1:], len(nodes), "2DM")
    return len(triangles)


def _end(nodes: int, triangles: int) -> str:
    return f"{_MARK}end: {nodes} nodes, {triangles} triangles\n"


def _read_document(path: Path) -> str:
    from geomesh.formats.tin_text import document_of

    with path.open(encoding="utf-8", errors="replace", newline="\n") as lines:
        return document_of(takewhile(lambda line: not line.startswith("ND"), lines), _MARK)


FORMAT = Format(
    _DRIVER,
    (".2dm",),
    _write,
    _count_rows,
    _read_document,
    layers=("triangles",),
    layer=layer_with_heights,
    leaves_out_voids=True,
    notes=_notes,
)
