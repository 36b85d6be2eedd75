"""`geomesh mesh`: convert rasters to mesh files."""

from __future__ import annotations

import json
import os
import sys
from collections import Counter
from contextlib import AbstractContextManager, ExitStack, suppress
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from geomesh.cli.console import Console, exit_code, guarded, interruptible, open_console, spell
from geomesh.cli.options import layer_options, output_options, raster_options, words
from geomesh.cli.outputs import protect_inputs
from geomesh.cli.recipe_options import build_recipe
from geomesh.cli.streams import echo, printable
from geomesh.errors import OutputError
from geomesh.formats.registry import EXTENSIONS, extension_of, find_format
from geomesh.parameters import STATISTICS
from geomesh.pipeline.jobs import MeshJob, MeshSummary

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from geomesh.pipeline.batch import Batch


@dataclass(frozen=True)
class _Plan:
    """The jobs of a command, and the folder of their outputs if this command created it."""

    jobs: tuple[MeshJob, ...]
    new_folder: Path | None


@click.command()
@click.argument("sources", metavar="SRC...", nargs=-1, required=True)
@click.option(
    "-o",
    "--output",
    required=True,
    metavar="OUT",
    help="File to write, or a folder for one mesh per SRC.",
)
@raster_options
@layer_options
@click.option(
    "--breaklines",
    metavar="FILE|canny",
    help="Lines that become edges of the mesh: a file of lines or polygons, or WKT. canny: the "
    "long, strong edges of the image.",
)
@click.option(
    "--breaklines-layer",
    metavar="LAYER",
    help="The layer of lines to use, if the file has several.",
)
@click.option(
    "--time-limit",
    type=click.FloatRange(min=0, min_open=True),
    metavar="SECONDS",
    help="End the refinement of adaptive after this time, with the mesh as it is then.",
)
@click.option(
    "--stats",
    "statistics",
    callback=words(STATISTICS),
    metavar="STAT,...",
    help="What to compute for each triangle and band: mean, std, min, max, median, majority, "
    "variety. Default: the first four; for the classes of a palette majority and variety.",
)
@click.option(
    "--workers",
    type=click.IntRange(min=1),
    metavar="N",
    help="Number of tiles, or of small rasters, to process at the same time. Default: one per "
    "core. The mesh is the same for any N.",
)
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Use a Dask cluster instead of this computer, such as tcp://host:8786. Its workers open "
    "SRC by its path or URL.",
)
@click.option(
    "--skip-existing",
    is_flag=True,
    help="Skip each SRC whose output exists, is complete and was made with the same recipe from "
    "the same pixels. Use it to continue an interrupted batch.",
)
@output_options
@click.pass_obj
def mesh(
    debug: bool,
    /,
    sources: tuple[str, ...],
    workers: int | None,
    scheduler: str | None,
    progress: str | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Turn each raster SRC into a triangle mesh.

    \b
    Examples:
      geomesh mesh scene.tif -o mesh.gpkg
      geomesh mesh scene.tif -o web.geojson --nodes 2000
      geomesh mesh scene.tif -o mesh.gpkg --bidx 5,4,3 --mask aoi.gpkg
      geomesh mesh scenes/*.tif -o meshes/ --preset paper --skip-existing
      geomesh mesh https://host/cog.tif -o mesh.gpkg --bounds 734145 -2827755 749505 -2812395
    """
    if workers is not None and scheduler is not None:
        raise click.UsageError("--workers and --scheduler cannot be used together: choose one")
    console = open_console(progress, quiet=as_json)
    plan, outcomes = _Plan((), None), list[dict[str, Any]]()
    # Also report an interruption between two rasters.
    with interruptible(console), ExitStack() as stack:
        with guarded(console, debug) as failures:
            plan = _plan(sources, **options)
            batch = stack.enter_context(_open_batch(plan.jobs, workers, scheduler, debug))
        if not failures:
            outcomes = _run(plan.jobs, batch, console, debug)
    if plan.new_folder is not None:
        with suppress(OSError):  # the folder is not empty: it contains a mesh
            plan.new_folder.rmdir()
    failed = len(failures) + sum("error" in outcome for outcome in outcomes)
    if as_json:
        echo(json.dumps({"results": outcomes, "failed": failed}, indent=2))
    elif len(outcomes) > 1 and progress != "jsonl":
        _print_table(outcomes)
    sys.exit(exit_code(failed, printed=as_json))


def _plan(
    sources: Sequence[str],
    output: str,
    reading: dict[str, Any],
    recipe_options: dict[str, Any],
    **writing: Any,
) -> _Plan:
    """Return one job for each source. Raise OutputError if an output would replace an input."""
    recipe = build_recipe(**recipe_options)
    paths, folder = _choose_outputs(sources, output, writing["driver"])
    protect_inputs(
        paths,
        [*sources, reading["mask"], writing["breaklines"], recipe_options["recipe_file"]],
    )
    jobs = tuple(
        MeshJob(source, path, recipe, reading=reading, **writing)
        for source, path in zip(sources, paths, strict=True)
    )
    new_folder = folder if folder is not None and _make_folder(folder) else None
    return _Plan(jobs, new_folder)


def _choose_outputs(
    sources: Sequence[str], output: str, driver: str | None
) -> tuple[list[Path], Path | None]:
    """Return the output file of each source, and the folder if OUT is a folder.

    OUT is a folder if it ends with a slash, if it is an existing folder, or if there are
    several SRC.
    """
    folder = Path(output)
    if len(sources) == 1 and not output.endswith(("/", "\\")) and not os.path.isdir(folder):  # noqa: PTH112
        return [folder], None
    if extension_of(folder) in EXTENSIONS and not folder.is_dir():
        raise OutputError(f"{output} is the name of one file; for several rasters give a folder")
    if folder.exists() and not folder.is_dir():
        raise OutputError(
            f"{output} is a file; for several rasters give a folder, as in -o meshes/"
        )
    extension = find_format(f"mesh.{driver or 'gpkg'}", driver).extensions[0]
    # Both "scene.tif" and "/vsizip/a.zip/scene.tif" become "scene".
    names = [
        Path(source.rstrip("/").replace("\\", "/").rpartition("/")[2]).stem for source in sources
    ]
    twice = [name for name, times in Counter(names).items() if times > 1]
    if twice:
        raise OutputError(
            f"several rasters have the name {twice[0]!r}, so their meshes would overwrite each "
            f"other in {output}; write them to different folders"
        )
    return [folder / f"{name}{extension}" for name in names], folder


def _make_folder(folder: Path) -> bool:
    """Create the folder of the outputs. Return False if it exists already."""
    if folder.is_dir():
        return False
    try:
        folder.mkdir(parents=True)
    except OSError as error:
        raise OutputError(f"the folder {folder} cannot be created: {error.strerror}") from error
    return True


def _open_batch(
    jobs: Sequence[MeshJob], workers: int | None, scheduler: str | None, debug: bool
) -> AbstractContextManager[Batch]:
    from geomesh.parallel.cores import available_cores
    from geomesh.pipeline.batch import open_batch

    def open_all() -> AbstractContextManager[Any]:
        if scheduler is None:
            from geomesh.parallel.workers import open_workers

            return open_workers(workers)
        from geomesh.parallel.dask import open_dask_workers

        return open_dask_workers(scheduler)

    # With --debug stay in this process: errors of other processes have no traceback.
    side_by_side = scheduler is None and not debug
    return open_batch(jobs, open_all, workers or available_cores(), side_by_side=side_by_side)


def _run(
    jobs: Sequence[MeshJob], batch: Batch, console: Console, debug: bool
) -> list[dict[str, Any]]:
    """Run the jobs one after the other, report each one, and return their results."""
    outcomes = []
    for job in jobs:
        console.start("mesh", str(job.source))
        about = str(job.source) if len(jobs) > 1 else ""
        with guarded(console, debug, about) as problems, console.progress() as report:
            summary = batch.mesh(job, report)
        if problems:
            outcomes.append({"source": job.source, "error": problems[0]})
        else:
            outcomes.append(_report(job, summary, console))
    return outcomes


def _report(job: MeshJob, summary: MeshSummary, console: Console) -> dict[str, Any]:
    figures = {"nodes": summary.nodes, "triangles": summary.triangles}
    state = "skipped" if summary.skipped else "certified"
    text = f"{job.output}: {summary.nodes:,} nodes, {summary.triangles:,} triangles, {state}"
    console.result([str(job.output)], figures, text)
    facts = asdict(summary) | {"warnings": [spell(warning) for warning in summary.warnings]}
    return {"source": job.source, "output": str(job.output), **facts}


def _print_table(outcomes: Sequence[Mapping[str, Any]]) -> None:
    """Print which rasters were meshed and which failed. Their errors were printed before."""
    from rich.console import Console as RichConsole
    from rich.table import Table
    from rich.text import Text

    failed = sum("error" in outcome for outcome in outcomes)
    skipped = sum(outcome.get("skipped", False) for outcome in outcomes)
    title = f"{len(outcomes) - failed - skipped} meshed, {failed} failed"
    title += f", {skipped} skipped" if skipped else ""
    table = Table(title=title, title_justify="left")
    for column in ("source", "nodes", "triangles", "outcome"):
        table.add_column(column, justify="right" if column in ("nodes", "triangles") else "left")
    for outcome in outcomes:
        source = Text(printable(outcome["source"]), overflow="fold")
        if "error" in outcome:
            table.add_row(source, "", "", Text("failed", style="red"))
        else:
            figures = (f"{outcome[name]:,}" for name in ("nodes", "triangles"))
            name = printable(Path(outcome["output"]).name)
            table.add_row(source, *figures, Text(name, overflow="fold"))
    console = RichConsole(stderr=True)
    if not console.is_terminal:
        console.width = 160
    console.print(table)
