"""How faithfully meshes show rasters: geomesh's adaptive meshes against other methods.

All methods get the same number of nodes, the same least squares and the same scorer.
"""

from __future__ import annotations

import os
import platform
import warnings
from importlib.metadata import version
from pathlib import Path
from time import process_time
from typing import TYPE_CHECKING

import click
import numpy as np
from rich.console import Console

import geomesh
from benchmarks.bounded import BOUNDS, compare_bounded
from benchmarks.fidelity_figure import Panel, draw
from benchmarks.fidelity_tables import (
    ADAPTIVE,
    PAPER,
    Findings,
    Record,
    checks,
    tables,
    write_csv,
    write_markdown,
)
from benchmarks.findings import check_table
from benchmarks.peers import PEERS, place, triangulate, with_corners
from benchmarks.scoring import Raster
from benchmarks.superpixels import SLIC, superpixels
from geomesh.errors import GeomeshError, GeomeshWarning
from geomesh.parameters import MODELS

if TYPE_CHECKING:
    from collections.abc import Iterator

    from geomesh.parameters import Model

SAMPLES = Path("data_samples")
SHARES = (1.0, 2.0, 4.0)
QUICK = ("olinda_landsat7_rgb_rotated_gt", "rmnp_dem")

_LIBRARIES = ("numpy", "scipy", "numba", "pydelatin", "scikit-image", "matplotlib")


@click.command()
@click.argument("images", nargs=-1, type=click.Path(exists=True, dir_okay=False, path_type=Path))
@click.option("--quick", is_flag=True, help="Two small images, 1 %, one bound; no goal is judged.")
@click.option("--check", is_flag=True, help="Exit with 1 if a goal is not reached.")
@click.option(
    *("-o", "--output"),
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("out/fidelity"),
    help="Folder for the pictures and tables. Default: out/fidelity.",
)
def main(*, images: tuple[Path, ...], quick: bool, check: bool, output: Path) -> None:
    """Compare adaptive meshes of IMAGES with other methods. Default: all of data_samples."""
    console = Console(width=None if Console().is_terminal else 200)
    warnings.simplefilter("ignore", GeomeshWarning)
    paths = list(images) or sorted(SAMPLES.glob("*.tif"))
    if quick and not images:
        paths = [path for path in paths if path.stem in QUICK]
    output.mkdir(parents=True, exist_ok=True)
    found = Findings(shares=SHARES[:1] if quick else SHARES)
    with console.status("compiling") as status:
        _compile()
        for path in paths:
            raster = Raster.read(path)
            panels: list[Panel] = []
            for record, panel in _records(path, raster, found.shares):
                status.update(f"{raster.name}: {record.method}, {record.label}")
                found.records.append(record)
                if panel is not None:
                    panels.append(panel)
            draw(raster, panels, output / f"{raster.name}.png")
            bounds = BOUNDS.get(raster.name, ())[: 1 if quick else None]
            if bounds:
                status.update(f"{raster.name}: bounds")
                found.bounded += compare_bounded(path, raster, bounds)
    libraries = ", ".join(f"{name} {version(name)}" for name in _LIBRARIES)
    console.print(f"Python {platform.python_version()}, {os.cpu_count()} CPUs; {libraries}")
    for table in tables(found):
        console.print(table.rich())
    judged = list(checks(found))
    console.print(check_table(judged, "Goals: the worst of all rasters"))
    write_csv(found, output)
    write_markdown(found, output / "fidelity.md")
    console.print(f"Pictures and tables: {output}/")
    failed = [one for one in judged if not (one.holds or (quick and one.expected != "the same"))]
    for one in failed:
        console.print(f"[red]Failed[/]: {one.what}: {one.found}, expected {one.expected}")
    if check and failed:
        raise SystemExit(1)


def _compile() -> None:
    """Run geomesh once with each model, so that the CPU seconds of the others are without it."""
    hills = np.add.outer(np.sin(np.arange(64) / 9), np.cos(np.arange(64) / 7)).astype(np.float32)
    for model in MODELS:
        geomesh.mesh_raster((hills, None, None), preset="adaptive", nodes=100, model=model)


def _records(
    path: Path, raster: Raster, shares: tuple[float, ...]
) -> Iterator[tuple[Record, Panel | None]]:
    """Yield the figures of all methods; with what to draw, for the first share."""
    for share in shares:
        count, draws = round(raster.pixels * share / 100), share == shares[0]
        label = f"{share:g} %"
        for model in MODELS:
            yield _adaptive(path, raster, label, count, model, draws=draws)
            for method in PEERS:
                yield _peer(raster, label, count, model, method, draws=draws)
        pixels = superpixels(raster, count)
        record = Record(
            raster.name,
            label,
            "constant",
            SLIC,
            count,
            pixels.vertices,
            *raster.score(pixels.image),
        )
        yield record, Panel(record, pixels.image, None) if draws else None
    # The preset `paper` finds its own number of nodes, so geomesh gets that number too.
    published = geomesh.mesh_raster(path, preset="paper")
    if published.domain.kind != "hull":  # it found no nodes, or none that span an area
        return
    mesh = triangulate(with_corners(published.nodes, raster.valid))
    count = len(mesh[0])
    for model in MODELS:
        image = raster.show(*mesh, model)
        record = Record(raster.name, PAPER, model, PAPER, count, count, *raster.score(image))
        yield record, Panel(record, image, mesh)
        yield _adaptive(path, raster, PAPER, count, model, draws=False)


def _adaptive(
    path: Path, raster: Raster, label: str, count: int, model: Model, *, draws: bool
) -> tuple[Record, Panel | None]:
    start = process_time()
    try:
        mesh = geomesh.mesh_raster(path, preset="adaptive", nodes=count, model=model)
    except GeomeshError as error:
        return Record(raster.name, label, model, ADAPTIVE, count, why=str(error)), None
    cpu = process_time() - start
    image = raster.show(mesh.nodes, mesh.triangles, model)
    record = Record(
        *(raster.name, label, model, ADAPTIVE, count, len(mesh.nodes), *raster.score(image)),
        cpu=cpu,
    )
    return record, Panel(record, image, (mesh.nodes, mesh.triangles)) if draws else None


def _peer(
    raster: Raster, label: str, count: int, model: Model, method: str, *, draws: bool
) -> tuple[Record, Panel | None]:
    tried = []
    for points in place(method, raster, count):
        mesh = triangulate(points)
        image = raster.show(*mesh, model)
        tried.append((raster.score(image), mesh, image))
    score, mesh, image = max(tried, key=lambda each: each[0][0])
    record = Record(raster.name, label, model, method, count, len(mesh[0]), *score)
    return record, Panel(record, image, mesh) if draws else None


if __name__ == "__main__":
    main()
