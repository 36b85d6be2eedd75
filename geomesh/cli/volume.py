"""`geomesh volume`: what lies between the surface of a mesh and a base."""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING

import click

from geomesh.cli.console import exit_code, guarded, open_console
from geomesh.cli.height_options import height_options
from geomesh.cli.options import message_options
from geomesh.cli.streams import echo

if TYPE_CHECKING:
    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.terrain.volume import Volume


@click.command()
@click.argument("mesh_file", metavar="MESH")
@click.option(
    "--base",
    metavar="LEVEL|FILE",
    help="A height, in the unit of MESH; another mesh (.gpkg); or a raster of heights. "
    "Default: the lowest height of MESH.",
)
@height_options
@message_options
@click.pass_obj
def volume(
    debug: bool,
    /,
    mesh_file: str,
    base: str | None,
    z: int | str | None,
    z_factor: float | None,
    progress: str | None,
    as_json: bool,
) -> None:
    """Measure the volume between the surface of MESH (.gpkg) and a base.

    Cut is the volume above the base, fill the volume below it: what has to be taken away and
    brought to make the ground as the base is. Net is cut minus fill.

    \b
    Examples:
      geomesh volume terrain.gpkg --base 2450
      geomesh volume after.gpkg --base before.gpkg --json
      geomesh volume terrain.gpkg --base other_dem.tif
    """
    console = open_console(progress, quiet=as_json)
    console.start("volume", mesh_file)
    with guarded(console, debug) as failures, console.progress() as report:
        from geomesh.io.read import read_mesh
        from geomesh.pipeline.volume import lowest, measure_volume

        report(0.0, "Reading the mesh")
        mesh = read_mesh(mesh_file).with_height(z, 1.0 if z_factor is None else z_factor)
        level = _level(base)
        if base is None:
            level = lowest(mesh)
        found = measure_volume(mesh, base if level is None else level, report)
        unit = "m3" if mesh.grid.crs is not None else "map units2 x m"
    if not failures:
        about = {"base": base if level is None else level, "unit": unit, **found.to_dict()}
        if as_json:
            echo(json.dumps(about, indent=2))
        console.result([], about, *_lines(mesh, found, _from(base, level, mesh), unit))
    sys.exit(exit_code(failures, printed=as_json))


def _level(base: str | None) -> float | None:
    """Return the base as a number; None if it is a file."""
    try:
        return None if base is None else float(base)
    except ValueError:
        return None


def _from(base: str | None, level: float | None, mesh: TriangleMesh) -> str:
    """Return the words for a base."""
    if level is None or mesh.height is None:
        return f"over {base}"
    return f"over {level:,.10g} {mesh.height.plural}"


def _lines(mesh: TriangleMesh, found: Volume, base: str, unit: str) -> list[str]:
    """Return the result as text."""
    area = "m2" if unit == "m3" else "map units2"
    lines = [f"{len(mesh.triangles):,} triangles {base}:"]
    for what, volume, ground in (
        ("cut", found.cut, found.cut_area),
        ("fill", found.fill, found.fill_area),
    ):
        lines.append(f"  {what:<5}{volume:>20,.1f} {unit}   on {ground:>18,.1f} {area}")
    lines.append(f"  {'net':<5}{found.net:>20,.1f} {unit}")
    if found.missing_area:
        lines.append(f"  {found.missing_area:,.1f} {area} are left out: there is no height")
    return lines
