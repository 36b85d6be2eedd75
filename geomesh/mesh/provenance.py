"""Provenance: from which raster a mesh was made, how, and what was counted on the way."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from geomesh.recipe import Recipe

if TYPE_CHECKING:
    from collections.abc import Mapping


@dataclass(frozen=True)
class SourceBand:
    """A band that was meshed.

    Parameters
    ----------
    name : str
        Its column in the tables of the mesh.
    index : int
        1-based number in the source.
    description : str or None
        The source's own.
    """

    name: str
    index: int
    description: str | None


@dataclass(frozen=True)
class SourceRaster:
    """What is needed to find the same pixels again.

    Parameters
    ----------
    name : str
    window : (int, int, int, int)
        Column, row, width and height of the part that was meshed.
    bands : tuple of SourceBand
        In the order in which they were read.
    nodata : float or None
        The nodata value that was given in place of the source's own.
    area : str or None
        WKT of the area of interest, in pixel-edge coordinates of the source.
    """

    name: str
    window: tuple[int, int, int, int]
    bands: tuple[SourceBand, ...]
    nodata: float | None
    area: str | None


@dataclass(frozen=True)
class PixelCounts:
    """Pixels whose centre a triangle owns, and the valid ones among them."""

    covered: int
    counted: int


@dataclass(frozen=True)
class CannyThresholds:
    """Canny's hysteresis thresholds as they were used, in gray levels."""

    low: float
    high: float


@dataclass(frozen=True)
class Provenance:
    """How a mesh was made.

    Parameters
    ----------
    recipe : Recipe
    source : SourceRaster
    pixels : PixelCounts
    canny : CannyThresholds
    warnings : tuple of str
        What the user was told.
    versions : mapping of str to str
        Of geomesh and the libraries that a result may depend on.
    """

    recipe: Recipe
    source: SourceRaster
    pixels: PixelCounts
    canny: CannyThresholds
    warnings: tuple[str, ...]
    versions: Mapping[str, str]

    def __post_init__(self) -> None:
        object.__setattr__(self, "versions", dict(self.versions))

    def to_dict(self) -> dict[str, Any]:
        """Return the provenance as plain JSON values."""
        source, nodata = asdict(self.source), self.source.nodata
        return {
            "recipe": self.recipe.to_dict(),
            "source": {
                **source,
                "window": list(self.source.window),
                "bands": list(source["bands"]),
                # As text: JSON has no NaN.
                "nodata": None if nodata is None else str(nodata),
            },
            "pixels": asdict(self.pixels),
            "canny": asdict(self.canny),
            "warnings": list(self.warnings),
            "versions": dict(self.versions),
        }

    @classmethod
    def from_dict(cls, values: Mapping[str, Any]) -> Provenance:
        """Return the provenance that `to_dict` wrote.

        Raises
        ------
        KeyError, TypeError, ValueError, RecipeError
            If something is missing, or is not what it should be.
        """
        source = values["source"]
        nodata = source["nodata"]
        return cls(
            recipe=Recipe.from_dict(values["recipe"]),
            source=SourceRaster(
                name=source["name"],
                window=tuple(source["window"]),
                bands=tuple(SourceBand(**band) for band in source["bands"]),
                nodata=None if nodata is None else float(nodata),
                area=source["area"],
            ),
            pixels=PixelCounts(**values["pixels"]),
            canny=CannyThresholds(**values["canny"]),
            warnings=tuple(values["warnings"]),
            versions=dict(values["versions"]),
        )
