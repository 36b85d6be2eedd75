"""GeoJSON (RFC 7946), written by GDAL from geometry in longitude and latitude."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from geomesh.formats.format import Format, LayerFile, WriteRows
from geomesh.formats.gdal import write_by_gdal
from geomesh.raster.paths import plain_name

if TYPE_CHECKING:
    from pathlib import Path

    from geomesh.formats.arrow import Layer
    from geomesh.formats.batch_stream import BatchStream
    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.parameters import LayerName

_FEATURE = b'{ "type": "Feature",'


def _layer(mesh: TriangleMesh, name: LayerName) -> Layer:
    from geomesh.formats.lonlat import LonLatLayer

    return LonLatLayer.of(mesh, name)


def _write(layer: Layer, file: LayerFile, stream: BatchStream, write_rows: WriteRows) -> None:
    from geomesh.formats.document import KEY

    collection = {"type": "FeatureCollection", KEY: json.loads(file.document)}
    options = {
        # Coordinates are rounded already: COORDINATE_PRECISION would turn 44.9999997 into 45.
        "SIGNIFICANT_FIGURES": "17",
        # Additional members of the collection (RFC 7946, section 6.1).
        "NATIVE_DATA": json.dumps(collection),
        "NATIVE_MEDIA_TYPE": "application/vnd.geo+json",
    }
    # RFC 7946 allows only one CRS, so the file does not name it.
    write_by_gdal(layer, file, stream, write_rows, with_crs=False, layer_options=options)


def _read_document(path: Path) -> str:
    from geomesh.formats.document import KEY

    with path.open(encoding="utf-8") as file:
        return json.dumps(json.load(file)[KEY])


def _count_rows(path: Path, layer: str) -> int:  # noqa: ARG001
    """Count features as lines: GDAL writes one per line, and parsing is as slow as writing."""
    rows, last = 0, b""
    with path.open("rb") as file:
        for line in file:
            rows += line.startswith(_FEATURE)
            last = line.strip() or last
    if rows and last == b"}":
        return rows
    import pyogrio

    return int(pyogrio.read_info(plain_name(path), force_feature_count=True)["features"])


FORMAT = Format(
    "GeoJSON",
    (".geojson", ".json"),
    _write,
    _count_rows,
    _read_document,
    layer=_layer,
    by_gdal=True,
)
