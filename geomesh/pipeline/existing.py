"""Find out whether a mesh file already is what a job would make.

Then it is complete and was made from the same pixels with the same recipe.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

from geomesh.errors import GeomeshError
from geomesh.formats.document import OPTIONS, WITH_HEIGHTS, describe_grid
from geomesh.formats.format import PLAIN, WriteOptions
from geomesh.formats.registry import find_format
from geomesh.mesh.provenance import Provenance, SourceRaster
from geomesh.pipeline.mesh_scene import source_of

if TYPE_CHECKING:
    from pathlib import Path

    from geomesh.parameters import LayerName
    from geomesh.raster.lines import PixelLines
    from geomesh.raster.scene import Scene
    from geomesh.recipe import Recipe

Made = tuple[Mapping[str, int], tuple[str, ...]]


def find_made(
    path: Path,
    scene: Scene,
    recipe: Recipe,
    breaklines: PixelLines | None = None,
    *,
    layers: Iterable[LayerName] | None = None,
    driver: str | None = None,
    options: WriteOptions = PLAIN,
) -> Made | str:
    """Return the counts and the warnings of a mesh file that need not be made again.

    If the file is damaged or was made from something else, return a text that says so and
    fits after "but".

    Parameters
    ----------
    path : Path
    scene : Scene
        The scene from which the job would make the mesh.
    recipe : Recipe
    breaklines : PixelLines, optional
        The breaklines that the mesh would have.
    layers, driver, options
        As in `geomesh.io.write.write_mesh`.
    """
    file_format = find_format(path, driver)
    try:
        document = json.loads(file_format.read_document(path))
        made, counts = Provenance.from_dict(document), document["mesh"]["counts"]
        grid = document["mesh"]["grid"]
    except (GeomeshError, ValueError, KeyError, TypeError, OSError, RuntimeError):
        return "is not a complete mesh file of geomesh"
    is_same = _is_same(made.source, source_of(scene)) and grid == describe_grid(scene.grid)
    digests = {None if lines is None else lines.digest for lines in (breaklines, made.breaklines)}
    for differs, how in (
        (made.recipe != recipe, "was made with another recipe"),
        (not is_same, f"was not made from the same pixels of {scene.name}"),
        (len(digests) > 1, "was made with other breaklines"),
        (document.get(OPTIONS, {}) != options.given(), "was written with other options"),
    ):
        if differs:
            return how
    try:
        for name in file_format.choose_layers(layers):
            stored = counts[WITH_HEIGHTS if file_format.leaves_out_voids else name]
            if file_format.count_rows(path, name) != stored:
                return f"does not have all its {name}"
    except (GeomeshError, ValueError, KeyError, OSError, RuntimeError):
        return "is damaged or does not have all layers"
    return counts, made.warnings


def _is_same(one: SourceRaster, other: SourceRaster) -> bool:
    """Return whether two sources are the same; their paths may differ, except the file name."""
    names = (re.split(r"[/\\]", source.name)[-1] for source in (one, other))
    return len(set(names)) == 1 and replace(one, name=other.name) == other
