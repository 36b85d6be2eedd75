"""The command that makes a mesh again, from what the mesh records."""

from __future__ import annotations

import json
import math
import shlex
from typing import TYPE_CHECKING, Any

from geomesh.errors import GeomeshError
from geomesh.pipeline.breaklines import CANNY
from geomesh.raster.crs import crs_label, is_known
from geomesh.raster.open import open_scene
from geomesh.recipe import DEFAULT_PRESET, PRESETS, Recipe
from geomesh.view.report.content import Again

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from geomesh.mesh.provenance import Provenance
    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.raster.grid import Grid
    from geomesh.view.report.errors import Original

# Length of a line of the command, if an option is not longer.
_LINE = 78

# Parameters of the recipe with an option of their own; the others need `--set`.
_OPTIONS = {
    "nodes": "--nodes",
    "max_error": "--max-error",
    "rmse": "--rmse",
    "min_angle": "--min-angle",
    "model": "--model",
    "effort": "--effort",
    "z": "--z",
    "z_factor": "--z-factor",
    "gray": "--gray",
    "domain": "--domain",
    "statistics": "--stats",
}


def how_again(mesh: TriangleMesh, original: Original | None) -> Again:
    """Return the command that makes a mesh again.

    Parameters
    ----------
    mesh : TriangleMesh
    original : Original, optional
        The raster. Without it, the command names bands and the box of the mesh although they
        may be the whole raster.
    """
    made = mesh.provenance
    if made is None:
        return Again("", ("The mesh does not record how it was made.",), {})
    parts = [
        ["geomesh", "mesh", _as_file(made.source.name)],
        ["-o", "mesh.gpkg"],
        *_recipe_parts(made.recipe),
        *_reading_parts(mesh, made, original),
    ]
    return Again(_shell(parts), tuple(_notes(made, original)), made.versions)


def _shell(parts: Sequence[Sequence[str]]) -> str:
    """Return a command for a shell, in lines that break between options."""
    lines = [shlex.join(parts[0])]
    for part in parts[1:]:
        text = shlex.join(part)
        if len(lines[-1]) + len(text) >= _LINE:
            lines.append(f"    {text}")
        else:
            lines[-1] += f" {text}"
    return " \\\n".join(lines)


def _as_file(name: str) -> str:
    """Return a name that is not taken for an option."""
    return f"./{name}" if name.startswith("-") else name


def _recipe_parts(recipe: Recipe) -> Iterator[Sequence[str]]:
    preset = recipe.preset if recipe.preset in PRESETS else Recipe().preset
    if preset != DEFAULT_PRESET:
        yield ("--preset", preset)
    usual = PRESETS[preset].to_dict()
    for name, value in recipe.to_dict().items():
        if value == usual[name]:
            continue
        if name == "keep_features" and value:
            yield ("--keep-features",)
        elif name == "sift_upsample":
            yield ("--sift-upsample" if value else "--no-sift-upsample",)
        elif name in _OPTIONS and value is not None:
            yield (_OPTIONS[name], _text(value))
        else:
            yield ("--set", f"{name}={json.dumps(value)}")


def _text(value: Any) -> str:
    if isinstance(value, list):
        return ",".join(map(_text, value))
    short = f"{value:g}" if isinstance(value, float) else str(value)
    return short if not isinstance(value, float) or float(short) == value else repr(value)


def _reading_parts(
    mesh: TriangleMesh, made: Provenance, original: Original | None
) -> Iterator[Sequence[str]]:
    source = made.source
    indexes = list(dict.fromkeys(band.index for band in source.bands))
    if not _are_usual(indexes, original):
        yield ("--bidx", ",".join(map(str, indexes)))
    if source.nodata is not None:
        yield ("--nodata", str(source.nodata))
    if source.alpha != "mask":
        yield ("--alpha", source.alpha)
    if source.unscale:
        yield ("--unscale",)
    if original is not None and not original.own_crs and mesh.grid.crs is not None:
        crs = mesh.grid.crs
        yield ("--crs", crs_label(crs) if is_known(crs) else crs.to_wkt())
    if source.area is None and not _is_whole(made, original):
        yield ("--bounds", *_box(mesh.grid))
    if made.breaklines is not None:
        name = CANNY if made.breaklines.digest == CANNY else made.breaklines.name
        yield ("--breaklines", name)


def _are_usual(indexes: list[int], original: Original | None) -> bool:
    """Return whether these bands are used without being asked for, as far as is known."""
    if original is None or not isinstance(original.scene.source, str):
        return indexes == list(range(1, len(indexes) + 1))
    scene = original.scene
    assert isinstance(scene.source, str)
    try:
        usual = open_scene(
            scene.source, nodata=scene.nodata, alpha=scene.alpha, unscale=scene.unscale
        )
    except GeomeshError:
        return False
    return indexes == [band.index for band in usual.classes.bands]


def _is_whole(made: Provenance, original: Original | None) -> bool:
    """Return whether the mesh is known to be one of the whole raster."""
    return original is not None and made.source.window == (0, 0, *original.scene.size)


def _box(grid: Grid) -> Iterator[str]:
    """Yield the bounds of a grid with so many decimals that they are within 1/8 of a pixel."""
    a, b, _, d, e, _ = grid.transform[:6]
    nearness = min(math.hypot(a, d), math.hypot(b, e)) / 8
    for value in grid.bounds():
        texts = (f"{value:.{decimals}f}" for decimals in range(17))
        yield next((text for text in texts if abs(float(text) - value) < nearness), repr(value))


def _notes(made: Provenance, original: Original | None) -> Iterator[str]:
    if original is None:
        yield (
            f"The mesh records its raster as {made.source.name}. Give its path if it is elsewhere "
            "now. The coordinates and bands in the command may be those of the whole raster."
        )
    if made.source.area is not None:
        yield (
            "The mesh was made inside an area of interest, of which it records the pixels and not "
            "the polygons. Add --mask or --bounds as it was given then."
        )
    if made.breaklines is not None and made.breaklines.digest != CANNY:
        yield (
            f"The mesh has the breaklines {made.breaklines.name}. Add --breaklines-layer if the "
            "file has several layers."
        )
    if made.recipe.refine and not _preset_refines(made.recipe):
        yield (
            "The mesh was refined from another mesh, which the command does not do: it makes one "
            "with the same goal."
        )
    if made.refinement is not None and made.refinement.note.startswith("the time was over"):
        yield "A time limit ended the refinement: without one, the mesh gets better than this one."
    yield "With these versions, the result is the same mesh, bit for bit."


def _preset_refines(recipe: Recipe) -> bool:
    return recipe.preset in PRESETS and PRESETS[recipe.preset].refine
