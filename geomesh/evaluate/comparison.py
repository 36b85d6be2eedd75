"""Comparison: figures of several methods on several images, their averages, and a table of them.

As in the paper, averages over images are those of each image's figures, not of all triangles
together; the median of the images stands beside the mean.
"""

from __future__ import annotations

import csv
import math
from dataclasses import asdict, dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from geomesh.arrays.plain import plain_json
from geomesh.io.atomic import check_place, staged, writing_to

if TYPE_CHECKING:
    from collections.abc import Iterator
    from os import PathLike

    import pandas as pd


@dataclass(frozen=True, slots=True, kw_only=True)
class Figures:
    """What is measured of one mesh: lengths in pixels of the plane, NaN where there is nothing.

    Parameters
    ----------
    nodes, triangles : float
        Of the mesh.
    ab, bc, ca : float
        Mean sides of the triangles: AB the shortest of each, BC the longest.
    ki, ki_mean, ki_min : float
        Mean over triangles of Ki with AB the shortest side (the greatest of the three
        labellings), of the mean of the labellings, and of Ki with AB the longest side.
    ki_median : float
        Median over triangles of `ki`.
    ki_of_sides : float
        The formula applied to `ab`, `bc` and `ca`, as in the paper's Table 1.
    ki_normalised : float
        ki / sqrt(area of the plane / nodes), without unit.
    angle_mean, angle_median, angle_p5 : float
        Of the triangles' smallest angles, in degrees; p5 is the 5th percentile.
    angle_under_10 : float
        TileMesh of triangles whose smallest angle is under 10 degrees.
    covered : float
        TileMesh of the valid pixels that lie in a triangle: those that PSNR is counted over,
        but for `psnr_whole`.
    psnr_linear_sampled, psnr_linear_least_squares : float
        PSNR in dB of the surface that is linear in each triangle, its values at the nodes
        taken from the image, or chosen so that the pixels err least.
    psnr_constant_sampled, psnr_constant_least_squares : float
        PSNR in dB of one value a triangle: that at its centroid, or the mean of its pixels.
    psnr_whole : float
        As `psnr_linear_least_squares`, but over all valid pixels, the corners of the plane
        added to the nodes where the mesh leaves pixels out: the figure to compare methods by.
    """

    nodes: float
    triangles: float
    ab: float
    bc: float
    ca: float
    ki: float
    ki_mean: float
    ki_min: float
    ki_median: float
    ki_of_sides: float
    ki_normalised: float
    angle_mean: float
    angle_median: float
    angle_p5: float
    angle_under_10: float
    covered: float
    psnr_linear_sampled: float
    psnr_linear_least_squares: float
    psnr_constant_sampled: float
    psnr_constant_least_squares: float
    psnr_whole: float


MEASURES = tuple(field.name for field in fields(Figures))


@dataclass(frozen=True, slots=True)
class Record:
    """One method on one image, in one plane.

    Parameters
    ----------
    image : str
        The source, as it was named.
    plane : str
        "256x256", or "native".
    method : str
    width, height : int
        Of the plane, in pixels.
    wanted : int
        Nodes that the method was asked for.
    figures : Figures
    """

    image: str
    plane: str
    method: str
    width: int
    height: int
    wanted: int
    figures: Figures


@dataclass(frozen=True, slots=True)
class Average:
    """One method in one plane, over the images on which it gave a mesh.

    Parameters
    ----------
    plane, method : str
    images : int
        How many they are.
    mean, median : Figures
        Of the figures of each image.
    """

    plane: str
    method: str
    images: int
    mean: Figures
    median: Figures


@dataclass(frozen=True, slots=True)
class Failure:
    """What could not be evaluated.

    Parameters
    ----------
    image : str
    plane : str
        Empty for the whole image.
    error : str
        Why not, in one line.
    code : str
        The kind of error: see `geomesh.errors`.
    """

    image: str
    plane: str
    error: str
    code: str


@dataclass(frozen=True)
class Comparison:
    """The figures of all methods on all images.

    Parameters
    ----------
    records : tuple of Record
        Image by image, in the order in which they were named.
    failures : tuple of Failure
    """

    records: tuple[Record, ...]
    failures: tuple[Failure, ...]

    def __repr__(self) -> str:
        return (
            f"<Comparison: {len(self.images)} images, {len(self.records)} meshes, "
            f"{len(self.failures)} failures>"
        )

    @property
    def images(self) -> tuple[str, ...]:
        """The images of which there are records, in order."""
        return tuple(dict.fromkeys(record.image for record in self.records))

    @property
    def methods(self) -> dict[str, tuple[str, ...]]:
        """The methods of each plane, in order."""
        planes: dict[str, dict[str, None]] = {}
        for record in self.records:
            planes.setdefault(record.plane, {})[record.method] = None
        return {plane: tuple(methods) for plane, methods in planes.items()}

    def of(self, plane: str, method: str) -> tuple[Record, ...]:
        """Return the records of a method in a plane, in order of the images."""
        return tuple(r for r in self.records if (r.plane, r.method) == (plane, method))

    def overall(self) -> tuple[Average, ...]:
        """Return the averages of each method in each plane."""
        return tuple(
            _average(plane, method, self.of(plane, method))
            for plane, methods in self.methods.items()
            for method in methods
        )

    def rows(self) -> Iterator[dict[str, Any]]:
        """Yield the rows of the table: images, then mean and median, then what failed.

        docs/evaluate.md lists the columns.
        """
        for record in self.records:
            about = asdict(record)
            yield {"row": "image", **about.pop("figures"), **about}
        for average in self.overall():
            about = {
                "plane": average.plane,
                "method": average.method,
                "image": f"{average.images} images",
            }
            yield {"row": "mean", **about, **asdict(average.mean)}
            yield {"row": "median", **about, **asdict(average.median)}
        for failure in self.failures:
            about = {"image": failure.image, "plane": failure.plane, "error": failure.error}
            yield {"row": "failed", **about}

    def to_dataframe(self) -> pd.DataFrame:
        """Return the records as a DataFrame, one row an image, plane and method."""
        import pandas as pd

        rows = [row for row in self.rows() if row["row"] == "image"]
        return pd.DataFrame(rows, columns=list(COLUMNS[1:-1]))

    def to_dict(self) -> dict[str, Any]:
        """Return everything as plain JSON values; figures that are not finite are None."""
        rows: dict[str, list[dict[str, Any]]] = {
            "image": [],
            "mean": [],
            "median": [],
            "failed": [],
        }
        for row in self.rows():
            plain = {name: plain_json(value) for name, value in row.items() if name != "row"}
            rows[row["row"]].append(plain)
        failed = rows.pop("failed")
        return {"results": rows.pop("image"), **rows, "failures": failed, "failed": len(failed)}

    def to_csv(self, path: str | PathLike[str], *, overwrite: bool = False) -> None:
        """Write all `rows` as CSV, whole or not at all; what is not known is left empty.

        Raises
        ------
        OutputError
            If the file exists and is not to be replaced, or cannot be written.
        """
        check_place(Path(path), overwrite=overwrite)
        with (
            writing_to(Path(path)),
            staged(Path(path), ".csv", overwrite=overwrite) as temporary,
            temporary.open("w", newline="", encoding="utf-8") as file,
        ):
            writer = csv.DictWriter(file, COLUMNS)
            writer.writeheader()
            writer.writerows(
                {name: _cell(value) for name, value in row.items()} for row in self.rows()
            )


COLUMNS = (
    *("row", "image", "plane", "method", "width", "height", "wanted"),
    *MEASURES,
    "error",
)


def _average(plane: str, method: str, records: tuple[Record, ...]) -> Average:
    table = np.array([[getattr(r.figures, name) for name in MEASURES] for r in records])
    table = table[~np.isnan(table[:, MEASURES.index("ki")])]
    if not len(table):
        table = np.full((1, len(MEASURES)), np.nan)
        return Average(plane, method, 0, *(2 * [_named(table[0])]))
    mean, median = table.mean(axis=0), np.median(table, axis=0)
    return Average(plane, method, len(table), _named(mean), _named(median))


def _named(values: np.ndarray[Any, Any]) -> Figures:
    return Figures(**dict(zip(MEASURES, map(float, values), strict=True)))


def _cell(value: Any) -> Any:
    """Return what a spreadsheet reads as it was meant: whole numbers without a point."""
    if not isinstance(value, float):
        return value
    if math.isnan(value):
        return ""
    return int(value) if value.is_integer() else float(f"{value:.6g}")
