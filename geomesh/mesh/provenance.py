"""Provenance: the raster and the settings that a mesh was made with, and pixel counts."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from geomesh.arrays.plain import plain_json
from geomesh.mesh.refinement import Refinement
from geomesh.raster.nodata import parse_nodata
from geomesh.recipe import Recipe

if TYPE_CHECKING:
    from collections.abc import Mapping

    from geomesh.parameters import Alpha
    from geomesh.raster.nodata import Number


@dataclass(frozen=True)
class SourceBand:
    """A band of the source from which a mesh was made.

    Parameters
    ----------
    name : str
        Name of its columns in the tables of the mesh.
    index : int
        1-based number in the source.
    description : str or None
        Description of the band in the source.
    unit : str
        Unit of its values as the source names it; empty if it does not.
    """

    name: str
    index: int
    description: str | None
    unit: str = ""


@dataclass(frozen=True)
class SourceRaster:
    """The information needed to read the same pixels of the source again.

    Parameters
    ----------
    name : str
    window : (int, int, int, int)
        Column, row, width and height of the part from which the mesh was made.
    bands : tuple of SourceBand
        In the order in which they were read.
    nodata : int, float or None
        The nodata value that the user gave to replace the value of the source.
    area : str or None
        The pixels of the area of interest: see `geomesh.raster.pixel_mask.PixelMask.to_text`.
    alpha : {"mask", "data"}
        What bands tagged as alpha were used as.
    unscale : bool
        Whether scale and offset were applied to the stored values.
    """

    name: str
    window: tuple[int, int, int, int]
    bands: tuple[SourceBand, ...]
    nodata: Number | None
    area: str | None
    alpha: Alpha = "mask"
    unscale: bool = False


@dataclass(frozen=True)
class PixelCounts:
    """Number of pixels whose centre is in a triangle, and of the valid pixels among them."""

    covered: int
    counted: int


@dataclass(frozen=True)
class CannyThresholds:
    """The hysteresis thresholds that Canny used, in gray levels."""

    low: float
    high: float


@dataclass(frozen=True)
class Display:
    """How the colours of the triangles were made from their means.

    Parameters
    ----------
    bands : (str, str, str)
        Names of the bands that are shown as red, green and blue.
    ranges : tuple of three (black, white)
        Values of each that are shown as 0 and as 255.
    """

    bands: tuple[str, str, str]
    ranges: tuple[tuple[float, float], tuple[float, float], tuple[float, float]]

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Display:
        """Return what was stored as plain JSON values."""
        red, green, blue = values["bands"]
        ranges = tuple((float(black), float(white)) for black, white in values["ranges"])
        return cls((red, green, blue), (ranges[0], ranges[1], ranges[2]))


@dataclass(frozen=True)
class BreaklineFacts:
    """The breaklines of a mesh.

    Parameters
    ----------
    name : str
        What they were read from; "canny" for edges of the image.
    digest : str
        The same for the same lines in the same CRS, wherever they are stored.
    lines, vertices : int
        Number of chains in the mesh, and of their points before nodes were added along them.
    length : float
        Of all chains, in pixels.
    """

    name: str
    digest: str
    lines: int
    vertices: int
    length: float


@dataclass(frozen=True)
class Provenance:
    """How a mesh was made.

    Parameters
    ----------
    recipe : Recipe
    source : SourceRaster
    pixels : PixelCounts
    canny : CannyThresholds or None
        None if the mesh was made without edges.
    warnings : tuple of str
        The warnings that the user got.
    versions : mapping of str to str
        Versions of geomesh and of the libraries that can change a result.
    refinement : Refinement, optional
        The goal of the refinement, and what the mesh reaches; None if it was not refined.
    breaklines : BreaklineFacts, optional
    display : Display, optional
        None if an older version of geomesh made the mesh.
    """

    recipe: Recipe
    source: SourceRaster
    pixels: PixelCounts
    canny: CannyThresholds | None
    warnings: tuple[str, ...]
    versions: Mapping[str, str]
    refinement: Refinement | None = None
    breaklines: BreaklineFacts | None = None
    display: Display | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "versions", dict(self.versions))

    def to_dict(self) -> dict[str, Any]:
        """Return the provenance as plain JSON values."""
        source, nodata = asdict(self.source), self.source.nodata
        refined = {} if self.refinement is None else {"refinement": self.refinement.to_dict()}
        return {
            "recipe": self.recipe.to_dict(),
            "source": {
                **source,
                "window": list(self.source.window),
                "bands": list(source["bands"]),
                # Stored as text because JSON has no NaN, and readers round large integers.
                "nodata": None if nodata is None else str(nodata),
            },
            "pixels": asdict(self.pixels),
            "canny": None if self.canny is None else asdict(self.canny),
            "breaklines": None if self.breaklines is None else asdict(self.breaklines),
            "display": None if self.display is None else plain_json(asdict(self.display)),
            "warnings": list(self.warnings),
            "versions": dict(self.versions),
            **refined,
        }

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Provenance:
        """Return the provenance from the values that `to_dict` returned.

        Raises
        ------
        KeyError, TypeError, ValueError, RecipeError
            If an entry is missing or not valid.
        """
        source = values["source"]
        nodata, canny = source["nodata"], values["canny"]
        # Only refined meshes have this.
        refinement = values.get("refinement")
        lines, display = values.get("breaklines"), values.get("display")
        return cls(
            recipe=Recipe.from_dict(values["recipe"]),
            source=SourceRaster(
                name=source["name"],
                window=tuple(source["window"]),
                bands=tuple(SourceBand(**band) for band in source["bands"]),
                nodata=None if nodata is None else parse_nodata(nodata),
                area=source["area"],
                # Older documents do not have these.
                alpha=source.get("alpha", "mask"),
                unscale=source.get("unscale", False),
            ),
            pixels=PixelCounts(**values["pixels"]),
            canny=None if canny is None else CannyThresholds(**canny),
            warnings=tuple(values["warnings"]),
            versions=dict(values["versions"]),
            refinement=None if refinement is None else Refinement.from_dict(refinement),
            breaklines=BreaklineFacts(**lines) if lines is not None else None,
            display=Display.from_dict(display) if display is not None else None,
        )
