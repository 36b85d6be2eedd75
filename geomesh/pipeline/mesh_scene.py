"""The pipeline: scene -> gray -> Sobel -> (resize) -> Canny -> SIFT -> Delaunay -> mesh."""

from __future__ import annotations

import threading
import warnings
from dataclasses import replace
from importlib.metadata import version
from typing import TYPE_CHECKING

import cv2
import numba
import numpy as np
import rasterio
import shapely

from geomesh._version import __version__
from geomesh.arrays.jit import prepare_kernels
from geomesh.errors import GeomeshWarning, RecipeError, WorkerError
from geomesh.features.detect import detect_keypoints
from geomesh.features.gray import Tone, fit_tone
from geomesh.features.gray_image import SceneGray
from geomesh.features.overview import read_overview
from geomesh.mesh.height import find_height
from geomesh.mesh.provenance import (
    CannyThresholds,
    Display,
    Provenance,
    SourceBand,
    SourceRaster,
)
from geomesh.parallel.background import in_background
from geomesh.parallel.deadline import never
from geomesh.parallel.progress import Progress, part_of
from geomesh.pipeline.attributes import describe
from geomesh.pipeline.breaklines import CANNY
from geomesh.pipeline.join import join_nodes
from geomesh.pipeline.nodes import place_nodes
from geomesh.raster.pixels import Excerpt

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from geomesh.mesh.height import Height
    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.parallel.workers import Workers
    from geomesh.raster.lines import PixelLines
    from geomesh.raster.pixels import Pixels
    from geomesh.raster.scene import Scene
    from geomesh.recipe import Recipe

# Libraries on which a result may depend, in addition to geomesh itself.
_LIBRARIES = (cv2, numba, np, rasterio, shapely)

# Share of the progress until the triangulation that detection has if the mesh is refined.
_SHARE_OF_DETECTION = 0.3

# Memory that SIFT needs for each pixel, and the gigabytes from which the user gets a warning.
_SIFT_BYTES = 240
_MUCH = 4


def mesh_scene(
    scene: Scene,
    recipe: Recipe,
    workers: Workers,
    progress: Progress,
    *,
    breaklines: PixelLines | None = None,
    shaped: Callable[[TriangleMesh], None] | None = None,
    is_late: Callable[[], bool] = never,
) -> TriangleMesh:
    """Run all stages on a scene and return the mesh.

    Parameters
    ----------
    scene : Scene
    recipe : Recipe
    workers : Workers
    progress : callable(fraction, message)
    breaklines : PixelLines, optional
        From `geomesh.pipeline.breaklines.read_breaklines`. It stays here, because the tiles do
        not need it.
    shaped : callable(TriangleMesh), optional
        Called with the mesh as soon as its geometry is final, before it has statistics.
    is_late : callable, optional
        Whether refinement should end early.
    """
    _require_reach(scene, workers)
    _require_refinable(recipe)
    height = _height_of(scene, recipe)
    own = breaklines.notes if breaklines is not None else ()
    doubts = [*_notes_on_memory(scene, recipe), *_notes_on_classes(scene, recipe)]
    notes = (*scene.notes, *own, *_notes_on_height(height), *doubts)
    _warn(notes)
    # Set when it is known whether kernels have to be compiled, or when all are ready.
    is_known = threading.Event()
    later_stages = in_background(lambda: _load_later_stages(recipe, is_known.set))
    later_stages.add_done_callback(lambda _: is_known.set())
    with scene.open():
        overview = read_overview(scene, workers, part_of(progress, 0, 0.05))
        tone = tone_of(scene, recipe, overview)
        image = SceneGray(scene, tone, recipe.sobel)
        share = _SHARE_OF_DETECTION if recipe.refine else 1.0
        detection = detect_keypoints(
            *(image, recipe, workers, part_of(progress, 0.05, 0.05 + 0.6 * share)),
            keep_edges=breaklines is not None and breaklines.digest == CANNY,
        )
        is_known.wait()
        if not later_stages.done():
            progress(0.05 + 0.65 * share, "Compiling, once")
        later_stages.result()
        progress(0.05 + 0.65 * share, "Triangulating")
        nodes = place_nodes(detection, scene.grid, recipe, breaklines)
        mesh = join_nodes(nodes, scene.grid, detection.size, recipe, workers.local)
        outcome = None
        if recipe.refine:
            # Imported here: its kernels take most of the time that compiling takes.
            from geomesh.pipeline.refine_scene import refine_scene

            more = part_of(progress, 0.05 + 0.7 * share, 0.8)
            outcome = refine_scene(mesh, scene, recipe, overview, workers, more, is_late=is_late)
            mesh = outcome.mesh
        if shaped is not None:
            shaped(mesh)
        more = part_of(progress, 0.8, 1)
        described = describe(mesh, scene, recipe, tone, workers, more, outcome=outcome)
    later_notes = nodes.notes if outcome is None else (*nodes.notes, *filter(None, [outcome.note]))
    _warn(later_notes)
    return replace(
        described.mesh,
        height=height,
        provenance=Provenance(
            recipe=recipe,
            source=source_of(scene),
            pixels=described.pixels,
            canny=CannyThresholds(detection.thresholds.low, detection.thresholds.high),
            warnings=(*notes, *later_notes),
            versions=versions(),
            refinement=described.refinement,
            breaklines=nodes.breaklines,
            display=display_of(scene, tone),
        ),
    )


def versions() -> dict[str, str]:
    """Return the versions of geomesh and of the libraries that can change a result."""
    return {
        "geomesh": __version__,
        "pythoncdt": version("pythoncdt"),
        **{library.__name__: library.__version__ for library in _LIBRARIES},
    }


def _load_later_stages(recipe: Recipe, compiling: Callable[[], None]) -> None:
    """Import libraries and load kernels of the later stages, in parallel with the detection.

    `compiling` is called if kernels have to be compiled.
    """
    import scipy.sparse.csgraph
    import scipy.spatial  # noqa: F401

    if recipe.refine:
        from geomesh.pipeline.goals import load_kernels

        load_kernels(recipe)

    prepare_kernels(compiling)


def _height_of(scene: Scene, recipe: Recipe) -> Height | None:
    """Return the height that a recipe asks for, before any pixel is read."""
    if recipe.z is None:
        return None
    bands, crs = scene.classes.bands, scene.grid.crs
    return find_height(bands, recipe.z, recipe.z_factor, crs, name=scene.name)


def _notes_on_height(height: Height | None) -> list[str]:
    """Return a warning if the unit of heights is a guess."""
    if height is None or not height.assumed or height.factor != 1.0:
        return []
    return ["the raster does not say in which unit its heights are: metres are assumed"]


def source_of(scene: Scene) -> SourceRaster:
    """Return the information needed to read the same pixels again."""
    window = scene.window
    return SourceRaster(
        name=scene.name,
        window=(window.col, window.row, window.width, window.height),
        bands=tuple(
            SourceBand(band.name, band.index, band.description, band.unit)
            for band in scene.classes.bands
        ),
        nodata=scene.nodata,
        alpha=scene.alpha,
        unscale=scene.unscale,
        area=scene.area.to_text() if scene.area is not None else None,
    )


def display_of(scene: Scene, tone: Tone) -> Display:
    """Return how the colours of a scene's triangles are made."""
    ranges = tone.display_ranges or ((0.0, 255.0),) * len(scene.bands)
    red, green, blue = scene.display
    names = (scene.bands[red].name, scene.bands[green].name, scene.bands[blue].name)
    return Display(names, (ranges[red], ranges[green], ranges[blue]))


def _warn(notes: Sequence[str]) -> None:
    # Warnings are not caught: filters apply to the process, and other threads may be meshing.
    for note in notes:
        warnings.warn(note, GeomeshWarning, stacklevel=4)


def _require_reach(scene: Scene, workers: Workers) -> None:
    """Raise WorkerError if workers in other processes could not read the source."""
    if not (workers.shares_memory or isinstance(scene.source, str | Excerpt)):
        raise WorkerError(
            f"{scene.name} is open in this process only; for workers in other processes give "
            "its path instead of the open dataset"
        )


def _require_refinable(recipe: Recipe) -> None:
    """Raise RecipeError if a mesh is to be refined that does not cover the raster's pixels."""
    if recipe.refine and (recipe.resize is not None or recipe.domain == "hull"):
        raise RecipeError(
            "refinement needs the domain valid or image and no resize, because a refined mesh "
            "covers the pixels of the raster: use `preset=features`"
        )


def _notes_on_memory(scene: Scene, recipe: Recipe) -> list[str]:
    """Return a warning if a recipe cannot work tile by tile and so needs much memory."""
    width, height = recipe.resize or (scene.grid.width, scene.grid.height)
    gigabytes = width * height * _SIFT_BYTES / 1e9
    if recipe.is_local or gigabytes < _MUCH:
        return []
    return [
        f"this recipe processes all {width} x {height} pixels at once and needs about "
        f"{gigabytes:.0f} GB of memory; to work tile by tile, use `sift_max_octave=2` "
        "`sift_source=gray` `sift_sigma=1.6` `sift_octave_layers=3`"
    ]


def _notes_on_classes(scene: Scene, recipe: Recipe) -> list[str]:
    """Return a warning if a surface is to be refined between classes, which have no order.

    A palette alone is no such case: its surface is that of its colours.
    """
    names = ", ".join(band.name for band in scene.bands if band.is_class)
    if not (recipe.refine and names):
        return []
    return [
        f"{names}: refinement takes classes for measured values and interpolates between them; "
        "choose other bands with `bidx`, or use `preset=features`"
    ]


def scene_tone(scene: Scene, recipe: Recipe, workers: Workers, progress: Progress) -> Tone:
    """Return the tone: how pixel values of the scene become gray levels and colours."""
    return tone_of(scene, recipe, read_overview(scene, workers, progress))


def tone_of(scene: Scene, recipe: Recipe, overview: Pixels) -> Tone:
    """Return the tone of a scene from its overview."""
    bands, valid = overview
    numbers = [band.index for band in scene.bands]
    return fit_tone(bands, valid, recipe, rgb=scene.rgb, numbers=numbers)
