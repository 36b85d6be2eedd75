"""Write contours to a file, atomically, in the formats of lines."""

from __future__ import annotations

import json
from concurrent.futures import CancelledError, ThreadPoolExecutor
from pathlib import Path
from threading import Event
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely

from geomesh._version import __version__
from geomesh.errors import OutputError
from geomesh.formats.crs_text import portable_wkt
from geomesh.formats.document import KEY
from geomesh.formats.gdal import gdal_name
from geomesh.formats.geopackage import DATASET_OPTIONS, LAYER_OPTIONS
from geomesh.formats.registry import extension_of, find_format
from geomesh.io.atomic import check_place, staged, writing_to
from geomesh.io.layer import write_here
from geomesh.parallel.progress import silent

if TYPE_CHECKING:
    from collections.abc import Iterator
    from os import PathLike

    import geopandas as gpd
    import pyarrow as pa

    from geomesh.formats.format import Format
    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.parallel.progress import Progress
    from geomesh.terrain.levels import Levels

_LAYER = "contours"
_TYPE = "LineString Z"
_EXTENSIONS = (".gpkg", ".geojson", ".fgb", ".parquet", ".geojson.gz")

# Lines that are encoded at once.
_BATCH = 10_000


def check_contours(path: str | PathLike[str], *, overwrite: bool = False) -> None:
    """Raise OutputError if contours cannot be written; call this before any work is done."""
    _find_format(path)
    check_place(Path(path), overwrite=overwrite)


def write_contours(
    mesh: TriangleMesh,
    lines: gpd.GeoDataFrame,
    path: str | PathLike[str],
    levels: Levels,
    *,
    overwrite: bool = False,
    progress: Progress = silent,
) -> Path:
    """Write contours; the file is complete or does not exist.

    Parameters
    ----------
    mesh : TriangleMesh
    lines : GeoDataFrame
        Its contours: see `geomesh.terrain.contour_frame.contour_frame`. There may be none.
    path : path-like
        Its extension names the format.
    levels : Levels
        Those of the contours, for the metadata of the file.
    overwrite : bool
        Replace an existing file, as the last step.
    progress : callable(fraction, message), optional

    Raises
    ------
    OutputError
        If the file cannot be written; then an existing one does not change.
    GeoreferenceError
        If the format is GeoJSON and the mesh has no longitude and latitude.
    """
    target, file_format = Path(path), _find_format(path)
    check_place(target, overwrite=overwrite)
    if file_format.driver == "GeoJSON":
        from geomesh.formats.lonlat_lines import to_lonlat_lines

        progress(0.0, "Turning to longitude and latitude")
        geometry = to_lonlat_lines(mesh, lines.geometry.to_numpy())
        lines = lines.drop(columns="geometry").set_geometry(geometry)
    progress(0.5, f"Writing {len(lines):,} contours")
    stopped = Event()
    with (
        staged(target, file_format.extension_for(target), overwrite=overwrite) as temporary,
        # In another thread: a C library would turn Ctrl-C in its reading into another error.
        ThreadPoolExecutor(1, "geomesh-contours") as thread,
        writing_to(target, "pyogrio", "pyarrow", way_out="choose another format"),
    ):
        rows = _Rows(lines, file_format.geometry, stopped)
        written = thread.submit(_write, rows, mesh, levels, temporary, file_format)
        try:
            written.result()
        finally:
            stopped.set()
    progress(1.0, "Written")
    return target


def _find_format(path: str | PathLike[str]) -> Format:
    if extension_of(path) not in _EXTENSIONS:
        raise OutputError(
            f"{path} has no extension of a format for contours; choose from "
            f"{', '.join(_EXTENSIONS)}"
        )
    return find_format(path)


class _Rows:
    """The lines as record batches, which another thread can stop."""

    def __init__(self, lines: gpd.GeoDataFrame, geometry: str, stopped: Event) -> None:
        self.lines = lines
        self.geometry = geometry
        self._stopped = stopped

    @property
    def schema(self) -> pa.Schema:
        return self._batch(slice(0, 0)).schema

    def batches(self) -> Iterator[pa.RecordBatch]:
        for start in range(0, len(self.lines), _BATCH):
            if self._stopped.is_set():
                raise CancelledError
            yield self._batch(slice(start, start + _BATCH))

    def _batch(self, rows: slice) -> pa.RecordBatch:
        import pyarrow as pa

        some = self.lines.iloc[rows]
        wkb = shapely.to_wkb(some.geometry.to_numpy(), byte_order=1, flavor="iso")
        return pa.RecordBatch.from_pydict(
            {
                "id": pa.array(some.index.to_numpy(np.int32)),
                "level": pa.array(some["level"].to_numpy()),
                "index": pa.array(some["index"].to_numpy()),
                "closed": pa.array(some["closed"].to_numpy()),
                "length": pa.array(some["length"].to_numpy()),
                self.geometry: pa.array(wkb, pa.binary()),
            }
        )


def _write(
    rows: _Rows, mesh: TriangleMesh, levels: Levels, path: Path, file_format: Format
) -> None:
    """Write the rows, and check that the file has all of them."""
    about = {
        "interval": levels.interval,
        "base": levels.base,
        "levels": levels.values.tolist(),
        "unit": None if mesh.height is None else mesh.height.unit,
        "source": None if mesh.provenance is None else mesh.provenance.source.name,
    }
    document = json.dumps({KEY: __version__, _LAYER: about}, sort_keys=True)
    if file_format.driver == "Parquet":
        _write_parquet(rows, mesh, path, document)
    else:
        _write_by_gdal(rows, mesh, path, file_format, document)
    found = file_format.count_rows(path, _LAYER)
    if found != len(rows.lines):
        raise OSError(f"the file has only {found} of {len(rows.lines)} lines")


def _write_by_gdal(
    rows: _Rows, mesh: TriangleMesh, path: Path, file_format: Format, document: str
) -> None:
    crs, driver = mesh.grid.crs, file_format.driver
    unit = "" if mesh.height is None else f", heights in {mesh.height.unit}"
    options: dict[str, Any] = {
        "DESCRIPTION": f"Contours of a mesh{unit}, written by geomesh {__version__}"
    }
    if driver == "GeoJSON":
        collection = {"type": "FeatureCollection", KEY: json.loads(document)}
        # As in `geomesh.formats.geojson`: RFC 7946 allows only one CRS.
        crs = None
        options |= {
            "SIGNIFICANT_FIGURES": "17",
            "NATIVE_DATA": json.dumps(collection),
            "NATIVE_MEDIA_TYPE": "application/vnd.geo+json",
        }
    else:
        options |= LAYER_OPTIONS  # a spatial index, in FlatGeobuf too
    write_here(
        rows.schema,
        rows.batches(),
        {
            "path": gdal_name(path),
            "layer": _LAYER,
            "driver": driver,
            "geometry_name": file_format.geometry,
            "geometry_type": _TYPE,
            "crs": None if crs is None else portable_wkt(crs),
            "layer_metadata": {KEY: document},
            "dataset_options": dict(DATASET_OPTIONS) if driver == "GPKG" else {},
            "layer_options": options,
        },
    )


def _write_parquet(rows: _Rows, mesh: TriangleMesh, path: Path, document: str) -> None:
    """Write GeoParquet 1.1, as `geomesh.formats.geoparquet` does."""
    import pyarrow.parquet as pq

    crs = mesh.grid.crs
    column: dict[str, Any] = {
        "encoding": "WKB",
        "geometry_types": [_TYPE] if len(rows.lines) else [],
        "crs": crs.to_json_dict() if crs else None,
    }
    if len(rows.lines):
        column["bbox"] = rows.lines.total_bounds.tolist()
    geo = {"version": "1.1.0", "primary_column": rows.geometry, "columns": {rows.geometry: column}}
    schema = rows.schema.with_metadata({"geo": json.dumps(geo), KEY: document})
    with pq.ParquetWriter(path, schema, compression="zstd") as writer:
        for batch in rows.batches():
            writer.write_batch(batch)
