"""Wavefront OBJ, written by pyarrow: text, with local coordinates and colours of vertices."""

from __future__ import annotations

from itertools import takewhile
from typing import TYPE_CHECKING, Any

from geomesh.formats.format import Format, LayerFile, WriteOptions, WriteRows, layer_with_heights

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

    from geomesh.formats.arrow import Layer
    from geomesh.formats.batch_stream import BatchStream
    from geomesh.mesh.triangle_mesh import TriangleMesh

# Decimals of a metre: programs keep 32 bits, so more would not be seen.
_DECIMALS = 6
_COLOR_DECIMALS = 4


def _notes(mesh: TriangleMesh, options: WriteOptions) -> tuple[str, ...]:  # noqa: ARG001
    from geomesh.formats.model import local_notes

    return local_notes(mesh, "OBJ", rounded=False)


def _write(layer: Layer, file: LayerFile, stream: BatchStream, write_rows: WriteRows) -> None:  # noqa: ARG001
    """Write local coordinates, because programs that show OBJ have 32-bit numbers.

    Comments say where the origin is, and hold the document.
    """
    import numpy as np

    from geomesh.formats.model import comments, document_comments, node_colors, place_of
    from geomesh.formats.tin import LocalFrame, require_heights, tin_of

    mesh = file.mesh
    require_heights(mesh, "OBJ")
    tin, frame = tin_of(mesh), LocalFrame.of(mesh)
    lines = [*comments(place_of(mesh, frame)), "z is up"]
    if mesh.grid.crs is not None:
        lines += comments(f"CRS: {mesh.grid.crs.to_wkt()}")
    lines += document_comments(file.document)
    # Adding 0 turns -0 into 0.
    columns = list(np.round(frame.to_local(tin.points), _DECIMALS).T + 0.0)
    colors = node_colors(mesh, tin)
    if colors is not None:
        columns += list(np.round(colors.T / 255, _COLOR_DECIMALS))
    with file.path.open("wb") as output:
        output.write("".join(f"# {line}\n" for line in lines).encode("ascii"))
        _write_lines(output, "v", columns)
        _write_lines(output, "f", list(tin.triangles.T + 1))
        output.write(f"# {len(tin.triangles)} triangles\n".encode("ascii"))
    stream.rows += len(layer)


def _write_lines(output: Any, mark: str, columns: list[NDArray[Any]]) -> None:
    """Write lines of numbers with a letter before them."""
    import numpy as np
    import pyarrow as pa
    from pyarrow import csv

    marks = pa.DictionaryArray.from_arrays(
        pa.array(np.zeros(len(columns[0]), np.int8)), pa.array([mark])
    ).cast(pa.string())
    values = [pa.array(np.ascontiguousarray(column)) for column in columns]
    table = pa.table([marks, *values], names=list(map(str, range(len(values) + 1))))
    plain = csv.WriteOptions(include_header=False, delimiter=" ", quoting_style="none")
    csv.write_csv(table, output, plain)


def _count_rows(path: Path, layer: str) -> int:  # noqa: ARG001
    """Count the faces, of which each must have three vertices that exist."""
    import numpy as np

    data = path.read_bytes()
    vertices, faces = (data.find(mark) + 1 for mark in (b"\nv ", b"\nf "))
    end = data.rfind(b"\n# ") + 1
    if not 0 < vertices < faces < end or not data.endswith(b" triangles\n"):
        raise OSError("the OBJ file is damaged or cut short")
    places, corners = (_numbers(part) for part in (data[vertices:faces], data[faces:end]))
    if not np.isfinite(places).all() or corners.dtype.kind != "i" or corners.shape[1] != 3:
        raise OSError("the OBJ file is damaged: it has other texts than numbers")
    if corners.min() < 1 or corners.max() > len(places):
        raise OSError("the OBJ file is damaged: it has faces without vertices")
    return len(corners)


def _numbers(lines: bytes) -> NDArray[Any]:
    """Return the numbers of lines (R, C); each has a letter before them."""
    import numpy as np
    import pyarrow as pa
    from pyarrow import csv

    plain = csv.ReadOptions(autogenerate_column_names=True)
    spaces = csv.ParseOptions(delimiter=" ", quote_char=False)
    try:
        table = csv.read_csv(pa.BufferReader(lines), plain, spaces)
        columns = [column.to_numpy() for column in table.columns[1:]]
        numbers: NDArray[Any] = np.column_stack(columns)
    except (pa.ArrowException, ValueError) as error:
        raise OSError(f"the OBJ file is damaged: {error}") from error
    return numbers


def _read_document(path: Path) -> str:
    from geomesh.formats.model import document_of

    with path.open(encoding="ascii", errors="replace") as file:
        lines = takewhile(lambda line: line.startswith("#"), file)
        return document_of(line[2:].rstrip("\n") for line in lines)


FORMAT = Format(
    "OBJ",
    (".obj",),
    _write,
    _count_rows,
    _read_document,
    layers=("triangles",),
    layer=layer_with_heights,
    leaves_out_voids=True,
    notes=_notes,
)
