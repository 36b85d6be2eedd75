"""Write a GeoPackage: compare geomesh.io with GeoDataFrame.to_file."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from queue import SimpleQueue
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np
import pyarrow as pa
import pyogrio

from benchmarks import inputs
from benchmarks.timing import Row, alternate
from geomesh.formats.arrow import Layer
from geomesh.formats.batch_stream import BatchStream
from geomesh.formats.format import LayerFile
from geomesh.formats.geopackage import FORMAT as GPKG
from geomesh.io.gdal_process import write_arrow
from geomesh.io.write import write_mesh

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from geomesh.parameters import LayerName

EXPECTED = 1.5
LAYER: LayerName = "triangles"


def run(*, quick: bool) -> Iterator[Row]:
    mesh = inputs.mesh(20_000, 512) if quick else inputs.mesh(200_000, 2048)
    rounds = 3 if quick else 5
    case = f"GPKG of {len(mesh.triangles):,} triangles"
    with TemporaryDirectory() as folder:
        one, other = Path(folder, "geomesh.gpkg"), Path(folder, "geopandas.gpkg")

        # A new mesh each time, because a mesh caches what it has computed.
        def whole() -> None:
            one.unlink(missing_ok=True)
            write_mesh(replace(mesh), one, layers=[LAYER])

        def whole_peer() -> None:
            other.unlink(missing_ok=True)
            replace(mesh).to_geodataframe().to_file(other, driver="GPKG", layer=LAYER)

        (ours, theirs), _ = alternate(rounds, whole, whole_peer)
        agree, evidence = _compare(one, other)
        peer = "to_geodataframe() + to_file (no certificate, count or sync)"
        yield Row(f"{case}, whole", peer, ours, theirs, None, agree, evidence)

        layer, frame = Layer.of(mesh, LAYER), mesh.to_geodataframe()

        def step() -> None:
            one.unlink(missing_ok=True)
            file = LayerFile(mesh, LAYER, one, GPKG, "{}")
            GPKG.write(layer, file, BatchStream(SimpleQueue()), _write_rows)

        def step_peer() -> None:
            other.unlink(missing_ok=True)
            frame.to_file(other, driver="GPKG", layer=LAYER)

        (ours, theirs), _ = alternate(rounds, step, step_peer)
        agree, evidence = _compare(one, other)
        expected = None if quick else EXPECTED
        yield Row(f"{case}, write alone", "to_file", ours, theirs, expected, agree, evidence)


def _write_rows(
    schema: pa.Schema, batches: Iterator[pa.RecordBatch], options: Mapping[str, Any]
) -> None:
    """Write in this process, as the peer does."""
    write_arrow(pa.RecordBatchReader.from_batches(schema, batches), options)


def _compare(one: Path, other: Path) -> tuple[bool, str]:
    (meta, _, shapes, fields), (peer_meta, _, peer_shapes, peer_fields) = (
        pyogrio.raw.read(path, layer=LAYER) for path in (one, other)
    )
    same = (
        list(meta["fields"]) == list(peer_meta["fields"])
        and np.array_equal(shapes, peer_shapes)
        and all(map(np.array_equal, fields, peer_fields))
        and _indexed_rows(one) == _indexed_rows(other) == len(shapes)
    )
    return same, f"{len(shapes):,} rows, {len(fields)} columns, geometry, index"


def _indexed_rows(path: Path) -> int:
    with closing(sqlite3.connect(path)) as database:
        (column,) = database.execute(
            "SELECT column_name FROM gpkg_geometry_columns WHERE table_name = ?", (LAYER,)
        ).fetchone()
        # The table of rows of the R-tree can be read without the R-tree module.
        query = f'SELECT count(*) FROM "rtree_{LAYER}_{column}_rowid"'
        return int(database.execute(query).fetchone()[0])
