"""PLY, binary, written by numpy: map coordinates with heights, colours and attributes.

QGIS opens it as a mesh layer through MDAL, which wants the corners as the first property of a
face, with the name vertex_indices. MeshLab, CloudCompare and Blender read it too.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Any

from geomesh.formats.format import Format, LayerFile, WriteOptions, WriteRows, layer_with_heights
from geomesh.formats.names import legal_name

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from numpy.typing import NDArray

    from geomesh.formats.arrow import Layer
    from geomesh.formats.batch_stream import BatchStream
    from geomesh.mesh.triangle_mesh import TriangleMesh

_CORNERS = "vertex_indices"

# Types by kind and size; others become double, whole numbers of 64 bits too.
_TYPES = {
    "i1": "char",
    "u1": "uchar",
    "i2": "short",
    "u2": "ushort",
    "i4": "int",
    "u4": "uint",
    "f4": "float",
    "f8": "double",
}
_DTYPES = {name: f"<{code}" for code, name in _TYPES.items()}

_HEADER = re.compile(rb"ply\nformat binary_little_endian 1\.0\n(.*?)end_header\n", re.DOTALL)
_MOST_FACES = 2**31 - 1


def _notes(mesh: TriangleMesh, options: WriteOptions) -> tuple[str, ...]:  # noqa: ARG001
    from geomesh.formats.model import map_notes

    return map_notes(mesh, "PLY")


def _write(layer: Layer, file: LayerFile, stream: BatchStream, write_rows: WriteRows) -> None:  # noqa: ARG001
    """Write vertices with colours and the values of the bands, and faces with their attributes.

    A name that PLY cannot have is in a comment. So are the CRS, the units and the document.
    """
    import numpy as np

    from geomesh.formats.crs_text import wkt1_or_wkt2
    from geomesh.formats.model import comments, document_comments, node_colors, numeric
    from geomesh.formats.tin import require_heights, tin_of

    mesh = file.mesh
    require_heights(mesh, "PLY")
    tin = tin_of(mesh)
    colors = node_colors(mesh, tin)
    vertices = dict(zip("xyz", tin.points.T, strict=True))
    if colors is not None:
        vertices |= dict(zip(("red", "green", "blue"), colors.T, strict=True))
    lines = list(_units(mesh))
    lines += _add(vertices, {name: mesh.node_table[name][tin.nodes] for name in _bands(mesh)})
    faces: dict[str, NDArray[Any]] = {_CORNERS: tin.triangles}
    lines += _add(faces, numeric(layer.columns))
    header = ["ply", "format binary_little_endian 1.0"]
    if mesh.grid.crs is not None:
        # MDAL looks for the CRS behind this word.
        lines = [f"crs: {wkt1_or_wkt2(mesh.grid.crs)}", *lines]
    escaped = (each for line in lines for each in comments(line))
    header += [f"comment {line}" for line in (*escaped, *document_comments(file.document))]
    for element, columns in (("vertex", vertices), ("face", faces)):
        header.append(f"element {element} {len(next(iter(columns.values())))}")
        for name, values in columns.items():
            kind = "list uchar int" if values.ndim == 2 else _TYPES[values.dtype.str[1:]]
            header.append(f"property {kind} {name}")
    with file.path.open("wb") as output:
        output.write("\n".join([*header, "end_header", ""]).encode("ascii"))
        for columns in (vertices, faces):
            output.write(_records(columns).view(np.uint8).data)
    stream.rows += len(layer)


def _units(mesh: TriangleMesh) -> Iterator[str]:
    from geomesh.raster.crs import crs_label

    unit = mesh.height.unit if mesh.height is not None else "metre"
    yield f"geomesh, x and y on the map: {crs_label(mesh.grid.crs)}, heights in: {unit}"


def _bands(mesh: TriangleMesh) -> list[str]:
    """Return the columns of the nodes that are values of bands."""
    known = [] if mesh.provenance is None else [band.name for band in mesh.provenance.source.bands]
    refinement = None if mesh.provenance is None else mesh.provenance.refinement
    if refinement is not None:  # of a palette: its colours
        known += [band.name for band in refinement.bands]
    if mesh.height is not None:
        known.append(mesh.height.band)
    return [
        name
        for name in dict.fromkeys(known)
        if name in mesh.node_table and mesh.node_table[name].dtype.kind in "biuf"
    ]


def _add(columns: dict[str, NDArray[Any]], added: Mapping[str, NDArray[Any]]) -> list[str]:
    """Add columns, by names and in types that PLY has; return comments on names it has not."""
    import numpy as np

    notes = []
    for name, values in added.items():
        legal = legal_name(name, columns)
        plain = values.astype(np.uint8) if values.dtype.kind == "b" else values
        known = plain.dtype.str[1:] in _TYPES
        columns[legal] = plain if known else plain.astype(np.float64)
        if legal != name:
            notes.append(f"the property {legal} is {name}")
    return notes


def _records(columns: Mapping[str, NDArray[Any]]) -> NDArray[Any]:
    """Return columns as an array of records; before corners comes their number."""
    import numpy as np

    fields: list[Any] = []
    for name, values in columns.items():
        kind = values.dtype.newbyteorder("<")
        fields += [("number of corners", "u1"), (name, kind, 3)] if values.ndim == 2 else [
            (name, kind)
        ]  # fmt: skip
    records = np.empty(len(next(iter(columns.values()))), np.dtype(fields))
    for name, values in columns.items():
        if values.ndim == 2:
            records["number of corners"] = 3
        records[name] = values
    return records


def _read_header(data: bytes) -> tuple[list[str], int]:
    """Return the lines of the header, and where the records start."""
    found = _HEADER.match(data)
    if found is None:
        raise OSError("the PLY file is damaged: it has no header that ends")
    return found[1].decode("ascii", "replace").splitlines(), found.end()


def _count_rows(path: Path, layer: str) -> int:  # noqa: ARG001
    """Count the faces, of which each must have three vertices that exist."""
    import numpy as np

    data = path.read_bytes()
    lines, offset = _read_header(data)
    elements: dict[str, tuple[int, list[Any]]] = {}
    fields: list[Any] = []
    try:
        for line in lines:
            word, *rest = line.split(" ")
            if word == "element":
                fields = []
                elements[rest[0]] = int(rest[1]), fields
            elif word == "property" and rest[0] == "list":
                fields += [("number of corners", "u1"), (rest[3], _DTYPES[rest[2]], 3)]
            elif word == "property":
                fields.append((rest[1], _DTYPES[rest[0]]))
        tables = {}
        for name, (count, kinds) in elements.items():
            dtype = np.dtype(kinds)
            tables[name] = np.frombuffer(data, dtype, count, offset)
            offset += count * dtype.itemsize
        vertices, corners = len(tables["vertex"]), tables["face"][_CORNERS]
        numbers = tables["face"]["number of corners"]
    except (IndexError, KeyError, ValueError) as error:
        raise OSError(f"the PLY file is damaged: {error}") from error
    if offset != len(data) or (numbers != 3).any():
        raise OSError("the PLY file is damaged: it has more or other elements than it says")
    if len(corners) and not 0 <= corners.min() <= corners.max() < vertices:
        raise OSError("the PLY file is damaged: it has faces without vertices")
    return len(corners)


def _read_document(path: Path) -> str:
    from geomesh.formats.model import document_of

    lines, _ = _read_header(path.read_bytes())
    return document_of(
        line.removeprefix("comment ") for line in lines if line.startswith("comment ")
    )


FORMAT = Format(
    "PLY",
    (".ply",),
    _write,
    _count_rows,
    _read_document,
    layers=("triangles",),
    layer=layer_with_heights,
    leaves_out_voids=True,
    most_rows=_MOST_FACES,
    notes=_notes,
)
