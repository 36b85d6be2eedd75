"""GeoParquet 1.1 (https://geoparquet.org/releases/v1.1.0), written by pyarrow."""

from __future__ import annotations

import json

import pyarrow.parquet as pq

from geomesh.formats.arrow import Layer
from geomesh.formats.document import KEY
from geomesh.formats.feed import Feed
from geomesh.formats.format import BBOX, GEOMETRY, LayerFile


def write_geoparquet(layer: Layer, file: LayerFile, feed: Feed) -> None:
    """Write a layer with the bounding box of every row, by which readers skip row groups.

    Parameters
    ----------
    layer : Layer
    file : LayerFile
        Its document is stored beside the `geo` key.
    feed : Feed
        Hands out the batches; each becomes a row group.
    """
    crs = file.mesh.grid.crs
    sides = ("xmin", "ymin", "xmax", "ymax")
    column = {
        "encoding": "WKB",
        "geometry_types": [layer.geometry_type],
        "crs": crs.to_json_dict() if crs else None,
        "orientation": "counterclockwise",
        "bbox": layer.bounds,
        "covering": {"bbox": {side: [BBOX, side] for side in sides}},
    }
    geo = {"version": "1.1.0", "primary_column": GEOMETRY, "columns": {GEOMETRY: column}}
    metadata = {"geo": json.dumps(geo), KEY: file.document}
    schema = layer.schema(GEOMETRY, bbox=BBOX).with_metadata(metadata)
    with pq.ParquetWriter(file.path, schema, compression="zstd") as writer:
        for batch in feed.batches(layer, GEOMETRY, bbox=BBOX):
            writer.write_batch(batch)
