"""GeoPackage 1.2, written by GDAL: several layers in one file.

An SQLite file can have only one writer at a time. So layers that are written in parallel get
separate files, which are joined at the end. GDAL is fastest if it fills a layer in a file of
its own, and SQLite copies the finished tables page by page in a tenth of that time.
"""

from __future__ import annotations

import sqlite3
from contextlib import closing
from types import MappingProxyType
from typing import TYPE_CHECKING

from geomesh.formats.format import PENDING, Format, Joining, LayerFile, WriteRows
from geomesh.formats.gdal import read_document_by_gdal, write_by_gdal

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from pathlib import Path

    from geomesh.formats.arrow import Layer
    from geomesh.formats.batch_stream import BatchStream
    from geomesh.parameters import LayerName

# Creation options of GDAL.
DATASET_OPTIONS: Mapping[str, str] = MappingProxyType({"VERSION": "1.2"})
LAYER_OPTIONS: Mapping[str, str] = MappingProxyType({"SPATIAL_INDEX": "YES"})

# A table of SQLite has at most 2000 columns: of these, GDAL adds `fid` and the geometry.
_MOST_COLUMNS = 1998

_INDEX = "rtree_{}_geom"
# Suffixes of the tables in which SQLite stores an R-tree.
_INDEX_TABLES = ("node", "rowid", "parent")
# Tables in which a GeoPackage lists its layers, and the column with the name of the layer.
_REGISTERS = {
    "gpkg_contents": "table_name",
    "gpkg_geometry_columns": "table_name",
    "gpkg_extensions": "table_name",
    "gpkg_ogr_contents": "table_name",
}

# Of these, the tables from which other programs take the order of the layers.
_ORDER = ("gpkg_contents", "gpkg_geometry_columns")


def _can_join() -> bool:
    """Return whether the SQLite of Python supports R-trees, which joining files needs."""
    with closing(sqlite3.connect(":memory:")) as database:
        try:
            database.execute("CREATE VIRTUAL TABLE tried USING rtree(id, low, high)")
        except sqlite3.OperationalError:
            return False
    return True


def _finish(
    path: Path, layers: Sequence[LayerName], separate: Mapping[LayerName, Path], document: str
) -> None:
    """Copy the layers of separate files into the GeoPackage at `path`, and complete it.

    Parameters
    ----------
    path : Path
        A GeoPackage written by GDAL, with layers in the same CRS.
    layers : sequence of str
        Names of all layers, in the order in which programs should list them.
    separate : mapping of str to Path
        The layers that are in separate files, and these files; they are removed.
    document : str
        Replaces `PENDING` in the metadata of the layers.

    Raises
    ------
    sqlite3.Error
        If the disk is full.
    """
    from xml.sax.saxutils import escape  # imports urllib: --help should not wait for it

    # No other program uses this temporary file, so it needs no journal; it is flushed later.
    with closing(sqlite3.connect(path, isolation_level=None)) as database:
        database.execute("PRAGMA journal_mode = OFF")
        database.execute("PRAGMA synchronous = OFF")
        for layer, file in separate.items():
            database.execute("ATTACH ? AS other", (str(file),))
            database.execute("BEGIN")
            _copy_layer(database, layer)
            database.execute("COMMIT")
            database.execute("DETACH other")
            file.unlink()
        for register in _ORDER:
            for layer in layers:
                last = f"(SELECT max(rowid) FROM {register})"
                database.execute(
                    f"UPDATE {register} SET rowid = {last} + 1 WHERE table_name = ?", (layer,)
                )
        database.execute(
            "UPDATE gpkg_metadata SET metadata = replace(metadata, ?, ?)",
            (PENDING, escape(document)),  # the document is inside an XML element
        )


def _copy_layer(database: sqlite3.Connection, layer: str) -> None:
    def sql_of(condition: str, *values: str) -> list[str]:
        query = f"SELECT sql FROM other.sqlite_master WHERE {condition}"
        return [sql for (sql,) in database.execute(query, values)]

    index = _INDEX.format(layer)
    for sql in sql_of("name IN (?, ?)", layer, index):
        database.execute(sql)
    tables = [layer, *(f"{index}_{part}" for part in _INDEX_TABLES)]
    for table in tables:
        database.execute(f'DELETE FROM main."{table}"')  # a new index already has an empty node
        copied = database.execute(f'INSERT INTO main."{table}" SELECT * FROM other."{table}"')
        (rows,) = database.execute(f'SELECT count(*) FROM other."{table}"').fetchone()
        if copied.rowcount != rows:
            raise sqlite3.DatabaseError(f"{copied.rowcount} of {rows} rows of {table} copied")
    # Fill the registers before the triggers are created: some triggers count rows.
    for register, column in _REGISTERS.items():
        database.execute(
            f"INSERT INTO main.{register} SELECT * FROM other.{register} WHERE {column} = ?",
            (layer,),
        )
    for sql in sql_of("type = 'trigger' AND tbl_name = ?", layer):
        database.execute(sql)
    _copy_metadata(database, layer)


def _copy_metadata(database: sqlite3.Connection, layer: str) -> None:
    columns = "md_scope, md_standard_uri, mime_type, metadata"
    made = database.execute(
        f"INSERT INTO main.gpkg_metadata ({columns}) SELECT {columns} FROM other.gpkg_metadata"
    )
    database.execute(
        "INSERT INTO main.gpkg_metadata_reference SELECT reference_scope, table_name, "
        "column_name, row_id_value, timestamp, ?, md_parent_id "
        "FROM other.gpkg_metadata_reference WHERE table_name = ?",
        (made.lastrowid, layer),
    )


def _write(layer: Layer, file: LayerFile, stream: BatchStream, write_rows: WriteRows) -> None:
    write_by_gdal(
        layer,
        file,
        stream,
        write_rows,
        dataset_options=DATASET_OPTIONS,
        layer_options=LAYER_OPTIONS,
    )


def _count_rows(path: Path, layer: str) -> int:
    # Not opened as a URI: URIs do not support network shares.
    with closing(sqlite3.connect(path)) as database:
        try:
            (state,) = database.execute(f'PRAGMA quick_check("{layer}")').fetchone()
            (rows,) = database.execute(f'SELECT count(*) FROM "{layer}"').fetchone()
        except sqlite3.Error as error:
            raise OSError(f"the database is damaged: {error}") from error
    if state != "ok":
        raise OSError(f"the database is damaged: {state}")
    return int(rows)


FORMAT = Format(
    "GPKG",
    (".gpkg",),
    _write,
    _count_rows,
    read_document_by_gdal,
    geometry="geom",
    reserved=("fid",),
    ignores_case=True,  # as SQLite does for column names
    joining=Joining(_can_join, _finish),
    by_gdal=True,
    most_columns=_MOST_COLUMNS,
)
