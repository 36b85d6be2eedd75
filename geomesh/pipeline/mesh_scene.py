"""The pipeline: scene -> gray -> Sobel -> (resize) -> Canny -> SIFT -> Delaunay -> mesh."""

from __future__ import annotations

import threading
import warnings
from dataclasses import replace
from importlib.metadata import version
from types import MappingProxyType
from typing import TYPE_CHECKING

import cv2
import numba
import numpy as np
import rasterio

from geomesh._version import __version__
from geomesh.arrays.jit import prepare_kernels
from geomesh.arrays.table import Table
from geomesh.delaunay.triangulate import constrained_delaunay, delaunay
from geomesh.errors import GeomeshWarning, WorkerError
from geomesh.features.detect import detect_keypoints
from geomesh.features.gray import Tone, fit_tone
from geomesh.features.gray_image import SceneGray
from geomesh.features.overview import read_overview
from geomesh.mesh.colors import format_colors
from geomesh.mesh.provenance import (
    CannyThresholds,
    PixelCounts,
    Provenance,
    SourceBand,
    SourceRaster,
)
from geomesh.mesh.triangle_mesh import TriangleMesh
from geomesh.parallel.background import in_background
from geomesh.parallel.progress import Progress, part_of
from geomesh.pipeline.nodes import NodeSet, place_nodes
from geomesh.raster.pixels import Excerpt
from geomesh.zonal import columns
from geomesh.zonal import statistics as zonal

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence
    from concurrent.futures import Executor

    from numpy.typing import NDArray

    from geomesh.arrays.types import Floats, Triangles
    from geomesh.parallel.workers import Workers
    from geomesh.parameters import LayerName
    from geomesh.raster.grid import Grid
    from geomesh.raster.scene import Scene
    from geomesh.recipe import Recipe

# Libraries on which a result may depend, in addition to geomesh itself.
_LIBRARIES = (cv2, numba, np, rasterio)

# Number of columns of each layer without those of the bands.
_OWN_COLUMNS: Mapping[LayerName, int] = MappingProxyType({"triangles": 13, "edges": 7, "nodes": 8})

# Memory that SIFT needs for each pixel, and the gigabytes from which the user gets a warning.
_SIFT_BYTES = 240
_MUCH = 4


def mesh_scene(
    scene: Scene,
    recipe: Recipe,
    workers: Workers,
    progress: Progress,
    *,
    shaped: Callable[[TriangleMesh], None] | None = None,
) -> TriangleMesh:
    """Run all stages on a scene and return the mesh.

    Parameters
    ----------
    scene : Scene
    recipe : Recipe
    workers : Workers
    progress : callable(fraction, message)
    shaped : callable(TriangleMesh), optional
        Called with the mesh as soon as its geometry is final, before it has statistics.
    """
    _require_reach(scene, workers)
    notes = (*scene.notes, *_notes_on_memory(scene, recipe))
    _warn(notes)
    # Set when it is known whether kernels have to be compiled, or when all are ready.
    is_known = threading.Event()
    later_stages = in_background(lambda: _load_later_stages(is_known.set))
    later_stages.add_done_callback(lambda _: is_known.set())
    with scene.open():
        tone = scene_tone(scene, recipe, workers, part_of(progress, 0, 0.05))
        image = SceneGray(scene, tone, recipe.sobel)
        detection = detect_keypoints(image, recipe, workers, part_of(progress, 0.05, 0.68))
        is_known.wait()
        if not later_stages.done():
            progress(0.7, "Compiling, once")
        later_stages.result()
        progress(0.7, "Triangulating")
        nodes = place_nodes(detection, scene.grid, recipe)
        nodes, triangles = triangulate_nodes(nodes, scene.grid, detection.size, workers.local)
        mesh = TriangleMesh(
            nodes=nodes.points,
            triangles=triangles,
            grid=scene.grid,
            domain=nodes.domain,
            constraints=nodes.segments,
            plane_size=detection.size,
            node_table=nodes.table,
        )
        if shaped is not None:
            shaped(mesh)
        statistics, means = _measure(mesh, scene, recipe, workers, part_of(progress, 0.8, 1))
    _warn(nodes.notes)
    bands = scene.classes.bands
    return replace(
        mesh,
        node_table=mesh.node_table.with_columns(columns.node_columns(statistics, bands)),
        triangle_table=Table(
            {
                **columns.triangle_columns(statistics, bands, recipe.statistics),
                "color": _colors(means, scene, tone),
            }
        ),
        provenance=Provenance(
            recipe=recipe,
            source=source_of(scene),
            pixels=PixelCounts(int(statistics.pixels.sum()), int(statistics.count.sum())),
            canny=CannyThresholds(detection.thresholds.low, detection.thresholds.high),
            warnings=(*notes, *nodes.notes),
            versions={
                "geomesh": __version__,
                "pythoncdt": version("pythoncdt"),
                **{library.__name__: library.__version__ for library in _LIBRARIES},
            },
        ),
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


def count_columns(layer: LayerName, scene: Scene, statistics: Sequence[str]) -> int:
    """Return the number of columns that a layer of the mesh will have."""
    bands = scene.classes.bands
    measured = {
        "triangles": sum(len(columns.statistics_of(band, statistics)) for band in bands),
        "edges": 0,
        "nodes": len(bands),
    }
    return _OWN_COLUMNS[layer] + measured[layer]


def _load_later_stages(compiling: Callable[[], None]) -> None:
    """Import libraries and load kernels of the later stages, in parallel with the detection.

    `compiling` is called if kernels have to be compiled.
    """
    import scipy.sparse.csgraph
    import scipy.spatial  # noqa: F401

    prepare_kernels(compiling)


def source_of(scene: Scene) -> SourceRaster:
    """Return the information needed to read the same pixels again."""
    window = scene.window
    return SourceRaster(
        name=scene.name,
        window=(window.col, window.row, window.width, window.height),
        bands=tuple(
            SourceBand(band.name, band.index, band.description) for band in scene.classes.bands
        ),
        nodata=scene.nodata,
        alpha=scene.alpha,
        unscale=scene.unscale,
        area=scene.area.to_text() if scene.area is not None else None,
    )


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


def scene_tone(scene: Scene, recipe: Recipe, workers: Workers, progress: Progress) -> Tone:
    """Return the tone: how pixel values of the scene become gray levels and colours."""
    bands, valid = read_overview(scene, workers, progress)
    numbers = [band.index for band in scene.bands]
    return fit_tone(bands, valid, recipe, rgb=scene.rgb, numbers=numbers)


def triangulate_nodes(
    nodes: NodeSet, grid: Grid, plane_size: tuple[int, int], threads: Executor
) -> tuple[NodeSet, Triangles]:
    """Triangulate nodes; return the nodes in use, and triangles counter-clockwise on the map.

    Parameters
    ----------
    nodes : NodeSet
    grid : Grid
        The pixel grid of the source.
    plane_size : (int, int)
        Width and height of the image in whose plane the triangulation is Delaunay.
    threads : Executor
        Used if there are too many nodes for one triangulation.
    """
    plane = nodes.points * (plane_size[0] / grid.width, plane_size[1] / grid.height)
    if len(nodes.segments):
        triangles, used = constrained_delaunay(plane, nodes.segments, executor=threads)
    else:
        triangles, used = delaunay(plane, executor=threads)
    new_id = np.full(len(nodes.points), -1, np.int32)
    new_id[used] = np.arange(len(used), dtype=np.int32)
    triangles = new_id[triangles]
    if grid.flips:
        triangles = triangles[:, [0, 2, 1]]
    # In the order of the edges, which is the order when a mesh is read from a file.
    segments = np.unique(np.sort(new_id[nodes.segments], axis=1), axis=0).reshape(-1, 2)
    kept = replace(
        nodes, points=nodes.points[used], table=nodes.table.take(used), segments=segments
    )
    return kept, np.ascontiguousarray(triangles)


def _colors(means: NDArray[np.float64], scene: Scene, tone: Tone) -> NDArray[np.str_]:
    """Return the colour of each triangle: the mean of its display bands."""
    return format_colors(np.ascontiguousarray(tone.display(means)[list(scene.display)].T))
