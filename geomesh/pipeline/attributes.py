"""The attributes of a mesh: statistics, colours, and the surface of a refined mesh."""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TYPE_CHECKING

import numpy as np

from geomesh.arrays.table import Table
from geomesh.mesh.colors import format_colors
from geomesh.mesh.provenance import PixelCounts
from geomesh.mesh.slope import SLOPE_COLUMNS
from geomesh.parallel.memory import trim_memory
from geomesh.parallel.progress import Progress, part_of
from geomesh.surface import columns as surface_columns
from geomesh.surface.accuracy import measure_accuracy
from geomesh.surface.fit import Surface, fit_values
from geomesh.surface.record import goal_of, record_refinement
from geomesh.zonal import columns
from geomesh.zonal import statistics as zonal

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

    from geomesh.arrays.types import Floats
    from geomesh.features.gray import Tone
    from geomesh.mesh.refinement import Refinement
    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.parallel.workers import Workers
    from geomesh.parameters import LayerName
    from geomesh.pipeline.refine_scene import Outcome
    from geomesh.raster.scene import Scene
    from geomesh.recipe import Recipe

# Columns of each layer before those of the bands.
_OWN_COLUMNS: Mapping[LayerName, tuple[str, ...]] = MappingProxyType(
    {
        "triangles": (
            *("id", "n0", "n1", "n2", "area", "ab", "bc", "ca", "ki", "min_angle", "shape"),
        ),
        "edges": ("id", "n0", "n1", "left", "right", "length", "constrained"),
        "nodes": ("id", "kind", "col", "row", "scale", "response", "octave", "angle"),
    }
)


@dataclass(frozen=True, eq=False)
class Described:
    """A mesh with all its attributes, and facts for its provenance."""

    mesh: TriangleMesh
    pixels: PixelCounts
    refinement: Refinement | None


def describe(
    mesh: TriangleMesh,
    scene: Scene,
    recipe: Recipe,
    tone: Tone,
    workers: Workers,
    progress: Progress,
    *,
    outcome: Outcome | None = None,
) -> Described:
    """Measure a scene in the triangles and at the nodes of its mesh.

    Parameters
    ----------
    mesh : TriangleMesh
    scene : Scene
    recipe : Recipe
    tone : Tone
    workers : Workers
    progress : callable(fraction, message)
    outcome : Outcome, optional
        If the mesh was refined.
    """
    values = None
    if outcome is not None:
        # Before the statistics, because both need much memory.
        values = _surface_values(outcome, scene, recipe, workers, part_of(progress, 0, 0.3))
        trim_memory()
    more = progress if outcome is None else part_of(progress, 0.3, 0.7)
    statistics, means = _measure(mesh, scene, recipe, workers, more)
    trim_memory()
    bands = scene.classes.bands
    node_columns: dict[str, NDArray[np.generic]] = columns.node_columns(statistics, bands)
    refinement = None
    if outcome is None:
        triangle_columns = columns.triangle_columns(statistics, bands, recipe.statistics)
    else:
        is_linear = values is not None
        values = (
            np.ascontiguousarray(means.T)
            if values is None
            else _sampled_apart(values, mesh, statistics, has_bands=scene.classes is scene)
        )
        accuracy = measure_accuracy(
            mesh.nodes,
            mesh.triangles,
            values,
            scene,
            workers,
            part_of(progress, 0.7, 1),
            model=recipe.model,
        )
        refinement = record_refinement(
            recipe,
            accuracy,
            mesh.nodes,
            mesh.triangles,
            values,
            budget=outcome.budget,
            reached=outcome.reached,
            note=outcome.note,
            min_angle_floor=None if outcome.keeps_floor else 0.0,
        )
        if is_linear:
            node_columns |= surface_columns.node_columns(values, accuracy.bands)
        triangle_columns = surface_columns.triangle_columns(
            statistics, bands, accuracy, recipe.statistics, means=None if is_linear else means
        )
    triangle_columns["color"] = _colors(means, scene, tone)
    return Described(
        replace(
            mesh,
            node_table=mesh.node_table.with_columns(node_columns),
            triangle_table=Table(triangle_columns),
        ),
        PixelCounts(int(statistics.pixels.sum()), int(statistics.count.sum())),
        refinement,
    )


def _measure(
    mesh: TriangleMesh, scene: Scene, recipe: Recipe, workers: Workers, progress: Progress
) -> tuple[zonal.Statistics, Floats]:
    """Return the statistics of the triangles, and the means (B, T) of the bands of `scene`.

    The statistics of a palette are those of its classes; the means are those of its colours.
    """
    measured = scene.classes
    more = progress if measured is scene else part_of(progress, 0, 0.5)
    statistics = zonal.measure_scene(
        *(mesh.nodes, mesh.triangles, measured, workers, more),
        counted=columns.counted_bands(measured.bands, recipe.statistics),
        classes=[k for k, band in enumerate(measured.bands) if band.is_class],
    )
    if measured is scene:
        return statistics, statistics.mean
    more = part_of(progress, 0.5, 1)
    return statistics, zonal.measure_scene(mesh.nodes, mesh.triangles, scene, workers, more).mean


def _surface_values(
    outcome: Outcome, scene: Scene, recipe: Recipe, workers: Workers, progress: Progress
) -> Floats | None:
    """Return the values (N, B) of a linear surface; None if triangles have one value each."""
    if recipe.model != "linear":
        return None
    if goal_of(recipe) == "max_error":
        return outcome.values  # the bound holds for these only
    mesh = outcome.mesh
    surface = Surface(mesh.nodes, mesh.triangles, outcome.values, "linear")
    return fit_values(surface, scene, workers, progress)


def _sampled_apart(
    values: Floats, mesh: TriangleMesh, statistics: zonal.Statistics, *, has_bands: bool
) -> Floats:
    """Return values (N, B) with those of the raster at nodes of which no triangle has a pixel.

    No pixel tells what such a value should be. It is NaN if there is no valid pixel around the
    node either, or if `statistics` are of a palette, not of its colours.
    """
    known = np.zeros(len(values), np.bool_)
    known[mesh.triangles[statistics.count > 0]] = True
    sampled = statistics.node_values.T if has_bands else np.nan
    return np.where(known[:, None], values, sampled)


def name_columns(layer: LayerName, scene: Scene, recipe: Recipe) -> list[str]:
    """Return the names of the columns that a layer of the mesh will have, in order."""
    own = [*_OWN_COLUMNS[layer]]
    bands = scene.classes.bands
    if layer == "edges":
        return own
    surface = [band.name for band in scene.bands] if recipe.refine else []
    if layer == "nodes":
        values = surface if recipe.model == "linear" else []
        return list(dict.fromkeys([*own, *(band.name for band in bands), *values]))
    mean = ("mean",) if recipe.model == "constant" else ()
    errors = dict.fromkeys(surface, (*mean, "rmse", "max_error"))
    own += [*(SLOPE_COLUMNS if recipe.z is not None else ()), "count"]
    for band in bands:
        measured = (*columns.statistics_of(band, recipe.statistics), *errors.pop(band.name, ()))
        own += [f"{band.name}_{each}" for each in dict.fromkeys(measured)]
    own += [f"{name}_{each}" for name, rest in errors.items() for each in rest]
    return [*own, "color"]


def _colors(means: Floats, scene: Scene, tone: Tone) -> NDArray[np.str_]:
    """Return the colour of each triangle: the mean of its display bands."""
    return format_colors(np.ascontiguousarray(tone.display(means)[list(scene.display)].T))
