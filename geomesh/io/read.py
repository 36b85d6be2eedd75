"""Read a mesh from a GeoPackage that geomesh wrote, without any loss."""

from __future__ import annotations

import json
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pyogrio
from affine import Affine
from pyogrio.errors import DataLayerError, DataSourceError
from pyproj import CRS

from geomesh.arrays.table import Table
from geomesh.errors import GeomeshError, GeomeshWarning, MeshFileError, one_line
from geomesh.formats.document import FORMAT, KEY
from geomesh.io.columns import added_by_others, can_keep, to_array, to_points
from geomesh.mesh.certificate import DomainFacts
from geomesh.mesh.height import Height
from geomesh.mesh.provenance import Provenance
from geomesh.mesh.topology import build_edges
from geomesh.mesh.triangle_mesh import TriangleMesh
from geomesh.parameters import LAYERS, LayerName
from geomesh.raster.grid import Grid
from geomesh.raster.paths import plain_name

if TYPE_CHECKING:
    from os import PathLike

    import pyarrow as pa
    from numpy.typing import NDArray

    from geomesh.arrays.types import Points

_CORNERS = ("n0", "n1", "n2")

# A node this far from its place, in pixels, was moved.
_MOVED = 1e-6


def read_mesh(path: str | PathLike[str]) -> TriangleMesh:
    """Return the mesh in a GeoPackage that `geomesh.io.write.write_mesh` wrote.

    Node coordinates are read from the columns `col` and `row`, not from the geometry, so they
    are the same to the last bit. The geometry of the nodes must agree with them. Constraints are
    in the order of the edges, with the lower node id first. Columns that another program added
    to the nodes or triangles come into their tables: numbers, text, truth values and dates.

    Parameters
    ----------
    path : path-like

    Returns
    -------
    TriangleMesh

    Raises
    ------
    MeshFileError
        If the file does not exist, is not a GeoPackage of geomesh, has no nodes or no
        triangles, or if rows or columns were removed or nodes moved after it was written.
    """
    source = Path(path)
    layers = _find_layers(source)
    missing = [name for name in ("nodes", "triangles") if name not in layers]
    if missing:
        raise MeshFileError(
            f"{path} has no layer {' or '.join(missing)}; write the mesh with all its layers"
        )
    document = read_document(source)
    stored = document["mesh"]
    nodes = _read_columns(source, "nodes", {"col": "<f8", "row": "<f8"}, stored)
    triangles = _read_columns(source, "triangles", dict.fromkeys(_CORNERS, "<i4"), stored)
    if "edges" in layers:
        _, dropped = _added(source, "edges", stored)
        _warn_of_dropped(path, "edges", dropped, "a mesh has no table of edges")
    corners = np.column_stack([triangles.pop(name) for name in _CORNERS])
    if corners.min(initial=0) < 0 or corners.max(initial=0) >= stored["counts"]["nodes"]:
        raise MeshFileError(
            f"{path} has triangles with nodes that do not exist; use the file that geomesh wrote"
        )
    about = stored["grid"]
    grid = Grid(
        about["width"],
        about["height"],
        Affine(*about["transform"]),
        CRS.from_wkt(about["crs"]) if about["crs"] else None,
    )
    pixels = np.column_stack([nodes.pop("col"), nodes.pop("row")])
    height = Height(**stored["height"]) if stored.get("height") else None
    made = TriangleMesh(
        nodes=pixels,
        triangles=corners,
        grid=grid,
        domain=DomainFacts(**stored["domain"]),
        constraints=_read_constraints(source, layers, corners, stored),
        plane_size=tuple(stored["plane_size"]),
        node_table=Table(nodes),
        triangle_table=Table(triangles),
        provenance=_read_provenance(path, document),
        height=height,
    )
    _require_place(source, made)
    return made


def _read_provenance(path: str | PathLike[str], document: dict[str, Any]) -> Provenance | None:
    """Return how the mesh was made; None if it was made without a raster."""
    if "source" not in document:
        return None
    try:
        return Provenance.from_dict(document)
    except (KeyError, TypeError, ValueError, GeomeshError) as error:
        raise MeshFileError(
            f"{path} has no complete description of how its mesh was made ({one_line(error)}); "
            "use the file that geomesh wrote"
        ) from error


def _find_layers(path: Path) -> set[str]:
    if not path.exists():
        raise MeshFileError(f"{path} does not exist; check the path")
    try:
        layers = {str(name) for name, _ in pyogrio.list_layers(plain_name(path))}
        first = min(layers.intersection(LAYERS) or layers, default=None)
        driver = pyogrio.read_info(plain_name(path), layer=first)["driver"] if layers else ""
    except UnicodeEncodeError as error:
        raise MeshFileError(
            f"{path} cannot be read: its path is not valid UTF-8; rename it, or set PYTHONUTF8=1"
        ) from error
    except (DataSourceError, DataLayerError) as error:
        raise MeshFileError(
            f"{path} cannot be read as a GeoPackage; use a .gpkg that geomesh wrote"
        ) from error
    if driver != "GPKG":
        raise MeshFileError(
            f"{path} is not a GeoPackage ({driver or 'it is empty'}); geomesh can read meshes "
            "only from the .gpkg that it wrote"
        )
    return layers


def read_document(path: str | PathLike[str]) -> dict[str, Any]:
    """Return the metadata document of a mesh: see `geomesh.formats.document.build_document`.

    Raises
    ------
    MeshFileError
        If the file does not exist, or is not a GeoPackage of geomesh.
    """
    layers = _find_layers(Path(path))
    # Another program may have added layers, or even have replaced one.
    metadata = [
        pyogrio.read_info(plain_name(path), layer=name)["layer_metadata"] or {}
        for name in LAYERS
        if name in layers
    ]
    try:
        document: dict[str, Any] = json.loads(
            next((each[KEY] for each in metadata if KEY in each), "null")
        )
        version = document["mesh"]["format"]
    except (KeyError, TypeError, ValueError) as error:
        raise MeshFileError(
            f"{path} has no metadata of geomesh: another program made it or saved it again; "
            "use the file that geomesh wrote"
        ) from error
    if version > FORMAT:
        raise MeshFileError(
            f"{path} was written by geomesh {document.get('geomesh')}, which is newer than this "
            "version; upgrade geomesh"
        )
    return document


def _read_columns(
    path: Path, layer: LayerName, own: dict[str, str], stored: dict[str, Any]
) -> dict[str, NDArray[Any]]:
    """Return the columns of a layer in the order of ids, with their original dtypes.

    `own` gives the columns that define the geometry, with their dtypes. Columns that another
    program added come last.
    """
    dtypes = own | dict(stored["columns"][layer])
    added, dropped = _added(path, layer, stored)
    _warn_of_dropped(path, layer, dropped, "a mesh can keep numbers, text, truth values and dates")
    table = _read_layer(path, layer, [*dtypes, *added], stored["counts"][layer])
    columns = {}
    for name, text in dtypes.items():
        dtype = np.dtype(text)
        # Null means NaN in a float column, NaT in one of dates and None in one of objects. In
        # other columns, and in columns that define the geometry, a value was removed.
        if table[name].null_count and (name in own or dtype.kind not in "fMO"):
            raise MeshFileError(
                f"{path} has {layer} without a value of {name!r}: values were removed; "
                "use the file that geomesh wrote"
            )
        columns[name] = to_array(table[name]).astype(dtype)
    return columns | {name: to_array(table[name]) for name in added}


def _require_place(path: Path, mesh: TriangleMesh) -> None:
    """Raise MeshFileError if another program moved or reprojected the nodes."""
    about, table = pyogrio.read_arrow(plain_name(path), layer="nodes", columns=["id"])
    points = to_points(table.sort_by("id")[about["geometry_name"] or "wkb_geometry"])
    expected = mesh.map_nodes
    pixel = np.abs(np.array(mesh.grid.transform[:6])[[0, 1, 3, 4]]).max()
    allowed = _MOVED * pixel + 4 * np.finfo(np.float64).eps * np.abs(expected).max(initial=0)
    if mesh.heights is not None:
        expected = np.column_stack([expected, mesh.heights])
    is_there = points is not None and points.shape == expected.shape
    if points is None or not is_there or not _is_near(points, expected, allowed):
        raise MeshFileError(
            f"{path} has nodes that are not where geomesh put them: another program moved or "
            "reprojected them; use the file that geomesh wrote"
        )


def _is_near(points: Points, expected: Points, allowed: float) -> bool:
    """Return whether points (N, 2) or (N, 3) are where expected, and have exactly its heights."""
    near = np.abs(points[:, :2] - expected[:, :2]) <= allowed
    return bool(near.all()) and np.array_equal(points[:, 2:], expected[:, 2:], equal_nan=True)


def _added(path: Path, layer: LayerName, stored: dict[str, Any]) -> tuple[list[str], list[str]]:
    """Return the columns that another program added: those that a mesh keeps, and the others."""
    known = dict(stored["columns"].get(layer, ()))
    fields = pyogrio.read_info(plain_name(path), layer=layer)["fields"]
    added = added_by_others(fields, layer, known, has_heights=bool(stored.get("height")))
    if not added or layer == "edges":
        return [], added
    # No row is read, only the types.
    _, table = pyogrio.read_arrow(
        plain_name(path), layer=layer, columns=added, read_geometry=False, max_features=1
    )
    kept = [name for name in added if can_keep(table.schema.field(name).type)]
    return kept, [name for name in added if name not in kept]


def _warn_of_dropped(
    path: str | PathLike[str], layer: LayerName, names: list[str], reason: str
) -> None:
    if names:
        warnings.warn(
            f"{path} has columns of another program in its {layer} that are left out "
            f"({', '.join(names)}): {reason}",
            GeomeshWarning,
            stacklevel=5,
        )


def _read_layer(path: Path, layer: LayerName, names: list[str], rows: int) -> pa.Table:
    """Return the table of a layer in the order of ids."""
    columns = ["id", *names]
    _, table = pyogrio.read_arrow(
        plain_name(path), layer=layer, columns=columns, read_geometry=False
    )
    missing = [name for name in ("id", *names) if name not in table.column_names]
    if missing:
        raise MeshFileError(
            f"{path} has no columns {', '.join(missing)} in {layer}: they were removed; "
            "use the file that geomesh wrote"
        )
    table = table.sort_by("id")
    if not np.array_equal(table["id"].to_numpy(), np.arange(rows)):
        raise MeshFileError(
            f"{path} should have {rows} {layer} with ids from 0: rows were removed or added; "
            "use the file that geomesh wrote"
        )
    return table


def _read_constraints(
    path: Path, layers: set[str], triangles: NDArray[np.int32], stored: dict[str, Any]
) -> NDArray[np.int32]:
    """Return the constrained node pairs from the layer of edges.

    Without that layer, return the boundary edges: the certificate says that they are the same.
    """
    edges = build_edges(triangles)
    chosen = np.zeros(len(edges.nodes), np.bool_)
    if "edges" in layers:
        table = _read_layer(path, "edges", ["constrained"], len(edges.nodes))
        chosen = table["constrained"].to_numpy().astype(np.bool_)
    elif stored["domain"]["kind"] != "hull":
        chosen = edges.uses == 1
    found: NDArray[np.int32] = edges.nodes[chosen]
    if len(found) != stored["counts"]["constraints"]:
        raise MeshFileError(
            f"{path} has {len(found)} of {stored['counts']['constraints']} constrained edges; "
            "write the mesh with all its layers"
        )
    return found
