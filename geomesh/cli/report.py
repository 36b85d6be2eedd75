"""`geomesh report`: a page about a mesh, to read and to print."""

from __future__ import annotations

import json
import sys
from typing import Any

import click

from geomesh.cli.console import exit_code, guarded, open_console
from geomesh.cli.options import output_options
from geomesh.cli.outputs import protect_inputs
from geomesh.cli.streams import echo


@click.command()
@click.argument("mesh_file", metavar="MESH")
@click.option("-o", "--output", required=True, metavar="OUT", help="Page to write (.html).")
@click.option(
    "--like",
    "source",
    metavar="SRC",
    help="The raster from which MESH was made, to show beside it and to measure its errors. "
    "Default: the file that MESH records, if it is there and has the same pixels.",
)
@click.option("--title", metavar="TEXT", help="Default: from the name of the raster.")
@output_options
@click.pass_obj
def report(
    debug: bool,
    /,
    mesh_file: str,
    output: str,
    source: str | None,
    title: str | None,
    overwrite: bool,
    progress: str | None,
    as_json: bool,
) -> None:
    """Write a page about MESH (.gpkg), to read and to print.

    OUT shows a map, the image beside the mesh, the certificate in words with the errors, how
    angles, areas and errors are distributed, the worst triangles, the recipe, and the command
    that makes MESH again. It loads nothing from elsewhere.

    \b
    Examples:
      geomesh report mesh.gpkg -o report.html
      geomesh report mesh.gpkg -o report.html --like scene.tif --title "Olinda, 2001"
    """
    console = open_console(progress, quiet=as_json)
    console.start("report", mesh_file)
    figures: dict[str, Any] = {}
    with guarded(console, debug) as failures, console.progress() as tell:
        from geomesh.io.html import check_html
        from geomesh.io.read import read_mesh
        from geomesh.parallel.progress import part_of
        from geomesh.view.report.write import write_report

        protect_inputs([output], [mesh_file, source])
        check_html(output, overwrite=overwrite)
        tell(0.0, "Reading the mesh")
        shown = read_mesh(mesh_file)
        passed = write_report(
            shown,
            output,
            source=source,
            title=title,
            overwrite=overwrite,
            progress=part_of(tell, 0.1, 1),
        ).passed
        figures = {
            "nodes": len(shown.nodes),
            "triangles": len(shown.triangles),
            "certified": passed,
        }
    outcome: dict[str, Any] = {"source": mesh_file, "error": "".join(failures[:1])}
    if not failures:
        outcome = {"source": mesh_file, "like": source, "output": output, **figures}
        text = f"{output}: the report of {mesh_file}"
        console.result(
            [output], figures, text if figures["certified"] else f"{text}, not certified"
        )
    if as_json:
        echo(json.dumps({"results": [outcome], "failed": len(failures)}, indent=2))
    sys.exit(exit_code(failures, printed=as_json))
