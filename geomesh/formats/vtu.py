"""VTU, the unstructured grid of VTK in XML, written by numpy, for ParaView and PyVista.

The values are appended as raw bytes, which every reader takes and which need no encoding.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any
from xml.sax.saxutils import quoteattr

from geomesh.formats.format import Format, LayerFile, WriteOptions, WriteRows

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path
    from xml.etree.ElementTree import Element

    from numpy.typing import NDArray

    from geomesh.formats.arrow import Layer
    from geomesh.formats.batch_stream import BatchStream
    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.parameters import LayerName

_TRIANGLE = 5  # the number of this type of cell
_KINDS = {"i": "Int", "u": "UInt", "f": "Float"}
_CRS, _UNIT = "CRS", "unit of heights"

_START = b'<AppendedData encoding="raw">\n_'
_END = b"\n</AppendedData>\n</VTKFile>\n"
_SIZE = 8  # bytes of the number before each array that says how long it is


def _layer(mesh: TriangleMesh, name: LayerName) -> Layer:
    from geomesh.formats.tin import tin_layer

    return tin_layer(mesh, name)


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

    mesh, blocks = file.mesh, _Blocks()
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
    parts = [
        '<?xml version="1.0"?>',
        '<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" '
        'header_type="UInt64">',
        "<UnstructuredGrid>",
        blocks.group("FieldData", {name: _bytes(text) for name, text in texts.items()}),
        f'<Piece NumberOfPoints="{len(tin.points)}" NumberOfCells="{count}">',
        blocks.group("PointData", on_points),
        blocks.group("CellData", on_cells),
        blocks.group("Points", {"Points": tin.points}),
        blocks.group("Cells", cells),
        "</Piece>\n</UnstructuredGrid>\n",
    ]
    with file.path.open("wb") as output:
        output.write("\n".join(parts).encode() + _START)
        for data in blocks.arrays:
            output.write(np.uint64(data.nbytes).astype("<u8").tobytes())
            output.write(data.reshape(-1).view(np.uint8).data)
        output.write(_END)
    stream.rows += count


class _Blocks:
    """Arrays that follow the XML, and the elements that say where each one starts."""

    def __init__(self) -> None:
        self.arrays: list[NDArray[Any]] = []
        self._offset = 0

    def group(self, tag: str, columns: Mapping[str, NDArray[Any]]) -> str:
        arrays = [self._array(tag, *each) for each in columns.items()]
        return "\n".join([f"<{tag}>", *arrays, f"</{tag}>"])

    def _array(self, tag: str, name: str, values: NDArray[Any]) -> str:
        import numpy as np

        plain = values.astype(np.uint8) if values.dtype.kind == "b" else values
        if plain.dtype == np.float16:
            plain = plain.astype(np.float32)
        kind = f"{_KINDS[plain.dtype.kind]}{8 * plain.dtype.itemsize}"
        many = f' NumberOfComponents="{plain.shape[1]}"' if plain.ndim == 2 else ""
        many += f' NumberOfTuples="{len(plain)}"' if tag == "FieldData" else ""
        little = np.ascontiguousarray(plain.astype(plain.dtype.newbyteorder("<"), copy=False))
        return (
            f'<DataArray type="{kind}" Name={quoteattr(_printable(name))}{many} '
            f'format="appended" offset="{self._add(little)}"/>'
        )

    def _add(self, values: NDArray[Any]) -> int:
        offset = self._offset
        self.arrays.append(values)
        self._offset += _SIZE + values.nbytes
        return offset


def _bytes(text: str) -> NDArray[Any]:
    """Return the bytes of a text: VTK has arrays of texts too, but meshio refuses those."""
    import numpy as np

    return np.frombuffer(text.encode(), np.uint8)


def _printable(name: str) -> str:
    """Return a name without the control characters that XML cannot have."""
    return "".join(each if each.isprintable() else "_" for each in name)


def _read(path: Path) -> tuple[Element, bytes]:
    """Return the XML, and the appended bytes."""
    from xml.etree import ElementTree as ET

    data = path.read_bytes()
    head, start, appended = data.partition(_START)
    if not start or not appended.endswith(_END):
        raise OSError("the VTU file is damaged or cut short")
    try:
        return ET.fromstring(head + b"</VTKFile>"), appended[: -len(_END)]
    except ET.ParseError as error:
        raise OSError(f"the VTU file is damaged: {error}") from error


def _block(found: Element, appended: bytes) -> bytes:
    start = int(found.get("offset", "0"))
    stop = start + _SIZE
    size = int.from_bytes(appended[start:stop], "little")
    if stop + size > len(appended):
        raise OSError("the VTU file is damaged: an array is longer than the file")
    return appended[stop : stop + size]


def _count_rows(path: Path, layer: str) -> int:  # noqa: ARG001
    """Count the cells, of which each must be a triangle between points that exist."""
    import numpy as np

    root, appended = _read(path)
    arrays = {
        str(found.get("Name")): _block(found, appended) for found in root.iterfind(".//Cells/")
    }
    others = [_block(found, appended) for found in root.iterfind(".//*[@offset]")]
    piece = root.find(".//Piece")
    if piece is None or not {"connectivity", "offsets", "types"} <= set(arrays) or not others:
        raise OSError("the VTU file is damaged: it has no cells")
    types = np.frombuffer(arrays["types"], np.uint8)
    corners = np.frombuffer(arrays["connectivity"], "<i4")
    points = int(piece.get("NumberOfPoints", "0"))
    if (types != _TRIANGLE).any() or len(corners) != 3 * len(types):
        raise OSError("the VTU file is damaged: it has other cells than triangles")
    if len(corners) and not 0 <= corners.min() <= corners.max() < points:
        raise OSError("the VTU file is damaged: it has cells without points")
    return len(types)


def _read_document(path: Path) -> str:
    from geomesh.formats.document import KEY

    root, appended = _read(path)
    for found in root.iterfind(".//FieldData/"):
        if found.get("Name") == KEY:
            return _block(found, appended).decode()
    raise KeyError("the file has no metadata document of geomesh")


FORMAT = Format(
    "VTU",
    (".vtu",),
    _write,
    _count_rows,
    _read_document,
    layers=("triangles",),
    layer=_layer,
    notes=_notes,
)
