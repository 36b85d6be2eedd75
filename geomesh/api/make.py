"""Functions that make a mesh from a raster, read one from a file, and show the stages."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from geomesh.api.mesh import Mesh
from geomesh.parallel.progress import Progress, reporting
from geomesh.raster.open import Source, open_scene
from geomesh.recipe import DEFAULT_PRESET, Recipe

if TYPE_CHECKING:
    from collections.abc import Sequence
    from concurrent.futures import Executor
    from os import PathLike

    from geomesh.parameters import Alpha
    from geomesh.view.stages import Stages


def mesh_raster(
    source: Source,
    *,
    preset: str = DEFAULT_PRESET,
    recipe: Recipe | None = None,
    bidx: Sequence[int] | None = None,
    nodata: float | None = None,
    alpha: Alpha = "mask",
    unscale: bool = False,
    crs: Any = None,
    bounds: tuple[float, float, float, float] | None = None,
    mask: Any = None,
    mask_layer: str | None = None,
    breaklines: Any = None,
    breaklines_layer: str | None = None,
    name: str | None = None,
    time_limit: float | None = None,
    workers: int | None = None,
    executor: Executor | None = None,
    progress: bool | Progress = False,
    **values: Any,
) -> Mesh:
    """Turn a raster into a triangle mesh.

    Parameters
    ----------
    source : str, PathLike, rasterio dataset, xarray.DataArray, or (array, transform, crs)
    preset : {"adaptive", "features", "paper"}
        "adaptive", the default: nodes are moved, added and removed until the mesh shows the
        raster as well as its goal says: ``nodes=`` a number or a share of the valid pixels,
        ``max_error=`` a bound on the error at every valid pixel, or ``rmse=`` a root mean square
        error. Without a goal: 1 % of the valid pixels, at least twice the nodes of outline and
        breaklines. See docs/presets.md.
        "features": the nodes are SIFT keypoints on Canny edges, at the image's own resolution;
        all of them, or the ``nodes=`` strongest.
        "paper": exactly the published system, at 256 x 256 pixels.
    recipe : Recipe, optional
        Used instead of the preset.
    bidx : sequence of int, optional
        Bands to use; the first band is 1. Default: all except alpha.
    nodata : float, optional
        Used instead of the file's own nodata value, as a stored value. NaN: there is none.
    alpha : {"mask", "data"}
        "mask": bands tagged as alpha and masks in the file or beside it hide pixels.
        "data": they do not, and a band tagged as alpha is an ordinary band.
    unscale : bool
        Use scale * stored value + offset of each band instead of the stored values.
    crs : str, int or pyproj.CRS, optional
        Used instead of the file's own CRS. The raster is not reprojected.
    bounds : (west, south, east, north), optional
        Box in map coordinates: the pixels whose centre is in it are used. In longitude and
        latitude, west may be greater than east, across the antimeridian.
    mask : path, GeoDataFrame, GeoSeries, shapely geometry, GeoJSON mapping or WKT, optional
        Polygons of the area of interest, in any CRS: the pixels whose centre is in one are used.
        A geometry without a CRS is in the raster's coordinates; a GeoJSON mapping is in
        longitude and latitude.
    mask_layer : str, optional
        The layer to use, if `mask` is a file with several.
    breaklines : path, GeoDataFrame, GeoSeries, shapely geometry, GeoJSON mapping, WKT or "canny"
        Lines that become edges of the mesh, and rings of polygons, in any CRS, as for `mask`.
        "canny": the long, strong edges of the image. Optional.
    breaklines_layer : str, optional
        The layer to use, if `breaklines` is a file with several.
    name : str, optional
        Name of the source in messages and metadata. Default: its path.
    time_limit : float, optional
        Seconds after which refinement ends early, with a certified mesh and a warning. Only for
        a preset that refines.
    workers : int, optional
        Number of tiles to process at the same time. Default: one per core. Any number
        gives the same mesh, bit for bit.
    executor : concurrent.futures.Executor, optional
        Used instead of geomesh's own threads: a pool of processes, or
        ``Client.get_executor()`` of a Dask cluster. The executor of Dask does not report
        its size, so give `workers` too. Its workers open the source by its path.
    progress : bool or callable(fraction, message)
        True shows a progress bar. A callable can raise an exception to cancel.
    **values
        Parameters of the recipe to change, such as ``nodes=5000``.

    Returns
    -------
    Mesh

    Raises
    ------
    GeomeshError
        The message is one line that says what is wrong and what to do.

    Examples
    --------
    >>> import geomesh
    >>> mesh = geomesh.mesh_raster("data_samples/olinda_landsat7_rgb_uint8.tif", nodes=500)
    >>> len(mesh.nodes), mesh.certify().passed
    (500, True)
    """
    from geomesh.parallel.deadline import deadline
    from geomesh.parallel.workers import open_workers
    from geomesh.pipeline.breaklines import read_breaklines
    from geomesh.pipeline.mesh_scene import mesh_scene

    recipe = (recipe or Recipe.from_preset(preset)).with_values(**values)
    if time_limit is not None:
        recipe.require_refinement("time_limit", time_limit)
    scene = open_scene(
        source,
        bidx=bidx,
        nodata=nodata,
        alpha=alpha,
        unscale=unscale,
        crs=crs,
        bounds=bounds,
        mask=mask,
        mask_layer=mask_layer,
        name=name,
    )
    lines = read_breaklines(breaklines, breaklines_layer, scene, recipe)
    is_late = deadline(time_limit)
    with reporting(progress) as report, open_workers(workers, executor) as pool:
        mesh = mesh_scene(scene, recipe, pool, report, breaklines=lines, is_late=is_late)
        return Mesh.of(mesh)


def read_mesh(path: str | PathLike[str]) -> Mesh:
    """Read a mesh from a GeoPackage that geomesh wrote.

    Parameters
    ----------
    path : path-like

    Returns
    -------
    Mesh
        Equal to the mesh that was written, bit for bit.

    Raises
    ------
    MeshFileError
        If the file does not exist or is not a GeoPackage of geomesh. If it does not contain
        the nodes or the triangles. If rows or columns were removed after it was written.
    """
    from geomesh.io.read import read_mesh

    return Mesh.of(read_mesh(path))


def stages(
    source: Source,
    *,
    preset: str = DEFAULT_PRESET,
    recipe: Recipe | None = None,
    bidx: Sequence[int] | None = None,
    nodata: float | None = None,
    alpha: Alpha = "mask",
    unscale: bool = False,
    crs: Any = None,
    bounds: tuple[float, float, float, float] | None = None,
    mask: Any = None,
    mask_layer: str | None = None,
    progress: bool | Progress = False,
    **values: Any,
) -> Stages:
    """Return the result of each stage of the pipeline for a raster.

    If a side of the raster is longer than 2048 pixels, only its middle is shown. Choose
    another part with `bounds`.

    Parameters
    ----------
    source, preset, recipe, bidx, nodata, alpha, unscale, crs, bounds, mask, mask_layer, progress
        As in `mesh_raster`.
    **values
        Parameters of the recipe to change, such as ``canny_low=50``.

    Returns
    -------
    Stages
        The gray image, the Canny edges, the keypoints and the mesh. ``plot()`` draws them next
        to each other.

    Examples
    --------
    >>> import geomesh
    >>> stages = geomesh.stages("data_samples/olinda_landsat7_rgb_uint8.tif")
    >>> stages.gray.shape, stages.edges.any()
    ((352, 349), np.True_)
    """
    from geomesh.view.stages import run_stages

    recipe = (recipe or Recipe.from_preset(preset)).with_values(**values)
    scene = open_scene(
        source,
        bidx=bidx,
        nodata=nodata,
        alpha=alpha,
        unscale=unscale,
        crs=crs,
        bounds=bounds,
        mask=mask,
        mask_layer=mask_layer,
    )
    with reporting(progress) as report:
        return run_stages(scene, recipe, report)
