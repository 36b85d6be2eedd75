"""A raster in, a mesh file out: what `geomesh mesh` does for each source."""

from __future__ import annotations

from collections.abc import Iterable
from os import PathLike
from typing import Any

from geomesh.io.gdal_process import WriterPool
from geomesh.io.write import open_writer
from geomesh.mesh.triangle_mesh import TriangleMesh
from geomesh.parallel.memory import trim_memory
from geomesh.parallel.progress import Progress, part_of
from geomesh.parallel.workers import Workers
from geomesh.parameters import LayerName
from geomesh.pipeline.mesh_scene import mesh_scene
from geomesh.raster.open import Source, open_scene
from geomesh.recipe import Recipe


def mesh_file(
    source: Source,
    path: str | PathLike[str],
    *,
    recipe: Recipe,
    workers: Workers,
    writer_pool: WriterPool,
    progress: Progress,
    layers: Iterable[LayerName] | None = None,
    driver: str | None = None,
    overwrite: bool = False,
    **reading: Any,
) -> TriangleMesh:
    """Turn a raster into a mesh file, writing the edges while triangles are measured.

    Parameters
    ----------
    source : str, PathLike, rasterio dataset, xarray.DataArray, or (array, transform, crs)
    path : path-like
    recipe : Recipe
    workers : Workers
        May work on one source after another.
    writer_pool : WriterPool
        So may they.
    progress : callable(fraction, message)
        May raise to cancel.
    layers, driver, overwrite
        As in `geomesh.io.write.write_mesh`.
    **reading
        As in `geomesh.raster.open.open_scene`.

    Returns
    -------
    TriangleMesh

    Raises
    ------
    GeomeshError
        With one line that says what is wrong and what to do; an old file stays as it was.
    """
    with open_writer(
        path, layers=layers, driver=driver, overwrite=overwrite, writer_pool=writer_pool
    ) as writer:
        scene = open_scene(source, **reading)

        def begin(shaped: TriangleMesh) -> None:
            trim_memory()  # detecting takes more than what follows
            writer.begin(shaped)

        mesh = mesh_scene(scene, recipe, workers, part_of(progress, 0, 0.8), shaped=begin)
        trim_memory()  # GDAL's cache, now that the pixels are read
        writer.finish(mesh, part_of(progress, 0.8, 1))
    return mesh
