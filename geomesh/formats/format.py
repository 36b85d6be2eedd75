"""The file formats of a mesh, and how their names are found."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path

from geomesh.errors import OutputError
from geomesh.mesh.triangle_mesh import LAYERS, LayerName, Mesh

GEOMETRY = "geometry"
BBOX = "bbox"


@dataclass(frozen=True)
class Format:
    """A file format.

    Parameters
    ----------
    driver : str
        Its name: GDAL's, where GDAL knows it.
    extensions : tuple of str
        The first is the usual one.
    geometry : str
        Name of the geometry column.
    reserved : tuple of str
        Names of further columns that it makes by itself.
    layers : tuple of {"triangles", "edges", "nodes"}
        What it can hold.
    many_layers : bool
        Whether one file holds several layers.
    by_gdal : bool
        Whether GDAL writes it.
    dataset_options, layer_options : mapping of str to str
        GDAL's creation options.
    """

    driver: str
    extensions: tuple[str, ...]
    geometry: str = GEOMETRY
    reserved: tuple[str, ...] = ()
    layers: tuple[LayerName, ...] = LAYERS
    many_layers: bool = False
    by_gdal: bool = True
    dataset_options: Mapping[str, str] = field(default_factory=dict)
    layer_options: Mapping[str, str] = field(default_factory=dict)


GPKG = Format(
    "GPKG",
    (".gpkg",),
    geometry="geom",
    reserved=("fid",),
    many_layers=True,
    dataset_options={"VERSION": "1.2"},
    layer_options={"SPATIAL_INDEX": "YES"},
)
GEOJSON = Format("GeoJSON", (".geojson", ".json"))
FLATGEOBUF = Format("FlatGeobuf", (".fgb",), layer_options={"SPATIAL_INDEX": "YES"})
PARQUET = Format("Parquet", (".parquet", ".geoparquet"), reserved=(BBOX,), by_gdal=False)
UGRID = Format("UGRID", (".nc",), layers=("triangles",), by_gdal=False)
FORMATS = (GPKG, GEOJSON, FLATGEOBUF, PARQUET, UGRID)


@dataclass(frozen=True, eq=False)
class LayerFile:
    """A layer of a mesh and the file that is to hold it.

    Parameters
    ----------
    mesh : Mesh
    name : {"triangles", "edges", "nodes"}
    path : Path
    format : Format
    document : str
        The metadata document of `geomesh.formats.document`.
    """

    mesh: Mesh
    name: LayerName
    path: Path
    format: Format
    document: str


def find_format(path: str | PathLike[str], driver: str | None = None) -> Format:
    """Return the format that `driver` names, or else the extension of `path`.

    Raises
    ------
    OutputError
        If there is no such format.
    """
    if driver is not None:
        for known in FORMATS:
            if known.driver.lower() == driver.lower():
                return known
        names = ", ".join(known.driver for known in FORMATS)
        raise OutputError(f"there is no vector format {driver!r}; choose from {names}")
    suffix = Path(path).suffix.lower()
    for known in FORMATS:
        if suffix in known.extensions:
            return known
    extensions = ", ".join(known.extensions[0] for known in FORMATS)
    raise OutputError(
        f"{path} has no extension that names a format; choose from {extensions}, "
        "or name one with --driver"
    )
