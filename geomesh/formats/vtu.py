"""VTU, the unstructured grid of VTK in XML, written by numpy, for ParaView and PyVista.

The values are base64, in their elements. Raw bytes at the end would take a quarter less, but meshio
5.3 mixes arrays up then: some get the values of others.
"""

from __future__ import annotations

from base64 import b64decode, b64encode
from typing import TYPE_CHECKING, Any, BinaryIO
from xml.sax.saxutils import quoteattr

from geomesh.formats.format import Format, LayerFile, WriteOptions, WriteRows, layer_with_heights

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path
    from xml.etree.ElementTree import Element

    from numpy.typing import NDArray

    from geomesh.formats.arrow import Layer
    from geomesh.formats.batch_stream import BatchStream
    from geomesh.mesh.triangle_mesh import TriangleMesh

_TRIANGLE = 5  # the number of this type of cell
_KINDS = {"i": "Int", "u": "UInt", "f": "Float"}
_CRS, _UNIT = "CRS", "unit of heights"

_HEAD = b"""<?xml version="1.0"?>
<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" header_type="UInt64">
<UnstructuredGrid>
"""
_TAIL = b"</Piece>\n</UnstructuredGrid>\n</VTKFile>"
_SIZE = 8  # bytes of the number before each array that says how long it is


def _notes(mesh: TriangleMesh, options: WriteOptions) -> tuple[str, ...]:  # noqa: ARG001
    from geomesh.formats.model import map_notes

    return map_notes(mesh, "VTU")


def _write(layer: Layer, file: LayerFile, stream: BatchStream, write_rows: WriteRows) -> None:  # noqa: ARG001
    """Write map coordinates with heights, and all numeric attributes of triangles and nodes.

    `color` becomes three bytes for each cell. CRS, unit of the heights and document are field data:
    the bytes of their texts.
    """
    import numpy as np

    from geomesh.formats.document import KEY
    from geomesh.formats.model import COLOR, numeric, triangle_colors
    from geomesh.formats.tin import require_heights, tin_of

    mesh = file.mesh
    require_heights(mesh, "VTU")
    tin, count = tin_of(mesh), len(layer)
    on_cells: dict[str, NDArray[Any]] = numeric(layer.columns)
    on_points = {name: col[tin.nodes] for name, col in numeric(mesh.attributes("nodes")).items()}
    colors = triangle_colors(mesh, tin)
    if colors is not None:
        on_cells[COLOR] = colors
    crs = mesh.grid.crs
    texts = {KEY: file.document}
    if crs is not None:
        texts[_CRS] = crs.to_wkt()
    if mesh.height is not None:
        texts[_UNIT] = mesh.height.unit
    cells: dict[str, NDArray[Any]] = {
        "connectivity": tin.triangles.ravel(),
        "offsets": np.arange(3, 3 * count + 1, 3, dtype=np.int64),
        "types": np.full(count, _TRIANGLE, np.uint8),
    }
    with file.path.open("wb") as output:
        output.write(_HEAD)
        _write_group(output, "FieldData", {name: _bytes(text) for name, text in texts.items()})
        size = f'<Piece NumberOfPoints="{len(tin.points)}" NumberOfCells="{count}">\n'
        output.write(size.encode())
        _write_group(output, "PointData", on_points)
        _write_group(output, "CellData", on_cells)
        _write_group(output, "Points", {"Points": tin.points})
        _write_group(output, "Cells", cells)
        output.write(_TAIL)
    stream.rows += count


def _write_group(output: BinaryIO, tag: str, columns: Mapping[str, NDArray[Any]]) -> None:
    """Write arrays as elements: the number of their bytes, and these, all in base64."""
    import numpy as np

    output.write(f"<{tag}>\n".encode())
    for name, values in columns.items():
        # VTK has no truth values, and no numbers of 16 bits with a fraction.
        others = {"?": np.uint8, "e": np.float32}
        plain = values.astype(others.get(values.dtype.char, values.dtype), copy=False)
        kind = f"{_KINDS[plain.dtype.kind]}{8 * plain.dtype.itemsize}"
        many = f' NumberOfComponents="{plain.shape[1]}"' if plain.ndim == 2 else ""
        many += f' NumberOfTuples="{len(plain)}"' if tag == "FieldData" else ""
        start = (
            f'<DataArray type="{kind}" Name={quoteattr(_printable(name))}{many} format="binary">'
        )
        data = plain.astype(plain.dtype.newbyteorder("<"), copy=False).tobytes()
        output.write(start.encode())
        output.write(b64encode(len(data).to_bytes(_SIZE, "little") + data))
        output.write(b"</DataArray>\n")
    output.write(f"</{tag}>\n".encode())


def _bytes(text: str) -> NDArray[Any]:
    """Return the bytes of a text: VTK has arrays of texts too, but meshio refuses those."""
    import numpy as np

    return np.frombuffer(text.encode(), np.uint8)


def _printable(name: str) -> str:
    """Return a name without the control characters that XML cannot have."""
    return "".join(each if each.isprintable() else "_" for each in name)


def _read(path: Path) -> Element:
    from xml.etree import ElementTree as ET

    try:
        return ET.parse(path).getroot()
    except ET.ParseError as error:
        raise OSError(f"the VTU file is damaged: {error}") from error


def _data(found: Element) -> bytes:
    """Return the bytes of an array."""
    try:
        data = b64decode((found.text or "").strip(), validate=True)
    except ValueError as error:
        raise OSError(f"the VTU file is damaged: {error}") from error
    if len(data) < _SIZE or int.from_bytes(data[:_SIZE], "little") != len(data) - _SIZE:
        raise OSError("the VTU file is damaged: an array does not have the size that it says")
    return data[_SIZE:]


def _count_rows(path: Path, layer: str) -> int:  # noqa: ARG001
    """Count the cells, of which each must be a triangle between points that exist."""
    import numpy as np

    root = _read(path)
    arrays = {id(found): _data(found) for found in root.iter("DataArray")}
    cells = {found.get("Name"): arrays[id(found)] for found in root.iterfind(".//Cells/DataArray")}
    piece = root.find(".//Piece")
    if piece is None or not {"connectivity", "offsets", "types"} <= set(cells):
        raise OSError("the VTU file is damaged: it has no cells")
    types = np.frombuffer(cells["types"], np.uint8)
    corners = np.frombuffer(cells["connectivity"], "<i4")
    points = int(piece.get("NumberOfPoints", "0"))
    if (types != _TRIANGLE).any() or len(corners) != 3 * len(types):
        raise OSError("the VTU file is damaged: it has other cells than triangles")
    if len(corners) and not 0 <= corners.min() <= corners.max() < points:
        raise OSError("the VTU file is damaged: it has cells without points")
    return len(types)


def _read_document(path: Path) -> str:
    from geomesh.formats.document import KEY

    for found in _read(path).iterfind(".//FieldData/DataArray"):
        if found.get("Name") == KEY:
            return _data(found).decode()
    raise KeyError("the file has no metadata document of geomesh")


FORMAT = Format(
    "VTU",
    (".vtu",),
    _write,
    _count_rows,
    _read_document,
    layers=("triangles",),
    layer=layer_with_heights,
    leaves_out_voids=True,
    notes=_notes,
)
