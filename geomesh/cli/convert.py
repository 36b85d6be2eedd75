"""`geomesh convert`: a mesh file in another format."""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING, Any

import click

from geomesh.cli.console import exit_code, guarded, open_console
from geomesh.cli.height_options import height_options
from geomesh.cli.options import layer_options, output_options
from geomesh.cli.outputs import protect_inputs
from geomesh.cli.streams import echo

if TYPE_CHECKING:
    from geomesh.formats.format import WriteOptions


@click.command()
@click.argument("mesh_file", metavar="MESH")
@click.option("-o", "--output", required=True, metavar="OUT", help="File to write.")
@layer_options
@height_options
@output_options
@click.pass_obj
def convert(
    debug: bool,
    /,
    mesh_file: str,
    output: str,
    layers: tuple[Any, ...] | None,
    driver: str | None,
    options: WriteOptions,
    z: int | str | None,
    z_factor: float | None,
    overwrite: bool,
    progress: str | None,
    as_json: bool,
) -> None:
    """Write MESH (.gpkg) in another format. The mesh is checked again.

    \b
    Examples:
      geomesh convert mesh.gpkg -o web.geojson.gz --precision 5 --columns color,area
      geomesh convert mesh.gpkg -o nodes.parquet --layers nodes
      geomesh convert mesh.gpkg -o mesh.nc     # UGRID, a mesh layer in QGIS
    """
    console = open_console(progress, quiet=as_json)
    console.start("convert", mesh_file)
    with guarded(console, debug) as failures, console.progress() as report:
        from geomesh.io.read import read_mesh
        from geomesh.io.write import check_output, write_mesh
        from geomesh.parallel.progress import part_of

        protect_inputs([output], [mesh_file])
        check_output(output, overwrite=overwrite, driver=driver, options=options)
        report(0.0, "Reading the mesh")
        read = read_mesh(mesh_file)
        if z is not None or z_factor is not None:
            read = read.with_height(z, 1.0 if z_factor is None else z_factor)
        write_mesh(
            read,
            output,
            layers=layers,
            driver=driver,
            overwrite=overwrite,
            options=options,
            progress=part_of(report, 0.3, 1),
        )
    outcome: dict[str, Any] = {"source": mesh_file, "error": "".join(failures[:1])}
    if not failures:
        figures = {"nodes": len(read.nodes), "triangles": len(read.triangles)}
        outcome = {"source": mesh_file, "output": output, **figures}
        console.result([output], figures, f"{output}: the mesh of {mesh_file}, certified")
    if as_json:
        echo(json.dumps({"results": [outcome], "failed": len(failures)}, indent=2))
    sys.exit(exit_code(failures, printed=as_json))
