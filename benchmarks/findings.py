"""What the runs of `benchmarks.scale` come to: tables, and what is expected of them."""

from __future__ import annotations

from dataclasses import dataclass, field
from statistics import median
from typing import TYPE_CHECKING, NamedTuple

from rich.table import Table

from benchmarks.timing import spread

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from benchmarks.children import Run

# The whole command over the bare work in it, both on one thread.
WHOLE = 1.3
# What two workers gain, over what two processes gain at SIFT alone.
GAIN = 0.9
# The most seconds a megapixel over the fewest, start-up apart, from 4 megapixels on.
FLAT, FLAT_FROM = 1.15, 2000
# Peak memory apart from the mesh's own arrays: of the largest scene over that of this one.
MEMORY, MEMORY_FROM, MEMORY_TO = 1.3, 4000, 10_980
MOST_MEMORY = 2e9


@dataclass
class Findings:
    """All that was measured; one entry a round where there is a list.

    Attributes
    ----------
    size : int
        Side of the scene that the bare work was done on.
    compiling : float
        Seconds of the first run, with an empty cache of compiled code.
    startup : list of Run
        The command with two workers on 64 x 64 pixels.
    steps : dict of str to list of float
        Seconds of each step of the bare work.
    told : dict of str to str
        What each step did.
    one, coarse : list of Run
        The command with one worker; with two and without doubled image.
    two : dict of int to list of Run
        The command with two workers, by the side of the scene.
    gains : list of float
        Of two processes at SIFT alone.
    arrays : dict of int to float
        Bytes of the mesh's own arrays, by the side of the scene.
    digests : list of str
        Of the rows written by one worker, and by two.
    """

    size: int
    compiling: float = 0.0
    startup: list[Run] = field(default_factory=list)
    steps: dict[str, list[float]] = field(default_factory=dict)
    told: dict[str, str] = field(default_factory=dict)
    one: list[Run] = field(default_factory=list)
    two: dict[int, list[Run]] = field(default_factory=dict)
    coarse: list[Run] = field(default_factory=list)
    gains: list[float] = field(default_factory=list)
    arrays: dict[int, float] = field(default_factory=dict)
    digests: list[str] = field(default_factory=list)

    @property
    def bare(self) -> list[float]:
        """Seconds of all steps together, round by round."""
        return [sum(seconds) for seconds in zip(*self.steps.values(), strict=True)]

    @property
    def whole(self) -> list[float]:
        """The command with one worker over the bare work, round by round."""
        return _ratios(_seconds(self.one), self.bare)

    @property
    def gain(self) -> list[float]:
        """The command with one worker over that with two, round by round."""
        return _ratios(_seconds(self.one), _seconds(self.two[self.size]))

    def beyond_startup(self, size: int) -> float:
        """Return the seconds a megapixel that a scene takes beyond start-up."""
        more = median(_seconds(self.two[size])) - median(_seconds(self.startup))
        return more / megapixels(size)

    def cpu_beyond_startup(self, size: int) -> float:
        """Return the same in CPU seconds, which tell less of what else the machine does."""
        return (median(_cpu(self.two[size])) - median(_cpu(self.startup))) / megapixels(size)

    def peak(self, size: int) -> float:
        """Return the most bytes that a run on a scene held."""
        return max(run.peak for run in self.two[size])

    def apart(self, size: int) -> float:
        """Return the peak without the mesh's own arrays."""
        return self.peak(size) - self.arrays[size]


class Check(NamedTuple):
    """One expectation.

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
    """Yield what can be said of the sizes that were measured."""
    ratio = median(found.whole)
    yield Check(
        "the whole command, one worker, over the bare work",
        spread(found.whole),
        f"<= {WHOLE}",
        ratio <= WHOLE,
    )
    shares = _ratios(found.gain, found.gains)
    yield Check(
        f"gain of two workers, {spread(found.gain)}x, over that of SIFT, {spread(found.gains)}x",
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
            what = f"{unit} a megapixel beyond start-up, {sides} pixels wide: most over fewest"
            yield Check(what, f"{flat:.2f}", f"<= {FLAT}", flat <= FLAT)
    if MEMORY_TO in found.two:
        peak = found.peak(MEMORY_TO)
        most = f"< {MOST_MEMORY / 1e6:,.0f} MB"
        what = f"peak memory at {MEMORY_TO:,}"
        yield Check(what, f"{peak / 1e6:,.0f} MB", most, peak < MOST_MEMORY)
        if MEMORY_FROM in found.two:
            growth = found.apart(MEMORY_TO) / found.apart(MEMORY_FROM)
            what = f"the same without the mesh's own arrays, over that at {MEMORY_FROM:,}"
            yield Check(what, f"{growth:.2f}", f"<= {MEMORY}", growth <= MEMORY)
    same = len(set(found.digests)) == 1
    short = ", ".join(digest[:12] for digest in found.digests)
    yield Check("SHA-256 of all rows, one worker and two", short, "the same", same)


def bare_table(found: Findings) -> Table:
    """Return the bare work, step by step, beside the whole command."""
    table = Table(title=f"Bare work on {found.size:,} x {found.size:,} pixels, one thread")
    for heading in ("step", "seconds", "what"):
        table.add_column(heading)
    for step, seconds in found.steps.items():
        table.add_row(step, spread(seconds), found.told[step])
    table.add_row("sum", spread(found.bare), "", style="bold")
    for name, runs in (
        ("geomesh mesh, one worker", found.one),
        ("geomesh mesh, two workers", found.two[found.size]),
        ("... with --no-sift-upsample", found.coarse),
    ):
        cpu = median(_cpu(runs))
        table.add_row(
            name, spread(_seconds(runs)), f"{runs[0].told['nodes']:,} nodes, {cpu:.3g} CPU seconds"
        )
    return table


def size_table(found: Findings) -> Table:
    """Return a row for every size."""
    startup = median(_seconds(found.startup))
    table = Table(
        title=f"geomesh mesh, two workers; start-up ({startup:.2f} s) is what 64 x 64 pixels take"
    )
    for heading in (
        *("pixels", "Mpx", "seconds", "s/Mpx", "beyond start-up", "CPU s/Mpx", "beyond"),
        *("peak MB", "mesh's arrays MB", "nodes", "nodes/Mpx", "triangles"),
    ):
        table.add_column(heading, justify="right")
    for size, runs in sorted(found.two.items()):
        area, nodes = megapixels(size), runs[0].told["nodes"]
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
            f"{runs[0].told['triangles']:,}",
        )
    return table


def check_table(found: Sequence[Check]) -> Table:
    """Return the expectations and what came of them."""
    table = Table(title="Medians \\[range] of alternating rounds")
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
    """Round by round: neighbours in time share the machine's mood."""
    return [a / b for a, b in zip(over, under, strict=True)]
