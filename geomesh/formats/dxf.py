"""DXF R2010 for CAD programs: 3DFACE for each triangle, and 3-D polylines, framed by ezdxf.

ezdxf makes the document with its tables and polylines. The faces are streamed into it as text:
as objects, a million of them would take gigabytes. DXF has one unit of length and no CRS.
"""

from __future__ import annotations

import mmap
import re
from io import StringIO
from itertools import chain, takewhile
from typing import TYPE_CHECKING, Any

from geomesh.errors import extra_required
from geomesh.formats.format import Format, LayerFile, WriteOptions, WriteRows, layer_with_heights

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from geomesh.formats.arrow import Layer
    from geomesh.formats.batch_stream import BatchStream
    from geomesh.formats.tin import Tin
    from geomesh.mesh.triangle_mesh import TriangleMesh

_DRIVER = "DXF"
_VERSION = "R2010"  # the oldest with text in UTF-8 that programs of today still write
_UNITLESS = 0

# $INSUNITS, and metres.
_UNITS = {
    1: 0.0254,
    2: 0.3048,
    3: 1609.344,
    4: 0.001,
    5: 0.01,
    6: 1.0,
    7: 1000.0,
    10: 0.9144,
    21: 1200 / 3937,
}
_IMPERIAL = (1, 2, 3, 10, 21)

# Layers, and their colours: grey, red and blue.
_TIN, _BREAKLINES, _OUTLINE = "TIN", "BREAKLINES", "OUTLINE"
_COLORS = {_TIN: 8, _BREAKLINES: 1, _OUTLINE: 5}

_FACES_OF_LARGE_FILE = 200_000
_SAMPLE = 1000
_MB = 1e6

# The group codes of the coordinates of a face.
_CODES = tuple(f"{10 * axis + corner:3d}" for corner in range(4) for axis in (1, 2, 3))
_HEAD = "  0\n3DFACE\n  5\n{handle}\n330\n{owner}\n100\nAcDbEntity\n  8\nTIN\n100\nAcDbFace\n"
_FACE = _HEAD + "".join(f"{code}\n%s\n" for code in _CODES)
_WRITTEN = re.compile(
    "".join(
        [
            _HEAD.format(handle="[0-9A-F]+", owner="[0-9A-F]+"),
            *(f"{code}\n[-+0-9][-+.0-9e]*\n" for code in _CODES),
        ]
    ).encode()
)
_START = b"  0\n3DFACE\n"
_END = b"  0\nEOF\n"
_COMMENT = "999\n"


def _require() -> None:
    with extra_required("ezdxf", "terrain"):
        import ezdxf  # noqa: F401


def _notes(mesh: TriangleMesh, options: WriteOptions) -> tuple[str, ...]:  # noqa: ARG001
    from geomesh.formats.tin import notes_on_voids, require_heights, require_lengths, tin_of
    from geomesh.formats.tin_units import horizontal_unit, note_on_conversion, told_crs

    require_heights(mesh, _DRIVER)
    require_lengths(mesh, _DRIVER)
    unit, crs = horizontal_unit(mesh.grid.crs), mesh.grid.crs
    notes = list(note_on_conversion(mesh, _DRIVER, unit))
    if crs is not None:
        notes.append(
            f"DXF stores no CRS: comments and properties of the drawing say {told_crs(mesh)!r}"
        )
    if unit is not None and _insunits(mesh) == _UNITLESS:
        notes.append(f"DXF has no code for the unit {unit.name!r}: the drawing has no unit")
    if len(mesh.triangles) >= _FACES_OF_LARGE_FILE:
        tin = tin_of(mesh)
        size = _estimate(tin) / _MB
        notes.append(f"the file will have {len(tin.triangles)} faces and about {size:.0f} MB")
    return (*notes, *notes_on_voids(mesh))


def _insunits(mesh: TriangleMesh) -> int:
    from geomesh.formats.tin_units import horizontal_unit

    unit = horizontal_unit(mesh.grid.crs)
    if unit is None:
        return _UNITLESS
    return next((code for code, metres in _UNITS.items() if unit.equals(metres)), _UNITLESS)


def _estimate(tin: Tin) -> float:
    """Return the approximate size of the faces in bytes, from some of them."""
    step = max(1, len(tin.triangles) // _SAMPLE)
    some = tin.triangles[::step]
    text = next(_faces(tin.points, some, 1 << 20, "17"))
    return len(text) / len(some) * len(tin.triangles)


def _write(layer: Layer, file: LayerFile, stream: BatchStream, by_gdal: WriteRows) -> None:  # noqa: ARG001
    import numpy as np

    from geomesh.formats.batch_stream import BATCH_ROWS
    from geomesh.formats.tin import tin_of
    from geomesh.formats.tin_text import document_lines, name_of
    from geomesh.formats.tin_units import converted, height_unit, horizontal_unit, told_crs

    mesh, tin = file.mesh, tin_of(file.mesh)
    points = tin.points
    wanted = horizontal_unit(mesh.grid.crs)
    if wanted is not None:
        heights = converted(points[:, 2], height_unit(mesh), wanted)
        points = np.column_stack([points[:, :2], heights])
    document, owner, first = _frame(mesh, tin, points)
    text = StringIO()
    document.write(text)
    # In the section of entities are the polylines: the faces go before them.
    before, entities, after = text.getvalue().partition("  2\nENTITIES\n")
    comments = [f"{name_of(mesh)}: {told_crs(mesh)}", *document_lines(file.document, "")]
    with file.path.open("wb") as out:
        out.write("".join(f"{_COMMENT}{line}\n" for line in comments).encode())
        out.write(f"{before}{entities}".encode())
        for start, faces in enumerate(_faces(points, tin.triangles, first, owner)):
            out.write(faces)
            stream.advance(min(BATCH_ROWS, len(tin.triangles) - start * BATCH_ROWS))
        out.write(after.encode())


def _frame(mesh: TriangleMesh, tin: Tin, points: NDArray[np.float64]) -> tuple[Any, str, int]:
    """Return the document without faces, the handle of its model space and of the first face."""
    from ezdxf.filemanagement import new

    from geomesh.formats.tin_lines import lines_of
    from geomesh.formats.tin_units import told_crs

    code = _insunits(mesh)
    drawing = new(_VERSION, units=code)
    drawing.header["$MEASUREMENT"] = int(code not in _IMPERIAL)
    drawing.header.custom_vars.append("CRS", told_crs(mesh))
    for name, color in _COLORS.items():
        drawing.layers.add(name, color=color)
    space = drawing.modelspace()
    space.reset_extents(points.min(axis=0).tolist(), points.max(axis=0).tolist())
    lines = lines_of(mesh, tin)
    for line in lines.breaklines:
        space.add_polyline3d(points[line].tolist(), dxfattribs={"layer": _BREAKLINES})
    for ring in (*lines.outer, *lines.holes):
        attributes = {"layer": _OUTLINE}
        space.add_polyline3d(points[ring].tolist(), close=True, dxfattribs=attributes)
    # Handles are unique in a file, and the header names the next free one.
    handles = drawing.entitydb.handles
    first = int(str(handles), 16)
    handles.reset(f"{first + len(tin.triangles):X}")
    return drawing, space.layout_key, first


def _faces(
    points: NDArray[np.float64], triangles: NDArray[np.int32], first: int, owner: str
) -> Iterator[bytes]:
    """Yield the text of some thousands of faces after the other."""
    import numpy as np

    from geomesh.formats.batch_stream import BATCH_ROWS

    template = _FACE.format(handle="%X", owner=owner)
    for start in range(0, len(triangles), BATCH_ROWS):
        corners = triangles[start : start + BATCH_ROWS]
        # A point has six triangles: its numbers become text once.
        used, position = np.unique(corners, return_inverse=True)
        texts = np.array([*map(repr, points[used].ravel().tolist())], object).reshape(-1, 3)
        # The fourth corner of a triangle is its third.
        numbers = texts[position.reshape(-1, 3)[:, [0, 1, 2, 2]]].reshape(len(corners), -1)
        handles = range(first + start, first + start + len(corners))
        rows = zip(handles, *numbers.T.tolist(), strict=True)
        yield ((template * len(corners)) % tuple(chain.from_iterable(rows))).encode("ascii")


def _count_rows(path: Path, layer: str) -> int:  # noqa: ARG001
    try:
        with (
            path.open("rb") as file,
            mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content,
        ):
            whole = sum(1 for _ in _WRITTEN.finditer(content))
            begun = sum(1 for _ in re.finditer(_START, content))
            is_complete = content[-len(_END) :] == _END
    except ValueError as error:  # an empty file
        raise OSError(f"the DXF file is damaged: {error}") from error
    if begun != whole or not is_complete:
        raise OSError("the DXF file is damaged: it is cut short, or a face has no coordinates")
    return whole


def _read_document(path: Path) -> str:
    from geomesh.formats.tin_text import document_of

    with path.open(encoding="utf-8", errors="replace", newline="\n") as lines:
        return document_of(takewhile(lambda line: line != "  0\n", lines), "")


FORMAT = Format(
    _DRIVER,
    (".dxf",),
    _write,
    _count_rows,
    _read_document,
    layers=("triangles",),
    layer=layer_with_heights,
    leaves_out_voids=True,
    notes=_notes,
    require=_require,
)
