"""`geomesh quality`: Ki and the standard measures of a mesh."""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING, Any

import click

from geomesh.cli.console import exit_code, guarded, open_console
from geomesh.cli.options import output_options
from geomesh.cli.outputs import protect_inputs
from geomesh.cli.streams import echo, printable

if TYPE_CHECKING:
    from collections.abc import Mapping


@click.command()
@click.argument("mesh_file", metavar="MESH")
@click.option(
    "-o",
    "--output",
    metavar="OUT",
    help="Write the mesh with all measures as attributes of its triangles.",
)
@click.option(
    "--space",
    type=click.Choice(["image", "map"]),
    default="image",
    show_default=True,
    help="Measure lengths in pixels of the image that was meshed, or in map units.",
)
@click.option(
    "--like",
    "source",
    metavar="SRC",
    help="The raster from which MESH was refined: measure the errors of MESH again, and fail if "
    "they are not those that it records.",
)
@output_options
@click.pass_obj
def quality(
    debug: bool,
    /,
    mesh_file: str,
    output: str | None,
    space: Any,
    source: str | None,
    overwrite: bool,
    progress: str | None,
    as_json: bool,
) -> None:
    """Print Ki and the standard measures of the triangles of MESH (.gpkg).

    \b
    Examples:
      geomesh quality mesh.gpkg
      geomesh quality mesh.gpkg --space map --json
      geomesh quality mesh.gpkg -o measured.gpkg
      geomesh quality mesh.gpkg --like scene.tif
    """
    console = open_console(progress, quiet=as_json)
    console.start("quality", mesh_file)
    with guarded(console, debug) as failures, console.progress() as report:
        from geomesh.io.read import read_mesh
        from geomesh.io.write import check_output, write_mesh
        from geomesh.parallel.progress import part_of

        if output is not None:
            protect_inputs([output], [mesh_file, *([source] if source is not None else [])])
            check_output(output, overwrite=overwrite)
        report(0.0, "Reading the mesh")
        read = read_mesh(mesh_file)
        report(0.2, "Measuring triangles")
        summary = read.quality(space).summary()
        if source is not None:
            from geomesh.surface.verify import verify

            summary["errors"] = verify(read, source, progress=part_of(report, 0.25, 0.4)).summary()
        if output is not None:
            write_mesh(
                read.with_measures(space),
                output,
                overwrite=overwrite,
                progress=part_of(report, 0.4, 1),
            )
    if not failures:
        if as_json:
            echo(json.dumps(summary, indent=2))
        elif progress != "jsonl":
            _print_quality(mesh_file, summary, "pixels" if space == "image" else "map units")
        if output is not None or progress == "jsonl":
            outputs = [] if output is None else [output]
            console.result(outputs, summary, f"{output}: the mesh with these measures, certified")
    sys.exit(exit_code(failures, printed=as_json or output is None))


def _print_quality(mesh_file: str, summary: Mapping[str, Any], unit: str) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    width, height = summary["size"]
    table = Table(
        title=Text(
            f"{printable(mesh_file)}: {summary['nodes']:,} nodes, {summary['triangles']:,} "
            f"triangles, lengths in {unit} of a plane of {width:g} x {height:g}",
            style="table.title",
        ),
        title_justify="left",
        caption=f"{summary['labelling']}. Ki / sqrt(area / nodes) = "
        f"{summary['ki_normalised'] or 0:.3f}",
        caption_justify="left",
    )
    figures = ("mean", "median", "p5", "p95", "min", "max")
    table.add_column("measure", no_wrap=True)
    for figure in figures:
        table.add_column(figure, justify="right")
    for name, values in summary["measures"].items():
        shown = (values[figure] for figure in figures)
        table.add_row(name, *("" if value is None else f"{value:.4g}" for value in shown))
    console = Console()
    if not console.is_terminal:
        console.width = 120
    console.print(table)
    for band, errors in summary.get("errors", {}).get("bands", {}).items():
        console.print(
            f"{printable(band)}: greatest error {errors['max_error']:.6g}, RMSE "
            f"{errors['rmse']:.6g}, as recorded",
            markup=False,
        )
    for limit, share in summary["share_min_angle_under"].items():
        console.print(f"smallest angle under {limit} degrees: {share or 0:.2%} of the triangles")
