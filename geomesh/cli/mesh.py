"""`geomesh mesh`: rasters in, mesh files out."""

from __future__ import annotations

import json
import os
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click

from geomesh.cli.console import guarded, open_console
from geomesh.cli.options import build_recipe, layer_options, output_options, raster_options, words
from geomesh.cli.outputs import protect_inputs
from geomesh.errors import OutputError
from geomesh.formats.registry import EXTENSIONS, find_format
from geomesh.parameters import STATISTICS

# A process writes each layer of a GeoPackage, as far as there are cores.
_MOST_LAYERS = 3


@dataclass(frozen=True)
class Job:
    """One raster and the file its mesh goes to."""

    source: str
    output: Path


@click.command()
@click.argument("sources", metavar="SRC...", nargs=-1, required=True)
@click.option(
    "-o",
    "--output",
    required=True,
    metavar="OUT",
    help="File to write, or a folder: one mesh for each SRC.",
)
@raster_options
@layer_options
@click.option(
    "--stats",
    "statistics",
    callback=words(STATISTICS),
    metavar="STAT,...",
    help="What to measure in each triangle and band: mean, std, min, max. Default: all.",
)
@click.option(
    "--workers",
    type=click.IntRange(min=1),
    metavar="N",
    help="Tiles to work on at a time. Default: one a core. The mesh is the same for any N.",
)
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Work on a Dask cluster instead, such as tcp://host:8786; its workers open SRC by "
    "its path or URL.",
)
@output_options
@click.pass_obj
def mesh(
    debug: bool,
    /,
    sources: tuple[str, ...],
    output: str,
    layers: tuple[Any, ...] | None,
    driver: str | None,
    workers: int | None,
    scheduler: str | None,
    overwrite: bool,
    progress: str | None,
    as_json: bool,
    reading: dict[str, Any],
    recipe_options: dict[str, Any],
) -> None:
    """Turn each raster SRC into a triangle mesh.

    \b
    Examples:
      geomesh mesh scene.tif -o mesh.gpkg
      geomesh mesh scene.tif -o web.geojson --nodes 2000
      geomesh mesh scene.tif -o mesh.gpkg --bidx 5,4,3 --mask aoi.gpkg
      geomesh mesh scenes/*.tif -o meshes/ --preset paper
      geomesh mesh https://host/cog.tif -o mesh.gpkg --bounds 734145 -2827755 749505 -2812395
    """
    if workers is not None and scheduler is not None:
        raise click.UsageError("--workers and --scheduler exclude each other: choose one")
    console = open_console(progress, quiet=as_json)
    jobs: list[Job] = []
    folder, made_folder = None, False
    outcomes: list[dict[str, Any]] = []
    with guarded(console, debug) as failures:
        recipe = build_recipe(**recipe_options)
        planned, folder = _plan(sources, output, driver)
        protect_inputs(
            [job.output for job in planned],
            [*sources, reading["mask"], recipe_options["recipe_file"]],
        )
        made_folder = folder is not None and _make_folder(folder)
        jobs = planned
    with ExitStack() as stack:
        with guarded(console, debug) as problems:
            if jobs:
                from geomesh.io.gdal_process import WriterPool

                writer_pool = stack.enter_context(
                    WriterPool(min(workers or os.cpu_count() or 1, _MOST_LAYERS))
                )
                writer_pool.warm()  # they load while this process does
                team = stack.enter_context(_open_workers(workers, scheduler))
                from geomesh.pipeline.mesh_file import mesh_file
        if problems:
            failures, jobs = failures + problems, []
        for job in jobs:
            console.start("mesh", job.source)
            about = f"{job.source}: " if len(jobs) > 1 else ""
            with guarded(console, debug, about) as problems, console.progress() as report:
                made = mesh_file(
                    job.source,
                    job.output,
                    recipe=recipe,
                    workers=team,
                    writer_pool=writer_pool,
                    progress=report,
                    layers=layers,
                    driver=driver,
                    overwrite=overwrite,
                    **reading,
                )
            if problems:
                failures += problems
                outcomes.append({"source": job.source, "error": problems[0]})
                continue
            figures = {"nodes": len(made.nodes), "triangles": len(made.triangles)}
            told = list(made.metadata["warnings"])
            outcome = {"source": job.source, "output": str(job.output), **figures, "warnings": told}
            outcomes.append(outcome)
            console.result(
                [str(job.output)],
                figures,
                f"{job.output}: {figures['nodes']:,} nodes, {figures['triangles']:,} triangles, "
                "certified",
            )
    if made_folder and folder is not None:
        with suppress(OSError):  # it holds a mesh
            folder.rmdir()
    if as_json:
        click.echo(json.dumps({"results": outcomes, "failed": len(failures)}, indent=2))
    elif len(jobs) > 1 and progress != "jsonl":
        _print_table(outcomes)
    sys.exit(1 if failures else 0)


def _open_workers(workers: int | None, scheduler: str | None) -> Any:
    """Return the workers as a context: threads, or those of the cluster."""
    if scheduler is None:
        from geomesh.parallel.workers import open_workers

        return open_workers(workers)
    from geomesh.parallel.dask import open_dask_workers

    return open_dask_workers(scheduler)


def _plan(sources: Sequence[str], output: str, driver: str | None) -> tuple[list[Job], Path | None]:
    """Return the jobs and, where OUT is a folder, that folder.

    It is one if it ends like one, is one already, or if there are several SRC.
    """
    folder = Path(output)
    if len(sources) == 1 and not output.endswith(("/", "\\")) and not os.path.isdir(folder):  # noqa: PTH112
        return [Job(sources[0], folder)], None

    if folder.suffix.lower() in EXTENSIONS and not folder.is_dir():
        raise OutputError(f"{output} is the name of one file; for several rasters name a folder")
    if folder.exists() and not folder.is_dir():
        raise OutputError(
            f"{output} is a file; for several rasters name a folder, as in -o meshes/"
        )
    extension = find_format(f"mesh.{driver or 'gpkg'}", driver).extensions[0]
    # "scene.tif" and "/vsizip/a.zip/scene.tif" alike give "scene".
    names = [
        Path(source.rstrip("/").replace("\\", "/").rpartition("/")[2]).stem for source in sources
    ]
    twice = [name for name, times in Counter(names).items() if times > 1]
    if twice:
        raise OutputError(
            f"several rasters are called {twice[0]!r}: their meshes would overwrite each other "
            f"in {output}; mesh them into different folders"
        )
    jobs = [
        Job(source, folder / f"{name}{extension}")
        for source, name in zip(sources, names, strict=True)
    ]
    return jobs, folder


def _make_folder(folder: Path) -> bool:
    """Make the folder of the outputs; return whether it was not there."""
    if folder.is_dir():
        return False
    try:
        folder.mkdir(parents=True)
    except OSError as error:
        raise OutputError(f"the folder {folder} cannot be made: {error.strerror}") from error
    return True


def _print_table(outcomes: Sequence[Mapping[str, Any]]) -> None:
    """Print which rasters were meshed and which failed; why was said when they did."""
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    failed = sum("error" in outcome for outcome in outcomes)
    table = Table(title=f"{len(outcomes) - failed} meshed, {failed} failed", title_justify="left")
    for column in ("source", "nodes", "triangles", "outcome"):
        table.add_column(column, justify="right" if column in ("nodes", "triangles") else "left")
    for outcome in outcomes:
        source = Text(outcome["source"], overflow="fold")
        if "error" in outcome:
            table.add_row(source, "", "", Text("failed", style="red"))
        else:
            figures = (f"{outcome[name]:,}" for name in ("nodes", "triangles"))
            table.add_row(source, *figures, Text(Path(outcome["output"]).name, overflow="fold"))
    console = Console(stderr=True)
    if not console.is_terminal:
        console.width = 160
    console.print(table)
