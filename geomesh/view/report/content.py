"""What a report shows, as value objects: texts and numbers that are ready to be set on a page."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from collections.abc import Mapping

# The measures by which triangles are the worst.
Worse = Literal["angle", "error"]


@dataclass(frozen=True)
class Figure:
    """A figure that says most about a mesh.

    Parameters
    ----------
    label, value : str
    note : str
        What the value is compared with; may be empty.
    """

    label: str
    value: str
    note: str = ""


@dataclass(frozen=True)
class Statement:
    """A sentence of the certificate.

    Parameters
    ----------
    text : str
    detail : str
        The numbers that were compared; may be empty.
    passed : bool or None
        Whether the sentence is true. None: it is a fact, and no condition.
    """

    text: str
    detail: str = ""
    passed: bool | None = None


@dataclass(frozen=True)
class Setting:
    """A parameter of the recipe.

    Parameters
    ----------
    name, value : str
    usual : str or None
        The value that the preset has, if it is another one.
    """

    name: str
    value: str
    usual: str | None = None


@dataclass(frozen=True)
class WorstTriangle:
    """One of the worst triangles.

    Parameters
    ----------
    mark : str
        Its mark on the map, such as "A1".
    id : int
        In the layer of the triangles.
    place : (float, float)
        Its centre, in the CRS of the mesh.
    lonlat : (float, float) or None
        The same in degrees; None if there is no CRS, or the place has none.
    value : str
    """

    mark: str
    id: int
    place: tuple[float, float]
    lonlat: tuple[float, float] | None
    value: str


@dataclass(frozen=True)
class WorstList:
    """The worst triangles by one measure, the worst first."""

    by: Worse
    title: str
    column: str
    triangles: tuple[WorstTriangle, ...]


@dataclass(frozen=True)
class Histogram:
    """How often the triangles of a mesh have which values.

    Parameters
    ----------
    title : str
    unit : str
        May be empty.
    edges : tuple of float
        Limits of the bins, one more than `counts`.
    counts : tuple of int
        A value that is equal to a limit belongs to the bin above it, except the last.
    median : float
    left_out : int
        Number of triangles without a finite value.
    logarithmic : bool
        Whether the bins have equal widths in the logarithm.
    limit : (float, str) or None
        A value to mark, and what it is.
    """

    title: str
    unit: str
    edges: tuple[float, ...]
    counts: tuple[int, ...]
    median: float
    left_out: int
    logarithmic: bool = False
    limit: tuple[float, str] | None = None


@dataclass(frozen=True)
class Picture:
    """A picture with the text below it.

    Parameters
    ----------
    png : bytes
    width, height : int
        In pixels.
    alt : str
        What it shows, for those who do not see it.
    caption : str
    """

    png: bytes
    width: int
    height: int
    alt: str
    caption: str


@dataclass(frozen=True)
class Marker:
    """A mark on the map: its text, the place in pixels of the picture, and that of the text."""

    by: Worse
    mark: str
    place: tuple[float, float]
    label: tuple[float, float]


@dataclass(frozen=True)
class Map:
    """The picture of the whole mesh.

    Parameters
    ----------
    picture : Picture
    markers : tuple of Marker
    scale : (float, str) or None
        Length of the scale bar in pixels of the picture, and its text.
    """

    picture: Picture
    markers: tuple[Marker, ...]
    scale: tuple[float, str] | None


@dataclass(frozen=True)
class Again:
    """How to make the mesh again.

    Parameters
    ----------
    command : str
        For a shell, in one or more lines; empty if it is not known how the mesh was made.
    notes : tuple of str
        What the command cannot say.
    versions : mapping of str to str
    """

    command: str
    notes: tuple[str, ...]
    versions: Mapping[str, str]


@dataclass(frozen=True)
class Report:
    """All that the page of a mesh shows.

    Parameters
    ----------
    title, subtitle : str
    passed : bool
        Whether the certificate passed.
    figures : tuple of Figure
    map : Map
    pairs : tuple of tuple of Picture
        Pictures to set side by side: the image and the mesh.
    pairs_note : str
        Where the image is from, or why there is none.
    accuracy : tuple of str
        Sentences about the errors.
    statements : tuple of Statement
    histograms : tuple of Histogram
    worst : tuple of WorstList
    quality : mapping
        The summary of `geomesh.Quality`.
    source : tuple of (str, str)
        Facts about the raster.
    settings : tuple of Setting
    preset : str
        The preset with which the settings are compared.
    warnings : tuple of str
    again : Again
    """

    title: str
    subtitle: str
    passed: bool
    figures: tuple[Figure, ...]
    map: Map
    pairs: tuple[tuple[Picture, ...], ...]
    pairs_note: str
    accuracy: tuple[str, ...]
    statements: tuple[Statement, ...]
    histograms: tuple[Histogram, ...]
    worst: tuple[WorstList, ...]
    quality: Mapping[str, object]
    source: tuple[tuple[str, str], ...]
    settings: tuple[Setting, ...]
    preset: str
    warnings: tuple[str, ...]
    again: Again
