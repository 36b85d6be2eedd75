"""The names that users import: Mesh, and functions that make, read and show a mesh."""

from geomesh.api.make import mesh_raster, read_mesh, stages
from geomesh.api.mesh import Mesh

__all__ = ["Mesh", "mesh_raster", "read_mesh", "stages"]
