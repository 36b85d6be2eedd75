"""`geomesh view`: a mesh as a web map in one file."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import click

from geomesh.cli.console import exit_code, guarded, open_console
from geomesh.cli.options import column_names, output_options
from geomesh.cli.outputs import protect_inputs
from geomesh.cli.streams import echo


@click.command()
@click.argument("mesh_files", metavar="MESH [MESH]", nargs=-1, required=True)
@click.option("-o", "--output", required=True, metavar="OUT", help="Web page (.html) to write.")
@click.option(
    "--column",
    metavar="COLUMN",
    help="Attribute of the triangles that is shown first, or color. Default: the colours of the "
    "image, or the heights of a DEM (meshed with --z).",
)
@click.option(
    "--columns",
    callback=column_names,
    metavar="NAME,...",
    help="Attributes in the page, or none. Default: all of a mesh with up to 200,000 triangles; "
    "of a larger one the number of pixels, the means and the classes. Measures of shape are always "
    "there.",
)
@click.option("--title", metavar="TEXT", help="Title of the page. Default: the name of MESH.")
@click.option(
    "--basemap",
    metavar="URL",
    help="Address of web tiles, such as https://host/{z}/{x}/{y}.png. They are loaded only when "
    "the base map is switched on in the page.",
)
@click.option(
    "--embed",
    metavar="SRC",
    help="A raster for the right side of a swipe: the one that was meshed, or another one of the "
    "same place, in any CRS.",
)
@output_options
@click.pass_obj
def view(
    debug: bool,
    /,
    mesh_files: tuple[str, ...],
    output: str,
    column: str | None,
    columns: tuple[str, ...] | None,
    title: str | None,
    basemap: str | None,
    embed: str | None,
    overwrite: bool,
    progress: str | None,
    as_json: bool,
) -> None:
    """Write MESH (.gpkg) as a web map: one page that opens from disk, without a network.

    The page shows the triangles in the colours of the image or by an attribute. A click on a
    triangle shows all its attributes. Two meshes are shown side by side, with a swipe.

    \b
    Examples:
      geomesh view mesh.gpkg -o map.html
      geomesh view mesh.gpkg -o map.html --embed scene.tif
      geomesh view before.gpkg after.gpkg -o change.html
      geomesh view dem.gpkg -o map.html --column slope --columns slope,aspect
    """
    if len(mesh_files) > 2:
        raise click.UsageError(f"one or two meshes make a map, not {len(mesh_files)}")
    console = open_console(progress, quiet=as_json)
    console.start("view", mesh_files[0])
    with guarded(console, debug) as failures, console.progress() as report:
        from geomesh.io.html import check_html
        from geomesh.io.read import read_mesh
        from geomesh.parallel.progress import part_of
        from geomesh.view.web_map.page import MapOptions
        from geomesh.view.web_map.write import write_map

        protect_inputs([output], [*mesh_files, embed])
        check_html(output, overwrite=overwrite)
        options = MapOptions(column, columns, title, basemap)
        report(0.0, "Reading the mesh")
        meshes = [read_mesh(path) for path in mesh_files]
        write_map(
            *(meshes, output, options),
            names=[Path(path).name for path in mesh_files],
            embed=embed,
            overwrite=overwrite,
            progress=part_of(report, 0.3, 1),
        )
    outcome: dict[str, Any] = {"sources": list(mesh_files), "error": "".join(failures[:1])}
    if not failures:
        size = Path(output).stat().st_size
        triangles = sum(len(mesh.triangles) for mesh in meshes)
        figures = {"triangles": triangles, "bytes": size}
        outcome = {"sources": list(mesh_files), "output": output, **figures}
        told = f"a map of {triangles:,} triangles, {size / 1e6:.2f} MB; open it in a browser"
        console.result([output], figures, f"{output}: {told}")
    if as_json:
        echo(json.dumps({"results": [outcome], "failed": len(failures)}, indent=2))
    sys.exit(exit_code(failures, printed=as_json))
