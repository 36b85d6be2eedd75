"""The results of `benchmarks.scale`: tables, and checks of expected values."""

from __future__ import annotations

from dataclasses import dataclass, field
from statistics import median
from typing import TYPE_CHECKING, NamedTuple

from rich.table import Table

from benchmarks.timing import spread

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from benchmarks.children import Run

# Maximum time of the whole command divided by that of its bare work, both on one thread.
WHOLE = 1.3
# Minimum speedup of two workers divided by the speedup of two processes for SIFT alone.
GAIN = 0.9
# Maximum ratio of the most to the fewest seconds per megapixel, without start-up, for sizes
# from 4 megapixels on.
FLAT, FLAT_FROM = 1.15, 2000
# Maximum ratio of the peak memory, without the arrays of the mesh, of two sizes; and the
# maximum peak memory in bytes of the larger size.
MEMORY, MEMORY_FROM, MEMORY_TO = 1.3, 4000, 10_980
MOST_MEMORY = 2e9


@dataclass
class Findings:
    """All measurements; lists have one entry per round.

    Attributes
    ----------
    size : int
        Side of the scene of the bare work, in pixels.
    compiling : float
        Seconds of the first run, with an empty cache of compiled code.
    startup : list of Run
        The command with two workers on 64 x 64 pixels; three runs per round.
    steps : dict of str to list of float
        Seconds of each step of the bare work.
    descriptions : dict of str to str
        What each step did.
    one, coarse : list of Run
        The command with one worker, and with two workers but without the doubled image.
    two : dict of int to list of Run
        The command with two workers, by the side of the scene.
    gains : list of float
        Speedup of two processes for SIFT alone.
    arrays : dict of int to float
        Bytes of the arrays of the mesh, by the side of the scene.
    digests : list of str
        Digests of the rows written with one worker and with two workers.
    """

    size: int
    compiling: float = 0.0
    startup: list[Run] = field(default_factory=list)
    steps: dict[str, list[float]] = field(default_factory=dict)
    descriptions: dict[str, str] = field(default_factory=dict)
    one: list[Run] = field(default_factory=list)
    two: dict[int, list[Run]] = field(default_factory=dict)
    coarse: list[Run] = field(default_factory=list)
    gains: list[float] = field(default_factory=list)
    arrays: dict[int, float] = field(default_factory=dict)
    digests: list[str] = field(default_factory=list)

    @property
    def bare(self) -> list[float]:
        """Seconds of all steps together, for each round."""
        return [sum(seconds) for seconds in zip(*self.steps.values(), strict=True)]

    @property
    def whole(self) -> list[float]:
        """Time of the command with one worker divided by the bare work, for each round."""
        return _ratios(_seconds(self.one), self.bare)

    @property
    def gain(self) -> list[float]:
        """Speedup of two workers over one worker, for each round."""
        return _ratios(_seconds(self.one), _seconds(self.two[self.size]))

    def beyond_startup(self, size: int) -> float:
        """Return the seconds per megapixel of a scene, without start-up."""
        more = median(_seconds(self.two[size])) - median(_seconds(self.startup))
        return more / megapixels(size)

    def cpu_beyond_startup(self, size: int) -> float:
        """Return the CPU seconds per megapixel, which depend less on other programs."""
        return (median(_cpu(self.two[size])) - median(_cpu(self.startup))) / megapixels(size)

    def peak(self, size: int) -> float:
        """Return the peak memory of all runs on a scene, in bytes."""
        return max(run.peak for run in self.two[size])

    def peak_without_arrays(self, size: int) -> float:
        """Return the peak memory without the arrays of the mesh, in bytes."""
        return self.peak(size) - self.arrays[size]


class Check(NamedTuple):
    """One expected value and the measured value.

    Attributes
    ----------
    what : str
    found, expected : str
    holds : bool
    """

    what: str
    found: str
    expected: str
    holds: bool


def megapixels(size: int) -> float:
    return size * size / 1e6


def checks(found: Findings) -> Iterator[Check]:
    """Yield the checks that are possible with the measured sizes."""
    ratio = median(found.whole)
    yield Check(
        "time of the whole command, one worker, divided by the bare work",
        spread(found.whole),
        f"<= {WHOLE}",
        ratio <= WHOLE,
    )
    shares = _ratios(found.gain, found.gains)
    yield Check(
        f"speedup of two workers, {spread(found.gain)}x, divided by that of SIFT, "
        f"{spread(found.gains)}x",
        spread(shares),
        f">= {GAIN}",
        median(shares) >= GAIN,
    )
    judged = [size for size in found.two if size >= FLAT_FROM]
    if len(judged) > 1:
        sides = f"{min(judged):,} to {max(judged):,}"
        for unit, rate in (
            ("seconds", found.beyond_startup),
            ("CPU seconds", found.cpu_beyond_startup),
        ):
            rates = [rate(size) for size in judged]
            flat = max(rates) / min(rates)
            what = f"{unit} per megapixel without start-up, {sides} pixels wide: most / fewest"
            yield Check(what, f"{flat:.2f}", f"<= {FLAT}", flat <= FLAT)
    if MEMORY_TO in found.two:
        peak = found.peak(MEMORY_TO)
        most = f"< {MOST_MEMORY / 1e6:,.0f} MB"
        what = f"peak memory at {MEMORY_TO:,}"
        yield Check(what, f"{peak / 1e6:,.0f} MB", most, peak < MOST_MEMORY)
        if MEMORY_FROM in found.two:
            growth = found.peak_without_arrays(MEMORY_TO) / found.peak_without_arrays(MEMORY_FROM)
            what = f"the same without the arrays of the mesh, divided by that at {MEMORY_FROM:,}"
            yield Check(what, f"{growth:.2f}", f"<= {MEMORY}", growth <= MEMORY)
    same = len(set(found.digests)) == 1
    short = ", ".join(digest[:12] for digest in found.digests)
    yield Check("SHA-256 of all rows, one worker and two workers", short, "the same", same)


def bare_table(found: Findings) -> Table:
    """Return a table of the steps of the bare work, and of the whole command."""
    table = Table(title=f"Bare work on {found.size:,} x {found.size:,} pixels, one thread")
    for heading in ("step", "seconds", "what"):
        table.add_column(heading)
    for step, seconds in found.steps.items():
        table.add_row(step, spread(seconds), found.descriptions[step])
    table.add_row("sum", spread(found.bare), "", style="bold")
    for name, runs in (
        ("geomesh mesh, one worker", found.one),
        ("geomesh mesh, two workers", found.two[found.size]),
        ("... with --no-sift-upsample", found.coarse),
    ):
        cpu = median(_cpu(runs))
        nodes = runs[0].output["nodes"]
        table.add_row(name, spread(_seconds(runs)), f"{nodes:,} nodes, {cpu:.3g} CPU seconds")
    return table


def size_table(found: Findings) -> Table:
    """Return a table with a row for every size."""
    startup = median(_seconds(found.startup))
    table = Table(
        title=f"geomesh mesh, two workers; start-up is the time for 64 x 64 pixels: {startup:.2f} s"
    )
    for heading in (
        *("pixels", "Mpx", "seconds", "s/Mpx", "without start-up", "CPU s/Mpx", "without"),
        *("peak MB", "arrays of the mesh MB", "nodes", "nodes/Mpx", "triangles"),
    ):
        table.add_column(heading, justify="right")
    for size, runs in sorted(found.two.items()):
        area, nodes = megapixels(size), runs[0].output["nodes"]
        table.add_row(
            f"{size:,} x {size:,}",
            f"{area:.4g}",
            spread(_seconds(runs)),
            f"{median(_seconds(runs)) / area:.3f}",
            f"{found.beyond_startup(size):.3f}",
            f"{median(_cpu(runs)) / area:.3f}",
            f"{found.cpu_beyond_startup(size):.3f}",
            f"{found.peak(size) / 1e6:,.0f}",
            f"{found.arrays[size] / 1e6:,.0f}",
            f"{nodes:,}",
            f"{nodes / area:,.0f}",
            f"{runs[0].output['triangles']:,}",
        )
    return table


def check_table(
    found: Sequence[Check], title: str = "Medians \\[range] of alternating rounds"
) -> Table:
    """Return a table of the checks."""
    table = Table(title=title)
    for heading in ("what", "found", "expected"):
        table.add_column(heading, overflow="fold")
    for check in found:
        value = check.found if check.holds else f"[red]{check.found}[/]"
        table.add_row(check.what, value, check.expected)
    return table


def _seconds(runs: Sequence[Run]) -> list[float]:
    return [run.seconds for run in runs]


def _cpu(runs: Sequence[Run]) -> list[float]:
    return [run.cpu for run in runs]


def _ratios(over: Sequence[float], under: Sequence[float]) -> list[float]:
    """Return ratios round by round: in one round, other programs slow down both values."""
    return [a / b for a, b in zip(over, under, strict=True)]
