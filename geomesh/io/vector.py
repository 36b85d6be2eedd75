"""Writing a mesh as GeoPackage, GeoJSON, FlatGeobuf, GeoParquet or UGRID.

GDAL (through pyogrio) writes the first three from Arrow batches, pyarrow the
fourth, scipy the last. Every file carries the metadata document of `geomesh.io.document`.
"""

from __future__ import annotations

import json
import sqlite3
import warnings
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from os import PathLike
from pathlib import Path

import pyarrow as pa
import pyogrio
from pyogrio.errors import DataLayerError, DataSourceError

from geomesh._version import __version__
from geomesh.errors import OutputError
from geomesh.io.atomic import check_place, staged
from geomesh.io.batches import Feed, Layer
from geomesh.io.document import KEY, describe
from geomesh.io.formats import GEOJSON, GPKG, PARQUET, UGRID, Format, find_format
from geomesh.io.geojson import LonLatLayer
from geomesh.io.geoparquet import write_geoparquet
from geomesh.io.meshfile import write_ugrid
from geomesh.io.verify import count_rows
from geomesh.mesh import LAYERS, LayerName, Mesh
from geomesh.tiles import Progress

_WRITE_FAILURES = (OSError, DataSourceError, DataLayerError, pa.ArrowException, sqlite3.Error)


def check_output(
    path: str | PathLike[str], *, overwrite: bool = False, driver: str | None = None
) -> None:
    """Refuse an output that could not be written; meant to be called before any work.

    Parameters
    ----------
    path : path-like
    overwrite : bool
        Whether an existing file may be replaced.
    driver : {"GPKG", "GeoJSON", "FlatGeobuf", "Parquet", "UGRID"}, optional
        By the extension of `path` if not given.

    Raises
    ------
    OutputError
        If the format is unknown, the file exists, or its folder is missing or
        cannot be written to.
    """
    find_format(path, driver)
    check_place(Path(path), overwrite=overwrite)


def write_mesh(
    mesh: Mesh,
    path: str | PathLike[str],
    *,
    layers: Iterable[LayerName] | None = None,
    driver: str | None = None,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Path:
    """Write a mesh that passes its certificate; the file is there whole or not at all.

    Parameters
    ----------
    mesh : Mesh
    path : path-like
    layers : iterable of {"triangles", "edges", "nodes"}, optional
        All three by default in a GeoPackage, else the triangles: the other formats
        hold one layer.
    driver : {"GPKG", "GeoJSON", "FlatGeobuf", "Parquet", "UGRID"}, optional
        By the extension of `path` if not given.
    overwrite : bool
        Replace an existing file, at the very end.
    progress : callable(fraction, message), optional
        Called before each batch of rows; an exception in it stops the writing.

    Returns
    -------
    Path
        `path`.

    Raises
    ------
    OutputError
        If the output cannot be written; what was there before is untouched.
    CertificateError
        If the mesh fails one of its checks.
    GeoreferenceError
        If GeoJSON is asked for and the nodes have no longitude and latitude.
    """
    target = Path(path)
    check_output(target, overwrite=overwrite, driver=driver)
    file_format = find_format(target, driver)
    names = _choose_layers(layers, file_format)
    certificate = mesh.certify()
    certificate.require()
    document = describe(mesh, certificate)
    kind = LonLatLayer if file_format is GEOJSON else Layer
    chosen = [kind.of(mesh, name) for name in names]
    for layer in chosen:
        _check_columns(layer, file_format)
    feed = Feed(sum(len(layer) for layer in chosen), progress)
    with (
        _failures_told(target, feed),
        staged(target, file_format.extensions[0], overwrite=overwrite) as temporary,
    ):
        for layer in chosen:
            if file_format is PARQUET:
                write_geoparquet(layer, temporary, feed, crs=mesh.grid.crs, document=document)
            elif file_format is UGRID:
                write_ugrid(layer, temporary, feed, crs=mesh.grid.crs, document=document)
            else:
                _write_gdal(mesh, layer, temporary, feed, document, file_format)
        _verify(temporary, chosen, file_format)
        feed.tell("Written")
    return target


def _choose_layers(layers: Iterable[LayerName] | None, file_format: Format) -> list[LayerName]:
    if layers is None:
        return list(LAYERS if file_format.many_layers else LAYERS[:1])
    asked = [layers] if isinstance(layers, str) else list(layers)
    for name in asked:
        if name not in LAYERS:
            raise OutputError(f"there is no layer {name!r}; choose from {', '.join(LAYERS)}")
        if name not in file_format.layers:
            raise OutputError(
                f"{file_format.driver} holds {', '.join(file_format.layers)}, not {name}; "
                "write .gpkg for all layers"
            )
    if not asked:
        raise OutputError(f"no layer to write; choose from {', '.join(LAYERS)}")
    chosen = [name for name in LAYERS if name in asked]
    if len(chosen) > 1 and not file_format.many_layers:
        raise OutputError(
            f"{file_format.driver} holds one layer, not {', '.join(chosen)}; "
            "choose one of them, or write .gpkg"
        )
    return chosen


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


@contextmanager
def _failures_told(target: Path, feed: Feed) -> Iterator[None]:
    """Tell what a library says of a failed write in one line, and pass on all else."""
    try:
        yield
    except Exception as error:
        if feed.failure is not None:
            raise feed.failure from None
        if not isinstance(error, _WRITE_FAILURES):
            raise
        reason = " ".join(str(error).split())
        raise OutputError(
            f"{target} could not be written: {reason}; free some space or choose another folder"
        ) from error


def _write_gdal(
    mesh: Mesh, layer: Layer, path: Path, feed: Feed, document: str, file_format: Format
) -> None:
    crs = None if file_format is GEOJSON else mesh.grid.crs
    geometry = file_format.geometry
    reader = pa.RecordBatchReader.from_batches(
        layer.schema(geometry), feed.batches(layer, geometry)
    )
    with warnings.catch_warnings():
        # No CRS is meant: GeoJSON's is understood, and a mesh without one stays so.
        warnings.filterwarnings("ignore", "'crs' was not provided", UserWarning)
        pyogrio.write_arrow(
            reader,
            path,
            layer=layer.name,
            driver=file_format.driver,
            geometry_name=geometry,
            geometry_type=layer.geometry_type,
            crs=crs.to_wkt() if crs else None,
            layer_metadata={KEY: document},
            dataset_options=dict(file_format.dataset_options),
            layer_options=_layer_options(mesh, layer, document, file_format),
        )


def _layer_options(mesh: Mesh, layer: Layer, document: str, file_format: Format) -> dict[str, str]:
    description = (
        f"{layer.name.capitalize()} of a mesh of {len(mesh.nodes)} nodes and "
        f"{len(mesh.triangles)} triangles, written by geomesh {__version__}"
    )
    options = {**file_format.layer_options, "DESCRIPTION": description}
    if file_format is GEOJSON:
        collection = {"type": "FeatureCollection", KEY: json.loads(document)}
        options |= {
            # Coordinates come rounded: COORDINATE_PRECISION would turn 44.9999997 into 45.
            "SIGNIFICANT_FIGURES": "17",
            # Members of the collection beside its features (RFC 7946, section 6.1).
            "NATIVE_DATA": json.dumps(collection),
            "NATIVE_MEDIA_TYPE": "application/vnd.geo+json",
        }
    return options


def _verify(path: Path, layers: list[Layer], file_format: Format) -> None:
    for layer in layers:
        found = count_rows(path, layer.name, file_format.driver)
        if found != len(layer):
            raise OSError(f"only {found} of {len(layer)} {layer.name} arrived in the file")
