"""Meshes with the record of a refinement, without a refinement."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any

from geomesh import Mesh, mesh_raster
from geomesh.parallel.progress import silent
from geomesh.parallel.workers import open_workers
from geomesh.raster.open import open_scene
from geomesh.recipe import Recipe
from geomesh.surface.accuracy import measure_accuracy
from geomesh.surface.columns import node_columns, triangle_columns
from geomesh.surface.fit import fit_surface
from geomesh.surface.record import record_refinement
from geomesh.zonal.columns import counted_bands
from geomesh.zonal.statistics import measure_scene

if TYPE_CHECKING:
    import numpy as np

    from geomesh.raster.open import Source


def with_record(
    mesh: Mesh,
    source: Source,
    *,
    values: np.ndarray | None = None,
    reached: bool = True,
    note: str = "",
    floor: float = 0,
    budget: int | None = None,
    **goal: Any,
) -> Mesh:
    """Return a mesh as if refinement had made it; the surface is that of least squares.

    `values` replaces the values of the surface. `goal` are parameters of the recipe, such as
    ``max_error=5``.
    """
    recipe = Recipe.from_preset("adaptive").with_values(**goal)
    scene = open_scene(source)
    measured = scene.classes
    with open_workers(1) as pool, scene.open():
        surface = fit_surface(
            *(mesh.nodes, mesh.triangles, scene),
            model=recipe.model,
            workers=pool,
            progress=silent,
        )
        values = surface.values if values is None else values
        statistics = measure_scene(
            *(mesh.nodes, mesh.triangles, measured, pool, silent),
            counted=counted_bands(measured.bands, recipe.statistics),
            classes=[k for k, band in enumerate(measured.bands) if band.is_class],
        )
        accuracy = measure_accuracy(
            *(mesh.nodes, mesh.triangles, values, scene, pool, silent), model=recipe.model
        )
    is_linear = recipe.model == "linear"
    columns = triangle_columns(
        *(statistics, measured.bands, accuracy, recipe.statistics),
        means=None if is_linear else values.T,
    )
    color = mesh.triangle_table["color"]
    if budget is None and recipe.max_error is None and recipe.rmse is None:
        budget = len(mesh.nodes)
    refinement = record_refinement(
        *(recipe, accuracy, mesh.nodes, mesh.triangles, values),
        budget=budget,
        reached=reached,
        note=note,
        min_angle_floor=floor,
    )
    return replace(
        mesh,
        node_table=mesh.node_table.with_columns(
            node_columns(values, accuracy.bands) if is_linear else {}
        ),
        triangle_table=type(mesh.triangle_table)({**columns, "color": color}),
        provenance=replace(mesh.provenance, recipe=recipe, refinement=refinement),
    )


def plain_mesh(source: Source, **options: Any) -> Mesh:
    """Return a mesh that is not refined: its nodes are features, and its values are sampled."""
    return mesh_raster(source, preset="features", **options)


def refined(source: Source, nodes: int = 200, **options: Any) -> Mesh:
    """Return the mesh of a raster with features, as if refinement had made it."""
    return with_record(plain_mesh(source, nodes=nodes), source, **options)
