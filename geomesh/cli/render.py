"""`geomesh render`: write a mesh as a raster."""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING, Any

import click

from geomesh.cli.console import exit_code, guarded, open_console
from geomesh.cli.options import output_options
from geomesh.cli.outputs import protect_inputs
from geomesh.cli.reading_options import numbers
from geomesh.cli.streams import echo, printable
from geomesh.parameters import ALPHA, Alpha

if TYPE_CHECKING:
    from geomesh.surface.fidelity import Fidelity


def _creation(_ctx: click.Context, _param: click.Parameter, value: tuple[str, ...]) -> Any:
    """Parse NAME=VALUE, in the same way as rio."""
    options = {}
    for item in value:
        name, equals, text = item.partition("=")
        if not (name and equals):
            raise click.BadParameter(f"{item!r}: give NAME=VALUE, such as COMPRESS=ZSTD")
        options[name] = text
    return options


@click.command()
@click.argument("mesh_file", metavar="MESH")
@click.option(
    "--like",
    "source",
    required=True,
    metavar="SRC",
    help="The raster that the mesh was made from. It gives the pixels and their values.",
)
@click.option("-o", "--output", required=True, metavar="OUT", help="GeoTIFF to write.")
@click.option(
    "--model",
    type=click.Choice(["linear", "constant"]),
    help="Linear between the nodes of each triangle, or one value per triangle. Default: as the "
    "mesh was refined, else linear.",
)
@click.option(
    "--fit",
    type=click.Choice(["least-squares", "sampled", "stored"]),
    help="Choose the values with the smallest squared error of the pixels, take them from the "
    "raster at the nodes and centroids, or show those that MESH has. Default: stored if MESH was "
    "refined, else least-squares.",
)
@click.option(
    "-b",
    "--bidx",
    callback=numbers,
    metavar="N,N,...",
    help="Bands of SRC; the first is 1. Default: the bands that the mesh was made from.",
)
@click.option(
    "--alpha",
    type=click.Choice(ALPHA),
    help="mask: bands of SRC tagged as alpha, and masks, hide pixels. data: they do not. Default: "
    "as for the mesh.",
)
@click.option(
    "--crs",
    metavar="CRS",
    help="Coordinate system, used instead of SRC's own. Give the same as for the mesh.",
)
@click.option(
    "--co",
    "creation",
    multiple=True,
    callback=_creation,
    metavar="NAME=VALUE",
    help="Creation option of GDAL's GTiff driver, such as COMPRESS=ZSTD (repeatable).",
)
@click.option(
    "--workers",
    type=click.IntRange(min=1),
    metavar="N",
    help="Number of tiles to process at the same time. Default: one per core. The result is the "
    "same for any N.",
)
@output_options
@click.pass_obj
def render(
    debug: bool,
    /,
    mesh_file: str,
    source: str,
    output: str,
    model: Any,
    fit: str | None,
    bidx: list[int] | None,
    alpha: Alpha | None,
    crs: str | None,
    creation: dict[str, str],
    workers: int | None,
    overwrite: bool,
    progress: str | None,
    as_json: bool,
) -> None:
    """Write MESH (.gpkg) as a raster on the pixels of SRC, and print its PSNR.

    OUT has the data type of SRC. It covers the part of SRC that the mesh was made from. Pixels
    outside the mesh get the nodata value of SRC, or OUT gets a mask.

    \b
    Examples:
      geomesh render mesh.gpkg --like scene.tif -o painted.tif
      geomesh render mesh.gpkg --like scene.tif -o flat.tif --model constant
      geomesh render mesh.gpkg --like scene.tif -o painted.tif --co COMPRESS=ZSTD --json
    """
    console = open_console(progress, quiet=as_json)
    console.start("render", mesh_file)
    with guarded(console, debug) as failures, console.progress() as report:
        from geomesh.io.geotiff import check_geotiff
        from geomesh.io.read import read_mesh
        from geomesh.io.render import render_file
        from geomesh.parallel.progress import part_of
        from geomesh.surface.stored import choose

        protect_inputs([output], [mesh_file, source])
        check_geotiff(output, overwrite=overwrite)
        report(0.0, "Reading the mesh")
        shown = read_mesh(mesh_file)
        chosen = choose(shown, model, fit and fit.replace("-", "_"), bidx)
        fidelity = render_file(
            shown,
            source,
            output,
            model=chosen.model,
            fit=chosen.fit,
            bidx=bidx,
            alpha=alpha,
            crs=crs,
            creation=creation,
            overwrite=overwrite,
            workers=workers,
            progress=part_of(report, 0.05, 1),
        )
    outcome: dict[str, Any] = {"source": mesh_file, "error": "".join(failures[:1])}
    if not failures:
        how = {"model": chosen.model, "fit": chosen.fit.replace("_", "-")}
        figures = {**how, **fidelity.summary()}
        outcome = {"source": mesh_file, "like": source, "output": output, **figures}
        if not as_json and progress != "jsonl":
            _print_fidelity(fidelity)
        text = f"{output}: {mesh_file} on the pixels of {source}, PSNR {fidelity.overall:.2f} dB"
        console.result([output], figures, text)
    if as_json:
        echo(json.dumps({"results": [outcome], "failed": len(failures)}, indent=2))
    sys.exit(exit_code(failures, printed=as_json))


def _print_fidelity(fidelity: Fidelity) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    table = Table(title=f"over {fidelity.pixels:,} pixels", title_justify="left")
    table.add_column("band")
    for column in ("PSNR, dB", "RMSE", "peak"):
        table.add_column(column, justify="right")
    rows = zip(fidelity.bands, fidelity.psnr, fidelity.rmse, fidelity.peak, strict=True)
    for band, decibels, rmse, peak in rows:
        table.add_row(Text(printable(band)), f"{decibels:.2f}", f"{rmse:.4g}", f"{peak:.6g}")
    Console(stderr=True).print(table)
