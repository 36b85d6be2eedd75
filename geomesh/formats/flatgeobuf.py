"""FlatGeobuf (https://flatgeobuf.org), written by GDAL."""

from __future__ import annotations

from typing import TYPE_CHECKING

from geomesh.formats.format import Format, LayerFile, WriteRows
from geomesh.formats.gdal import count_by_gdal, read_document_by_gdal, write_by_gdal

if TYPE_CHECKING:
    from geomesh.formats.arrow import Layer
    from geomesh.formats.batch_stream import BatchStream


def _write(layer: Layer, file: LayerFile, stream: BatchStream, write_rows: WriteRows) -> None:
    write_by_gdal(layer, file, stream, write_rows, layer_options={"SPATIAL_INDEX": "YES"})


FORMAT = Format(
    "FlatGeobuf",
    (".fgb",),
    _write,
    count_by_gdal,
    read_document_by_gdal,
    by_gdal=True,
    options=("columns",),
    most_columns=65_536,  # a row stores the number of each column in 16 bits
)
