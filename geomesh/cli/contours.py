"""`geomesh contours`: the contours of a mesh with heights."""

from __future__ import annotations

import json
import math
import sys
from typing import TYPE_CHECKING, Any

import click

from geomesh.cli.console import exit_code, guarded, open_console
from geomesh.cli.height_options import height_options
from geomesh.cli.options import output_options
from geomesh.cli.outputs import protect_inputs
from geomesh.cli.streams import echo

if TYPE_CHECKING:
    from collections.abc import Mapping


def _heights(_ctx: click.Context, _param: click.Parameter, value: str | None) -> Any:
    """Parse heights such as '100,200,500'."""
    if value is None:
        return None
    try:
        return [float(part) for part in value.split(",") if part.strip()]
    except ValueError as error:
        raise click.BadParameter(f"{value!r}: give heights such as 100,200,500") from error


@click.command()
@click.argument("mesh_file", metavar="MESH")
@click.option("-o", "--output", required=True, metavar="OUT", help="File to write.")
@click.option(
    "--interval",
    type=float,
    metavar="H",
    help="Height from a contour to the next, in the unit of the heights. Default: a round number "
    "that gives 10 to 20 levels.",
)
@click.option(
    "--base",
    type=float,
    default=0.0,
    show_default=True,
    metavar="H",
    help="Height from which the levels are counted.",
)
@click.option(
    "--levels",
    callback=_heights,
    metavar="H,H,...",
    help="The heights of the contours, in rising order, instead of --interval.",
)
@click.option(
    "--index",
    type=int,
    default=5,
    show_default=True,
    metavar="N",
    help="Mark every N-th level, for thick lines and labels. 0: none.",
)
@height_options
@output_options
@click.pass_obj
def contours(
    debug: bool,
    /,
    mesh_file: str,
    output: str,
    interval: float | None,
    base: float,
    levels: list[float] | None,
    index: int,
    z: int | str | None,
    z_factor: float | None,
    overwrite: bool,
    progress: str | None,
    as_json: bool,
) -> None:
    """Write the contours of MESH (.gpkg), whose nodes have heights.

    They are exact on the triangles, joined into longest lines, and never cross. Higher ground is
    to the left of a line. OUT is .gpkg, .geojson, .fgb or .parquet.

    \b
    Examples:
      geomesh contours mesh.gpkg -o contours.gpkg
      geomesh contours mesh.gpkg -o contours.gpkg --interval 10 --index 5
      geomesh contours mesh.gpkg -o shore.geojson --levels 0,2.5
    """
    console = open_console(progress, quiet=as_json)
    console.start("contours", mesh_file)
    with guarded(console, debug) as failures, console.progress() as report:
        from geomesh.io.contours import check_contours, write_contours
        from geomesh.io.read import read_mesh
        from geomesh.parallel.progress import part_of
        from geomesh.terrain.contour_frame import contour_frame, find_levels, height_range

        protect_inputs([output], [mesh_file])
        check_contours(output, overwrite=overwrite)
        report(0.0, "Reading the mesh")
        mesh = read_mesh(mesh_file).with_height(z, 1.0 if z_factor is None else z_factor)
        planned = find_levels(mesh, interval=interval, base=base, levels=levels, index=index)
        lines = contour_frame(mesh, planned, part_of(report, 0.2, 0.6))
        figures = {
            "lines": len(lines),
            "levels": int(lines["level"].nunique()),
            "lowest": None if lines.empty else float(lines["level"].min()),
            "highest": None if lines.empty else float(lines["level"].max()),
            "interval": planned.interval,
            "base": planned.base if planned.interval is not None else None,
            "unit": mesh.height.unit if mesh.height is not None else None,
        }
        write_contours(
            mesh, lines, output, planned, overwrite=overwrite, progress=part_of(report, 0.6, 1)
        )
        told = _describe(figures, height_range(mesh), chosen=planned.chosen)
    outcome: dict[str, Any] = {"source": mesh_file, "error": "".join(failures[:1])}
    if not failures:
        outcome = {"source": mesh_file, "output": output, **figures}
        console.result([output], figures, f"{output}: {told}")
    if as_json:
        echo(json.dumps({"results": [outcome], "failed": len(failures)}, indent=2))
    sys.exit(exit_code(failures, printed=as_json))


def _describe(
    figures: Mapping[str, Any], height_range: tuple[float, float], *, chosen: bool
) -> str:
    """Return the result for people."""
    from geomesh.mesh.height import short_unit

    unit = short_unit(figures["unit"])
    if not figures["lines"]:
        low, high = height_range
        if math.isnan(low):
            return "no contours: no triangle has heights"
        if low == high:
            return f"no contours: the mesh is flat, at {low:g} {unit}"
        return f"no contours: no level lies between the heights {low:g} and {high:g} {unit}"
    lines, levels = (
        f"{count:,} {name if count != 1 else name[:-1]}"
        for name, count in figures.items()
        if name in ("lines", "levels")
    )
    lowest, highest = figures["lowest"], figures["highest"]
    extent = f"at {lowest:g}" if lowest == highest else f"from {lowest:g} to {highest:g}"
    told = f"{lines} at {levels} {extent} {unit}"
    if figures["interval"] is not None:
        told += f", interval {figures['interval']:g} {unit}"
    return told + (" (chosen: give another with --interval)" if chosen else "")
