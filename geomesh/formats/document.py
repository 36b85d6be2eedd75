"""The metadata document: JSON in a mesh file from which the mesh can be restored."""

from __future__ import annotations

import json
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from geomesh._version import __version__
from geomesh.arrays.plain import plain_json
from geomesh.formats.format import PLAIN, WriteOptions
from geomesh.mesh.topology import edge_keys

if TYPE_CHECKING:
    from geomesh.arrays.table import Table
    from geomesh.mesh.certificate import Certificate
    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.raster.grid import Grid

KEY = "geomesh"
FORMAT = 1
OPTIONS = "options"

# Name of the number of triangles that have heights.
WITH_HEIGHTS = "triangles_with_heights"


def build_document(
    mesh: TriangleMesh, certificate: Certificate, options: WriteOptions = PLAIN
) -> str:
    """Return the metadata document of a mesh as JSON text.

    It has the entries of the mesh's provenance (see `Provenance.to_dict`) and three more:
    `geomesh` (the version that wrote the file), `certificate` (the checks and their results)
    and `mesh` (what `geomesh.read_mesh` needs in addition to the layers). If the file was written
    with options, it also has these: `options`.
    """
    given = options.given()
    document = {
        **mesh.metadata,
        **({OPTIONS: given} if given else {}),
        "geomesh": __version__,
        "certificate": certificate.to_dict(),
        "mesh": {
            "format": FORMAT,
            "grid": describe_grid(mesh.grid),
            "plane_size": mesh.plane_size,
            "height": None if mesh.height is None else mesh.height.to_dict(),
            "domain": asdict(mesh.domain),
            "counts": {
                "nodes": len(mesh.nodes),
                "triangles": len(mesh.triangles),
                "edges": len(mesh.edges.nodes),
                "constraints": len(np.unique(edge_keys(mesh.constraints))),
                **_with_heights(mesh),
            },
            "columns": {
                "nodes": _dtypes(mesh.node_table),
                "triangles": _dtypes(mesh.triangle_table),
            },
        },
    }
    return json.dumps(plain_json(document), sort_keys=True, allow_nan=False)


def describe_grid(grid: Grid) -> dict[str, Any]:
    """Return the description of a mesh's grid as plain JSON values."""
    return {
        "width": grid.width,
        "height": grid.height,
        "transform": list(map(float, grid.transform[:6])),
        "crs": grid.crs.to_wkt() if grid.crs else None,
    }


def _with_heights(mesh: TriangleMesh) -> dict[str, int]:
    """Return how many triangles formats for terrain store, if there are voids."""
    if mesh.heights is None:
        return {}
    return {WITH_HEIGHTS: int(np.isfinite(mesh.heights[mesh.triangles]).all(axis=1).sum())}


def _dtypes(table: Table) -> list[list[str]]:
    """Return pairs of name and dtype: sorted keys of a JSON object would lose the order."""
    return [[name, values.dtype.str] for name, values in table.items()]
