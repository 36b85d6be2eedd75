"""Write the report of a mesh."""

from __future__ import annotations

from typing import TYPE_CHECKING

from geomesh.io.html import check_html, write_html
from geomesh.parallel.progress import Progress, part_of, reporting
from geomesh.parallel.workers import open_workers
from geomesh.raster.crs import crs_label
from geomesh.view.report.again import how_again
from geomesh.view.report.beside import pairs
from geomesh.view.report.content import Figure, Report
from geomesh.view.report.errors import opened_original, recorded_errors, refinement_of
from geomesh.view.report.histograms import histograms
from geomesh.view.report.markers import marked
from geomesh.view.report.page import html
from geomesh.view.report.pictures import map_picture
from geomesh.view.report.settings import settings, source_facts
from geomesh.view.report.spelling import spell
from geomesh.view.report.statements import about_errors, in_words
from geomesh.view.report.worst import worst_triangles
from geomesh.view.thumbnail import colors_of

if TYPE_CHECKING:
    from collections.abc import Iterator
    from os import PathLike

    from geomesh.mesh.certificate import Certificate
    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.raster.open import Source
    from geomesh.view.report.errors import Errors, Original

# Bands whose PSNR is among the key figures.
_MOST_BANDS = 3


def write_report(
    mesh: TriangleMesh,
    path: str | PathLike[str],
    *,
    source: Source | None = None,
    title: str | None = None,
    overwrite: bool = False,
    progress: bool | Progress = False,
) -> Report:
    """Write the report of a mesh: one page of HTML to read and print, which loads nothing.

    Parameters
    ----------
    mesh : TriangleMesh
    path : path-like
        A file .html.
    source : path, rasterio dataset, xarray.DataArray, or (array, transform, crs), optional
        The raster from which the mesh was made, to show beside the mesh and to measure its
        errors. Default: the file that the mesh records, if it is there and has these pixels.
    title : str, optional
        Default: from the name of the raster.
    overwrite : bool
        Replace an existing file.
    progress : bool or callable(fraction, message)

    Returns
    -------
    Report
        What the page shows.

    Raises
    ------
    OutputError
        If the file cannot be written; then an existing file does not change.
    GeomeshError
        If `source` cannot be read, or does not have the pixels of the mesh.
    """
    check_html(path, overwrite=overwrite)
    with reporting(progress) as report:
        shown = describe(mesh, source, title, part_of(report, 0, 0.95))
        page = html(shown)
        report(0.95, "Writing the report")
        write_html(page, path, overwrite=overwrite)
    return shown


def describe(
    mesh: TriangleMesh, source: Source | None, title: str | None, progress: Progress
) -> Report:
    """Return what the report of a mesh shows; the parameters are those of `write_report`."""
    progress(0.0, "Checking the mesh")
    certificate = mesh.certify()
    progress(0.1, "Measuring triangles")
    quality = mesh.quality()
    made = mesh.provenance
    preset, rows = ("", ()) if made is None else settings(made.recipe)
    with (
        open_workers() as workers,
        opened_original(mesh, source, workers, part_of(progress, 0.2, 0.7)) as original,
    ):
        errors = recorded_errors(mesh) if original is None else original.errors
        progress(0.7, "Drawing the pictures")
        shown = pairs(mesh, original, workers, part_of(progress, 0.7, 0.8))
        again = how_again(mesh, original)
        note = _note_on_pairs(mesh, original)
    progress(0.8, "Drawing the map")
    worst = tuple(worst_triangles(mesh, quality.table["min_angle"], errors))
    return Report(
        title=title if title and title.strip() else _title(mesh),
        subtitle=_subtitle(mesh),
        passed=certificate.passed,
        figures=tuple(_figures(mesh, certificate, errors)),
        map=marked(mesh, map_picture(mesh), worst),
        pairs=shown,
        pairs_note=note,
        accuracy=tuple(about_errors(mesh, errors)),
        statements=tuple(in_words(certificate)),
        histograms=tuple(histograms(mesh, quality, errors)),
        worst=worst,
        quality=quality.summary(),
        source=tuple(source_facts(mesh)),
        settings=rows,
        preset=preset,
        warnings=() if made is None else made.warnings,
        again=again,
    )


def _title(mesh: TriangleMesh) -> str:
    if mesh.provenance is None:
        return "Mesh"
    name = mesh.provenance.source.name
    return f"Mesh of {name.replace(chr(92), '/').rstrip('/').rpartition('/')[2] or name}"


def _subtitle(mesh: TriangleMesh) -> str:
    grid, made = mesh.grid, mesh.provenance
    crs = "no CRS" if grid.crs is None else crs_label(grid.crs)
    preset = "" if made is None else f"preset {made.recipe.preset}, "
    return f"{preset}{grid.width:,} × {grid.height:,} pixels, {crs}"


def _figures(
    mesh: TriangleMesh, certificate: Certificate, errors: Errors | None
) -> Iterator[Figure]:
    yield Figure("Nodes", f"{len(mesh.nodes):,}")
    yield Figure("Triangles", f"{len(mesh.triangles):,}")
    refinement = refinement_of(mesh)
    allowed = "" if refinement is None else f"{refinement.min_angle_floor:g}° allowed"
    yield Figure("Smallest angle", f"{certificate.min_angle:.2f}°", allowed)
    if errors is None:
        return
    several = len(errors.bands) > 1
    bounded = refinement is not None and refinement.goal == "max_error"
    for k, band in enumerate(errors.bands[:_MOST_BANDS]):
        of = f", {band.name}" if several else ""
        if bounded and refinement is not None:
            limit = refinement.limits[k]
            bound = f"bound {limit:.6g}" + (", not reached" if band.max_error > limit else "")
            yield Figure(f"Greatest error{of}", f"{band.max_error:.6g}", bound)
        if not (bounded and several):
            yield Figure(f"PSNR{of}", f"{band.psnr:.2f} dB", f"RMSE {spell(band.rmse)}")


def _note_on_pairs(mesh: TriangleMesh, original: Original | None) -> str:
    if original is not None:
        shown = "linear between the values at its nodes"
        if original.surface.model == "constant":
            shown = "with one value for each triangle"
        found = "" if original.given else " The raster was found where the mesh records it."
        return f"The raster, and the mesh painted on its pixels, {shown}.{found}"
    return (
        "The mesh, in the mean colours of its triangles. The report was made without the raster, "
        "so there is no image beside it."
        if colors_of(mesh) is not None
        else "The mesh has no colours, and the report was made without its raster."
    )
