"""Write the meshes of all zooms of a map into one PMTiles file, with tiles that GDAL makes."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from geomesh.formats.batch_stream import BatchStream
from geomesh.formats.mercator import BUFFER, EXTENT, tile_ids
from geomesh.formats.pmtiles import ArchiveWriter

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path
    from queue import SimpleQueue

    from geomesh.formats.pmtiles import Place
    from geomesh.formats.tile_layer import TileLayer
    from geomesh.io.gdal_process import WriterPool

LAYER = "triangles"
_GEOMETRY = "geometry"

# GDAL leaves features out of a tile with more than so many of them or so many bytes.
_NO_LIMIT = 2**31 - 1


@dataclass(frozen=True, eq=False)
class LevelFile:
    """The triangles of one zoom, and the file in which GDAL writes their tiles.

    Parameters
    ----------
    zoom : int
    layer : TileLayer
    path : Path
        Ends in .mbtiles.
    """

    zoom: int
    layer: TileLayer
    path: Path


def write_level(level: LevelFile, events: SimpleQueue[None], pool: WriterPool) -> None:
    """Write the tiles of one zoom.

    GDAL leaves out no triangle and simplifies none. It rounds corners to steps of the zoom, the
    same for all triangles and tiles. So no gap opens between triangles.

    Raises
    ------
    OSError
        With the message of GDAL, if writing failed.
    """
    stream = BatchStream(events)
    options: dict[str, Any] = {
        "path": str(level.path),
        "layer": LAYER,
        "driver": "MBTiles",
        "geometry_name": _GEOMETRY,
        "geometry_type": "Unknown",
        "crs": "EPSG:4326",
        "dataset_options": {
            "MINZOOM": str(level.zoom),
            "MAXZOOM": str(level.zoom),
            "EXTENT": str(EXTENT),
            "BUFFER": str(BUFFER),
            "SIMPLIFICATION": "0",
            "SIMPLIFICATION_MAX_ZOOM": "0",
            "MAX_SIZE": str(_NO_LIMIT),
            "MAX_FEATURES": str(_NO_LIMIT),
        },
        "layer_options": {},
    }
    pool.write(level.layer.schema(_GEOMETRY), stream.batches(level.layer, _GEOMETRY), options)


def join_levels(
    levels: Sequence[LevelFile], path: Path, place: Place, metadata: Mapping[str, Any]
) -> None:
    """Copy the tiles of all zooms, the farthest first, into one PMTiles file."""
    with path.open("wb") as file:
        archive = ArchiveWriter(file)
        for level in levels:
            with closing(sqlite3.connect(level.path)) as tiles:
                _copy(tiles, level.zoom, archive)
        archive.finish(place, metadata)


def _copy(tiles: sqlite3.Connection, zoom: int, archive: ArchiveWriter) -> None:
    rows = tiles.execute("SELECT tile_column, tile_row FROM tiles WHERE zoom_level = ?", (zoom,))
    places = np.array(rows.fetchall(), np.int64).reshape(-1, 2)
    ids = tile_ids(zoom, places[:, 0], (1 << zoom) - 1 - places[:, 1])
    for k in np.argsort(ids).tolist():
        found = tiles.execute(
            "SELECT tile_data FROM tiles WHERE zoom_level = ? AND tile_column = ? AND tile_row = ?",
            (zoom, *places[k].tolist()),
        )
        archive.add(int(ids[k]), found.fetchone()[0])


def describe_fields(layer: TileLayer) -> dict[str, str]:
    """Return the attributes and their types, as TileJSON names them."""
    names = {"b": "Boolean", "U": "String", "O": "String"}
    return {name: names.get(col.dtype.kind, "Number") for name, col in layer.columns.items()}
