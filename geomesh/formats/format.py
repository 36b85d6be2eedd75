"""Format: what a file format can store, how to write it and how to check it."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from geomesh.errors import OutputError
from geomesh.parameters import LAYERS, LayerName

if TYPE_CHECKING:
    from os import PathLike
    from pathlib import Path

    import pyarrow as pa

    from geomesh.formats.arrow import Layer
    from geomesh.formats.batch_stream import BatchStream
    from geomesh.mesh.triangle_mesh import TriangleMesh

GEOMETRY = "geometry"

# Extension of a compressed file, after the usual one.
COMPRESSED = ".gz"

# A longitude in float64 has no more decimals than this.
MOST_DECIMALS = 13

# Placeholder in the metadata of a layer until the document is known.
PENDING = "@document of the mesh@"

# Writes the rows of a layer with GDAL: schema, batches, and keywords of pyogrio.write_arrow.
WriteRows = Callable[["pa.Schema", "Iterator[pa.RecordBatch]", Mapping[str, Any]], None]


@dataclass(frozen=True)
class WriteOptions:
    """What a user asks of formats that can do it; see `Format.options`.

    Parameters
    ----------
    solid : float, optional
        Height of the base of a solid, in the unit of the mesh's heights. None: a surface.
    precision : int, optional
        Number of decimals of longitudes and latitudes, 0 to 13. None: as many as the format
        finds right.
    columns : tuple of str, optional
        The only attributes to write, in this order. None: all.

    Raises
    ------
    OutputError
        If there is no such precision.
    """

    solid: float | None = None
    precision: int | None = None
    columns: tuple[str, ...] | None = None

    def __post_init__(self) -> None:
        if self.precision is not None and self.precision not in range(MOST_DECIMALS + 1):
            raise OutputError(
                f"`precision` is {self.precision}: choose a number of decimals from 0 to "
                f"{MOST_DECIMALS}"
            )

    def given(self) -> dict[str, Any]:
        """Return those that are not None, as plain JSON values."""
        values = {
            "solid": self.solid,
            "precision": self.precision,
            "columns": None if self.columns is None else list(self.columns),
        }
        return {name: value for name, value in values.items() if value is not None}


PLAIN = WriteOptions()


@dataclass(frozen=True, eq=False)
class LayerFile:
    """A layer of a mesh and the file to write it to.

    Parameters
    ----------
    mesh : TriangleMesh
    name : {"triangles", "edges", "nodes"}
    path : Path
    format : Format
    document : str
        The metadata document of `geomesh.formats.document`.
    options : WriteOptions
    """

    mesh: TriangleMesh
    name: LayerName
    path: Path
    format: Format
    document: str
    options: WriteOptions = PLAIN


def _nothing_to_say(mesh: TriangleMesh, options: WriteOptions) -> tuple[str, ...]:  # noqa: ARG001
    return ()


def _layer_of(mesh: TriangleMesh, name: LayerName, options: WriteOptions) -> Layer:  # noqa: ARG001
    from geomesh.formats.arrow import Layer

    return Layer.of(mesh, name)


def layer_with_heights(mesh: TriangleMesh, name: LayerName, options: WriteOptions) -> Layer:  # noqa: ARG001
    """Return the layer of the triangles with heights, for `Format.layer`."""
    from geomesh.formats.tin import tin_layer

    return tin_layer(mesh, name)


@dataclass(frozen=True)
class Joining:
    """How to join layers that were written to separate files into one file.

    Parameters
    ----------
    is_possible : callable() -> bool
        Whether this computer can join them; if not, one process writes all layers.
    finish : callable(path, names, separate, document)
        Copies the layers in `separate` (name to path) into the file at `path`, puts the
        layers into the order of `names`, and replaces `PENDING` by the document.
    """

    is_possible: Callable[[], bool]
    finish: Callable[[Path, Sequence[LayerName], Mapping[LayerName, Path], str], None]


@dataclass(frozen=True)
class Format:
    """A file format.

    Parameters
    ----------
    driver : str
        Name of the format; if GDAL supports it, the name of GDAL's driver.
    extensions : tuple of str
        File extensions, of one or two parts; the first is the usual one. A file whose name
        ends in .gz is compressed, if the format has such an extension.
    write : callable(layer, file, stream, write_rows)
        Writes `layer` to `file`. The batches come from `stream`; formats that use GDAL
        write them with `write_rows`.
    count_rows : callable(path, layer name) -> int
        Counts the rows by reading them, not from a number in a header; raises OSError or
        RuntimeError for a damaged file.
    read_document : callable(path) -> str
        Returns the metadata document; raises KeyError if there is none.
    geometry : str
        Name of the geometry column.
    reserved : tuple of str
        Names of other columns that the format adds.
    ignores_case : bool
        Whether names that differ only in case are the same column.
    layers : tuple of {"triangles", "edges", "nodes"}
        The layers that the format can store.
    layer : callable(mesh, name, options) -> Layer
        Returns a layer with its rows.
    joining : Joining, optional
        Only for a format that stores several layers in one file.
    by_gdal : bool
        Whether GDAL writes the format.
    most_columns, most_rows : int, optional
        Largest number of attributes and of rows of a layer, if there is a limit.
    leaves_out_voids : bool
        Whether the format stores only triangles with heights.
    options : tuple of str
        Names of the `WriteOptions` that the format knows.
    notes : callable(mesh, options) -> tuple of str
        Returns what the user should know before the mesh is written: an origin that is
        subtracted, a very large file. Raises OutputError if the mesh cannot be written.
    require : callable()
        Imports an optional library. Raises MissingExtraError if it is not installed.
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
    layer: Callable[[TriangleMesh, LayerName, WriteOptions], Layer] = _layer_of
    joining: Joining | None = None
    by_gdal: bool = False
    most_columns: int | None = None
    most_rows: int | None = None
    leaves_out_voids: bool = False
    options: tuple[str, ...] = ()
    notes: Callable[[TriangleMesh, WriteOptions], tuple[str, ...]] = _nothing_to_say
    require: Callable[[], None] = lambda: None

    def extension_for(self, path: str | PathLike[str]) -> str:
        """Return the extension of a temporary file whose content is that of the file `path`."""
        is_compressed = str(path).lower().endswith(COMPRESSED)
        able = [each for each in self.extensions if each.endswith(COMPRESSED)]
        return able[0] if is_compressed and able else self.extensions[0]

    def require_room(
        self, name: LayerName, *, columns: int = 0, rows: int = 0, way_out: str = "write .parquet"
    ) -> None:
        """Raise OutputError if a layer has more columns or rows than the format can store."""
        for count, most, things in (
            (columns, self.most_columns, "attributes"),
            (rows, self.most_rows, "rows"),
        ):
            if most is not None and count > most:
                raise OutputError(
                    f"{self.driver} can store at most {most} {things} of a layer, and the {name} "
                    f"would have {count}: {way_out}"
                )

    def choose_layers(self, layers: Iterable[LayerName] | None) -> list[LayerName]:
        """Return the layers to write, in order; by default all that one file can store.

        Raises
        ------
        OutputError
            If a layer does not exist, or the format cannot store the layers.
        """
        if layers is None:
            return list(LAYERS if self.joining is not None else LAYERS[:1])
        asked = [layers] if isinstance(layers, str) else list(layers)
        for name in asked:
            if name not in LAYERS:
                raise OutputError(f"there is no layer {name!r}; choose from {', '.join(LAYERS)}")
            if name not in self.layers:
                raise OutputError(
                    f"{self.driver} can store {', '.join(self.layers)}, not {name}; "
                    "write .gpkg for all layers"
                )
        if not asked:
            raise OutputError(f"no layer to write; choose from {', '.join(LAYERS)}")
        chosen = [name for name in LAYERS if name in asked]
        if len(chosen) > 1 and self.joining is None:
            raise OutputError(
                f"{self.driver} can store one layer, not {', '.join(chosen)}; "
                "choose one of them, or write .gpkg"
            )
        return chosen
