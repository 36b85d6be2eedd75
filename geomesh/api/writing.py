"""Methods of a mesh that write files."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from geomesh.mesh.triangle_mesh import TriangleMesh
from geomesh.parallel.progress import reporting

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence
    from os import PathLike
    from pathlib import Path

    from geomesh.parallel.progress import Progress
    from geomesh.parameters import LayerName
    from geomesh.pipeline.tiles import TileSummary
    from geomesh.raster.open import Source
    from geomesh.surface.fidelity import Fidelity


class WritingMesh(TriangleMesh):
    """A mesh that can be written: layers, maps, reports, tiles and rasters."""

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

    def to_html(
        self,
        path: str | PathLike[str],
        *,
        other: TriangleMesh | None = None,
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
        from geomesh.io.html import check_html
        from geomesh.parallel.workers import open_workers
        from geomesh.pipeline.tiles import check_tiles, write_tiles
        from geomesh.view.tiles_page.page import write_page

        check_tiles(path, overwrite=overwrite)
        if page is not None:
            check_html(page, overwrite=overwrite)
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

    def render(self, source: Source, path: str | PathLike[str], **options: Any) -> Fidelity:
        """Write the mesh as a raster on the pixels of `source`.

        See `geomesh.io.render.render_file`.
        """
        from geomesh.io.render import render_file

        return render_file(self, source, path, **options)
