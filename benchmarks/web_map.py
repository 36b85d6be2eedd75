"""The web map beside deck.gl and folium, in one run: size, first frame, panning."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import click
import numpy as np
from PIL import Image

from benchmarks.web_browser import HEIGHT, WIDTH, Measured, measure
from benchmarks.web_pages import (
    fetch_deck,
    fetch_leaflet,
    load_mesh,
    write_deck,
    write_folium,
    write_own,
)

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from geomesh import Mesh

# The browser is driven by what the tests drive it with.
sys.path.append(str(Path(__file__).parent.parent / "tests"))

_MILLION = 1_000_000
_ROUNDS = 3

# What folium is tried with: it stops to be usable at about 5,000 polygons.
_FOLIUM = (5_000, 20_000)

# Goals for the own page with a million triangles: MB, seconds, milliseconds.
_GOALS = (17.0, 2.0, 100.0)

# Levels by which the mean colours of the windows of two pages may differ: one of them smooths
# triangles smaller than a pixel, and has a panel over the map.
_SAME = 12

Found = TypeVar("Found")
Write = Callable[["Mesh", Path], Path]


class _Row(NamedTuple):
    """A page, and its best of several rounds."""

    name: str
    triangles: int
    size: int
    best: Measured


@click.command()
@click.option("-o", "--output", required=True, type=click.Path(path_type=Path), metavar="FOLDER")
@click.option("--rounds", type=click.IntRange(min=1), default=_ROUNDS, show_default=True)
@click.option("--triangles", type=click.IntRange(min=1000), default=_MILLION, show_default=True)
@click.option("--check", is_flag=True, help="Exit with 1 if a goal is not reached.")
def main(*, output: Path, rounds: int, triangles: int, check: bool) -> None:
    """Compare the web map with others. FOLDER keeps the pages, the meshes, and what they need."""
    output.mkdir(parents=True, exist_ok=True)
    pages = list(_pages(output, triangles))
    rounds_of = [[_measure(page) for page in pages] for _ in range(rounds)]  # in turn: A B C A B C
    for page, measured in zip(pages, rounds_of[0], strict=True):
        Image.fromarray(measured.picture).save(page.path.with_suffix(".png"))
    rows = [
        _Row(page.name, page.triangles, page.path.stat().st_size, _best(measured))
        for page, measured in zip(pages, zip(*rounds_of, strict=True), strict=True)
    ]
    text = "\n".join(_table(rows))
    (output / "web_map.md").write_text(text + "\n", encoding="utf-8")
    print(text)
    if check and not _reached(rows[0]):
        raise SystemExit(1)


class _Page(NamedTuple):
    name: str
    triangles: int
    path: Path


def _pages(folder: Path, triangles: int) -> Iterator[_Page]:
    """Write the pages; the first one is geomesh's own, with most triangles."""
    own, polygons = "geomesh", "deck.gl SolidPolygonLayer"
    cache = folder / "cache"
    cache.mkdir(exist_ok=True)
    mesh = load_mesh(folder, triangles)
    bundle, leaflet = _tried(fetch_deck, cache), _tried(fetch_leaflet, cache)
    writers: list[tuple[str, Write]] = [(own, write_own)]
    if bundle is not None:
        writers += [
            (polygons, partial(write_deck, layer="solidPolygons", bundle=bundle)),
            ("deck.gl SimpleMeshLayer", partial(write_deck, layer="simpleMesh", bundle=bundle)),
        ]
    yield from _written(mesh, folder, writers)
    for count in _FOLIUM if leaflet is not None else ():
        writers = [(own, write_own), ("folium", partial(write_folium, leaflet=leaflet))]
        yield from _written(load_mesh(folder, count), folder, writers)


def _tried(fetch: Callable[[Path], Found], cache: Path) -> Found | None:
    try:
        return fetch(cache)
    except (OSError, subprocess.CalledProcessError) as error:
        print(f"Left out: {error}", file=sys.stderr)
    return None


def _written(mesh: Mesh, folder: Path, writers: Iterable[tuple[str, Write]]) -> Iterator[_Page]:
    for name, write in writers:
        path = folder / f"{name.replace(' ', '_')}_{len(mesh.triangles)}.html"
        yield _Page(name, len(mesh.triangles), write(mesh, path))


def _measure(page: _Page) -> Measured:
    found = measure(page.path)
    print(
        f"{page.name}, {page.triangles:,}: first frame {found.first_frame:.2f} s, CPU "
        f"{found.cpu:.1f} s, pan "
        f"{found.pan:.0f} ms, redraw {found.redraw:.2f} s, {found.times}",
        file=sys.stderr,
    )
    return found


def _best(measured: tuple[Measured, ...]) -> Measured:
    """Return the least of each: other programs of the computer only add to it."""
    least = [min(getattr(each, name) for each in measured) for name in Measured._fields[:5]]
    first = min(measured, key=lambda each: each.first_frame)
    return Measured(*least, first.times, first.picture)


def _table(rows: list[_Row]) -> Iterator[str]:
    load, _, _ = os.getloadavg()
    yield f"Window of {WIDTH} x {HEIGHT} pixels, {os.cpu_count()} CPUs, load {load:.1f}"
    yield ""
    yield (
        "| triangles | page | MB | first frame | its CPU | longest frame of a pan | redraw at rest "
        "| same picture |"
    )
    yield "|---:|---|---:|---:|---:|---:|---:|---|"
    own = rows[0]
    for row in rows:
        own = row if row.name == "geomesh" else own
        best, first = row.best, own.best
        cells = (
            (f"{row.size / 1e6:.1f}", row.size / own.size),
            (f"{best.first_frame:.2f} s", best.first_frame / first.first_frame),
            (f"{best.cpu:.1f} s", best.cpu / first.cpu),
            (f"{best.pan:.0f} ms", best.pan / max(first.pan, 1)),
            (f"{best.redraw:.2f} s", best.redraw / first.redraw),
        )
        told = [text if row is own else f"{text} ({ratio:.1f}x)" for text, ratio in cells]
        # Leaflet has only whole levels of zoom, so its window shows more.
        is_comparable = row.name.startswith("deck.gl")
        same = ("yes" if _looks_same(best, first) else "NO") if is_comparable else ""
        yield f"| {row.triangles:,} | {row.name} | {' | '.join(told)} | {same} |"


def _looks_same(one: Measured, other: Measured) -> bool:
    """Return whether two windows have the same colours in their middle, about."""
    parts = [picture[200:600, 400:800].reshape(8, 50, 8, 50, 3).mean(axis=(1, 3))
             for picture in (one.picture, other.picture)]  # fmt: skip
    return bool(np.abs(parts[0] - parts[1]).mean() < _SAME)


def _reached(own: _Row) -> bool:
    found = (own.size / 1e6, own.best.first_frame, own.best.pan)
    for name, value, goal in zip(("MB", "s", "ms"), found, _GOALS, strict=True):
        print(f"{value:.2f} of at most {goal:g} {name}", file=sys.stderr)
    return all(value <= goal for value, goal in zip(found, _GOALS, strict=True))


if __name__ == "__main__":
    with suppress(KeyboardInterrupt):
        main()
