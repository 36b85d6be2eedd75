"""One layer of a mesh into one file, in any of the formats.

GDAL (through pyogrio) writes GeoPackage, GeoJSON and FlatGeobuf from Arrow batches, pyarrow
GeoParquet, scipy UGRID. Every file carries the metadata document of `geomesh.formats.document`.
"""

from __future__ import annotations

import json
import threading
from contextlib import suppress

import pyarrow as pa

from geomesh._version import __version__
from geomesh.errors import OutputError
from geomesh.formats.arrow import Layer
from geomesh.formats.document import KEY
from geomesh.formats.feed import Feed
from geomesh.formats.format import GEOJSON, GPKG, PARQUET, UGRID, Format, LayerFile
from geomesh.formats.geojson import LonLatLayer
from geomesh.formats.geoparquet import write_geoparquet
from geomesh.formats.ugrid import write_ugrid
from geomesh.io.gdal_process import Scribes, write_arrow
from geomesh.io.verify import count_rows

_thread = threading.local()

# pyogrio keeps the interpreter's lock anyway, and filters of warnings belong to the process.
_in_process = threading.Lock()


def write_layer(file: LayerFile, feed: Feed, scribes: Scribes | None) -> None:
    """Write one layer of a mesh to a file, and look whether it arrived there.

    Parameters
    ----------
    file : LayerFile
    feed : Feed
        Hands out the rows.
    scribes : Scribes, optional
        Who writes what GDAL writes; this process by default.

    Raises
    ------
    OSError
        If rows are missing.
    OutputError
        If the format cannot hold one of the columns.
    GeoreferenceError
        If GeoJSON is asked for and the nodes have no longitude and latitude.
    """
    layer = (LonLatLayer if file.format is GEOJSON else Layer).of(file.mesh, file.name)
    _check_columns(layer, file.format)
    if file.format is PARQUET:
        write_geoparquet(layer, file, feed)
    elif file.format is UGRID:
        write_ugrid(layer, file, feed)
    else:
        _write_gdal(layer, file, feed, scribes)
    found = count_rows(file.path, file.name, file.format.driver)
    if found != len(layer):
        raise OSError(f"only {found} of {len(layer)} {file.name} arrived in the file")


def _check_columns(layer: Layer, file_format: Format) -> None:
    """Refuse names that the format takes for itself or cannot tell apart."""
    taken = {file_format.geometry, *file_format.reserved}
    for name in layer.columns:
        # SQLite's column names know no case.
        key = name.lower() if file_format is GPKG else name
        if key in taken:
            raise OutputError(
                f"{file_format.driver} cannot hold a column {name!r} in {layer.name}: "
                "rename the band or the attribute"
            )
        taken.add(key)


def _write_gdal(layer: Layer, file: LayerFile, feed: Feed, scribes: Scribes | None) -> None:
    crs = None if file.format is GEOJSON else file.mesh.grid.crs
    geometry = file.format.geometry
    schema, batches = layer.schema(geometry), feed.batches(layer, geometry)
    options = {
        "path": str(file.path),
        "layer": file.name,
        "driver": file.format.driver,
        "geometry_name": geometry,
        "geometry_type": layer.geometry_type,
        "crs": crs.to_wkt() if crs else None,
        "layer_metadata": {KEY: file.document},
        "dataset_options": dict(file.format.dataset_options),
        "layer_options": _layer_options(file),
    }
    if scribes is not None:
        scribes.write(schema, batches, options)
    else:
        with _in_process:
            _quiet_gdal()
            write_arrow(pa.RecordBatchReader.from_batches(schema, batches), options)


def _layer_options(file: LayerFile) -> dict[str, str]:
    description = (
        f"{file.name.capitalize()} of a mesh of {len(file.mesh.nodes)} nodes and "
        f"{len(file.mesh.triangles)} triangles, written by geomesh {__version__}"
    )
    options = {**file.format.layer_options, "DESCRIPTION": description}
    if file.format is GEOJSON:
        collection = {"type": "FeatureCollection", KEY: json.loads(file.document)}
        options |= {
            # Coordinates come rounded: COORDINATE_PRECISION would turn 44.9999997 into 45.
            "SIGNIFICANT_FIGURES": "17",
            # Members of the collection beside its features (RFC 7946, section 6.1).
            "NATIVE_DATA": json.dumps(collection),
            "NATIVE_MEDIA_TYPE": "application/vnd.geo+json",
        }
    return options


def _quiet_gdal() -> None:
    """Keep GDAL from printing errors: pyogrio raises them, but hushes the main thread alone.

    It has no public way to do so in another; without this one the lines appear as well.
    """
    if not getattr(_thread, "is_quiet", False):
        with suppress(ImportError):
            from pyogrio._err import _register_error_handler

            _register_error_handler()
        _thread.is_quiet = True
