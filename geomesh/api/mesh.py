"""Mesh: a triangle mesh with methods that write, refine, draw, compare and measure it."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Any

import numpy as np

from geomesh.mesh.triangle_mesh import TriangleMesh
from geomesh.parallel.progress import Progress, reporting

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence
    from concurrent.futures import Executor
    from os import PathLike
    from pathlib import Path

    import geopandas as gpd

    from geomesh.parameters import Alpha, Effort, LayerName, Model
    from geomesh.pipeline.tiles import TileSummary
    from geomesh.raster.open import Source
    from geomesh.surface.accuracy import Accuracy
    from geomesh.surface.fidelity import Fidelity
    from geomesh.terrain.volume import Volume
    from geomesh.view.web_map.write import NotebookMap


@dataclass(frozen=True, eq=False, repr=False)
class Mesh(TriangleMesh):
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

    def to_file(
        self,
        path: str | PathLike[str],
        *,
        layers: Iterable[LayerName] | None = None,
        driver: str | None = None,
        overwrite: bool = False,
        solid: float | None = None,
        precision: int | None = None,
        columns: Iterable[str] | None = None,
        progress: Callable[[float, str], None] | None = None,
    ) -> Path:
        """Write the mesh to a file; see `geomesh.io.write.write_mesh`.

        Parameters
        ----------
        path : path-like
        layers : iterable of {"triangles", "edges", "nodes"}, optional
            By default all three in a GeoPackage, and the triangles in other formats.
        driver : str, optional
            Name of a format (see docs/formats.md). Default: from the extension of `path`.
        overwrite : bool
            Replace an existing file.
        solid : float, optional
            Of an STL file: write a closed solid with its base at this height.
        precision : int, optional
            Of GeoJSON: number of decimals of longitudes and latitudes, 0 to 13. Default: 7, and
            more if a triangle would collapse. Nodes of triangles that would collapse have more.
        columns : iterable of str, optional
            Of GeoJSON, FlatGeobuf and GeoParquet: the only attributes to write, in this order;
            an empty one for none. Default: all.
        progress : callable(fraction, message), optional
        """
        from geomesh.formats.format import WriteOptions
        from geomesh.io.write import write_mesh

        columns = (columns,) if isinstance(columns, str) else columns
        chosen = None if columns is None else tuple(columns)
        return write_mesh(
            *(self, path),
            layers=layers,
            driver=driver,
            overwrite=overwrite,
            options=WriteOptions(solid, precision, chosen),
            progress=progress,
        )

    def to_tiles(
        self,
        path: str | PathLike[str],
        *,
        min_zoom: int | None = None,
        max_zoom: int | None = None,
        columns: Sequence[str] | None = None,
        page: str | PathLike[str] | None = None,
        overwrite: bool = False,
        workers: int | None = None,
        progress: bool | Progress = False,
    ) -> TileSummary:
        """Write the mesh as vector tiles for maps on the web, a whole mesh at each zoom.

        All tiles are read again. A file with a gap, or without one of its triangles, is not
        written.

        Parameters
        ----------
        path : path-like
            Ends in .pmtiles.
        min_zoom, max_zoom : int, optional
            Default: from a zoom at which the mesh fits half a tile to one that shows about
            each pixel of the raster, and each node of the mesh.
        columns : sequence of str, optional
            Attributes of the triangles. Default: id, area, count, color and all means.
        page : path-like, optional
            Write a page that shows the tiles too.
        overwrite : bool
            Replace existing files.
        workers, progress
            As in `mesh_raster`.

        Returns
        -------
        TileSummary
            The zooms, with the number of triangles, tiles and gap pixels of each.

        Raises
        ------
        GeomeshError
            If the mesh has no place on a map on the web, or a file cannot be written.
        """
        from geomesh.parallel.workers import open_workers
        from geomesh.pipeline.tiles import check_tiles, write_tiles
        from geomesh.view.tiles_page.page import check_page, write_page

        check_tiles(path, overwrite=overwrite)
        if page is not None:
            check_page(page, overwrite=overwrite)
        with reporting(progress) as report, open_workers(workers) as pool:
            summary = write_tiles(
                *(self, path, pool),
                min_zoom=min_zoom,
                max_zoom=max_zoom,
                columns=columns,
                overwrite=overwrite,
                progress=report,
            )
        if page is not None:
            write_page(page, path, overwrite=overwrite)
        return summary

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

    def psnr(self, source: Source, **options: Any) -> Fidelity:
        """Return how faithfully the mesh shows a raster.

        See `geomesh.surface.fidelity.measure_fidelity`.
        """
        from geomesh.surface.fidelity import measure_fidelity

        return measure_fidelity(self, source, **options)

    def verify(self, source: Source, **options: Any) -> Accuracy:
        """Measure the errors of a refined mesh again, and compare them with the recorded ones.

        See `geomesh.surface.verify.verify`.
        """
        from geomesh.surface.verify import verify

        return verify(self, source, **options)

    def surface_area(self) -> float:
        """Return the area of the surface in space, in square metres.

        Triangles without heights are left out. The mesh needs heights: see `with_height`.
        """
        return float(np.nansum(self.with_height().attributes("triangles")["area_3d"]))

    def volume(self, base: Any = None, *, progress: bool | Progress = False) -> Volume:
        """Return the volume between the surface and a base.

        Parameters
        ----------
        base : float, Mesh, path, or raster, optional
            A level in the unit of the mesh's heights; another mesh, or the GeoPackage of one; or
            a raster of heights, of which each pixel is a prism. Default: the lowest height of
            the mesh.
        progress : bool or callable(fraction, message)

        Returns
        -------
        Volume
            `cut`, above the base; `fill`, below it; and `net`, in cubic metres.

        Examples
        --------
        >>> import geomesh
        >>> mesh = geomesh.mesh_raster("data_samples/rmnp_dem.tif", nodes=200, z=1)
        >>> found = mesh.volume(3000)
        >>> bool(found.net == found.cut - found.fill)
        True
        """
        from geomesh.pipeline.volume import measure_volume

        with reporting(progress) as report:
            return measure_volume(self.with_height(), base, report)

    def render(self, source: Source, path: str | PathLike[str], **options: Any) -> Fidelity:
        """Write the mesh as a raster on the pixels of `source`.

        See `geomesh.io.render.render_file`.
        """
        from geomesh.io.render import render_file

        return render_file(self, source, path, **options)

    def to_report(
        self,
        path: str | PathLike[str],
        *,
        source: Source | None = None,
        title: str | None = None,
        overwrite: bool = False,
    ) -> Path:
        """Write a page of HTML about the mesh, to read and to print, which loads nothing.

        Parameters
        ----------
        path : path-like
            A file .html.
        source : path, rasterio dataset, xarray.DataArray, or (array, transform, crs), optional
            The raster from which the mesh was made, to show beside the mesh and to measure its
            errors. Default: the file that the mesh records, if it is there and has the same
            pixels.
        title : str, optional
            Default: from the name of the raster.
        overwrite : bool
            Replace an existing file.

        Raises
        ------
        OutputError
            If the file cannot be written; then an existing file does not change.
        GeomeshError
            If `source` cannot be read, or does not have the pixels of the mesh.
        """
        from pathlib import Path

        from geomesh.view.report.write import write_report

        write_report(self, path, source=source, title=title, overwrite=overwrite)
        return Path(path)

    def contours(
        self,
        interval: float | None = None,
        *,
        base: float = 0.0,
        levels: Sequence[float] | None = None,
        index: int = 5,
    ) -> gpd.GeoDataFrame:
        """Return the contours of the heights: exact on the surface, joined, never crossing.

        Parameters
        ----------
        interval : float, optional
            Contours are at ``base + k * interval``, in the unit of the heights. Default: a round
            number that gives 10 to 20 levels.
        base : float
        levels : sequence of float, optional
            The levels themselves, in rising order, instead of an interval.
        index : int
            Every `index`-th level is marked, for thick lines and labels. 0: none.

        Returns
        -------
        geopandas.GeoDataFrame
            In the CRS of the mesh, with the columns `level`, `index`, `closed`, `length` (in
            metres) and LineString Z. Higher ground is to the left of a line.

        Raises
        ------
        BandError
            If the mesh has no heights and several bands: see `with_height`.
        LevelError
            If a value is not valid, or there would be more than 10,000 levels.
        """
        from geomesh.terrain.contour_frame import contour_frame, find_levels

        mesh = self.with_height()
        found = find_levels(mesh, interval=interval, base=base, levels=levels, index=index)
        return contour_frame(mesh, found)

    def plot(self, column: str = "color", **options: Any) -> Any:
        """Draw the mesh with matplotlib, filled by `column`; see `geomesh.view.plot.plot_mesh`."""
        from geomesh.view.plot import plot_mesh

        return plot_mesh(self, column, **options)

    def to_html(
        self,
        path: str | PathLike[str],
        *,
        other: Mesh | None = None,
        column: str | None = None,
        columns: Iterable[str] | None = None,
        title: str | None = None,
        basemap: str | None = None,
        embed: Source | None = None,
        overwrite: bool = False,
        progress: bool | Progress = False,
    ) -> Path:
        """Write the mesh as a web map: one HTML file that opens from disk, without a network.

        Parameters
        ----------
        path : path-like
            Named .html.
        other : Mesh, optional
            A second mesh in the same CRS, on the right side of a swipe.
        column : str, optional
            The attribute that is shown first: "color" (the colours of the image), or a column of
            ``mesh.attributes("triangles")``. Default: the colours, or the heights of a DEM.
        columns : iterable of str, optional
            Attributes in the page. Default: all of a mesh with up to 200,000 triangles; of a
            larger one the number of pixels, the means and the classes. Measures of shape are
            always there.
        title : str, optional
        basemap : str, optional
            Address of web tiles with {z}, {x} and {y}, which the user can turn on.
        embed : path, rasterio dataset, xarray.DataArray, or (array, transform, crs), optional
            A raster for the right side of a swipe, such as the one that was meshed.
        overwrite : bool
            Replace an existing file.
        progress : bool or callable(fraction, message)

        Raises
        ------
        OutputError
            If the file cannot be written, there are more than 3 million triangles, or a column
            does not exist.
        """
        from geomesh.view.web_map.page import MapOptions
        from geomesh.view.web_map.write import write_map

        meshes = [self] if other is None else [self, other]
        options = MapOptions(column, columns, title, basemap)
        with reporting(progress) as report:
            return write_map(
                *(meshes, path, options), embed=embed, overwrite=overwrite, progress=report
            )

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
