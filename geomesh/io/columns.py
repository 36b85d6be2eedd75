"""Columns of a mesh file as numpy arrays, and those that another program added."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyarrow.types as kinds

from geomesh.mesh.slope import SLOPE_COLUMNS

if TYPE_CHECKING:
    from collections.abc import Collection

    from numpy.typing import NDArray

    from geomesh.parameters import LayerName

# Bytes of the WKB of a point without height, and the codes of points of two and of three
# coordinates (that of the OGC, and an older one of GDAL).
_FLAT_POINT = 21
_POINTS = {2: (1,), 3: (1001, 0x80000001)}

# Columns that geomesh computes from the nodes and triangles when it writes a mesh.
_COMPUTED: dict[LayerName, frozenset[str]] = {
    "nodes": frozenset(("id", "col", "row")),
    "edges": frozenset(("id", "n0", "n1", "left", "right", "length", "constrained")),
    "triangles": frozenset(
        ("id", "n0", "n1", "n2", "area", "ab", "bc", "ca", "ki", "min_angle", "shape")
    ),
}


def added_by_others(
    names: Collection[str], layer: LayerName, stored: Collection[str], *, has_heights: bool
) -> list[str]:
    """Return those columns of a layer that geomesh did not write.

    Parameters
    ----------
    names : collection of str
        The columns of the layer, without geometry and fid.
    layer : {"triangles", "edges", "nodes"}
    stored : collection of str
        The columns that the metadata document lists.
    has_heights : bool
        Whether the mesh has heights.
    """
    own = _COMPUTED[layer]
    if has_heights and layer == "triangles":
        own |= set(SLOPE_COLUMNS)
    return [name for name in names if name not in own and name not in stored]


def can_keep(kind: pa.DataType) -> bool:
    """Return whether a table of a mesh can have a column of this type."""
    return any(
        is_kind(kind)
        for is_kind in (
            *(kinds.is_boolean, kinds.is_integer, kinds.is_floating),
            *(kinds.is_string, kinds.is_large_string, kinds.is_date32, kinds.is_timestamp),
        )
    )


def to_array(column: pa.ChunkedArray) -> NDArray[Any]:
    """Return a column as a numpy array.

    Text is an array of objects, and so are whole numbers and truth values among which are nulls:
    a null is None. Among floats it is NaN, and among dates NaT. Times are in UTC.
    """
    kind = column.type
    if kinds.is_timestamp(kind) and kind.tz is not None:
        column = column.cast(pa.timestamp(kind.unit, "UTC")).cast(pa.timestamp(kind.unit))
    is_text = kinds.is_string(kind) or kinds.is_large_string(kind)
    is_exact = kinds.is_integer(kind) or kinds.is_boolean(kind)
    if is_text or (is_exact and column.null_count):
        values = np.empty(len(column), object)
        values[:] = column.to_pylist()
        return values
    found: NDArray[Any] = column.to_numpy()
    return found


def to_points(geometry: pa.ChunkedArray) -> NDArray[np.float64] | None:
    """Return the coordinates (N, 2) or (N, 3) in a column of WKB, or None if not all are points."""
    column = geometry.combine_chunks()
    if isinstance(column, pa.ChunkedArray):  # without rows
        return np.empty((0, 2))
    sizes = np.diff(np.frombuffer(column.buffers()[1], np.int32)[: len(column) + 1])
    count = 3 if len(sizes) and sizes[0] > _FLAT_POINT else 2
    record = np.dtype([("order", "u1"), ("type", "<u4"), ("places", "<f8", count)])
    if column.offset or column.null_count or (sizes != record.itemsize).any():
        return None
    records = np.frombuffer(column.buffers()[2], record, len(column))
    if (records["order"] != 1).any() or not np.isin(records["type"], _POINTS[count]).all():
        return None
    places: NDArray[np.float64] = records["places"]
    return places
