"""Write one layer of a mesh to one file, in any format."""

from __future__ import annotations

import threading
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from geomesh.errors import OutputError
from geomesh.formats.names import choose_columns
from geomesh.io.gdal_process import WriterPool, write_arrow

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    import pyarrow as pa

    from geomesh.formats.arrow import Layer
    from geomesh.formats.batch_stream import BatchStream
    from geomesh.formats.format import Format, LayerFile

_thread = threading.local()

# pyogrio holds the interpreter lock anyway, and warning filters apply to the whole process.
_in_process = threading.Lock()


def write_layer(file: LayerFile, stream: BatchStream, writer_pool: WriterPool | None) -> None:
    """Write one layer of a mesh to a file, and check that the file has all rows.

    Parameters
    ----------
    file : LayerFile
    stream : BatchStream
        Yields the rows.
    writer_pool : WriterPool, optional
        Processes for the formats that GDAL writes; by default this process writes.

    Raises
    ------
    OSError
        If rows are missing in the file.
    OutputError
        If there is no column that was asked for, or the format cannot store one.
    GeoreferenceError
        If the format is GeoJSON and the nodes have no longitude and latitude.
    """
    layer = file.format.layer(file.mesh, file.name, file.options)
    if file.options.columns is not None:
        layer = layer.with_columns(choose_columns(layer.columns, file.options.columns, file.name))
    _check_columns(layer, file.format)
    file.format.write(layer, file, stream, writer_pool.write if writer_pool else write_here)
    found = file.format.count_rows(file.path, file.name)
    if found != len(layer):
        raise OSError(f"the file has only {found} of {len(layer)} {file.name}")


def _check_columns(layer: Layer, file_format: Format) -> None:
    """Refuse too many columns or rows, and names that the format reserves or cannot distinguish."""
    file_format.require_room(layer.name, columns=len(layer.columns), rows=len(layer))
    taken = {file_format.geometry, *file_format.reserved}
    for name in layer.columns:
        key = name.lower() if file_format.ignores_case else name
        if key in taken:
            raise OutputError(
                f"{file_format.driver} cannot store the column {name!r} of the {layer.name}: "
                "rename the band or the attribute"
            )
        taken.add(key)


def write_here(
    schema: pa.Schema, batches: Iterator[pa.RecordBatch], options: Mapping[str, Any]
) -> None:
    """Write rows with the keywords of pyogrio.write_arrow, in this process."""
    import pyarrow as pa

    with _in_process:
        _quiet_gdal()
        write_arrow(pa.RecordBatchReader.from_batches(schema, batches), options)


def _quiet_gdal() -> None:
    """Keep GDAL from printing errors in this thread: pyogrio raises them anyway.

    pyogrio itself silences GDAL only in the main thread, and has no public function for other
    threads. If this private function is missing, errors are also printed.
    """
    if not getattr(_thread, "is_quiet", False):
        with suppress(ImportError):
            from pyogrio._err import _register_error_handler

            _register_error_handler()
        _thread.is_quiet = True
