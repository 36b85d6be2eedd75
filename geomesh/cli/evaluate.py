"""`geomesh evaluate`: the paper's Table 1 on any images."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from geomesh.cli.console import exit_code, guarded, open_console, spell
from geomesh.cli.options import output_options
from geomesh.cli.outputs import protect_inputs
from geomesh.cli.reading_options import alpha_option, nodata_option, numbers
from geomesh.cli.streams import echo
from geomesh.errors import EmptyError

if TYPE_CHECKING:
    from geomesh.evaluate.comparison import Comparison
    from geomesh.parameters import Alpha


@click.command()
@click.argument("sources", metavar="SRC...", nargs=-1, required=True)
@click.option("-o", "--output", metavar="CSV", help="Write all results to a CSV file.")
@click.option("--figure", metavar="FIG", help="Draw the distributions (.png, .pdf or .svg).")
@click.option(
    "-b",
    "--bidx",
    callback=numbers,
    metavar="N,N,...",
    help="Bands to use; the first is 1. Default: all except alpha.",
)
@nodata_option
@alpha_option
@click.option(
    "--workers",
    type=click.IntRange(min=1),
    metavar="N",
    help="Number of images to process at the same time. Default: one per core. The results are "
    "the same for any N.",
)
@output_options
@click.pass_obj
def evaluate(
    debug: bool,
    /,
    sources: tuple[str, ...],
    output: str | None,
    figure: str | None,
    bidx: list[int] | None,
    nodata: float | None,
    alpha: Alpha,
    workers: int | None,
    overwrite: bool,
    progress: str | None,
    as_json: bool,
) -> None:
    """Print the paper's Table 1 for images, and other measures of their meshes.

    SRC is a file, a folder (all rasters in it) or a quoted pattern. Every image is evaluated
    twice. First at 256 x 256 pixels: the presets and six baselines get as many nodes as
    `paper` finds. Then at its own resolution (only the middle, if a side is longer than 2048
    pixels): `features`, `adaptive` and the baselines get as many nodes as `features` finds.

    If an image fails, its error is printed, and the tables contain the other images. The exit
    code is then 1. If all images fail, nothing is written.

    \b
    Examples:
      geomesh evaluate scene.tif
      geomesh evaluate scenes/ -o table1.csv --figure table1.png
      geomesh evaluate 'scenes/**/*.tif' --json > table1.json
    """
    console = open_console(progress, quiet=as_json)
    console.start("evaluate", " ".join(sources))
    outputs = [path for path in (output, figure) if path is not None]
    comparison = None
    with guarded(console, debug) as problems:
        with console.progress() as report:
            from geomesh.evaluate.images import find_images
            from geomesh.evaluate.run import evaluate as evaluate_images

            images = find_images(sources)
            protect_inputs(outputs, images)
            _check_outputs(output, figure, overwrite)
            comparison = evaluate_images(
                images, bidx=bidx, nodata=nodata, alpha=alpha, workers=workers, progress=report
            )
        for failure in comparison.failures:
            console.error(failure.code, spell(failure.error))
        if not comparison.records:
            raise EmptyError(
                f"none of {len(images)} images could be evaluated, so nothing is written; see the "
                "errors above"
            )
        if output is not None:
            comparison.to_csv(output, overwrite=overwrite)
        if figure is not None:
            _draw(comparison, figure, overwrite)
    if comparison is None:
        sys.exit(1)
    if as_json:
        echo(json.dumps(comparison.to_dict(), indent=2))
    elif comparison.records and progress != "jsonl":
        from geomesh.cli.evaluate_tables import print_comparison

        print_comparison(comparison)
    if not problems and (outputs or progress == "jsonl"):
        figures = {"images": len(comparison.images), "failed": len(comparison.failures)}
        console.result(outputs, figures, *(f"{path}: written" for path in outputs))
    sys.exit(exit_code(problems or comparison.failures, printed=as_json or not outputs))


def _check_outputs(output: str | None, figure: str | None, overwrite: bool) -> None:
    """Raise an error before the work begins if an output cannot be written."""
    from geomesh.io.atomic import check_place

    if output is not None:
        check_place(Path(output), overwrite=overwrite)
    if figure is not None:
        import geomesh.evaluate.figure  # noqa: F401  (raises an error if matplotlib is missing)
        from geomesh.io.picture import check_picture

        check_picture(figure, overwrite=overwrite)


def _draw(comparison: Comparison, figure: str, overwrite: bool) -> None:
    from geomesh.evaluate.figure import draw_comparison
    from geomesh.io.picture import save_picture

    save_picture(draw_comparison(comparison), figure, overwrite=overwrite)
