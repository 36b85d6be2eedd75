"""The jobs of `geomesh mesh` and their summaries: values that can be sent to processes."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from geomesh.formats.format import PLAIN, WriteOptions

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    from geomesh.parameters import LayerName
    from geomesh.raster.open import Source
    from geomesh.recipe import Recipe


@dataclass(frozen=True)
class MeshJob:
    """One raster, how to mesh it, and the file to write.

    Parameters
    ----------
    source : str, PathLike, rasterio dataset, xarray.DataArray, or (array, transform, crs)
    output : Path
    recipe : Recipe
    layers : tuple of {"triangles", "edges", "nodes"}, optional
    driver : str, optional
    overwrite : bool
        As in `geomesh.io.write.write_mesh`.
    skip_existing : bool
        Keep an existing output that is complete and was made from the same pixels with the
        same recipe.
    reading : mapping
        Keywords of `geomesh.raster.open.open_scene`.
    options : WriteOptions
    breaklines, breaklines_layer
        See `geomesh.pipeline.breaklines.read_breaklines`.
    time_limit : float, optional
        Seconds after which refinement ends early.

    Raises
    ------
    RecipeError
        If there is a time limit, but no refinement.
    """

    source: Source
    output: Path
    recipe: Recipe
    layers: tuple[LayerName, ...] | None = None
    driver: str | None = None
    overwrite: bool = False
    skip_existing: bool = False
    reading: Mapping[str, Any] = field(default_factory=dict)
    options: WriteOptions = PLAIN
    breaklines: Any = None
    breaklines_layer: str | None = None
    time_limit: float | None = None

    def __post_init__(self) -> None:
        if self.time_limit is not None:
            self.recipe.require_refinement("time_limit", self.time_limit)


@dataclass(frozen=True)
class MeshSummary:
    """The result of a job: counts, warnings, and whether an existing file was kept."""

    nodes: int
    triangles: int
    warnings: tuple[str, ...]
    skipped: bool = False
