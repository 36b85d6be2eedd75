"""The command line. Each command parses its options, calls the library and prints the result.

Slow libraries are imported only when a command runs, so that `--help` is fast.
"""

from __future__ import annotations

import os
import signal
import sys
from contextlib import suppress
from typing import NoReturn

import click

from geomesh.cli.contours import contours
from geomesh.cli.convert import convert
from geomesh.cli.evaluate import evaluate
from geomesh.cli.info import info
from geomesh.cli.mesh import mesh
from geomesh.cli.quality import quality
from geomesh.cli.render import render
from geomesh.cli.report import report
from geomesh.cli.signals import on_signal
from geomesh.cli.stages import stages
from geomesh.cli.streams import tell_of_lost_output, unfailing_streams
from geomesh.cli.tiles import tiles
from geomesh.cli.versions import print_versions
from geomesh.cli.view import view
from geomesh.cli.volume import volume
from geomesh.parallel.memory import keep_freed_memory

_INTERRUPTED = 130
_TERMINATED = 143


def main() -> NoReturn:
    """Run the command line and exit: 0 success, 1 failure, 2 wrong usage, 130 interrupted."""
    # SIGTERM must clean up too, like Ctrl-C.
    on_signal(signal.SIGTERM, lambda: sys.exit(_TERMINATED))
    if signal.getsignal(signal.SIGINT) is signal.default_int_handler:  # not ignored, as by nohup
        on_signal(signal.SIGINT, _interrupt)
    keep_freed_memory()
    with unfailing_streams():
        code = _run()
        tell_of_lost_output(code)
    sys.exit(code)


def _run() -> int:
    """Run the command and return its exit code."""
    try:
        cli(standalone_mode=False)
    except click.exceptions.Exit as stop:
        return stop.exit_code
    except click.ClickException as error:
        error.show()
        return error.exit_code
    except (click.Abort, KeyboardInterrupt):
        _leave(_INTERRUPTED)
    except SystemExit as stop:
        if stop.code == _TERMINATED:
            _leave(_TERMINATED)
        return int(stop.code or 0)
    return 0


def _interrupt() -> NoReturn:
    raise KeyboardInterrupt


def _leave(code: int) -> NoReturn:
    """Exit at once, after the cleanup: threads may still run in a library for seconds."""
    for stream in (sys.stdout, sys.stderr):
        with suppress(OSError, ValueError):
            stream.flush()
    os._exit(code)


@click.group(
    "geomesh", context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100}
)
@click.option(
    "--version",
    is_flag=True,
    is_eager=True,
    expose_value=False,
    callback=print_versions,
    help="Show the versions of geomesh, GDAL, PROJ, OpenCV and others, and exit.",
)
@click.option("--debug", is_flag=True, help="Show a traceback when something fails.")
@click.pass_context
def cli(ctx: click.Context, debug: bool) -> None:
    """Turn georeferenced rasters into certified triangle meshes.

    \b
    Examples:
      geomesh mesh scene.tif -o mesh.gpkg
      geomesh mesh scene.tif -o mesh.gpkg --nodes 5000 --bidx 4,3,2
      geomesh stages scene.tif -o stages.png
      geomesh quality mesh.gpkg
      geomesh render mesh.gpkg --like scene.tif -o painted.tif
      geomesh report mesh.gpkg -o report.html
      geomesh evaluate scenes/ -o table1.csv
      geomesh convert mesh.gpkg -o web.geojson
      geomesh contours mesh.gpkg -o contours.gpkg --interval 10
      geomesh view mesh.gpkg -o map.html
      geomesh tiles mesh.gpkg -o map.pmtiles --page map.html
    """
    if isinstance(ctx.obj, dict) and "env" in ctx.obj:
        ctx.with_resource(ctx.obj["env"])  # `rio geomesh`: use the GDAL settings of rio's options
    ctx.with_resource(unfailing_streams())  # `rio geomesh` does not call `main`
    ctx.obj = debug


for command in (
    *(mesh, stages, quality, render, report, view, evaluate, info, convert, contours, volume),
    tiles,
):
    cli.add_command(command)
