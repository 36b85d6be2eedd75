"""STL, binary, written by numpy: a surface, or a closed solid to print.

STL has 32-bit coordinates, no units and no topology: programs join corners that are equal.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from geomesh.errors import OutputError
from geomesh.formats.format import (
    PLAIN,
    Format,
    LayerFile,
    WriteOptions,
    WriteRows,
    layer_with_heights,
)

if TYPE_CHECKING:
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray

    from geomesh.formats.arrow import Layer
    from geomesh.formats.batch_stream import BatchStream
    from geomesh.mesh.triangle_mesh import TriangleMesh

_HEADER = 80
_FACET = [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]

# The number of facets is stored in 32 bits; a solid has two for each triangle, and the walls.
_MOST_FACETS = 2**32 - 1
_MOST_TRIANGLES = _MOST_FACETS // 8


def _notes(mesh: TriangleMesh, options: WriteOptions = PLAIN) -> tuple[str, ...]:
    from geomesh.formats.model import local_notes

    notes = local_notes(mesh, "STL")
    _check_base(mesh, options)
    return notes


def _check_base(mesh: TriangleMesh, options: WriteOptions) -> None:
    """Raise OutputError if the base of a solid is not below all heights."""
    from geomesh.formats.tin import tin_of

    if options.solid is None or mesh.height is None:
        return
    lowest = float(tin_of(mesh).points[:, 2].min())
    if not (math.isfinite(options.solid) and options.solid < lowest):
        raise OutputError(
            "the base of a solid has to be below its surface, whose lowest height is "
            f"{lowest:.10g} (in {mesh.height.unit}), and it is {options.solid:g}: choose a lower "
            "`solid`"
        )


def _write(layer: Layer, file: LayerFile, stream: BatchStream, write_rows: WriteRows) -> None:  # noqa: ARG001
    """Write the triangles, and if it is asked for the base and the walls that close the solid.

    The header says where the origin is.
    """
    import numpy as np

    from geomesh.formats.solid import closed_solid
    from geomesh.formats.tin import LocalFrame, require_heights, tin_of
    from geomesh.raster.crs import crs_label

    mesh, base = file.mesh, file.options.solid
    require_heights(mesh, "STL")
    _check_base(mesh, file.options)
    tin, frame = tin_of(mesh), LocalFrame.of(mesh)
    # Adding 0 turns -0 into 0: some programs join corners only if their bytes are equal.
    points = frame.to_local(tin.points).astype(np.float32).astype(np.float64) + 0.0
    _check_rounded(points, tin.triangles)
    triangles = tin.triangles
    if base is not None:
        level = float(np.float32(base * frame.height_metres))
        touches = bool(points[:, 2].min() <= level)
        points, triangles = closed_solid(points, triangles, level)
    corners = points.astype(np.float32)[triangles]
    if base is not None and (touches or _has_flat_walls(corners)):
        raise OutputError(
            f"the base {base:g} is so close below the surface that they touch in the 32-bit "
            "numbers of STL: choose a lower `solid`"
        )
    facets = np.zeros(len(triangles), _FACET)
    facets["corners"] = corners
    facets["normal"] = _normals(points, triangles)
    x, y = frame.origin
    about = f"geomesh STL: metres from x {x:.12g} y {y:.12g} {crs_label(mesh.grid.crs)}, z up"
    # A reader would take "solid" at the start for text.
    header = about.encode("ascii", "replace").replace(b"\n", b" ")[:_HEADER].ljust(_HEADER)
    with file.path.open("wb") as output:
        output.write(header + np.uint32(len(facets)).astype("<u4").tobytes())
        output.write(facets.view(np.uint8).data)
    stream.rows += len(layer)


def _has_flat_walls(corners: NDArray[np.float32]) -> bool:
    """Return whether two corners of a facet (F, 3, 3) are the same."""
    import numpy as np

    return bool((corners == np.roll(corners, 1, axis=1)).all(axis=2).any())


def _normals(points: NDArray[np.float64], triangles: NDArray[np.int32]) -> NDArray[np.float64]:
    import numpy as np

    a, b, c = (points[triangles[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    unit: NDArray[np.float64] = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    return unit


def _check_rounded(points: NDArray[np.float64], triangles: NDArray[np.int32]) -> None:
    """Raise OutputError if rounding has moved points onto one another or turned triangles over.

    A program that joins equal corners would find holes where a triangle has vanished.
    """
    import numpy as np

    lost = np.count_nonzero(_turn(points[triangles]) <= 0)
    pairs = np.ascontiguousarray(points[:, :2].astype(np.float32)).view(np.uint64)
    if lost or len(np.unique(pairs)) < len(points):
        raise OutputError(
            f"{max(lost, 1)} triangles would vanish or turn over in the 32-bit numbers of STL: the "
            "area is too large for such small triangles; mesh a part of it (`bounds`), or write "
            ".ply, which has 64-bit numbers"
        )


def _turn(corners: NDArray[Any]) -> NDArray[np.float64]:
    """Return twice the area of triangles (F, 3, 3) on the map: positive if they face upwards.

    It is exactly 0 for a wall, of which two corners are one above the other.
    """
    import numpy as np

    (ax, ay), (bx, by) = np.moveaxis(np.diff(corners[..., :2].astype(np.float64), axis=1), 0, -1)
    turn: NDArray[np.float64] = ax * by - ay * bx
    return turn


def _count_rows(path: Path, layer: str) -> int:  # noqa: ARG001
    """Count the facets that face upwards: those of the surface, also in a solid."""
    import numpy as np

    data = path.read_bytes()
    if len(data) < _HEADER + 4:
        raise OSError("the STL file is damaged: it is shorter than its header")
    count = int.from_bytes(data[_HEADER : _HEADER + 4], "little")
    dtype = np.dtype(_FACET)
    if len(data) != _HEADER + 4 + count * dtype.itemsize:
        raise OSError(f"the STL file is damaged: it does not have the size of {count} facets")
    corners = np.frombuffer(data, dtype, offset=_HEADER + 4)["corners"]
    if not np.isfinite(corners).all():
        raise OSError("the STL file is damaged: it has corners without a place")
    return int(np.count_nonzero(_turn(corners) > 0))


def _read_document(path: Path) -> str:
    raise KeyError(f"STL has no room for a metadata document: {path}")


FORMAT = Format(
    "STL",
    (".stl",),
    _write,
    _count_rows,
    _read_document,
    layers=("triangles",),
    layer=layer_with_heights,
    leaves_out_voids=True,
    most_rows=_MOST_TRIANGLES,
    options=("solid",),
    notes=_notes,
)
