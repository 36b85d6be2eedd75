"""Measure a page in headless Chromium without a graphics card: first frame, panning, redrawing."""

from __future__ import annotations

import os
import sys
from contextlib import suppress
from itertools import cycle
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

WIDTH, HEIGHT = 1200, 800

# Seconds of dragging; a page that is slow to answer is dragged once.
_DRAGGING = 3.0
_REACH = 200  # CSS pixels
_DRIFT = 10  # so that the map never ends where it was, and has to be drawn anew

# Keeps the times of all frames and of all moves of the mouse.
_WATCH = """void (() => {
    window.seen = { frames: [], moves: [] };
    const tick = () => { seen.frames.push(performance.now()); requestAnimationFrame(tick); };
    requestAnimationFrame(tick);
    addEventListener("pointermove", () => seen.moves.push(performance.now()), true);
})()"""

# The pages of others have the same names in `bench` as ours has in `geomesh`. Reading a pixel waits
# for all that the GPU has to do.
_READY = """(async () => {
    const page = window.bench ?? window.geomesh;
    await page.ready;
    const gl = document.querySelector("canvas")?.getContext("webgl2");
    gl?.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
    return { now: performance.now(), times: page.times };
})()"""
_REST = """(async () => {
    await (window.bench ?? window.geomesh).idle();
    seen.end = performance.now();
    await new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(done)));
    return seen;
})()"""


class Measured(NamedTuple):
    """What one page needed.

    Attributes
    ----------
    first_frame : float
        Seconds from the start of the navigation until the GPU had drawn the map.
    cpu : float
        CPU seconds of all processes of the browser in this time. Other programs of a busy computer
        hardly change them.
    pan : float
        The longest time between two frames while the map was dragged, in milliseconds.
    redraw : float
        Seconds from the last move until the map was as it should be.
    longest_at_rest : float
        The longest time between two frames in this time, in milliseconds.
    times : dict
        Steps of the first frame, as the page tells them, in milliseconds.
    picture : uint8 (H, W, 3)
        The window after the first frame.
    """

    first_frame: float
    cpu: float
    pan: float
    redraw: float
    longest_at_rest: float
    times: dict[str, float]
    picture: NDArray[np.uint8]


def measure(page: Path) -> Measured:
    """Open a page in a new browser, and drag its map."""
    from support.browser import open_browser

    with open_browser("chromium", width=WIDTH, height=HEIGHT) as browser:
        before = _cpu_of_children()
        browser.open(page)
        ready = browser.evaluate(_READY)
        cpu = _cpu_of_children() - before
        picture = browser.screenshot()
        times = ready["times"]
        # The page itself knows it sooner, if it was ready before it was asked.
        first = min(ready["now"], max(times.get("firstFrame", np.inf), 0)) / 1000
        browser.evaluate(_WATCH)
        here, begin = (WIDTH / 2, HEIGHT / 2), monotonic()
        for reach in cycle((_REACH, _DRIFT - _REACH)):
            there = here[0] + reach, here[1] + reach / 2
            browser.drag(here, there)
            here = there
            if monotonic() - begin > _DRAGGING:
                break
        seen = browser.evaluate(_REST)
        # What the browser asks for by itself, such as updates, is not the page's.
        asked = [url for url in browser.requests if not url.startswith(("file:", "data:", "blob:"))]
        if browser.errors or asked:
            sys.exit(f"{page} does not work without a network: {browser.errors} {asked}")
    return Measured(first, cpu, *frames_of(seen), times, picture)


def frames_of(seen: dict[str, Any]) -> tuple[float, float, float]:
    """Return the longest frame of the dragging, the time until rest, and its longest frame."""
    frames, moves, end = np.array(seen["frames"]), seen["moves"], seen["end"]
    starts, ends = frames[:-1], frames[1:]
    lengths = ends - starts
    dragging = (ends > moves[0]) & (starts < moves[-1])
    resting = (starts >= moves[-1]) & (starts < end)
    return (
        float(lengths[dragging].max(initial=0)),
        (end - moves[-1]) / 1000,
        float(lengths[resting].max(initial=0)),
    )


def _cpu_of_children() -> float:
    """Return the CPU seconds of all processes that this one has started, and they in turn (Linux).

    Without those that have ended.
    """
    parents: dict[int, int] = {}
    ticks: dict[int, int] = {}
    for entry in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            # After the name, which may contain anything: state, parent, ..., utime, stime.
            fields = entry.read_text().rpartition(")")[2].split()
            number = int(entry.parent.name)
            parents[number], ticks[number] = int(fields[1]), int(fields[11]) + int(fields[12])
    family = {os.getpid()}
    while more := {number for number, parent in parents.items() if parent in family} - family:
        family |= more
    own = sum(ticks[number] for number in family if number != os.getpid())
    return own / os.sysconf("SC_CLK_TCK")
