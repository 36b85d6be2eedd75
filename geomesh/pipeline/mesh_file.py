"""A raster in, a mesh file out: what `geomesh mesh` does for each source."""

from __future__ import annotations

from collections.abc import Iterable
from os import PathLike
from typing import Any

from geomesh.io.gdal_process import Scribes
from geomesh.io.write import open_writer
from geomesh.mesh.triangle_mesh import LayerName, Mesh
from geomesh.parallel.memory import give_back
from geomesh.parallel.tiles import Progress, part_of
from geomesh.parallel.workers import Crew
from geomesh.pipeline.mesh_scene import mesh_scene
from geomesh.raster.open import Source, open_scene
from geomesh.recipe import Recipe


def mesh_file(
    source: Source,
    path: str | PathLike[str],
    *,
    recipe: Recipe,
    crew: Crew,
    scribes: Scribes,
    progress: Progress,
    layers: Iterable[LayerName] | None = None,
    driver: str | None = None,
    overwrite: bool = False,
    **reading: Any,
) -> Mesh:
    """Turn a raster into a mesh file, writing the edges while triangles are measured.

    Parameters
    ----------
    source : str, PathLike, rasterio dataset, xarray.DataArray, or (array, transform, crs)
    path : path-like
    recipe : Recipe
    crew : Crew
        May work on one source after another.
    scribes : Scribes
        So may they.
    progress : callable(fraction, message)
        May raise to cancel.
    layers, driver, overwrite
        As in `geomesh.io.write.write_mesh`.
    **reading
        As in `geomesh.raster.open.open_scene`.

    Returns
    -------
    Mesh

    Raises
    ------
    GeomeshError
        With one line that says what is wrong and what to do; an old file stays as it was.
    """
    with open_writer(
        path, layers=layers, driver=driver, overwrite=overwrite, scribes=scribes
    ) as writer:
        scene = open_scene(source, **reading)

        def begin(shaped: Mesh) -> None:
            give_back()  # detecting takes more than what follows
            writer.begin(shaped)

        mesh = mesh_scene(scene, recipe, crew, part_of(progress, 0, 0.8), shaped=begin)
        give_back()  # GDAL's cache, now that the pixels are read
        writer.finish(mesh, part_of(progress, 0.8, 1))
    return mesh
