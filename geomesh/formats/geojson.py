"""GeoJSON (RFC 7946), written by GDAL from geometry in longitude and latitude."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from geomesh.formats.format import COMPRESSED, Format, LayerFile, WriteOptions, WriteRows
from geomesh.formats.gdal import write_by_gdal
from geomesh.raster.paths import plain_name

if TYPE_CHECKING:
    from io import BufferedIOBase
    from pathlib import Path

    from geomesh.formats.arrow import Layer
    from geomesh.formats.batch_stream import BatchStream
    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.parameters import LayerName

_FEATURE = b'{ "type": "Feature",'

# With so many significant digits, numbers are exactly those that were rounded. With more, a tenth
# of all coordinates would end as 7.1234567000000002 does.
_DIGITS = 15

# Digits of a longitude before the point.
_BEFORE_POINT = 3

# First bytes of a file that gzip has compressed (RFC 1952).
_GZIP = b"\x1f\x8b"


def _layer(mesh: TriangleMesh, name: LayerName, options: WriteOptions) -> Layer:
    from geomesh.formats.lonlat import LonLatLayer

    return LonLatLayer.of(mesh, name, options.precision)


def _notes(mesh: TriangleMesh, options: WriteOptions) -> tuple[str, ...]:
    """Say which nodes have more decimals than the user asked for."""
    precision = options.precision
    if precision is None:
        return ()
    from geomesh.formats.lonlat import LonLatLayer

    decimals = LonLatLayer.of(mesh, "nodes", precision).decimals.nodes
    more = int((decimals > precision).sum())
    if not more:
        return ()
    return (
        f"with `precision={precision}`, {more:,} of {len(decimals):,} nodes have more decimals, "
        f"up to {decimals.max()}: otherwise triangles would collapse, turn over, or lose the "
        "curves of their sides",
    )


def _write(layer: Layer, file: LayerFile, stream: BatchStream, write_rows: WriteRows) -> None:
    from geomesh.formats.document import KEY
    from geomesh.formats.lonlat import LonLatLayer

    assert isinstance(layer, LonLatLayer)
    collection = {"type": "FeatureCollection", KEY: json.loads(file.document)}
    options = {
        # Coordinates are rounded already: COORDINATE_PRECISION would turn 44.9999997 into 45.
        "SIGNIFICANT_FIGURES": str(max(_DIGITS, layer.decimals.most + _BEFORE_POINT)),
        # Additional members of the collection (RFC 7946, section 6.1).
        "NATIVE_DATA": json.dumps(collection),
        "NATIVE_MEDIA_TYPE": "application/vnd.geo+json",
    }
    # RFC 7946 allows only one CRS, so the file does not name it.
    write_by_gdal(layer, file, stream, write_rows, with_crs=False, layer_options=options)


def _is_compressed(path: Path) -> bool:
    with path.open("rb") as file:
        return file.read(len(_GZIP)) == _GZIP


def _open(path: Path) -> BufferedIOBase:
    """Open a file, compressed or not."""
    if not _is_compressed(path):
        return path.open("rb")
    import gzip

    return gzip.open(path)


def _read_document(path: Path) -> str:
    from geomesh.formats.document import KEY

    with _open(path) as file:
        return json.dumps(json.load(file)[KEY])


def _count_rows(path: Path, layer: str) -> int:  # noqa: ARG001
    """Count features as lines: GDAL writes one per line, and parsing is as slow as writing.

    Of a compressed file, this also compares the checksum of the whole.
    """
    from zlib import error as damage

    rows, last = 0, b""
    try:
        with _open(path) as file:
            for line in file:
                rows += line.startswith(_FEATURE)
                last = line.strip() or last
    except (EOFError, damage) as error:
        raise OSError(f"the compressed file is damaged: {error}") from error
    if rows and last == b"}":
        return rows
    import pyogrio

    name = plain_name(path)
    name = f"/vsigzip/{name}" if _is_compressed(path) else name
    return int(pyogrio.read_info(name, force_feature_count=True)["features"])


FORMAT = Format(
    "GeoJSON",
    (".geojson", ".json", f".geojson{COMPRESSED}", f".json{COMPRESSED}"),
    _write,
    _count_rows,
    _read_document,
    layer=_layer,
    by_gdal=True,
    options=("precision", "columns"),
    notes=_notes,
)
