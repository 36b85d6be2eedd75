"""The pipeline: raster -> gray -> Sobel -> (resize) -> Canny -> SIFT -> Delaunay -> Mesh."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from dataclasses import replace
from importlib.metadata import version
from typing import Any

import cv2
import numba
import numpy as np
import rasterio
from numpy.typing import NDArray

from geomesh._version import __version__
from geomesh.arrays.jit import load_compiler
from geomesh.arrays.table import Table
from geomesh.delaunay.triangulate import constrained_delaunay, delaunay
from geomesh.errors import GeomeshWarning, WorkerError
from geomesh.features.detect import detect
from geomesh.features.gray import Tone, fit_tone
from geomesh.features.gray_image import SceneGray
from geomesh.features.overview import read_overview
from geomesh.mesh.topology import Triangles
from geomesh.mesh.triangle_mesh import Mesh
from geomesh.parallel.progress import reporting
from geomesh.parallel.tiles import Progress, part_of
from geomesh.parallel.workers import Crew, open_crew
from geomesh.pipeline.nodes import NodeSet, place_nodes
from geomesh.raster.grid import Grid
from geomesh.raster.open import Source, open_scene
from geomesh.raster.scene import Excerpt, Scene
from geomesh.recipe import Recipe
from geomesh.zonal import columns
from geomesh.zonal import statistics as zonal

# What a result may depend on, beside geomesh itself.
_LIBRARIES = (cv2, numba, np, rasterio)

# What SIFT takes for each pixel that it looks at; gigabytes that a user should know of.
_SIFT_BYTES = 240
_MUCH = 4


def mesh_raster(
    source: Source,
    *,
    preset: str = "features",
    recipe: Recipe | None = None,
    bidx: Sequence[int] | None = None,
    nodata: float | None = None,
    crs: Any = None,
    bounds: tuple[float, float, float, float] | None = None,
    mask: Any = None,
    name: str | None = None,
    workers: int | None = None,
    executor: Executor | None = None,
    progress: bool | Progress = False,
    **values: Any,
) -> Mesh:
    """Turn a raster into a triangle mesh.

    Parameters
    ----------
    source : str, PathLike, rasterio dataset, xarray.DataArray, or (array, transform, crs)
    preset : {"features", "paper"}
        "features": nodes at the image's own resolution over the whole valid area;
        "paper": the published system to the letter, at 256 x 256 pixels.
    recipe : Recipe, optional
        Takes the place of the preset.
    bidx : sequence of int, optional
        1-based bands to use; all but alpha by default.
    nodata : float, optional
        Takes the place of the file's own nodata value.
    crs : str, int or pyproj.CRS, optional
        Takes the place of the file's own coordinate system; nothing is reprojected.
    bounds : (west, south, east, north), optional
        Box in map coordinates to crop to.
    mask : path, GeoDataFrame or GeoSeries, optional
        Area of interest.
    name : str, optional
        What messages and metadata call the source, if not by its path.
    workers : int, optional
        How many tiles to work on at a time; one a core by default. The mesh is the same
        to the last bit whatever their number.
    executor : concurrent.futures.Executor, optional
        Takes the place of geomesh's own threads: processes, or a Dask cluster's
        ``Client.get_executor()``, which cannot tell its size: give `workers`, too. They
        open the source by its path.
    progress : bool or callable(fraction, message)
        True shows a progress bar; a callable may raise to cancel.
    **values
        Parameters of the recipe to change, such as ``nodes=5000``.

    Returns
    -------
    Mesh

    Raises
    ------
    GeomeshError
        With one line that says what is wrong and what to do.

    Examples
    --------
    >>> import geomesh
    >>> mesh = geomesh.mesh_raster("data_samples/olinda_landsat7_rgb_uint8.tif", nodes=500)
    >>> len(mesh.nodes), mesh.certify().passed
    (500, True)
    """
    recipe = (recipe or Recipe.from_preset(preset)).with_values(**values)
    scene = open_scene(
        source, bidx=bidx, nodata=nodata, crs=crs, bounds=bounds, mask=mask, name=name
    )
    with reporting(progress) as report, open_crew(workers, executor) as crew:
        return mesh_scene(scene, recipe, crew, report)


def mesh_scene(
    scene: Scene,
    recipe: Recipe,
    crew: Crew,
    progress: Progress,
    *,
    shaped: Callable[[Mesh], None] | None = None,
) -> Mesh:
    """Run the stages on a scene, one after the other.

    Parameters
    ----------
    scene : Scene
    recipe : Recipe
    crew : Crew
    progress : callable(fraction, message)
    shaped : callable(Mesh), optional
        Called with the mesh as soon as its shape is final; it has no statistics yet.
    """
    _require_reach(scene, crew)
    notes = (*scene.notes, *_notes_on_memory(scene, recipe))
    _warn(notes)
    crew.local.submit(load_compiler)
    with scene.open():
        tone = scene_tone(scene, recipe, crew, part_of(progress, 0, 0.05))
        image = SceneGray(scene, tone, recipe.sobel)
        detection = detect(image, recipe, crew, part_of(progress, 0.05, 0.7))
        progress(0.7, "Triangulating")
        nodes = place_nodes(detection, scene.grid, recipe)
        nodes, triangles = triangulate(nodes, scene.grid, detection.size, crew.local)
        mesh = Mesh(
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
        statistics = zonal.measure_scene(
            mesh.nodes, mesh.triangles, scene, crew, part_of(progress, 0.8, 1)
        )
    _warn(nodes.notes)
    names = columns.band_names([band.description for band in scene.bands])
    return replace(
        mesh,
        node_table=mesh.node_table.with_columns(columns.node_columns(statistics, names)),
        triangle_table=Table(
            {
                **columns.triangle_columns(statistics, names, recipe.statistics),
                "color": _colors(statistics.mean, scene, tone),
            }
        ),
        metadata={
            "recipe": recipe.to_dict(),
            "warnings": [*notes, *nodes.notes],
            "source": _describe(scene, names),
            "canny": {"low": detection.thresholds.low, "high": detection.thresholds.high},
            "pixels": {
                "covered": int(statistics.pixels.sum()),
                "counted": int(statistics.count.sum()),
            },
            "versions": {
                "geomesh": __version__,
                "pythoncdt": version("pythoncdt"),
                **{library.__name__: library.__version__ for library in _LIBRARIES},
            },
        },
    )


def _warn(notes: Sequence[str]) -> None:
    # No catching of warnings: filters belong to the process, and other threads may be meshing.
    for note in notes:
        warnings.warn(note, GeomeshWarning, stacklevel=4)


def _require_reach(scene: Scene, crew: Crew) -> None:
    """Refuse a source that only this process can read to workers elsewhere."""
    if not (crew.shares_memory or isinstance(scene.source, str | Excerpt)):
        raise WorkerError(
            f"{scene.name} is open in this process only; for workers in other processes give "
            "its path instead of the open dataset"
        )


def _notes_on_memory(scene: Scene, recipe: Recipe) -> list[str]:
    """Tell of recipes that cannot be followed tile by tile, where that takes much memory."""
    width, height = recipe.resize or (scene.grid.width, scene.grid.height)
    gigabytes = width * height * _SIFT_BYTES / 1e9
    if recipe.is_local or gigabytes < _MUCH:
        return []
    return [
        f"this recipe looks at all {width} x {height} pixels at once, which takes about "
        f"{gigabytes:.0f} GB of memory; sift_max_octave=2, sift_source=gray and the usual blur "
        "go tile by tile"
    ]


def scene_tone(scene: Scene, recipe: Recipe, crew: Crew, progress: Progress) -> Tone:
    """Return how the scene's pixel values become gray levels and colours."""
    bands, valid = read_overview(scene, crew, progress)
    numbers = [band.index for band in scene.bands]
    return fit_tone(bands, valid, recipe, rgb=scene.rgb, numbers=numbers)


def triangulate(
    nodes: NodeSet, grid: Grid, plane_size: tuple[int, int], threads: Executor
) -> tuple[NodeSet, Triangles]:
    """Return the nodes that are in use, and the triangles counter-clockwise on the map.

    Parameters
    ----------
    nodes : NodeSet
    grid : Grid
        The source's lattice.
    plane_size : (int, int)
        Width and height of the image in whose plane circumcircles are to be empty.
    threads : Executor
        For sets too large for one triangulation.
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
    # In the order of the edges, as they are read back from a file.
    segments = np.unique(np.sort(new_id[nodes.segments], axis=1), axis=0).reshape(-1, 2)
    kept = replace(
        nodes, points=nodes.points[used], table=nodes.table.take(used), segments=segments
    )
    return kept, np.ascontiguousarray(triangles)


def _colors(means: NDArray[np.float64], scene: Scene, tone: Tone) -> NDArray[np.str_]:
    """Return the colour of each triangle: its mean in the display bands."""
    return columns.colors(np.ascontiguousarray(tone.display(means)[list(scene.display)].T))


def _describe(scene: Scene, names: Sequence[str]) -> dict[str, Any]:
    """Return what is needed to find the same pixels again."""
    window = scene.window
    return {
        "name": scene.name,
        "window": [window.col, window.row, window.width, window.height],
        "bands": {
            name: {"index": band.index, "description": band.description}
            for name, band in zip(names, scene.bands, strict=True)
        },
        # JSON has no NaN.
        "nodata": None if scene.nodata is None else str(scene.nodata),
        "area": scene.area.wkt if scene.area is not None else None,
    }
