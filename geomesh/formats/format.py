"""Format: what a file format can hold, and how it is written and counted."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from geomesh.parameters import LAYERS, LayerName

if TYPE_CHECKING:
    from pathlib import Path

    import pyarrow as pa

    from geomesh.formats.arrow import Layer
    from geomesh.formats.batch_stream import BatchStream
    from geomesh.mesh.triangle_mesh import TriangleMesh

GEOMETRY = "geometry"

# Stands in a layer's metadata until the document is known.
PENDING = "@document of the mesh@"

# How GDAL gets the rows of a layer: their schema, the rows, and keywords of pyogrio.write_arrow.
WriteRows = Callable[["pa.Schema", "Iterator[pa.RecordBatch]", Mapping[str, Any]], None]


@dataclass(frozen=True, eq=False)
class LayerFile:
    """A layer of a mesh and the file that is to hold it.

    Parameters
    ----------
    mesh : TriangleMesh
    name : {"triangles", "edges", "nodes"}
    path : Path
    format : Format
    document : str
        The metadata document of `geomesh.formats.document`.
    """

    mesh: TriangleMesh
    name: LayerName
    path: Path
    format: Format
    document: str


def _layer_of(mesh: TriangleMesh, name: LayerName) -> Layer:
    from geomesh.formats.arrow import Layer

    return Layer.of(mesh, name)


@dataclass(frozen=True)
class Joining:
    """How layers that were written to files of their own become one file.

    Parameters
    ----------
    is_possible : callable() -> bool
        Whether they can be joined here; one process writes them all otherwise.
    finish : callable(path, names, others, document)
        Copies the layers in `others` (name to path) into the file at `path`, puts all
        `names` in this order, and replaces `PENDING` by the document.
    """

    is_possible: Callable[[], bool]
    finish: Callable[[Path, Sequence[LayerName], Mapping[LayerName, Path], str], None]


@dataclass(frozen=True)
class Format:
    """A file format.

    Parameters
    ----------
    driver : str
        Its name: GDAL's, where GDAL knows it.
    extensions : tuple of str
        The first is the usual one.
    write : callable(layer, file, stream, write_rows)
        Writes a layer: what it holds, where to, its batches, and GDAL for those that use it.
    count_rows : callable(path, layer name) -> int
        Counts the rows that can be read back, themselves, not the number in a header; raises
        OSError or RuntimeError for a damaged file.
    read_document : callable(path) -> str
        Returns the metadata document; raises KeyError if there is none.
    geometry : str
        Name of the geometry column.
    reserved : tuple of str
        Names of further columns that it makes by itself.
    ignores_case : bool
        Whether names that differ in case only are the same column.
    layers : tuple of {"triangles", "edges", "nodes"}
        What it can hold.
    layer : callable(mesh, name) -> Layer
        Makes the rows of a layer.
    joining : Joining, optional
        Of a format that holds several layers in one file.
    by_gdal : bool
        Whether GDAL writes it.
    """

    driver: str
    extensions: tuple[str, ...]
    write: Callable[[Layer, LayerFile, BatchStream, WriteRows], None]
    count_rows: Callable[[Path, str], int]
    read_document: Callable[[Path], str]
    geometry: str = GEOMETRY
    reserved: tuple[str, ...] = ()
    ignores_case: bool = False
    layers: tuple[LayerName, ...] = LAYERS
    layer: Callable[[TriangleMesh, LayerName], Layer] = _layer_of
    joining: Joining | None = None
    by_gdal: bool = False
