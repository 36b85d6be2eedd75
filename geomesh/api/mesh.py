"""Mesh: a triangle mesh with methods that write, refine, draw, compare and measure it."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

from geomesh.api.measuring import MeasuringMesh
from geomesh.api.writing import WritingMesh
from geomesh.parallel.progress import Progress, reporting

if TYPE_CHECKING:
    from collections.abc import Iterable
    from concurrent.futures import Executor

    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.parameters import Alpha, Effort, Model
    from geomesh.raster.open import Source
    from geomesh.view.web_map.write import NotebookMap


@dataclass(frozen=True, eq=False, repr=False)
class Mesh(WritingMesh, MeasuringMesh):
    """A conforming triangle mesh of a raster.

    `mesh_raster` and `read_mesh` return it. It adds methods to `TriangleMesh` that write, draw
    and compare the mesh. It has no other fields.
    """

    @classmethod
    def of(cls, mesh: TriangleMesh) -> Mesh:
        """Return the same mesh as a Mesh. The arrays are not copied."""
        return cls(**{field.name: getattr(mesh, field.name) for field in fields(mesh)})

    def _repr_html_(self) -> str:
        from geomesh.view.notebook import mesh_html

        return mesh_html(self)

    def refine(
        self,
        source: Source,
        *,
        nodes: int | str | None = None,
        max_error: float | tuple[float, ...] | None = None,
        rmse: float | tuple[float, ...] | None = None,
        min_angle: float = 10.0,
        model: Model = "linear",
        effort: Effort = "normal",
        keep_features: bool = False,
        alpha: Alpha | None = None,
        crs: Any = None,
        time_limit: float | None = None,
        workers: int | None = None,
        executor: Executor | None = None,
        progress: bool | Progress = False,
    ) -> Mesh:
        """Return a mesh that shows the raster better: move, add and remove nodes.

        The outline and breaklines stay where they are. The mesh need not be one of geomesh's
        own; it must pass its certificate.

        Parameters
        ----------
        source : path, rasterio dataset, xarray.DataArray, or (array, transform, crs)
            The raster from which the mesh was made, or another one with the same pixels.
        nodes, max_error, rmse
            The goal, as for the preset "adaptive" of `mesh_raster`, with the same default.
        min_angle, model, effort, keep_features
            As in the recipe: see `Recipe`.
        alpha, crs, time_limit, workers, executor, progress
            As in `mesh_raster`.

        Raises
        ------
        GeomeshError
            If the raster cannot be read or does not have the pixels of the mesh, a goal is not
            valid, or the mesh is not sound.

        Examples
        --------
        >>> import geomesh
        >>> scene = "data_samples/olinda_landsat7_rgb_uint8.tif"
        >>> mesh = geomesh.mesh_raster(scene, preset="features", nodes=500)
        >>> len(mesh.refine(scene, nodes=500).nodes)
        500
        """
        from geomesh.parallel.deadline import deadline
        from geomesh.parallel.workers import open_workers
        from geomesh.pipeline.refine_mesh import refine_mesh
        from geomesh.surface.original import open_original

        goals = {
            "nodes": nodes,
            "max_error": max_error,
            "rmse": rmse,
            "min_angle": min_angle,
            "model": model,
            "effort": effort,
            "keep_features": keep_features,
        }
        scene, is_late = open_original(self, source, alpha=alpha, crs=crs), deadline(time_limit)
        with reporting(progress) as report, open_workers(workers, executor) as pool:
            return Mesh.of(refine_mesh(self, scene, goals, pool, report, is_late=is_late))

    def plot(self, column: str = "color", **options: Any) -> Any:
        """Draw the mesh with matplotlib, filled by `column`; see `geomesh.view.plot.plot_mesh`."""
        from geomesh.view.plot import plot_mesh

        return plot_mesh(self, column, **options)

    def explore(
        self,
        column: str | None = None,
        *,
        other: Mesh | None = None,
        columns: Iterable[str] | None = None,
        basemap: str | None = None,
        embed: Source | None = None,
        height: int = 520,
    ) -> NotebookMap:
        """Return the map of `to_html` for a notebook, which shows it below the cell.

        Parameters
        ----------
        column, other, columns, basemap, embed
            As in `to_html`.
        height : int
            Of the map, in pixels.
        """
        from geomesh.view.web_map.page import MapOptions
        from geomesh.view.web_map.write import NotebookMap, page_of

        meshes = [self] if other is None else [self, other]
        options = MapOptions(column, columns, None, basemap)
        return NotebookMap(page_of(meshes, options, embed=embed), height)
