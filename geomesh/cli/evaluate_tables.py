"""How a comparison of methods is printed: image by image, then all methods over all images."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

if TYPE_CHECKING:
    from geomesh.evaluate.comparison import Comparison, Figures

# Heading: figure (of the median of the images, where it begins so), and how it is written.
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
    "Of the methods: means of the images' figures; the median beside is that of the images. "
    "Lengths: pixels of the plane; AB is a triangle's shortest side, BC its longest. Ki of sides: "
    "the formula applied to the mean sides, as in the paper's Table 1. Ki: mean over triangles, "
    "with this labelling, which gives the greatest value; Ki mean: of the three labellings; Ki "
    "min: AB the longest side. A: area of the plane, N: nodes. Angle: the smallest of each "
    "triangle, in degrees: mean, median, 5th percentile, share under 10. PSNR: of the gray image, "
    "over the valid pixels covered; sampled: with values of the image; fitted: by least squares; "
    "whole image: linear, fitted, over all valid pixels, the corners of the image added to the "
    "nodes."
)
_NONE = "–"
_NAMES = 14
_WIDTH = 120  # where there is no terminal


def print_comparison(comparison: Comparison) -> None:
    """Print the tables of a comparison to standard output."""
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = _WIDTH
    for part in tables(comparison):
        console.print(part)
    console.print(_LEGEND)


def tables(comparison: Comparison) -> Iterator[Text | Table]:
    """Yield titles and tables: the `paper` preset image by image, then three for each plane."""
    records = comparison.of("256x256", "paper")
    if records:
        yield _title("The `paper` preset, image by image; lengths in pixels of 256 x 256")
        table = _table(_IMAGE)
        names = _short_names([record.image for record in records])
        for name, record in zip(names, records, strict=True):
            table.add_row(Text(name, overflow="fold"), *_cells(record.figures, _IMAGE))
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
    for name, how in columns.values():
        source = median if name.startswith("median ") else figures
        value = getattr(source, name.removeprefix("median "))
        cells.append(_NONE if math.isnan(value) else format(value, how))
    return cells


def _short_names(paths: Sequence[str]) -> list[str]:
    """Return paths without the folders that all have in common: still different ones."""
    parts = [path.split("/") for path in paths]
    folders = min((len(part) for part in parts), default=1) - 1
    shared = 0
    while shared < folders and len({part[shared] for part in parts}) == 1:
        shared += 1
    return ["/".join(part[shared:]) for part in parts]
