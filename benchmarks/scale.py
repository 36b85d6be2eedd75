"""How the command scales: with the size of the scene, with workers, beside the bare work in it.

This process stays small and does nothing itself: see `benchmarks.children`.
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

# The bare work is done on the scene nearest to this: of 36 megapixels.
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
            self.fail(f"{value!r}: give sides in pixels such as 1000,4000", param, ctx)
        if sizes[0] < _TINY:
            self.fail(f"{sizes[0]} is too small: {_TINY} or more", param, ctx)
        return sizes


@click.command()
@click.option(
    "--sizes",
    type=_Sizes(),
    metavar="N,N,...",
    help=f"Sides of the square scenes in pixels. Default: {SIZES}.",
)
@click.option("--rounds", type=click.IntRange(min=1), help=f"Default: {_ROUNDS}.")
@click.option("--quick", is_flag=True, help="Small scenes, one round; only results are judged.")
@click.option("--check", is_flag=True, help="Exit with 1 if something falls short.")
def main(*, sizes: list[int] | None, rounds: int | None, quick: bool, check: bool) -> None:
    """Measure the time and memory of `geomesh mesh` on scenes of several sizes."""
    console = Console(width=None if Console().is_terminal else 200)
    sizes = sizes or _Sizes().convert(QUICK_SIZES if quick else SIZES, None, None)
    with TemporaryDirectory(prefix="geomesh-scale-") as folder:
        # An empty cache, so that what is reported as compiling is that.
        os.environ["NUMBA_CACHE_DIR"] = str(Path(folder, "compiled"))
        found = _measure(console, Path(folder), sizes, rounds or (1 if quick else _ROUNDS))
    versions = ", ".join(f"{name} {version(name)}" for name in _LIBRARIES)
    console.print(f"Python {platform.python_version()}, {os.cpu_count()} CPUs; {versions}")
    console.print(
        "Every step and every run in a fresh process, all of them with the command's policy of "
        "keeping freed memory (geomesh.parallel.memory); OpenCV on one thread."
    )
    console.print(f"The first run of all, which compiles: {found.compiling:.3g} s")
    console.print(bare_table(found))
    console.print(size_table(found))
    judged = list(checks(found))
    console.print(check_table(judged))
    short = [one for one in judged if not (one.holds or (quick and one.expected != "the same"))]
    for one in short:
        console.print(f"[red]Fell short[/]: {one.what}: {one.found}, expected {one.expected}")
    if check and short:
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
            about = f"round {number + 1} of {rounds}"
            status.update(f"{about}: start-up")
            found.startup += [mesh(scenes[_TINY], folder / "tiny.gpkg", 2) for _ in range(3)]
            for step in STEPS:
                status.update(f"{about}: bare {step}")
                seconds, told = run_module("benchmarks.bare", step, scene, kept).told
                found.steps.setdefault(step, []).append(seconds)
                found.told[step] = told
            status.update(f"{about}: the command")
            found.one.append(mesh(scene, folder / "one.gpkg", 1))
            two = mesh(scene, folder / "two.gpkg", 2)
            found.coarse.append(mesh(scene, folder / "coarse.gpkg", 2, "--no-sift-upsample"))
            status.update(f"{about}: SIFT in two processes")
            found.gains += run_module("benchmarks.bare", "gain", scene, kept, "1").told
            found.two.setdefault(found.size, []).append(two)
            if number == 0:
                outputs = folder / "one.gpkg", folder / "two.gpkg"
                found.digests = [_contents("digest", output) for output in outputs]
                found.arrays[found.size] = _contents("bytes", outputs[1])
            for size in sizes:
                if size != found.size:
                    status.update(f"{about}: {size} x {size} pixels")
                    found.two.setdefault(size, []).append(_other(scenes[size], found, size))
    return found


def _other(scene: Path, found: Findings, size: int) -> Run:
    """Mesh a scene and leave no file behind: the largest takes gigabytes."""
    output = scene.with_suffix(".gpkg")
    run = mesh(scene, output, 2)
    if size not in found.arrays:
        found.arrays[size] = _contents("bytes", output)
    output.unlink()
    return run


def _contents(what: str, path: Path) -> str | float:
    return run_module("benchmarks.contents", what, path).told


if __name__ == "__main__":
    main()
