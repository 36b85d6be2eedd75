"""The results of `benchmarks.fidelity`: tables, files, and checks of the goals."""

from __future__ import annotations

import csv
from dataclasses import astuple, dataclass, field, fields
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from rich.table import Table

from benchmarks.findings import Check
from benchmarks.peers import PEERS
from benchmarks.superpixels import SLIC

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from benchmarks.bounded import BoundedPair
    from geomesh.parameters import Model

ADAPTIVE, PAPER = "adaptive", "paper's nodes"

# Least lead in dB over the best triangulated peer of the same model, and over the nodes of the
# preset `paper` with the linear model.
LEAD: dict[Model, float] = {"linear": 2.5, "constant": 1.5}
LEAD_OVER_PAPER = 6.0
# Largest number of nodes for a bound divided by that of pydelatin: of each mesh, and the mean.
EACH, MEAN = 0.45, 0.40
# The smallest angle of geomesh's meshes in degrees, with room for rounding.
ANGLE = 10.0 - 1e-6


@dataclass(frozen=True)
class Record:
    """How faithfully one method shows one raster.

    Parameters
    ----------
    image : str
    label : str
        The share of nodes in the valid pixels, or `PAPER` for the number of its nodes.
    model : {"linear", "constant"}
    method : str
    wanted, nodes : int
        Number of nodes wanted and placed (of superpixels: vertices).
    decibels : float
        PSNR over all valid pixels; NaN if there is no mesh.
    missing : int
        Number of valid pixels in no triangle.
    cpu : float
        CPU seconds of geomesh's whole pipeline; NaN for other methods.
    why : str
        Why there is no mesh.
    """

    image: str
    label: str
    model: Model
    method: str
    wanted: int
    nodes: int = 0
    decibels: float = np.nan
    missing: int = 0
    cpu: float = np.nan
    why: str = ""


@dataclass
class Findings:
    """All results.

    Attributes
    ----------
    shares : tuple of float
        Nodes in percent of the valid pixels.
    records : list of Record
    bounded : list of BoundedPair
    """

    shares: tuple[float, ...]
    records: list[Record] = field(default_factory=list)
    bounded: list[BoundedPair] = field(default_factory=list)

    def groups(self, model: Model) -> Iterator[dict[str, Record]]:
        """Yield the records of a model by method: all those of one raster and label."""
        keys = dict.fromkeys((r.image, r.label) for r in self.records if r.model == model)
        for key in keys:
            members = [r for r in self.records if (r.image, r.label) == key and r.model == model]
            yield {record.method: record for record in members}


def lead(group: dict[str, Record]) -> float:
    """Return the lead of geomesh over the best triangulated peer, in dB.

    NaN if geomesh has no mesh, or more nodes than wanted: then there is no comparison.
    """
    own = group[ADAPTIVE]
    others = [r.decibels for name, r in group.items() if name not in (ADAPTIVE, SLIC)]
    return own.decibels - max(others) if own.nodes <= own.wanted else np.nan


class PlainTable(NamedTuple):
    """A table of texts, for the screen or for Markdown."""

    title: str
    headings: Sequence[str]
    rows: list[tuple[str, ...]]

    def rich(self) -> Table:
        """Return the table for the screen: red in square brackets marks a goal not reached."""
        table = Table(title=self.title)
        for k, heading in enumerate(self.headings):
            table.add_column(heading, justify="right" if k else "left")
        for row in self.rows:
            cells = (f"[red]{cell[:-1]}[/]" if cell.endswith("!") else cell for cell in row)
            table.add_row(*cells, end_section=False)
        return table

    def markdown(self) -> str:
        """Return the table as Markdown: an exclamation mark is at a goal not reached."""
        rule = ["---", *["---:"] * (len(self.headings) - 1)]
        lines = ["| " + " | ".join(row) + " |" for row in (self.headings, rule, *self.rows)]
        return f"## {self.title}\n\n" + "\n".join(lines) + "\n"


def tables(found: Findings) -> Iterator[PlainTable]:
    """Yield the tables: linear, constant and bounded."""
    for model, least in LEAD.items():
        methods = (ADAPTIVE, *PEERS, *((SLIC,) if model == "constant" else ()), PAPER)
        rows = []
        for group in found.groups(model):
            own = group[ADAPTIVE]
            goal = LEAD_OVER_PAPER if own.label == PAPER else least
            marked = not lead(group) >= goal and (own.label != PAPER or model == "linear")
            shown = [_decibels(group[name]) if name in group else "" for name in methods]
            if model == "constant" and SLIC in group:
                shown[methods.index(SLIC)] += f" ({group[SLIC].nodes:,})"
            ahead = f"{lead(group):+.2f}{'!' if marked else ''}"
            rows.append((own.image, own.label, f"{own.nodes:,}", *shown, ahead, f"{own.cpu:.1f}"))
        headings = ("image", "nodes", "number", *methods, "lead", "CPU s")
        yield PlainTable(f"PSNR in dB, {model} model, least squares", headings, rows)
    headings = (
        *("DEM", "bound", "nodes", "pydelatin", "ratio", "CPU s", "pydelatin", "largest error"),
        *("pydelatin", "uncovered", "smallest angle"),
    )
    rows = [
        (
            *(pair.raster, f"{pair.bound:g}", f"{pair.ours.nodes:,}", f"{pair.theirs.nodes:,}"),
            f"{pair.ratio:.3f}{'' if pair.ratio <= EACH else '!'}",
            *(f"{pair.ours.cpu:.3f}", f"{pair.theirs.cpu:.3f}"),
            f"{pair.ours.error:.6g}{'' if pair.ours.holds(pair.bound) else '!'}",
            *(f"{pair.theirs.error:.6g}", f"{pair.ours.missing:,}"),
            f"{pair.angle:.2f}{'' if pair.angle >= ANGLE else '!'}",
        )
        for pair in found.bounded
    ]
    if rows:
        yield PlainTable("Fewest nodes for a bound of the error", headings, rows)


def _decibels(record: Record) -> str:
    return "-" if record.why else f"{record.decibels:.2f}"


def checks(found: Findings) -> Iterator[Check]:
    """Yield the checks of the goals that can be judged."""
    other = [r for r in found.records if r.method != SLIC and r.nodes != r.wanted]
    shown = [f"{r.image} {r.label} {r.method}: {r.nodes:,} of {r.wanted:,}" for r in other[:3]]
    shown += [f"and {len(other) - 3} more"] if len(other) > 3 else []
    different = ", ".join(shown) or "the same"
    yield Check("numbers of nodes of all methods", different, "the same", not other)
    for model, least in LEAD.items():
        groups = [group for group in found.groups(model) if PAPER not in group]
        what = f"{model} model: least lead in dB over the best triangulated peer"
        yield from _least(what, groups, least)
    groups = [group for group in found.groups("linear") if PAPER in group]
    what = "linear model: least lead in dB over the paper's nodes, at their number"
    yield from _least(what, groups, LEAD_OVER_PAPER)
    pairs = found.bounded
    if pairs:
        ratios = [pair.ratio for pair in pairs]
        what = "nodes for a bound divided by those of pydelatin"
        yield Check(f"{what}: each", f"{max(ratios):.3f}", f"<= {EACH}", max(ratios) <= EACH)
        mean = float(np.mean(ratios))
        yield Check(f"{what}: mean", f"{mean:.3f}", f"<= {MEAN}", mean <= MEAN)
        broken = sum(not pair.ours.holds(pair.bound) for pair in pairs)
        what = "meshes with a pixel above the bound or in no triangle (matplotlib)"
        yield Check(what, str(broken), "0", not broken)
        angle = min(pair.angle for pair in pairs)
        what = "smallest angle of the meshes with a bound, in degrees"
        yield Check(what, f"{angle:.3f}", f">= {ANGLE:.0f}", angle >= ANGLE)


def _least(what: str, groups: list[dict[str, Record]], least: float) -> Iterator[Check]:
    if groups:
        # NaN, where there is no mesh, is the worst.
        worst = min(groups, key=lambda group: np.nan_to_num(lead(group), nan=-np.inf))
        own, value = worst[ADAPTIVE], lead(worst)
        below = sum(not lead(group) >= least for group in groups)
        shown = f"{value:.2f} ({own.image}, {own.label}); {below} of {len(groups)} below the goal"
        yield Check(what, own.why or shown, f">= {least}", below == 0)


def write_csv(found: Findings, folder: Path) -> None:
    """Write the figures of all methods to fidelity.csv, and those of the bounds to bounded.csv."""
    with (folder / "fidelity.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        writer.writerow([field.name for field in fields(Record)])
        writer.writerows(map(astuple, found.records))
    with (folder / "bounded.csv").open("w", newline="") as file:
        writer = csv.writer(file)
        measured = ("nodes", "cpu", "error", "missing")
        names = [f"{who}_{name}" for who in ("adaptive", "pydelatin") for name in measured]
        writer.writerow(["image", "bound", *names, "smallest_angle"])
        for pair in found.bounded:
            figures = *astuple(pair.ours), *astuple(pair.theirs)
            writer.writerow([pair.raster, pair.bound, *figures, pair.angle])


def write_markdown(found: Findings, path: Path) -> None:
    """Write all tables as Markdown."""
    text = "\n".join(table.markdown() for table in tables(found))
    goals = "\n".join(
        f"- {'reached' if one.holds else 'NOT reached'}: {one.what}: {one.found}, "
        f"expected {one.expected}"
        for one in checks(found)
    )
    path.write_text(f"{text}\n## Goals\n\n{goals}\n", encoding="utf-8")
