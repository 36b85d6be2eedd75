"""The recipe and the raster of a mesh, as rows of the tables of its report."""

from __future__ import annotations

from typing import TYPE_CHECKING

from geomesh.raster.crs import crs_label
from geomesh.recipe import PRESETS, Recipe
from geomesh.view.report.content import Setting
from geomesh.view.report.spelling import spell

if TYPE_CHECKING:
    from collections.abc import Iterator

    from geomesh.mesh.provenance import Provenance
    from geomesh.mesh.triangle_mesh import TriangleMesh

# Bands that are named.
_MOST_BANDS = 12


def settings(recipe: Recipe) -> tuple[str, tuple[Setting, ...]]:
    """Return the preset with which a recipe is compared, and its parameters in their order.

    A recipe whose preset is not known is compared with the preset "features".
    """
    name = recipe.preset if recipe.preset in PRESETS else Recipe().preset
    usual, own = PRESETS[name].to_dict(), recipe.to_dict()
    rows = tuple(
        Setting(key, _spell(value), None if value == usual[key] else _spell(usual[key]))
        for key, value in own.items()
        if key != "preset"
    )
    return name, rows


def _spell(value: object) -> str:
    if value is None:
        return "none"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, list):
        return ", ".join(map(_spell, value))
    return f"{value:g}" if isinstance(value, float) else str(value)


def source_facts(mesh: TriangleMesh) -> Iterator[tuple[str, str]]:
    """Yield facts about the raster and the area of a mesh: pairs of label and text."""
    grid, domain, made = mesh.grid, mesh.domain, mesh.provenance
    if made is not None:
        yield "Raster", made.source.name
        yield "Bands", _bands(made)
    yield "Pixels", f"{grid.width:,} × {grid.height:,}" + _part(made)
    yield "Size of a pixel", _pixel_size(mesh)
    if grid.crs is None:
        yield "CRS", "none: coordinates are columns and rows"
    else:
        label = crs_label(grid.crs)
        yield "CRS", f"{label}, {grid.crs.name}" if ":" in label else label
    yield "Valid pixels", f"{domain.valid_pixels:,}"
    if domain.islands_dropped or domain.holes_bridged:
        yield (
            "Small parts",
            f"{domain.islands_dropped:,} islands of data left out, {domain.holes_bridged:,} holes "
            "filled",
        )
    if made is not None:
        yield from _reading(made)
    if mesh.height is not None:
        guess = " (the raster does not say so)" if mesh.height.assumed else ""
        yield "Heights", f"band {mesh.height.band}, in {mesh.height.plural}{guess}"
    if made is not None and made.breaklines is not None:
        lines = made.breaklines
        yield (
            "Breaklines",
            f"{lines.name}: {lines.lines:,} lines, {spell(lines.length)} pixels long",
        )


def _bands(made: Provenance) -> str:
    bands = made.source.bands
    named = ", ".join(
        f"{band.index} ({band.name}{f', {band.unit}' if band.unit else ''})"
        for band in bands[:_MOST_BANDS]
    )
    rest = len(bands) - _MOST_BANDS
    return f"{named} and {rest} more" if rest > 0 else named


def _part(made: Provenance | None) -> str:
    if made is None:
        return ""
    col, row, *_ = made.source.window
    start = f", from column {col:,} and row {row:,}" if col or row else ""
    return start + (", inside an area of interest" if made.source.area is not None else "")


def _pixel_size(mesh: TriangleMesh) -> str:
    a, b, _, d, e, _ = mesh.grid.transform[:6]
    width, height = (a * a + d * d) ** 0.5, (b * b + e * e) ** 0.5
    crs = mesh.grid.crs
    unit = crs.axis_info[0].unit_name if crs is not None and crs.axis_info else "pixel"
    turned = ", turned" if b or d else ""
    return f"{spell(width, 6)} × {spell(height, 6)} {unit}{turned}"


def _reading(made: Provenance) -> Iterator[tuple[str, str]]:
    if made.source.nodata is not None:
        yield "Nodata", f"{made.source.nodata}, instead of the raster's own"
    if made.source.alpha == "data":
        yield "Alpha", "used as data"
    if made.source.unscale:
        yield "Values", "scale and offset of the raster applied"
