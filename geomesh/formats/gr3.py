"""gr3, the grid of SCHISM, which is fort.14 of ADCIRC: nodes with depths, and boundaries.

Depths are positive down and in metres: minus the height. Nodes and elements are counted from 1.
What follows the boundaries no model reads: there is the metadata document.
"""

from __future__ import annotations

from itertools import islice
from typing import TYPE_CHECKING

from geomesh.formats.format import Format, LayerFile, WriteOptions, WriteRows, layer_with_heights

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path
    from typing import BinaryIO

    from geomesh.formats.arrow import Layer
    from geomesh.formats.batch_stream import BatchStream
    from geomesh.formats.tin_lines import TinLines
    from geomesh.mesh.triangle_mesh import TriangleMesh

_DRIVER = "gr3"
_MARK = "! "
_LAST = f"{_MARK}end\n"

# ADCIRC keeps only the first 24 characters of the title.
_LONGEST_TITLE = 80

# Kinds of land boundaries: around the domain, and around an island.
_OUTER, _ISLAND = 0, 1


def _notes(mesh: TriangleMesh, options: WriteOptions) -> tuple[str, ...]:  # noqa: ARG001
    from geomesh.formats.tin import notes_on_voids, require_heights
    from geomesh.formats.tin_units import METRE, height_unit, horizontal_unit
    from geomesh.raster.crs import has_angles

    require_heights(mesh, _DRIVER)
    own, crs = height_unit(mesh), mesh.grid.crs
    unit = "" if own.equals(METRE.metres) else f", converted from {own.name} to metre"
    told = [f"the third number of a node is the depth, positive down: minus the height{unit}"]
    place = horizontal_unit(crs)
    if crs is not None and place is not None and not has_angles(crs) and not place.equals(1.0):
        told.append(f"x and y are in {place.name}, but ADCIRC and SCHISM expect metres or degrees")
    return (*told, *notes_on_voids(mesh))


def _write(layer: Layer, file: LayerFile, stream: BatchStream, by_gdal: WriteRows) -> None:  # noqa: ARG001
    import numpy as np

    from geomesh.formats.tin import tin_of
    from geomesh.formats.tin_lines import lines_of
    from geomesh.formats.tin_text import document_lines, name_of, write_rows
    from geomesh.formats.tin_units import METRE, converted, height_unit, told_crs

    mesh, tin = file.mesh, tin_of(file.mesh)
    x, y, heights = tin.points.T
    # 0 - z, not -z: there is no depth of minus zero.
    depths = 0.0 - converted(heights, height_unit(mesh), METRE)
    about = f"{_MARK}{told_crs(mesh)}; in this file depths in metre, positive down"
    with file.path.open("wb") as out:
        out.write(f"{name_of(mesh)[:_LONGEST_TITLE]}\n".encode())
        out.write(f"{len(tin.triangles)} {len(tin.points)}\n".encode())
        write_rows(out, "%d %r %r %r\n", (np.arange(1, len(x) + 1), x, y, depths))
        ids = np.arange(1, len(tin.triangles) + 1)
        write_rows(out, "%d 3 %d %d %d\n", (ids, *(tin.triangles + 1).T), stream.advance)
        _write_boundaries(out, lines_of(mesh, tin))
        comments = [about, *document_lines(file.document, _MARK)]
        out.write(("\n".join(comments) + f"\n{_LAST}").encode())


def _write_boundaries(out: BinaryIO, lines: TinLines) -> None:
    """Write the outline as land boundaries, with the mesh to their left.

    An outer one ends at its first node, so that its last side is part of it; an island is
    closed by the models themselves.
    """
    import numpy as np

    from geomesh.formats.tin_text import write_rows

    rings = [(_OUTER, np.append(ring, ring[:1]) + 1) for ring in lines.outer]
    rings += [(_ISLAND, ring + 1) for ring in lines.holes]
    total = sum(len(nodes) for _, nodes in rings)
    head = (
        "0 = Number of open boundaries\n0 = Total number of open boundary nodes\n"
        f"{len(rings)} = Number of land boundaries\n{total} = Total number of land boundary nodes\n"
    )
    out.write(head.encode())
    for number, (kind, nodes) in enumerate(rings, start=1):
        out.write(f"{len(nodes)} {kind} = Number of nodes for land boundary {number}\n".encode())
        write_rows(out, "%d\n", (nodes,))


def _count_rows(path: Path, layer: str) -> int:  # noqa: ARG001
    from geomesh.formats.tin_text import check_corners, read_rows

    try:
        with path.open(encoding="utf-8", newline="\n") as lines:
            next(lines, "")
            triangles, nodes = map(int, next(lines, "").split())
            points = read_rows(islice(lines, nodes), (0, 1, 2, 3), float)
            corners = read_rows(islice(lines, triangles), (1, 2, 3, 4), int)
            if (len(points), len(corners)) != (nodes, triangles):
                raise ValueError("it has not all its nodes and triangles")
            _read_boundaries(lines, nodes)
            if [*lines][-1:] != [_LAST]:
                raise ValueError("its last line is missing")
    except ValueError as error:
        raise OSError(f"the gr3 file is damaged: {error}") from error
    check_corners(corners[:, 1:], nodes, _DRIVER)
    return triangles


def _read_boundaries(lines: Iterator[str], nodes: int) -> None:
    from geomesh.formats.tin_text import check_corners, read_rows

    for _ in ("open", "land"):
        count, total = _read_number(lines), _read_number(lines)
        for _ in range(count):
            length = _read_number(lines)
            ring = read_rows(islice(lines, length), (0,), int)
            check_corners(ring, nodes, _DRIVER)
            total -= len(ring)
        if total:
            raise ValueError("it has not all the nodes of its boundaries")


def _read_number(lines: Iterator[str]) -> int:
    return int(next(lines, "").partition(" ")[0])


def _read_document(path: Path) -> str:
    from geomesh.formats.tin_text import document_of

    with path.open(encoding="utf-8", errors="replace", newline="\n") as lines:
        return document_of(lines, _MARK)


FORMAT = Format(
    _DRIVER,
    (".gr3", ".14"),
    _write,
    _count_rows,
    _read_document,
    layers=("triangles",),
    layer=layer_with_heights,
    leaves_out_voids=True,
    notes=_notes,
)
