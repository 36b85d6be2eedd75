"""The layers of a mesh as Arrow record batches, without one Python object per row.

All geometries of a layer have the same number of vertices. So their WKB (OGC 06-103r4,
section 8.2) has a fixed size, and one structured array holds the WKB of all rows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, Literal, Self

import numpy as np
import pyarrow as pa

from geomesh.arrays.table import Table

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from numpy.typing import NDArray

    from geomesh.arrays.types import Floats, Points
    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.parameters import LayerName

GeometryType = Literal["Point", "LineString", "Polygon"]

_LITTLE_ENDIAN = 1
_NO_ASCII = 128  # the first code point outside ASCII
_WKB_CODES: dict[GeometryType, int] = {"Point": 1, "LineString": 2, "Polygon": 3}
_WITH_Z = 1000  # added to the code
_WKB_COUNTS: dict[GeometryType, tuple[str, ...]] = {
    "Point": (),
    "LineString": ("vertices",),
    "Polygon": ("rings", "vertices"),
}


@dataclass(frozen=True, eq=False)
class Layer:
    """A layer of a mesh, which returns its rows as batches.

    Parameters
    ----------
    name : {"triangles", "edges", "nodes"}
    columns : Table
        Attributes, one row per geometry.
    points : float64 (N, 2)
        Node coordinates on the map.
    vertices : int32 (R, V)
        Node ids of each geometry; rings are closed.
    geometry_type : {"Polygon", "LineString", "Point"}
    heights : float64 (N,), optional
        Third coordinate of the points; None if they have two.
    """

    name: LayerName
    columns: Table
    points: Points
    vertices: NDArray[np.int32]
    geometry_type: GeometryType
    heights: Floats | None = None

    @classmethod
    def of(cls, mesh: TriangleMesh, name: LayerName) -> Layer:
        """Return the layer `name` of a mesh."""
        columns, points, heights = mesh.attributes(name), mesh.map_nodes, mesh.heights
        if name == "triangles":
            rings = mesh.triangles[:, [0, 1, 2, 0]]
            return cls(name, columns, points, rings, "Polygon", heights)
        if name == "edges":
            return cls(name, columns, points, mesh.edges.nodes, "LineString", heights)
        each = np.arange(len(points), dtype=np.int32)[:, None]
        return cls(name, columns, points, each, "Point", heights)

    def __len__(self) -> int:
        return len(self.vertices)

    @property
    def full_type(self) -> str:
        """The type of the geometry, with its third coordinate: "Polygon Z"."""
        return self.geometry_type if self.heights is None else f"{self.geometry_type} Z"

    @property
    def bounds(self) -> tuple[float, float, float, float]:
        """West, south, east and north of the layer on the map."""
        (west, south), (east, north) = self.points.min(axis=0), self.points.max(axis=0)
        return float(west), float(south), float(east), float(north)

    def with_columns(self, names: Sequence[str]) -> Self:
        """Return the layer with only these attributes, in this order."""
        kept = {name: self.columns[name] for name in names}
        return replace(self, columns=Table(kept, len(self)))

    @cached_property
    def _object_types(self) -> Mapping[str, pa.DataType]:
        """The types of the columns of objects. The rows of one batch may all be null."""
        found = {
            name: pa.infer_type(values, from_pandas=True)
            for name, values in self.columns.items()
            if values.dtype.kind == "O"
        }
        return {name: pa.string() if kind == pa.null() else kind for name, kind in found.items()}

    def schema(self, geometry: str, *, bbox: str | None = None) -> pa.Schema:
        """Return the schema of the batches; see `batch` for the parameters."""
        return self.batch(slice(0, 0), geometry, bbox=bbox).schema

    def batch(self, rows: slice, geometry: str, *, bbox: str | None = None) -> pa.RecordBatch:
        """Return the given rows as a record batch.

        Parameters
        ----------
        rows : slice
        geometry : str
            Name of the WKB column.
        bbox : str, optional
            Name of a struct column to add, with xmin, ymin, xmax and ymax.
        """
        arrays = {
            name: _attribute(values[rows], self._object_types.get(name))
            for name, values in self.columns.items()
        }
        arrays[geometry] = self.geometry(rows)
        if bbox is not None:
            xy = self.points[self.vertices[rows]]
            extremes = np.concatenate([xy.min(axis=1), xy.max(axis=1)], axis=1)
            names = ["xmin", "ymin", "xmax", "ymax"]
            sides = [pa.array(np.ascontiguousarray(side)) for side in extremes.T]
            arrays[bbox] = pa.StructArray.from_arrays(sides, names=names)
        return pa.RecordBatch.from_pydict(arrays)

    def geometry(self, rows: slice) -> pa.Array:
        """Return the WKB of the given rows."""
        return binary(wkb(self.coordinates(rows), self.geometry_type))

    def coordinates(self, rows: slice) -> NDArray[np.float64]:
        """Return the coordinates (R, V, 2) of the given rows, or (R, V, 3) with heights."""
        vertices = self.vertices[rows]
        places = self.points[vertices]
        if self.heights is None:
            return places
        return np.concatenate([places, self.heights[vertices][..., None]], axis=-1)


def _attribute(values: NDArray[Any], object_type: pa.DataType | None = None) -> pa.Array:
    """Return an Arrow column; NaN becomes null, which every format supports.

    `object_type` is the type of a column of objects.

    Columns of numbers and ASCII text are made from buffers: the first call of
    `pyarrow.array` imports pandas, which takes half a second and is not needed.
    """
    if values.dtype.kind == "U":
        return _text(values)
    if values.dtype.kind not in "biuf":
        return pa.array(values, object_type, from_pandas=object_type is not None)
    known = None
    if values.dtype.kind == "f" and (missing := np.isnan(values)).any():
        known = _bits(~missing)
    data = _bits(values) if values.dtype.kind == "b" else pa.py_buffer(np.ascontiguousarray(values))
    return pa.Array.from_buffers(pa.from_numpy_dtype(values.dtype), len(values), [known, data])


def _bits(values: NDArray[np.bool_]) -> pa.Buffer:
    return pa.py_buffer(np.packbits(values, bitorder="little"))


def _text(values: NDArray[np.str_]) -> pa.Array:
    letters = np.ascontiguousarray(values).view(np.uint32)
    letters = letters.reshape(len(values), values.dtype.itemsize // letters.itemsize)
    if letters.max(initial=0) >= _NO_ASCII:
        return pa.array(values)
    used = letters != 0
    offsets = np.zeros(len(values) + 1, np.int32)
    np.cumsum(np.count_nonzero(used, axis=1), out=offsets[1:])
    buffers = [None, pa.py_buffer(offsets), pa.py_buffer(letters.astype(np.uint8)[used])]
    return pa.Array.from_buffers(pa.string(), len(values), buffers)


def wkb(places: NDArray[np.float64], geometry_type: GeometryType) -> NDArray[Any]:
    """Return the well-known binary of coordinates, as a structured array (R,).

    They are (R, V, 2), or (R, V, 3) with heights.
    """
    counts = _WKB_COUNTS[geometry_type]
    fields = [("order", "u1"), ("type", "<u4"), *((name, "<u4") for name in counts)]
    records = np.empty(len(places), np.dtype([*fields, ("places", "<f8", places.shape[1:])]))
    records["order"] = _LITTLE_ENDIAN
    records["type"] = _WKB_CODES[geometry_type] + _WITH_Z * (places.shape[-1] == 3)
    for name in counts:
        records[name] = 1 if name == "rings" else places.shape[1]
    records["places"] = places
    return records


def binary(records: NDArray[Any], replacements: Mapping[int, bytes] | None = None) -> pa.Array:
    """Return an Arrow binary array of the records' bytes.

    Parameters
    ----------
    records : structured array (R,)
    replacements : mapping of int to bytes, optional
        Row number to the bytes that replace this row; they may have another size.
    """
    sizes = np.full(len(records), records.dtype.itemsize, np.int32)
    # pyarrow does not accept a buffer of a structured dtype.
    data = records.view(np.uint8)
    if replacements:
        sizes[list(replacements)] = [len(new) for new in replacements.values()]
        kept = np.split(records, sorted(replacements))
        pieces = [kept[0].view(np.uint8)]
        for row, run in zip(sorted(replacements), kept[1:], strict=True):
            pieces += [np.frombuffer(replacements[row], np.uint8), run[1:].view(np.uint8)]
        data = np.concatenate(pieces)
    offsets = np.concatenate([[0], np.cumsum(sizes)]).astype(np.int32)
    buffers = [None, pa.py_buffer(offsets), pa.py_buffer(data)]
    return pa.Array.from_buffers(pa.binary(), len(records), buffers)
