"""`geomesh tiles`: a mesh as the tiles of a map on the web."""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING, Any

import click
from click.core import ParameterSource

from geomesh.cli.console import exit_code, guarded, open_console
from geomesh.cli.kinds import is_mesh
from geomesh.cli.options import column_names, output_options, raster_options
from geomesh.cli.outputs import protect_inputs
from geomesh.cli.recipe_options import build_recipe
from geomesh.cli.streams import echo
from geomesh.errors import RecipeError

if TYPE_CHECKING:
    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.parallel.progress import Progress
    from geomesh.parallel.workers import Workers
    from geomesh.pipeline.tiles import TileSummary

# Options of this command that are not about how a raster becomes a mesh.
_OWN = frozenset(
    (
        *("source", "output", "page", "min_zoom", "max_zoom", "columns"),
        *("workers", "overwrite", "progress", "as_json", "until_eof"),
    )
)


@click.command()
@click.argument("source", metavar="MESH|SRC")
@click.option("-o", "--output", required=True, metavar="OUT", help="File to write: .pmtiles.")
@click.option(
    "--page",
    metavar="HTML",
    help="Write a page that shows the tiles too. It holds tiles of up to 30 MB itself.",
)
@click.option(
    "--min-zoom",
    type=click.IntRange(0, 22),
    metavar="Z",
    help="The farthest zoom. Default: one at which the mesh fits half a tile.",
)
@click.option(
    "--max-zoom",
    type=click.IntRange(0, 22),
    metavar="Z",
    help="The nearest zoom. Default: one that shows about each pixel of the raster, and each node "
    "of the mesh. Maps show its tiles enlarged when they are nearer.",
)
@click.option(
    "--columns",
    callback=column_names,
    metavar="NAME,...",
    help="Attributes of the triangles. Default: id, area, count, color and all means.",
)
@raster_options
@click.option(
    "--workers",
    type=click.IntRange(min=1),
    metavar="N",
    help="Number of tiles of the raster to process at the same time. Default: one per core.",
)
@output_options
@click.pass_obj
def tiles(
    debug: bool,
    /,
    source: str,
    output: str,
    page: str | None,
    min_zoom: int | None,
    max_zoom: int | None,
    columns: tuple[str, ...] | None,
    workers: int | None,
    overwrite: bool,
    progress: str | None,
    as_json: bool,
    reading: dict[str, Any],
    recipe_options: dict[str, Any],
) -> None:
    """Write a mesh as vector tiles for maps on the web: one .pmtiles file.

    Each zoom shows a whole mesh: the nearest ones MESH (.gpkg) or the mesh of the raster SRC
    itself, the others one with fewer nodes. All tiles are read again: no triangle is missing, and
    no pixel between triangles is a gap.

    \b
    Examples:
      geomesh tiles mesh.gpkg -o map.pmtiles --page map.html
      geomesh tiles scene.tif -o map.pmtiles --nodes 20000
      geomesh tiles mesh.gpkg -o map.pmtiles --min-zoom 5 --max-zoom 12 --columns color,count
    """
    console = open_console(progress, quiet=as_json)
    console.start("tiles", source)
    summary, holds = None, False
    with guarded(console, debug) as failures, console.progress() as report:
        from geomesh.io.html import check_html
        from geomesh.parallel.progress import part_of
        from geomesh.parallel.workers import open_workers
        from geomesh.pipeline.tiles import check_tiles, write_tiles
        from geomesh.view.tiles_page.page import write_page

        outputs = [output, *filter(None, [page])]
        protect_inputs(outputs, [source, reading["mask"], recipe_options["recipe_file"]])
        check_tiles(output, overwrite=overwrite)
        if page is not None:
            check_html(page, overwrite=overwrite)
        with open_workers(workers) as pool:
            mesh, rest = _open(source, reading, recipe_options, pool, report)
            summary = write_tiles(
                *(mesh, output, pool),
                min_zoom=min_zoom,
                max_zoom=max_zoom,
                columns=columns,
                overwrite=overwrite,
                progress=part_of(report, rest, 1),
            )
        if page is not None:
            holds = write_page(page, output, overwrite=overwrite)
    outcome: dict[str, Any] = {"source": source, "error": "".join(failures[:1])}
    if not failures and summary is not None:
        figures = _figures(summary)
        outcome = {"source": source, "output": output, "page": page, **figures}
        console.result(outputs, figures, *_lines(output, page, summary, holds=holds))
    if as_json:
        echo(json.dumps({"results": [outcome], "failed": len(failures)}, indent=2))
    sys.exit(exit_code(failures, printed=as_json))


def _open(
    source: str,
    reading: dict[str, Any],
    recipe_options: dict[str, Any],
    workers: Workers,
    progress: Progress,
) -> tuple[TriangleMesh, float]:
    """Return the mesh of a file or of a raster, and the share of the work that this was."""
    if is_mesh(source):
        _refuse_options_of_rasters(source)
        from geomesh.io.read import read_mesh

        progress(0.0, "Reading the mesh")
        return read_mesh(source), 0.05
    from geomesh.parallel.progress import part_of
    from geomesh.pipeline.mesh_scene import mesh_scene
    from geomesh.raster.open import open_scene

    recipe = build_recipe(**recipe_options).with_values(statistics=("mean",))
    scene = open_scene(source, **reading)
    _require_crs(scene.grid.crs)
    return mesh_scene(scene, recipe, workers, part_of(progress, 0, 0.5)), 0.5


def _require_crs(crs: Any) -> None:
    """Raise an error before a raster is meshed that has no place on a map."""
    from geomesh.formats.tile_layer import check_crs

    check_crs(crs, "the raster")


def _refuse_options_of_rasters(source: str) -> None:
    """Raise RecipeError if there is an option that would have no effect."""
    context = click.get_current_context()
    for parameter in context.command.params:
        name = parameter.name or ""
        given = context.get_parameter_source(name) is ParameterSource.COMMANDLINE
        if given and name not in _OWN:
            option = max(parameter.opts, key=len)
            raise RecipeError(f"{option} is for a raster, and {source} is a mesh: leave it out")


def _figures(summary: TileSummary) -> dict[str, Any]:
    return {
        "bytes": summary.size,
        "gap_pixels": sum(level.check.gap_pixels for level in summary.levels),
        "levels": [
            {
                "zoom": level.zoom,
                "own": level.own,
                "nodes": level.nodes,
                "triangles": level.triangles,
                "shown": level.check.shown,
                "tiles": level.check.tiles,
                "largest_tile": level.check.largest,
                "pixels": level.check.pixels,
                "gap_pixels": level.check.gap_pixels,
            }
            for level in summary.levels
        ],
    }


def _lines(output: str, page: str | None, summary: TileSummary, *, holds: bool) -> list[str]:
    """Return the result for people."""
    first, last = summary.levels[0].zoom, summary.levels[-1].zoom
    zooms = f"zooms {first} to {last}" if first < last else f"zoom {first}"
    lines = [f"{output}: {zooms}, {summary.size / 1e6:,.1f} MB, complete"]
    for level in summary.levels:
        check = level.check
        small = level.triangles - check.shown
        lines.append(
            f"  zoom {level.zoom:>2}: {level.triangles:>9,} triangles"
            f"{', the mesh itself' if level.own else ''}, {check.tiles:,} "
            f"tile{'s' if check.tiles != 1 else ''}, {check.gap_pixels} gap pixels"
            f"{f' ({small:,} without an area here)' if small else ''}"
        )
    if page is not None:
        inside = "holds the tiles" if holds else f"needs {output} and a web server"
        lines.append(f"{page}: {inside}")
    return lines
