"""Print a comparison of methods: a table of the images, then tables of the methods."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from geomesh.cli.streams import printable

if TYPE_CHECKING:
    from geomesh.evaluate.comparison import Comparison, Figures

# For each heading: the name of the figure, and its format. "median NAME" is the median over the
# images.
Columns = Mapping[str, tuple[str, str]]

_SIDES: Columns = {
    "nodes": ("nodes", ",.0f"),
    "AB": ("ab", ".2f"),
    "BC": ("bc", ".2f"),
    "CA": ("ca", ".2f"),
}
_LABELLINGS: Columns = {"Ki\nmean": ("ki_mean", ".2f"), "Ki\nmin": ("ki_min", ".2f")}
_SCALE_FREE: Columns = {"Ki /\n√(A/N)": ("ki_normalised", ".3f")}
_IMAGE: Columns = {**_SIDES, "Ki": ("ki", ".2f"), **_LABELLINGS, **_SCALE_FREE}
_METHOD: Mapping[str, Columns] = {
    "sides and Ki": {
        **_SIDES,
        "Ki of\nsides": ("ki_of_sides", ".2f"),
        "Ki": ("ki", ".2f"),
        "median": ("median ki", ".2f"),
        **_LABELLINGS,
    },
    "measures without unit of length": {
        **_SCALE_FREE,
        "angle\nmean": ("angle_mean", ".1f"),
        "median": ("angle_median", ".1f"),
        "5 %": ("angle_p5", ".1f"),
        "< 10°": ("angle_under_10", ".1%"),
    },
    "PSNR in dB": {
        "covered": ("covered", ".1%"),
        "linear\nsampled": ("psnr_linear_sampled", ".2f"),
        "\nfitted": ("psnr_linear_least_squares", ".2f"),
        "constant\nsampled": ("psnr_constant_sampled", ".2f"),
        "\n fitted": ("psnr_constant_least_squares", ".2f"),
        "whole\nimage": ("psnr_whole", ".2f"),
        "median": ("median psnr_whole", ".2f"),
    },
}

_PLANES = {
    "256x256": "256 x 256 pixels, as many nodes as `paper` finds",
    "native": "Native resolution, as many nodes as `features` finds",
}
_LEGEND = (
    "Tables of methods: mean over the images; median: over the images. Lengths are in pixels of "
    "the plane; AB is the shortest side of a triangle, BC the longest. Ki of sides: the formula "
    "applied to the mean sides, as in the paper's Table 1. Ki: mean over triangles, with this "
    "labelling of the sides, which gives the largest value. Ki mean: mean of the three labellings. "
    "Ki min: AB is the longest side. A: area of the plane. N: number of nodes. Angle: smallest "
    "angle of each triangle, in degrees: mean, median, 5th percentile, and share under 10. PSNR: "
    "of the gray image, over the valid pixels that the mesh covers. Sampled: values taken from the "
    "image. Fitted: values from least squares. Whole image: linear, fitted, over all valid pixels, "
    "with the corners of the image added to the nodes."
)
_NONE = "–"
_NAMES = 14
_WIDTH = 120  # if the output is not a terminal


def print_comparison(comparison: Comparison) -> None:
    """Print the tables of a comparison to standard output."""
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = _WIDTH
    for part in tables(comparison):
        console.print(part)
    console.print(_LEGEND)


def tables(comparison: Comparison) -> Iterator[Text | Table]:
    """Yield titles and tables: one of the images with `paper`, then three for each plane."""
    records = comparison.of("256x256", "paper")
    if records:
        yield _title("The `paper` preset, image by image; lengths in pixels of 256 x 256")
        table = _table(_IMAGE)
        names = _short_names([record.image for record in records])
        for name, record in zip(names, records, strict=True):
            table.add_row(Text(printable(name), overflow="fold"), *_cells(record.figures, _IMAGE))
        yield table
    overall = comparison.overall()
    for plane in comparison.methods:
        averages = [average for average in overall if average.plane == plane]
        images = max(average.images for average in averages)
        for about, columns in _METHOD.items() if images else ():
            number = f"{images} image{'s' if images != 1 else ''}"
            yield _title(f"{_PLANES[plane]}; {number}: {about}")
            table = _table(columns)
            for average in averages:
                table.add_row(average.method, *_cells(average.mean, columns, average.median))
            yield table


def _title(text: str) -> Text:
    return Text(text, style="bold")


def _table(columns: Columns) -> Table:
    table = Table(box=SIMPLE_HEAD, padding=(0, 0, 0, 1))
    table.add_column("", overflow="fold", min_width=_NAMES)
    for name in columns:
        table.add_column(name, justify="right", vertical="bottom")
    return table


def _cells(figures: Figures, columns: Columns, median: Figures | None = None) -> list[str]:
    cells = []
    for name, pattern in columns.values():
        source = median if name.startswith("median ") else figures
        value = getattr(source, name.removeprefix("median "))
        cells.append(_NONE if math.isnan(value) else format(value, pattern))
    return cells


def _short_names(paths: Sequence[str]) -> list[str]:
    """Return paths without their common parent folders, so that they are still different."""
    parts = [path.split("/") for path in paths]
    folders = min((len(part) for part in parts), default=1) - 1
    shared = 0
    while shared < folders and len({part[shared] for part in parts}) == 1:
        shared += 1
    return ["/".join(part[shared:]) for part in parts]
