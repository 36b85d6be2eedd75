"""Run all comparisons and print one table of ratios."""

from __future__ import annotations

import os
import platform
from importlib.metadata import version
from statistics import median
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import TYPE_CHECKING

import click
from rich.console import Console
from rich.table import Table

from benchmarks.timing import Row, spread

if TYPE_CHECKING:
    from collections.abc import Iterable

_LIBRARIES = (
    *("numpy", "scipy", "numba", "pythoncdt", "rasterio", "shapely", "geopandas", "pyogrio"),
    *("pyarrow", "exactextract", "opencv-contrib-python-headless"),
)


@click.command()
@click.option("--quick", is_flag=True, help="Smaller inputs; ratios are not judged.")
@click.option("--check", is_flag=True, help="Exit with 1 if a ratio is too low or results differ.")
def main(*, quick: bool, check: bool) -> None:
    """Compare geomesh with other libraries that compute the same results."""
    console = Console(width=None if Console().is_terminal else 200)
    with TemporaryDirectory() as cache:
        # An empty cache, so that the reported time of compiling is that of all kernels.
        os.environ["NUMBA_CACHE_DIR"] = cache
        rows, compiling = _compare(console, quick=quick)
    versions = ", ".join(f"{name} {version(name)}" for name in _LIBRARIES)
    console.print(f"Python {platform.python_version()}, {os.cpu_count()} CPUs; {versions}")
    console.print(f"Compiling the statistics kernels, before all rounds: {compiling:.3g} s")
    console.print(_table(rows))
    failed = [row for row in rows if not (row.agree and row.reached)]
    for row in failed:
        reason = f"expected {row.expected:g}x" if row.agree else "the results do not agree"
        console.print(f"[red]Failed[/]: {row.case}, {row.peer or 'geomesh'}: {reason}")
    if check and failed:
        raise SystemExit(1)


def _compare(console: Console, *, quick: bool) -> tuple[list[Row], float]:
    from benchmarks import triangulation

    with console.status("memory"):
        memory = triangulation.memory(quick=quick)  # first: see benchmarks.memory
    import cv2

    from benchmarks import inputs, writing, zonal

    cv2.setNumThreads(1)
    start = perf_counter()
    small = inputs.mesh(100, 64)
    # Once more, because kernels are compiled separately for the read-only arrays of a mesh.
    inputs.statistics(small.nodes, small.triangles, inputs.image(64))
    compiling = perf_counter() - start
    rows: list[Row] = []
    for subject in (triangulation, zonal, writing):
        with console.status(subject.__name__):
            rows += subject.run(quick=quick)
        rows += [memory] if subject is triangulation else []
    return rows, compiling


def _table(rows: Iterable[Row]) -> Table:
    table = Table(
        title="Ratio above 1: geomesh needs less. Medians \\[range] of alternating rounds"
    )
    for heading in ("case", "against", "geomesh", "peer", "ratio", "expected", "agreement"):
        table.add_column(heading, overflow="fold")
    for row in rows:
        ratio = f"{median(row.ratios):.2f}x" if row.ratios else "-"
        if len(row.ratios) > 1:
            ratio += f" [{min(row.ratios):.2f} to {max(row.ratios):.2f}]"
        table.add_row(
            row.case,
            row.peer or "-",
            f"{spread(row.ours)} {row.unit}",
            f"{spread(row.theirs)} {row.unit}" if row.theirs else "-",
            ratio if row.reached else f"[red]{ratio}[/]",
            f">= {row.expected:g}x" if row.expected else "-",
            f"{'yes' if row.agree else '[red]NO[/]'}: {row.evidence}",
        )
    return table


if __name__ == "__main__":
    main()
