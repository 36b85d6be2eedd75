"""glTF 2.0 in one binary file (https://registry.khronos.org/glTF), written by numpy and json."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from geomesh._version import __version__
from geomesh.formats.format import Format, LayerFile, WriteOptions, WriteRows, layer_with_heights

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from geomesh.formats.arrow import Layer
    from geomesh.formats.batch_stream import BatchStream
    from geomesh.mesh.triangle_mesh import TriangleMesh

_MAGIC, _JSON, _BINARY = b"glTF", b"JSON", b"BIN\0"
_VERSION = 2
_ALIGNMENT = 4

# Numbers that glTF has from OpenGL.
_BYTE, _UINT, _FLOAT = 5121, 5125, 5126
_VERTICES, _INDICES = 34962, 34963

# The length of the file is stored in 32 bits; a triangle has 12 bytes, and 28 for half a node.
_MOST_TRIANGLES = (2**32 - 2**24) // 40


def _notes(mesh: TriangleMesh, options: WriteOptions) -> tuple[str, ...]:  # noqa: ARG001
    from geomesh.formats.model import local_notes

    return local_notes(mesh, "GLB")


def _write(layer: Layer, file: LayerFile, stream: BatchStream, write_rows: WriteRows) -> None:  # noqa: ARG001
    """Write a node with one mesh: x to the east, y up, z to the south, in metres.

    `extras` of the node say where the origin is, and those of the asset hold the document.
    """
    import numpy as np

    from geomesh.formats.document import KEY
    from geomesh.formats.model import node_colors, place_of
    from geomesh.formats.tin import LocalFrame, require_heights, tin_of

    mesh = file.mesh
    require_heights(mesh, "GLB")
    tin, frame = tin_of(mesh), LocalFrame.of(mesh)
    local = frame.to_local(tin.points)
    points = _y_up(local)
    parts: dict[str, tuple[NDArray[Any], str, int, dict[str, Any]]] = {
        "POSITION": (points, "VEC3", _FLOAT, _range(points)),
        "NORMAL": (_y_up(_normals(local, tin.triangles)), "VEC3", _FLOAT, {}),
    }
    colors = node_colors(mesh, tin)
    if colors is not None:
        parts["COLOR_0"] = (_linear(colors), "VEC4", _BYTE, {"normalized": True})
    parts["indices"] = (tin.triangles.astype("<u4").reshape(-1, 1), "SCALAR", _UINT, {})
    views, accessors, offset = [], [], 0
    for number, (name, (values, kind, component, more)) in enumerate(parts.items()):
        target = _INDICES if name == "indices" else _VERTICES
        views.append(
            {"buffer": 0, "byteOffset": offset, "byteLength": values.nbytes, "target": target}
        )
        accessors.append(
            {"bufferView": number, "componentType": component, "count": len(values), "type": kind}
            | more
        )
        offset += values.nbytes
    attributes = {name: number for number, name in enumerate(parts) if name != "indices"}
    x, y = frame.origin
    about = {
        "about": place_of(mesh, frame),
        "crs": None if mesh.grid.crs is None else mesh.grid.crs.to_wkt(),
        "origin": [x, y, 0.0],
        "metres_per_unit": [*frame.metres, frame.height_metres],
        "unit": "metre",
    }
    drawn = {"attributes": attributes, "indices": len(parts) - 1, "material": 0}
    # Without these a surface looks like metal, and is dark.
    rough = {"metallicFactor": 0.0, "roughnessFactor": 1.0}
    content = {
        "asset": {
            "version": "2.0",
            "generator": f"geomesh {__version__}",
            "extras": {KEY: file.document},
        },
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": "terrain", "mesh": 0, "extras": about}],
        "meshes": [{"name": "terrain", "primitives": [drawn]}],
        "materials": [{"name": "terrain", "pbrMetallicRoughness": rough, "doubleSided": True}],
        "buffers": [{"byteLength": offset}],
        "bufferViews": views,
        "accessors": accessors,
    }
    text = json.dumps(content, allow_nan=False).encode()
    text += b" " * (-len(text) % _ALIGNMENT)
    with file.path.open("wb") as output:
        size = 12 + 8 + len(text) + 8 + offset
        output.write(_MAGIC + _words(_VERSION, size) + _words(len(text)) + _JSON + text)
        output.write(_words(offset) + _BINARY)
        for values, *_ in parts.values():
            output.write(np.ascontiguousarray(values).reshape(-1).view(np.uint8).data)
    stream.rows += len(layer)


def _words(*numbers: int) -> bytes:
    return b"".join(number.to_bytes(4, "little") for number in numbers)


def _y_up(local: NDArray[np.float64]) -> NDArray[np.float32]:
    import numpy as np

    # Adding 0 turns -0 into 0.
    turned: NDArray[np.float32] = (local[:, [0, 2, 1]] * (1, 1, -1) + 0.0).astype("<f4")
    return np.ascontiguousarray(turned)


def _range(points: NDArray[np.float32]) -> dict[str, Any]:
    return {"min": points.min(axis=0).tolist(), "max": points.max(axis=0).tolist()}


def _normals(points: NDArray[np.float64], triangles: NDArray[np.int32]) -> NDArray[np.float64]:
    """Return the unit normals of the points: the mean of their triangles, weighted by area.

    Without them a viewer has to show every triangle flat.
    """
    import numpy as np

    a, b, c = (points[triangles[:, k]] for k in range(3))
    area = np.repeat(np.cross(b - a, c - a), 3, axis=0)
    sums = [np.bincount(triangles.ravel(), part, len(points)) for part in area.T]
    total = np.column_stack(sums)
    unit: NDArray[np.float64] = total / np.linalg.norm(total, axis=1, keepdims=True)
    return unit


def _linear(colors: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return colours (N, 4) in linear light, opaque.

    The colours of a mesh are sRGB, as those of images are, but glTF wants vertex colours linear:
    a viewer that got sRGB would show them too bright. A fourth channel aligns each to 4 bytes.
    """
    import numpy as np

    level = np.arange(256) / 255
    light = np.where(level <= 0.04045, level / 12.92, ((level + 0.055) / 1.055) ** 2.4)
    table = np.rint(255 * light).astype(np.uint8)
    return np.column_stack([table[colors], np.full(len(colors), 255, np.uint8)])


def _read(path: Path) -> tuple[dict[str, Any], bytes]:
    """Return the JSON and the binary chunk."""
    data = path.read_bytes()
    length = int.from_bytes(data[12:16], "little")
    start = 20 + length
    size = int.from_bytes(data[start : start + 4], "little")
    is_whole = data[:4] == _MAGIC and int.from_bytes(data[8:12], "little") == len(data)
    if not is_whole or data[16:20] != _JSON or len(data) != start + 8 + size:
        raise OSError("the GLB file is damaged or cut short")
    try:
        content: dict[str, Any] = json.loads(data[20:start])
    except ValueError as error:
        raise OSError(f"the GLB file is damaged: {error}") from error
    return content, data[start + 8 :]


def _count_rows(path: Path, layer: str) -> int:  # noqa: ARG001
    """Count the triangles, of which each must have three vertices that exist."""
    import numpy as np

    content, binary = _read(path)
    try:
        drawn = content["meshes"][0]["primitives"][0]
        indices = content["accessors"][drawn["indices"]]
        vertices = content["accessors"][drawn["attributes"]["POSITION"]]["count"]
        view = content["bufferViews"][indices["bufferView"]]
        corners = np.frombuffer(binary, "<u4", indices["count"], view["byteOffset"])
    except (IndexError, KeyError, TypeError, ValueError) as error:
        raise OSError(f"the GLB file is damaged: {error}") from error
    if len(corners) % 3 or corners.max(initial=0) >= vertices:
        raise OSError("the GLB file is damaged: it has triangles without vertices")
    return len(corners) // 3


def _read_document(path: Path) -> str:
    from geomesh.formats.document import KEY

    content, _ = _read(path)
    extras = content.get("asset", {}).get("extras", {})
    return str(extras[KEY])


FORMAT = Format(
    "GLB",
    (".glb",),
    _write,
    _count_rows,
    _read_document,
    layers=("triangles",),
    layer=layer_with_heights,
    leaves_out_voids=True,
    most_rows=_MOST_TRIANGLES,
    notes=_notes,
)
