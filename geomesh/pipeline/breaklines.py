"""Breaklines of a mesh: from a file or from Canny edges to chains that fit the outline."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
import shapely

from geomesh.domain.breaklines import GAP, Laid, lay_breaklines, without_crossings
from geomesh.domain.loops import subdivide
from geomesh.errors import RecipeError, SourceError
from geomesh.mesh.provenance import BreaklineFacts
from geomesh.raster.grid import snap
from geomesh.raster.lines import PixelLines, read_lines

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray
    from scipy.spatial import cKDTree

    from geomesh.arrays.types import Mask, Points
    from geomesh.features.detect import Detection
    from geomesh.raster.scene import Scene
    from geomesh.recipe import Recipe

# The word that stands for the edges of the image; it is their name and digest too.
CANNY = "canny"

# Largest distance of a simplified line to the given one, in pixels.
_TOLERANCE = 0.25
_CANNY_TOLERANCE = 1.0

# The share of the node budget, or without one of the feature nodes, for the edges of the image.
_CANNY_SHARE = 0.25


def read_breaklines(
    value: Any, layer: str | None, scene: Scene, recipe: Recipe
) -> PixelLines | None:
    """Return the breaklines that the user gave: a file, an object, a text, or the word "canny".

    Raises
    ------
    RecipeError
        If the mesh would not follow the pixels of the raster.
    SourceError, GeoreferenceError
        See `geomesh.raster.lines.read_lines`.
    """
    if value is None:
        if layer is not None:
            raise SourceError("`breaklines_layer` chooses a layer of `breaklines`: give that too")
        return None
    if recipe.domain == "hull" or recipe.resize is not None:
        raise RecipeError(
            f"`breaklines` needs a mesh that follows the pixels of the raster, and the preset "
            f"{recipe.preset} has domain={recipe.domain!r} and resize={recipe.resize!r}: use "
            "`preset=features` or `preset=adaptive`"
        )
    if isinstance(value, str) and value == CANNY:
        if layer is not None:
            raise SourceError("`breaklines_layer` chooses a layer of a file, not of Canny edges")
        return PixelLines(CANNY, np.empty(0, object), CANNY)
    return read_lines(value, scene, layer)


def fit_breaklines(
    breaklines: PixelLines, detection: Detection, loops: Sequence[Points], budget: int | None
) -> tuple[Laid, BreaklineFacts, tuple[str, ...]]:
    """Return the breaklines that fit the outline, facts about them, and warnings.

    Parameters
    ----------
    breaklines : PixelLines
    detection : Detection
    loops : sequence of float64 (k, 2)
        The outline.
    budget : int or None
        The node budget; it limits only Canny edges.
    """
    lines, tolerance, none = breaklines.lines, _TOLERANCE, "no breakline is inside the domain"
    if breaklines.digest == CANNY:
        lines, tolerance = _canny_lines(detection, budget), _CANNY_TOLERANCE
        none = "no edge of the image is long enough for a breakline"
    laid = lay_breaklines(lines, loops, tolerance)
    facts = BreaklineFacts(
        name=breaklines.name,
        digest=breaklines.digest,
        lines=len(laid.chains),
        vertices=sum(map(len, laid.chains)),
        length=float(sum(np.hypot(*np.diff(chain, axis=0).T).sum() for chain in laid.chains)),
    )
    return laid, facts, () if laid.chains else (none,)


def _canny_lines(detection: Detection, budget: int | None) -> NDArray[Any]:
    """Return the strongest of the long Canny edges, as many as their share of the nodes allows."""
    # Imported here: other breaklines do not need this kernel, which has to be compiled.
    from geomesh.features.chains import choose_chains, follow_chains

    assert detection.edges is not None
    chains = follow_chains(detection.edges, detection.size[0])
    if not chains:
        return np.empty(0, object)
    lines = np.array([shapely.LineString(chain.xy) for chain in chains])
    nodes = len(detection.keypoints) if budget is None else budget
    # Along a line, nodes will be about as far from each other as elsewhere in the mesh.
    spacing = np.sqrt(detection.survey.valid_pixels / max(nodes, 1))
    corners = shapely.get_num_coordinates(
        shapely.simplify(lines, _CANNY_TOLERANCE, preserve_topology=False)
    )
    costs = np.maximum(corners, shapely.length(lines) / spacing)
    kept: NDArray[Any] = lines[choose_chains(costs, _CANNY_SHARE * nodes)]
    return kept


def away_from(chains: Sequence[Points], points: Points, spacing: float) -> Mask:
    """Return which points (N, 2) are not closer to a chain than `spacing`."""
    away = np.ones(len(points), np.bool_)
    if chains:
        ends = np.concatenate([np.stack([chain[:-1], chain[1:]], axis=1) for chain in chains])
        tree = shapely.STRtree(shapely.linestrings(ends))
        near = tree.query(shapely.points(points), predicate="dwithin", distance=max(spacing, GAP))
        away[near[0]] = False
    return away


def divide_chains(
    chains: Sequence[Points], border: Sequence[Points], spacing: float, inner: cKDTree
) -> Points:
    """Return the segments (S, 2, 2) of chains, with nodes added as along the outline.

    Parameters
    ----------
    chains : sequence of float64 (k, 2)
    border : sequence of float64 (k, 2)
        The loops of the outline with all their nodes.
    spacing, inner
        As in `geomesh.domain.loops.subdivide`.
    """
    if not chains:
        return np.empty((0, 2, 2))
    lines = [snap(subdivide(chain, spacing, inner, closed=False)) for chain in chains]
    pieces = np.concatenate([np.stack([line[:-1], line[1:]], axis=1) for line in lines])
    outline = [np.stack([loop, np.roll(loop, -1, axis=0)], axis=1) for loop in border]
    return pieces[without_crossings(np.concatenate(outline), pieces)]
