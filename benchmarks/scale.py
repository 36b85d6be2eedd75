"""How the command scales with the size of the scene and with workers, and its overhead.

This process needs little memory and does no work itself: see `benchmarks.children`.
"""

from __future__ import annotations

import os
import platform
from importlib.metadata import version
from pathlib import Path
from tempfile import TemporaryDirectory

import click
from rich.console import Console

from benchmarks.children import Run, mesh, run_module
from benchmarks.findings import Findings, bare_table, check_table, checks, size_table

STEPS = ("reading", "features", "triangulation", "statistics", "writing")
SIZES, QUICK_SIZES = "1000,2000,4000,6000,10980", "1000,2000"

# The bare work is done on the scene with the side nearest to this: 36 megapixels.
_BARE = 6000
_TINY = 64
_ROUNDS = 3

_LIBRARIES = (
    *("numpy", "numba", "pythoncdt", "rasterio", "pyogrio", "pyarrow"),
    "opencv-contrib-python-headless",
)


class _Sizes(click.ParamType):
    name = "sizes"

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> list[int]:
        try:
            sizes = sorted({int(part) for part in str(value).split(",")})
        except ValueError:
            self.fail(f"{value!r} is not a list of sides: use pixels such as 1000,4000", param, ctx)
        if sizes[0] < _TINY:
            self.fail(f"{sizes[0]} is too small: use {_TINY} or more", param, ctx)
        return sizes


@click.command()
@click.option(
    "--sizes",
    type=_Sizes(),
    metavar="N,N,...",
    help=f"Sides of the square scenes in pixels. Default: {SIZES}.",
)
@click.option("--rounds", type=click.IntRange(min=1), help=f"Default: {_ROUNDS}.")
@click.option("--quick", is_flag=True, help="Small scenes, one round; only results are checked.")
@click.option("--check", is_flag=True, help="Exit with 1 if a check fails.")
def main(*, sizes: list[int] | None, rounds: int | None, quick: bool, check: bool) -> None:
    """Measure the time and memory of `geomesh mesh` on scenes of several sizes."""
    console = Console(width=None if Console().is_terminal else 200)
    sizes = sizes or _Sizes().convert(QUICK_SIZES if quick else SIZES, None, None)
    with TemporaryDirectory(prefix="geomesh-scale-") as folder:
        # An empty cache, so that the first run compiles all kernels.
        os.environ["NUMBA_CACHE_DIR"] = str(Path(folder, "compiled"))
        found = _measure(console, Path(folder), sizes, rounds or (1 if quick else _ROUNDS))
    versions = ", ".join(f"{name} {version(name)}" for name in _LIBRARIES)
    console.print(f"Python {platform.python_version()}, {os.cpu_count()} CPUs; {versions}")
    console.print(
        "Every step and every run is in a new process. All of them keep freed memory, as the "
        "command does (geomesh.parallel.memory). OpenCV uses one thread."
    )
    console.print(f"The very first run, which compiles: {found.compiling:.3g} s")
    console.print(bare_table(found))
    console.print(size_table(found))
    judged = list(checks(found))
    console.print(check_table(judged))
    failed = [one for one in judged if not (one.holds or (quick and one.expected != "the same"))]
    for one in failed:
        console.print(f"[red]Failed[/]: {one.what}: {one.found}, expected {one.expected}")
    if check and failed:
        raise SystemExit(1)


def _measure(console: Console, folder: Path, sizes: list[int], rounds: int) -> Findings:
    scenes = {size: folder / f"scene{size}.tif" for size in (_TINY, *sizes)}
    found = Findings(min(sizes, key=lambda size: abs(size - _BARE)))
    scene, kept = scenes[found.size], folder / "kept"
    kept.mkdir()
    with console.status("making the scenes") as status:
        for size, path in scenes.items():
            run_module("benchmarks.scenes", str(size), path)
        status.update("compiling")
        found.compiling = mesh(scenes[_TINY], folder / "tiny.gpkg", 2).seconds
        run_module("benchmarks.bare", "prepare", scene, kept)
        for number in range(rounds):
            position = f"round {number + 1} of {rounds}"
            status.update(f"{position}: start-up")
            found.startup += [mesh(scenes[_TINY], folder / "tiny.gpkg", 2) for _ in range(3)]
            for step in STEPS:
                status.update(f"{position}: bare {step}")
                seconds, description = run_module("benchmarks.bare", step, scene, kept).output
                found.steps.setdefault(step, []).append(seconds)
                found.descriptions[step] = description
            status.update(f"{position}: the command")
            found.one.append(mesh(scene, folder / "one.gpkg", 1))
            two = mesh(scene, folder / "two.gpkg", 2)
            found.coarse.append(mesh(scene, folder / "coarse.gpkg", 2, "--no-sift-upsample"))
            status.update(f"{position}: SIFT in two processes")
            found.gains += run_module("benchmarks.bare", "gain", scene, kept, "1").output
            found.two.setdefault(found.size, []).append(two)
            if number == 0:
                outputs = folder / "one.gpkg", folder / "two.gpkg"
                found.digests = [_contents("digest", output) for output in outputs]
                found.arrays[found.size] = _contents("bytes", outputs[1])
            for size in sizes:
                if size != found.size:
                    status.update(f"{position}: {size} x {size} pixels")
                    found.two.setdefault(size, []).append(_mesh_once(scenes[size], found, size))
    return found


def _mesh_once(scene: Path, found: Findings, size: int) -> Run:
    """Mesh a scene with two workers, and remove the file: the largest needs gigabytes."""
    output = scene.with_suffix(".gpkg")
    run = mesh(scene, output, 2)
    if size not in found.arrays:
        found.arrays[size] = _contents("bytes", output)
    output.unlink()
    return run


def _contents(what: str, path: Path) -> str | float:
    return run_module("benchmarks.contents", what, path).output


if __name__ == "__main__":
    main()
