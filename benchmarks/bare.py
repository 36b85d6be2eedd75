"""The bare work of a mesh: the time that the libraries need if nothing else is done.

Each step is timed in a separate process on one thread, with the memory settings of the
command. Everything that is not part of the step is prepared before.
"""

from __future__ import annotations

import json
import multiprocessing
import pickle
import sys
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

from geomesh.parallel.memory import keep_freed_memory

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Sequence

# (seconds, description of what was done)
Timed = tuple[float, str]


@dataclass(frozen=True)
class Kept:
    """A folder with the inputs of all steps, which are prepared once."""

    folder: Path

    @property
    def gray(self) -> Path:
        """File with the gray image of the scene."""
        return self.folder / "gray.npy"

    @property
    def thresholds(self) -> Path:
        """File with the thresholds of Canny."""
        return self.folder / "thresholds.pickle"

    @property
    def mesh(self) -> Path:
        """File with the finished mesh."""
        return self.folder / "mesh.pickle"

    def load(self, path: Path) -> Any:
        """Return the object in a pickle file; only this program writes to the folder."""
        return pickle.loads(path.read_bytes())


def prepare(scene_path: Path, kept: Kept) -> None:
    """Make the gray image, the thresholds and the mesh of a scene."""
    import numpy as np

    import geomesh
    from geomesh.features.canny import canny_thresholds
    from geomesh.features.gray_image import SceneGray
    from geomesh.parallel.tiles import plan_tiles
    from geomesh.parallel.workers import open_workers
    from geomesh.pipeline.mesh_scene import scene_tone
    from geomesh.raster.open import open_scene
    from geomesh.recipe import Recipe

    recipe, scene = Recipe(), open_scene(scene_path)
    with open_workers(1) as workers, scene.open():
        image = SceneGray(scene, scene_tone(scene, recipe, workers, lambda *_: None), recipe.sobel)
        gray = np.empty(image.extent.shape, np.uint8)
        for tile in plan_tiles(image.extent, halo=0):
            gray[tile.core.slices()] = image.read(tile.core)[0]
        kept.thresholds.write_bytes(pickle.dumps(canny_thresholds(image, recipe)))
    np.save(kept.gray, gray)
    kept.mesh.write_bytes(pickle.dumps(geomesh.mesh_raster(scene_path, preset="features")))


def reading(scene_path: Path, _kept: Kept) -> Timed:
    """Read all bands of every tile with its halo once."""
    import rasterio
    from rasterio.env import setenv
    from rasterio.windows import Window

    from geomesh.parallel.tiles import plan_tiles
    from geomesh.raster.gdal import settings
    from geomesh.raster.grid import Grid

    with rasterio.Env():
        setenv(**settings())
        start = perf_counter()
        with rasterio.open(scene_path) as dataset:
            tiles = plan_tiles(Grid(dataset.width, dataset.height).extent)
            for tile in tiles:
                window = tile.read
                dataset.read(window=Window(window.col, window.row, window.width, window.height))
    return perf_counter() - start, f"rasterio, {len(tiles)} tiles"


def features(_scene_path: Path, kept: Kept) -> Timed:
    """Run SIFT and Canny on the gray tiles, with the parameters of the recipe."""
    import cv2

    cv2.setNumThreads(1)
    tiles, thresholds = list(_gray_tiles(kept.gray)), kept.load(kept.thresholds)
    start = perf_counter()
    sift, found = _sift(), 0
    for tile in tiles:
        found += len(sift.detect(tile, None))
        cv2.Canny(tile, thresholds.low, thresholds.high, L2gradient=thresholds.l2)
    return perf_counter() - start, f"OpenCV, {found:,} keypoints"


def triangulation(_scene_path: Path, kept: Kept) -> Timed:
    """Triangulate the nodes and the outline of the mesh, and erase the triangles outside."""
    import numpy as np
    import pythoncdt

    mesh = kept.load(kept.mesh)
    segments = mesh.constraints.astype(np.uintc)
    start = perf_counter()
    engine: Any = pythoncdt.Triangulation(
        pythoncdt.VertexInsertionOrder.AUTO,
        pythoncdt.IntersectingConstraintEdges.NOT_ALLOWED,
        0.0,
    )
    engine.insert_vertices(mesh.nodes)
    engine.insert_edges(segments)
    engine.erase_outer_triangles_and_holes()
    return perf_counter() - start, f"pythoncdt, {len(mesh.nodes):,} nodes"


def statistics(scene_path: Path, kept: Kept) -> Timed:
    """Run the kernels of the statistics over every tile, on pixels already read."""
    import numpy as np

    from geomesh.parallel.tiles import plan_tiles
    from geomesh.raster.open import open_scene
    from geomesh.zonal.kernels import blend_pixels, collect_pixels, find_moments
    from geomesh.zonal.tile_mesh import split_by_tiles

    def run(part: Any, bands: Any, valid: Any, tile: Any) -> None:
        core, count = tile.core, len(part.triangles)
        pixels, stops = np.zeros((2, count), np.int64)
        members = np.empty(core.width * core.height + 1, np.int32)
        origin = np.array([tile.read.row, tile.read.col])
        box = np.array([core.row, core.stop_row, core.col, core.stop_col])
        collect_pixels(part.nodes, part.triangles, valid, origin, box, pixels, stops, members)
        moments, values = np.zeros((4, count)), np.empty(valid.size)
        blended = np.empty(len(part.nodes))
        for band in bands:
            values.reshape(valid.shape)[:] = band
            find_moments(values, members, stops, moments)
            blend_pixels(part.nodes, values, valid, origin, blended)

    mesh, scene = kept.load(kept.mesh), open_scene(scene_path)
    tiles = plan_tiles(scene.grid.extent, halo=1)
    with scene.open():
        tasks = [
            partial(run, part, *scene.read(tile.read), tile)
            for tile, part in zip(
                tiles, split_by_tiles(mesh.nodes, mesh.triangles, tiles), strict=True
            )
        ]
    tasks[0]()  # compiles the kernels
    start = perf_counter()
    for task in tasks:
        task()
    return perf_counter() - start, f"the kernels, {len(mesh.triangles):,} triangles"


def writing(_scene_path: Path, kept: Kept) -> Timed:
    """Write ready batches of the three layers into one GeoPackage with spatial indexes."""
    import pyarrow as pa
    import pyogrio

    from geomesh.formats.arrow import Layer
    from geomesh.formats.batch_stream import BATCH_ROWS
    from geomesh.formats.geopackage import DATASET_OPTIONS, LAYER_OPTIONS
    from geomesh.formats.geopackage import FORMAT as GPKG
    from geomesh.parameters import LAYERS

    mesh, path = kept.load(kept.mesh), kept.folder / "bare.gpkg"
    path.unlink(missing_ok=True)
    crs, rows, ready = mesh.grid.crs.to_wkt(), 0, []
    for layer in (Layer.of(mesh, name) for name in LAYERS):
        starts = range(0, len(layer), BATCH_ROWS)
        batches = [layer.batch(slice(k, k + BATCH_ROWS), GPKG.geometry) for k in starts]
        ready.append((layer.name, layer.geometry_type, layer.schema(GPKG.geometry), batches))
        rows += len(layer)
    start = perf_counter()
    for name, geometry_type, schema, batches in ready:
        pyogrio.write_arrow(
            pa.RecordBatchReader.from_batches(schema, batches),
            path,
            layer=name,
            driver=GPKG.driver,
            geometry_name=GPKG.geometry,
            geometry_type=geometry_type,
            crs=crs,
            dataset_options=dict(DATASET_OPTIONS),
            layer_options=dict(LAYER_OPTIONS),
        )
    seconds = perf_counter() - start
    path.unlink()
    return seconds, f"pyogrio, {rows:,} rows"


STEPS: dict[str, Callable[[Path, Kept], Timed]] = {
    step.__name__: step for step in (reading, features, triangulation, statistics, writing)
}


def gain(kept: Kept, rounds: int) -> list[float]:
    """Return the speedup of two processes over this process for SIFT alone, for every round."""
    _start()
    spawn = multiprocessing.get_context("spawn")
    tiles = list(_gray_tiles(kept.gray))
    # First the largest tile in both processes, so that they have started and have memory.
    largest = [max(tiles, key=lambda tile: tile.size)]
    ratios = []
    with ProcessPoolExecutor(2, spawn, initializer=_start) as pool:
        list(map(_detect, largest))
        list(pool.map(_detect, largest * 8))
        for _ in range(rounds):
            seconds = []
            for detect in (map, pool.map):
                start = perf_counter()
                list(detect(_detect, tiles))
                seconds.append(perf_counter() - start)
            ratios.append(seconds[0] / seconds[1])
    return ratios


def _start() -> None:
    import cv2

    keep_freed_memory()
    cv2.setNumThreads(1)


def _detect(tile: Any) -> int:
    return len(_sift().detect(tile, None))


def _sift() -> Any:
    import cv2

    from geomesh.recipe import Recipe

    recipe = Recipe()
    return cv2.SIFT_create(  # type: ignore[attr-defined]
        nOctaveLayers=recipe.sift_octave_layers,
        contrastThreshold=recipe.sift_contrast_threshold,
        edgeThreshold=recipe.sift_edge_threshold,
        sigma=recipe.sift_sigma,
        enable_precise_upscale=True,
    )


def _gray_tiles(path: Path) -> Iterator[Any]:
    import numpy as np

    from geomesh.parallel.tiles import plan_tiles
    from geomesh.raster.grid import Grid

    gray = np.load(path)
    for tile in plan_tiles(Grid(gray.shape[1], gray.shape[0]).extent):
        yield np.ascontiguousarray(gray[tile.read.slices()])


def main(task: str, scene_path: Path, folder: Path, options: Sequence[str]) -> None:
    """Run one task and print its result as JSON."""
    kept = Kept(folder)
    if task == "prepare":
        prepare(scene_path, kept)
    elif task == "gain":
        print(json.dumps(gain(kept, int(options[0]))))
    else:
        print(json.dumps(STEPS[task](scene_path, kept)))


if __name__ == "__main__":
    keep_freed_memory()
    main(sys.argv[1], Path(sys.argv[2]), Path(sys.argv[3]), sys.argv[4:])
