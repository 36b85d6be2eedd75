"""One layer of a mesh into one file, in any of the formats."""

from __future__ import annotations

import threading
from contextlib import suppress
from typing import TYPE_CHECKING, Any

from geomesh.errors import OutputError
from geomesh.io.gdal_process import WriterPool, write_arrow

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    import pyarrow as pa

    from geomesh.formats.arrow import Layer
    from geomesh.formats.batch_stream import BatchStream
    from geomesh.formats.format import Format, LayerFile

_thread = threading.local()

# pyogrio keeps the interpreter's lock anyway, and filters of warnings belong to the process.
_in_process = threading.Lock()


def write_layer(file: LayerFile, stream: BatchStream, writer_pool: WriterPool | None) -> None:
    """Write one layer of a mesh to a file, and check that all rows arrived there.

    Parameters
    ----------
    file : LayerFile
    stream : BatchStream
        Gives the rows.
    writer_pool : WriterPool, optional
        Processes that write what GDAL writes; this process by default.

    Raises
    ------
    OSError
        If rows are missing.
    OutputError
        If the format cannot hold one of the columns.
    GeoreferenceError
        If GeoJSON is asked for and the nodes have no longitude and latitude.
    """
    layer = file.format.layer(file.mesh, file.name)
    _check_columns(layer, file.format)
    file.format.write(layer, file, stream, writer_pool.write if writer_pool else _write_here)
    found = file.format.count_rows(file.path, file.name)
    if found != len(layer):
        raise OSError(f"only {found} of {len(layer)} {file.name} arrived in the file")


def _check_columns(layer: Layer, file_format: Format) -> None:
    """Refuse names that the format takes for itself or cannot tell apart."""
    taken = {file_format.geometry, *file_format.reserved}
    for name in layer.columns:
        key = name.lower() if file_format.ignores_case else name
        if key in taken:
            raise OutputError(
                f"{file_format.driver} cannot hold a column {name!r} in {layer.name}: "
                "rename the band or the attribute"
            )
        taken.add(key)


def _write_here(
    schema: pa.Schema, batches: Iterator[pa.RecordBatch], options: Mapping[str, Any]
) -> None:
    import pyarrow as pa

    with _in_process:
        _quiet_gdal()
        write_arrow(pa.RecordBatchReader.from_batches(schema, batches), options)


def _quiet_gdal() -> None:
    """Keep GDAL from printing errors: pyogrio raises them, but hushes the main thread alone.

    It has no public way to do so in another; without this one the lines appear as well.
    """
    if not getattr(_thread, "is_quiet", False):
        with suppress(ImportError):
            from pyogrio._err import _register_error_handler

            _register_error_handler()
        _thread.is_quiet = True
