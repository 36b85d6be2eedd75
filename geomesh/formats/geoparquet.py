"""GeoParquet 1.1 (https://geoparquet.org/releases/v1.1.0), written by pyarrow."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from geomesh.formats.format import GEOMETRY, Format, LayerFile, WriteRows

if TYPE_CHECKING:
    from pathlib import Path

    from geomesh.formats.arrow import Layer
    from geomesh.formats.batch_stream import BatchStream

_BBOX = "bbox"


def _write(layer: Layer, file: LayerFile, stream: BatchStream, write_rows: WriteRows) -> None:  # noqa: ARG001
    """Write a layer with the bounding box of every row, so that readers can skip row groups.

    The file metadata have the document and the `geo` key. Each batch becomes a row group.
    """
    import pyarrow.parquet as pq

    from geomesh.formats.document import KEY

    crs = file.mesh.grid.crs
    sides = ("xmin", "ymin", "xmax", "ymax")
    column = {
        "encoding": "WKB",
        "geometry_types": [layer.full_type],
        "crs": crs.to_json_dict() if crs else None,
        "orientation": "counterclockwise",
        "bbox": layer.bounds,
        "covering": {"bbox": {side: [_BBOX, side] for side in sides}},
    }
    geo = {"version": "1.1.0", "primary_column": GEOMETRY, "columns": {GEOMETRY: column}}
    metadata = {"geo": json.dumps(geo), KEY: file.document}
    schema = layer.schema(GEOMETRY, bbox=_BBOX).with_metadata(metadata)
    with pq.ParquetWriter(file.path, schema, compression="zstd") as writer:
        for batch in stream.batches(layer, GEOMETRY, bbox=_BBOX):
            writer.write_batch(batch)


def _count_rows(path: Path, layer: str) -> int:  # noqa: ARG001
    import pyarrow.parquet as pq

    return int(pq.read_metadata(path).num_rows)


def _read_document(path: Path) -> str:
    import pyarrow.parquet as pq

    from geomesh.formats.document import KEY

    return str((pq.read_schema(path).metadata or {})[KEY.encode()].decode())


FORMAT = Format(
    "Parquet",
    (".parquet", ".geoparquet"),
    _write,
    _count_rows,
    _read_document,
    reserved=(_BBOX,),
    options=("columns",),
)
