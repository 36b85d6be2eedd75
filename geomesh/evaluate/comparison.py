"""Comparison: the figures of several methods on several images, their averages, and tables.

As in the paper, averages are taken over the figures of the images, not over all triangles
together. Each average has a mean and a median.
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
    """The measures of one mesh; lengths are in pixels of the plane, unknown values are NaN.

    Parameters
    ----------
    nodes, triangles : float
        Number of nodes and of triangles of the mesh.
    ab, bc, ca : float
        Mean sides of the triangles. AB is the shortest side of a triangle, BC the longest.
    ki, ki_mean, ki_min : float
        Means over the triangles: of Ki with AB as the shortest side (the maximum of the three
        labellings), of the mean of the labellings, and of Ki with AB as the longest side.
    ki_median : float
        Median over triangles of `ki`.
    ki_of_sides : float
        The formula applied to `ab`, `bc` and `ca`, as in the paper's Table 1.
    ki_normalised : float
        ki / sqrt(area of the plane / nodes), without unit.
    angle_mean, angle_median, angle_p5 : float
        Of the smallest angles of the triangles, in degrees; p5 is the 5th percentile.
    angle_under_10 : float
        Share of the triangles whose smallest angle is less than 10 degrees.
    covered : float
        Share of the valid pixels that are in a triangle. PSNR is measured on these pixels,
        except `psnr_whole`.
    psnr_linear_sampled, psnr_linear_least_squares : float
        PSNR in dB of the surface that is linear in each triangle. Its node values are taken
        from the image, or minimise the squared errors of the pixels.
    psnr_constant_sampled, psnr_constant_least_squares : float
        PSNR in dB of one value per triangle: the value at its centroid, or the mean of its
        pixels.
    psnr_whole : float
        Like `psnr_linear_least_squares`, but on all valid pixels: if the mesh does not cover
        all of them, the corners of the plane are added to the nodes. Use this figure to
        compare methods.
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
        The source, as the user named it.
    plane : str
        "256x256" or "native".
    method : str
    width, height : int
        Size of the plane, in pixels.
    wanted : int
        Number of nodes that the method had to place.
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
    """The averages of one method in one plane, over the images for which it has a mesh.

    Parameters
    ----------
    plane, method : str
    images : int
        Number of these images.
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
    """An image, or a plane of it, that could not be evaluated.

    Parameters
    ----------
    image : str
    plane : str
        Empty if the whole image failed.
    error : str
        The reason, in one line.
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
        In the order in which the user named the images.
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
        """The images that have records, in order."""
        return tuple(dict.fromkeys(record.image for record in self.records))

    @property
    def methods(self) -> dict[str, tuple[str, ...]]:
        """The methods of each plane, in order."""
        planes: dict[str, dict[str, None]] = {}
        for record in self.records:
            planes.setdefault(record.plane, {})[record.method] = None
        return {plane: tuple(methods) for plane, methods in planes.items()}

    def of(self, plane: str, method: str) -> tuple[Record, ...]:
        """Return the records of a method in a plane, in the order of the images."""
        return tuple(r for r in self.records if (r.plane, r.method) == (plane, method))

    def overall(self) -> tuple[Average, ...]:
        """Return the averages of each method in each plane."""
        return tuple(
            _average(plane, method, self.of(plane, method))
            for plane, methods in self.methods.items()
            for method in methods
        )

    def rows(self) -> Iterator[dict[str, Any]]:
        """Yield the rows of the table: first images, then means and medians, then failures.

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
        """Return the records as a DataFrame, with one row per image, plane and method."""
        import pandas as pd

        rows = [row for row in self.rows() if row["row"] == "image"]
        return pd.DataFrame(rows, columns=list(COLUMNS[1:-1]))

    def to_dict(self) -> dict[str, Any]:
        """Return all rows as plain JSON values; figures that are not finite become None."""
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
        """Write all `rows` as CSV, atomically; unknown values are empty cells.

        Raises
        ------
        OutputError
            If the file exists (unless `overwrite`) or cannot be written.
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
    """Return a value for a spreadsheet: NaN as an empty cell, integers without a point."""
    if not isinstance(value, float):
        return value
    if math.isnan(value):
        return ""
    return int(value) if value.is_integer() else float(f"{value:.6g}")
