"""`geomesh stages`: draw the result of each stage."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import click

from geomesh.cli.console import exit_code, guarded, open_console
from geomesh.cli.options import output_options, raster_options
from geomesh.cli.outputs import protect_inputs
from geomesh.cli.recipe_options import build_recipe
from geomesh.cli.streams import echo


@click.command()
@click.argument("source", metavar="SRC")
@click.option(
    "-o",
    "--output",
    required=True,
    metavar="FIG",
    help="Picture to write (.png, .pdf or .svg).",
)
@raster_options
@output_options
@click.pass_obj
def stages(
    debug: bool,
    /,
    source: str,
    output: str,
    overwrite: bool,
    progress: str | None,
    as_json: bool,
    reading: dict[str, Any],
    recipe_options: dict[str, Any],
) -> None:
    """Draw the stages of the pipeline for SRC: gray image, Canny edges, keypoints, mesh.

    If a side of the raster is longer than 2048 pixels, only its middle is shown. Choose
    another part with --bounds.

    \b
    Examples:
      geomesh stages scene.tif -o stages.png
      geomesh stages scene.tif -o stages.pdf --preset paper
    """
    console = open_console(progress, quiet=as_json)
    console.start("stages", source)
    with guarded(console, debug) as failures, console.progress() as report:
        from geomesh.io.picture import check_picture, save_picture
        from geomesh.raster.open import open_scene
        from geomesh.view.stages import draw_stages, run_stages

        recipe = build_recipe(**recipe_options)
        protect_inputs([output], [source, reading["mask"], recipe_options["recipe_file"]])
        check_picture(output, overwrite=overwrite)
        scene = open_scene(source, **reading)
        results = run_stages(scene, recipe, report)
        save_picture(draw_stages(results, Path(source).name), output, overwrite=overwrite)
    outcome: dict[str, Any] = {"source": source, "error": "".join(failures[:1])}
    if not failures:
        figures = {"nodes": len(results.mesh.nodes), "triangles": len(results.mesh.triangles)}
        outcome = {"source": source, "output": output, **figures}
        console.result([output], figures, f"{output}: the stages of {source}")
    if as_json:
        echo(json.dumps({"results": [outcome], "failed": len(failures)}, indent=2))
    sys.exit(exit_code(failures, printed=as_json))
