"""Attributes for the page: which ones, and their values as 16-bit codes."""

from __future__ import annotations

import warnings
from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from geomesh.errors import GeomeshWarning, OutputError
from geomesh.mesh.height import short_unit
from geomesh.raster.crs import has_angles

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from numpy.typing import NDArray

    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.raster.grid import Grid

# The code of a missing value, and the number of codes below it.
NULL = 65535

# Up to this many triangles a page holds all attributes; above it, it would be large.
_MOST_WITH_ALL = 200_000

# What a page of a larger mesh holds beside the bands.
_MAIN = ("count", "area")

# The page knows these from the geometry.
_MEASURED = ("id", "n0", "n1", "n2", "ab", "bc", "ca", "ki", "min_angle", "shape")

# The range of colours: values outside this share of all values get the colours of the ends.
_PERCENTILES = (2, 98)

# A band with at most this many values is shown with a colour for each, if it has classes.
_MOST_CLASSES = 256

# Columns whose greatest value is next to their least: degrees of a circle.
_CIRCULAR = ("aspect",)


@dataclass(frozen=True)
class Expected:
    """What the colour of a triangle lets expect of the code of a mean.

    The code is about ``first + step * level``, with the level of a channel of the colour. Only
    the difference is stored, which is small: a third less for an image of 8 bits.
    """

    channel: int
    first: float
    step: float

    def subtract(self, codes: NDArray[np.uint16], colors: NDArray[np.uint8]) -> NDArray[np.uint16]:
        """Return codes (T,) without what colours (T, 3) let expect: 2 d, or -2 d - 1."""
        levels = colors[:, self.channel].astype(np.float64)
        expected = np.floor(self.first + levels * self.step + 0.5).astype(np.int64)
        away = (codes.astype(np.int64) - expected).astype(np.int16)
        return ((away << 1) ^ (away >> 15)).astype(np.uint16)


@dataclass(frozen=True, eq=False)
class Column:
    """An attribute as 16-bit codes.

    Parameters
    ----------
    name : str
    at : {"triangles", "nodes"}
        What has the values. Values at nodes are interpolated.
    codes : uint16 (n,)
        ``low + step * code``, or a position in `texts`; 65535 where there is no value.
    low, step : float
    cut : (float, float)
        The 2nd and the 98th percentile.
    texts : tuple of str, optional
        The categories of a column that has no order.
    unit : str
    kind : {"number", "classes", "circle"}
    key : str
        Under which the page knows it; the name, unless two columns have the same.
    near : Expected, optional
        If the page stores the codes as differences to this.
    """

    name: str
    at: str
    codes: NDArray[np.uint16]
    low: float
    step: float
    cut: tuple[float, float]
    texts: tuple[str, ...] | None = None
    unit: str = ""
    kind: str = "number"
    key: str = ""
    near: Expected | None = None

    def head(self) -> dict[str, Any]:
        """Return everything but the codes as plain JSON values."""
        texts = None if self.texts is None else list(self.texts)
        return {
            "name": self.name,
            "at": self.at,
            "low": self.low,
            "step": self.step,
            "cut": list(self.cut),
            "texts": texts,
            "unit": self.unit,
            "kind": self.kind,
            "key": self.key or self.name,
            "near": None if self.near is None else asdict(self.near),
        }


def measured_columns(mesh: TriangleMesh) -> tuple[str, ...]:
    """Return the names of the columns that the page computes from the geometry."""
    # On an ellipsoid this needs more than the page knows.
    is_plane = mesh.grid.crs is None or not has_angles(mesh.grid.crs)
    return (*_MEASURED, "area") if is_plane else _MEASURED


def area_unit(grid: Grid) -> str:
    """Return the unit of the areas of triangles."""
    return "px²" if grid.crs is None else "m²"


def choose_columns(mesh: TriangleMesh, names: Iterable[str] | None) -> list[str]:
    """Return the columns of the triangles, and the bands of a surface, that the page needs.

    Parameters
    ----------
    mesh : TriangleMesh
    names : iterable of str, optional
        Default: all of a mesh with up to 200,000 triangles; of a larger one the number of
        pixels, the means and the classes. A name that a column and a band share is the column.

    Raises
    ------
    OutputError
        If there is no such column.
    """
    known = dict.fromkeys([*mesh.attributes("triangles"), *surface_bands(mesh)])
    left_out = {*measured_columns(mesh), "color"}
    if names is None and len(mesh.triangles) <= _MOST_WITH_ALL:
        names = known
    elif names is None:
        of_bands = ("_mean", "_majority")
        names = [name for name in known if name in _MAIN or name.endswith(of_bands)]
    asked = dict.fromkeys([names] if isinstance(names, str) else names)
    for name in asked:
        if name not in known:
            raise OutputError(
                f"the triangles have no column {name!r}: choose from {', '.join(known)}"
            )
    return [name for name in asked if name not in left_out]


def encode_columns(mesh: TriangleMesh, names: Sequence[str]) -> list[Column]:
    """Return columns as codes, in the order of the triangles or nodes.

    Texts of which there are too many different ones are left out, with a warning.
    """
    table = mesh.attributes("triangles")
    units = _units(mesh)
    found, dropped = [], []
    for name in names:
        if name not in table:
            found.append(surface_column(mesh, name))
            continue
        column = _encode(name, table[name], units.get(name, ""))
        found += [column] if column is not None else []
        dropped += [name] if column is None else []
    if dropped:
        warnings.warn(
            f"the map leaves out {', '.join(dropped)}: more than {NULL:,} different texts; choose "
            "other columns with `columns`",
            GeomeshWarning,
            stacklevel=2,
        )
    return found


def surface_bands(mesh: TriangleMesh) -> tuple[str, ...]:
    """Return the bands with values at the nodes: of a refined linear surface, and the height."""
    refinement = None if mesh.provenance is None else mesh.provenance.refinement
    refined = refinement is not None and refinement.model == "linear"
    names = [band.name for band in refinement.bands] if refinement is not None and refined else []
    names += [] if mesh.height is None else [mesh.height.band]
    return tuple(name for name in dict.fromkeys(names) if name in mesh.node_table)


def surface_column(mesh: TriangleMesh, band: str) -> Column:
    """Return the values of a band at the nodes."""
    unit, height = _band_units(mesh).get(band, ""), mesh.height
    if not unit and height is not None and height.band == band and height.factor == 1:
        unit = short_unit(height.unit)
    column = _numbers(band, "nodes", mesh.node_table[band], unit)
    taken = band in mesh.attributes("triangles")
    return replace(column, key=f"{band} at nodes" if taken else band)


def _encode(name: str, values: NDArray[Any], unit: str) -> Column | None:
    kind = values.dtype.kind
    if kind == "b":
        return _categories(name, np.where(values, "true", "false"))
    if kind in "iuf":
        if name.endswith("_majority") and len(np.unique(values)) <= _MOST_CLASSES:
            return _classes(name, values, unit)
        return _numbers(name, "triangles", values, unit)
    is_missing = np.isnat(values) if kind == "M" else values == None  # noqa: E711
    return _categories(name, np.where(is_missing, "", values.astype(str)))


def _numbers(name: str, at: str, values: NDArray[Any], unit: str) -> Column:
    """Return numbers as codes: whole numbers of a small range exactly, others in equal steps."""
    numbers = values.astype(np.float64)
    known = np.isfinite(numbers)
    some = numbers[known]
    low, high = (float(some.min()), float(some.max())) if len(some) else (0.0, 0.0)
    # Halves, as the whole range may not fit into a number.
    half = high / 2 - low / 2
    is_whole = 2 * half < NULL and np.array_equal(some, np.rint(some))
    step = 1.0 if is_whole or half == 0 else half / ((NULL - 1) / 2)
    codes = np.full(len(numbers), NULL, np.uint16)
    codes[known] = np.minimum(np.rint((some / 2 - low / 2) / step * 2), NULL - 1)
    cut = np.percentile(some, _PERCENTILES) if len(some) else (0.0, 0.0)
    kind = "circle" if name in _CIRCULAR else "number"
    return Column(name, at, codes, low, step, (float(cut[0]), float(cut[1])), None, unit, kind)


def _classes(name: str, values: NDArray[Any], unit: str) -> Column:
    """Return classes, which have numbers, as codes of categories."""
    known = values != -1 if values.dtype.kind in "iu" else np.isfinite(values)
    found, places = np.unique(values[known], return_inverse=True)
    codes = np.full(len(values), NULL, np.uint16)
    codes[known] = places
    texts = tuple(f"{value:.10g}" for value in found.tolist())
    return Column(name, "triangles", codes, 0.0, 1.0, (0.0, 0.0), texts, unit, "classes")


def _categories(name: str, texts: NDArray[np.str_]) -> Column | None:
    found, places = np.unique(texts[texts != ""], return_inverse=True)
    if len(found) >= NULL:
        return None
    codes = np.full(len(texts), NULL, np.uint16)
    codes[texts != ""] = places
    return Column(
        name, "triangles", codes, 0.0, 1.0, (0.0, 0.0), tuple(found.tolist()), kind="classes"
    )


def _band_units(mesh: TriangleMesh) -> Mapping[str, str]:
    bands = () if mesh.provenance is None else mesh.provenance.source.bands
    return {band.name: band.unit for band in bands}


def _units(mesh: TriangleMesh) -> dict[str, str]:
    """Return the units of the columns of the triangles, where they are known."""
    units = {
        "area": area_unit(mesh.grid),
        "area_3d": "m²",
        "slope": "°",
        "aspect": "°",
    }
    for band, unit in _band_units(mesh).items():
        for suffix in ("mean", "std", "min", "max", "median", "rmse", "max_error"):
            units[f"{band}_{suffix}"] = unit
    return units
