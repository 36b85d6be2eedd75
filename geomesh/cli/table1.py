"""How a comparison of methods is printed: image by image, then all methods over all images."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING

from rich.console import Console
from rich.table import Table
from rich.text import Text

if TYPE_CHECKING:
    from geomesh.comparison import Average, Comparison, Figures

# Heading: figure, and how it is written.
Columns = Mapping[str, tuple[str, str]]

_KI: Columns = {
    "nodes": ("nodes", ",.0f"),
    "AB": ("ab", ".2f"),
    "BC": ("bc", ".2f"),
    "CA": ("ca", ".2f"),
    "Ki": ("ki", ".2f"),
    "Ki mean": ("ki_mean", ".2f"),
    "Ki min": ("ki_min", ".2f"),
    "Ki/√(A/N)": ("ki_normalised", ".3f"),
}
_OVERALL: Columns = {**_KI, "Ki of sides": ("ki_of_sides", ".2f")}
_IMAGE: Columns = {**_KI, "angle°": ("angle_mean", ".1f"), "PSNR": ("psnr_whole", ".2f")}
_FIDELITY: Columns = {
    "angle°": ("angle_mean", ".1f"),
    "median": ("angle_median", ".1f"),
    "5 %": ("angle_p5", ".1f"),
    "< 10°": ("angle_under_10", ".1%"),
    "covered": ("covered", ".1%"),
    "linear sampled": ("psnr_linear_sampled", ".2f"),
    "linear fitted": ("psnr_linear_least_squares", ".2f"),
    "constant sampled": ("psnr_constant_sampled", ".2f"),
    "constant fitted": ("psnr_constant_least_squares", ".2f"),
    "whole image": ("psnr_whole", ".2f"),
}
# Of these the median of the images stands beside the mean, in brackets.
_WITH_MEDIAN = ("Ki", "whole image")

_PLANES = {
    "256x256": "At 256 x 256 pixels, each method with as many nodes as `paper` finds",
    "native": "At native resolution, each method with as many nodes as `features` finds",
}
_LEGEND = (
    "Averages are those of the images' figures (in brackets the median). Lengths are in pixels of "
    "the plane; AB is a triangle's shortest side, BC its longest. Ki: with this labelling, the "
    "greatest value of the three; Ki mean: of the three labellings; Ki min: AB the longest side; "
    "Ki of sides: the formula applied to the mean sides, as in the paper's Table 1; A and N: area "
    "of the plane, nodes. angle: the smallest of each triangle. PSNR in dB of the gray image, over "
    "the pixels covered; sampled: values taken from the image; fitted: by least squares; whole "
    "image: linear, fitted, over all valid pixels, the corners added to the nodes."
)
_NONE = "–"
_WIDTH = 120  # where there is no terminal


def print_comparison(comparison: Comparison) -> None:
    """Print the tables of a comparison to standard output."""
    console = Console(highlight=False)
    if not console.is_terminal:
        console.width = _WIDTH
    for table in tables(comparison):
        console.print(table)
    console.print(_LEGEND)


def tables(comparison: Comparison) -> Iterator[Table]:
    """Yield the tables: the `paper` preset image by image, then two for each plane."""
    yield _images_table(comparison)
    overall = comparison.overall()
    for plane in comparison.methods:
        averages = [average for average in overall if average.plane == plane]
        images = max(average.images for average in averages)
        title = f"{_PLANES[plane]}; {images} image{'s' if images != 1 else ''}"
        yield _methods_table(f"{title}: sides and Ki", averages, _OVERALL)
        yield _methods_table(f"{title}: shape, and PSNR in dB", averages, _FIDELITY)


def _images_table(comparison: Comparison) -> Table:
    table = _table("The `paper` preset, image by image: lengths in pixels of 256 x 256", _IMAGE)
    records = comparison.of("256x256", "paper")
    names = _short_names([record.image for record in records])
    for name, record in zip(names, records, strict=True):
        table.add_row(Text(name, overflow="fold"), *_cells(record.figures, _IMAGE))
    return table


def _methods_table(title: str, averages: Sequence[Average], columns: Columns) -> Table:
    table = _table(title, columns)
    for average in averages:
        cells = _cells(average.mean, columns)
        medians = _cells(average.median, columns)
        table.add_row(
            average.method,
            *(
                f"{cell} ({median})" if name in _WITH_MEDIAN else cell
                for name, cell, median in zip(columns, cells, medians, strict=True)
            ),
        )
    return table


def _table(title: str, columns: Columns) -> Table:
    table = Table(title=Text(title), title_justify="left", padding=(0, 0, 0, 1), pad_edge=False)
    table.add_column("", overflow="fold", ratio=None)
    for name in columns:
        table.add_column(name, justify="right", vertical="bottom")
    return table


def _cells(figures: Figures, columns: Columns) -> list[str]:
    values = [(getattr(figures, name), how) for name, how in columns.values()]
    return [_NONE if math.isnan(value) else format(value, how) for value, how in values]


def _short_names(paths: Sequence[str]) -> list[str]:
    """Return paths without the folder that all are in: still different ones."""
    folder = os.path.commonprefix([path.rpartition("/")[0] + "/" for path in paths])
    folder = folder[: folder.rfind("/") + 1]
    return [path.removeprefix(folder) for path in paths]
