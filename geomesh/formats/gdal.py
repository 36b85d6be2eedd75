"""Write layers with GDAL from Arrow batches, for all formats that GDAL writes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from geomesh._version import __version__
from geomesh.formats.format import COMPRESSED
from geomesh.raster.paths import plain_name

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from geomesh.formats.arrow import Layer
    from geomesh.formats.batch_stream import BatchStream
    from geomesh.formats.format import LayerFile, WriteRows


def gdal_name(path: Path) -> str:
    """Return the name with which GDAL writes a file; .gz compresses it on the way to the disk."""
    compressed = path.suffix.lower() == COMPRESSED
    return f"/vsigzip/{path}" if compressed else str(path)


def write_by_gdal(
    layer: Layer,
    file: LayerFile,
    stream: BatchStream,
    write_rows: WriteRows,
    *,
    with_crs: bool = True,
    dataset_options: Mapping[str, str] | None = None,
    layer_options: Mapping[str, str] | None = None,
) -> None:
    """Write a layer with the GDAL driver of its format.

    Parameters
    ----------
    layer, file, stream, write_rows
        As in `Format.write`.
    with_crs : bool
        Whether to write the CRS of the mesh.
    dataset_options, layer_options : mapping of str to str, optional
        GDAL's creation options.
    """
    from geomesh.formats.crs_text import portable_wkt
    from geomesh.formats.document import KEY

    crs, geometry = file.mesh.grid.crs, file.format.geometry
    description = (
        f"{file.name.capitalize()} of a mesh of {len(file.mesh.nodes)} nodes and "
        f"{len(file.mesh.triangles)} triangles, written by geomesh {__version__}"
    )
    options: dict[str, Any] = {
        "path": gdal_name(file.path),
        "layer": file.name,
        "driver": file.format.driver,
        "geometry_name": geometry,
        "geometry_type": layer.full_type,
        "crs": portable_wkt(crs) if crs is not None and with_crs else None,
        "layer_metadata": {KEY: file.document},
        "dataset_options": dict(dataset_options or {}),
        "layer_options": {**(layer_options or {}), "DESCRIPTION": description},
    }
    write_rows(layer.schema(geometry), stream.batches(layer, geometry), options)


def read_document_by_gdal(path: Path) -> str:
    """Return the metadata document of the first layer that has one; KeyError if none has."""
    import pyogrio

    from geomesh.formats.document import KEY

    name = plain_name(path)
    for layer in sorted(str(name) for name, _ in pyogrio.list_layers(name)):
        metadata = pyogrio.read_info(name, layer=layer)["layer_metadata"] or {}
        if KEY in metadata:
            return str(metadata[KEY])
    raise KeyError(KEY)


def count_by_gdal(path: Path, layer: str) -> int:
    """Return the number of rows that GDAL reads from a layer."""
    import pyogrio

    name = plain_name(path)
    columns = list(pyogrio.read_info(name, layer=layer)["fields"][:1])
    # A table without columns has no rows: read the geometry if there are no attributes.
    _, table = pyogrio.read_arrow(name, layer=layer, columns=columns, read_geometry=not columns)
    return int(table.num_rows)
