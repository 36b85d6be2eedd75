"""Choose the nodes of a mesh, and the edges it must have, from keypoints and the domain."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import shapely
from numpy.typing import NDArray

from geomesh.arrays.table import Table
from geomesh.delaunay.triangulate import constrained_delaunay, delaunay
from geomesh.domain.breaklines import Laid
from geomesh.domain.loops import describe_domain, frame, loop_area, simplify, subdivide
from geomesh.domain.outline import drop_small_loops, trace
from geomesh.features.detect import SEAM, Detection
from geomesh.features.sift import Keypoints, spread_evenly, thin
from geomesh.mesh.certificate import DomainFacts
from geomesh.pipeline.breaklines import away_from, divide_chains, fit_breaklines
from geomesh.pipeline.budget import notes_on_features, wanted_nodes
from geomesh.raster.grid import Grid, snap

if TYPE_CHECKING:
    from scipy.spatial import cKDTree

    from geomesh.mesh.provenance import BreaklineFacts
    from geomesh.raster.lines import PixelLines
    from geomesh.recipe import Recipe

# The distance to the third nearest node is close to the length of an edge. The query for
# four neighbours returns the node itself first.
_NEAREST = 4
_SPACING_SAMPLE = 20_000

# Shares of the wanted nodes that features take at the start of refinement: if they can move
# later, and if they are kept.
_SHARE_OF_FEATURES = 0.1
_SHARE_KEPT = 0.5

Loops = list[NDArray[np.float64]]


@dataclass(frozen=True)
class NodeSet:
    """The nodes and constraints to triangulate.

    Attributes
    ----------
    points : float64 (N, 2)
        Distinct pixel-edge coordinates of the source, in order of y, then x.
    table : Table
        Columns kind, scale, response, octave and angle; the last four are NaN on the border.
    segments : int32 (S, 2)
        Pairs of points that must be edges: the outline and the breaklines.
    is_breakline : bool (S,)
        Which of them are breaklines.
    domain : DomainFacts
    notes : tuple of str
        Warnings for the user about the choice of nodes.
    breaklines : BreaklineFacts, optional
        None if the user gave none.
    """

    points: NDArray[np.float64]
    table: Table
    segments: NDArray[np.int32]
    is_breakline: NDArray[np.bool_]
    domain: DomainFacts
    notes: tuple[str, ...] = ()
    breaklines: BreaklineFacts | None = None


def place_nodes(
    detection: Detection, grid: Grid, recipe: Recipe, breaklines: PixelLines | None = None
) -> NodeSet:
    """Choose the feature nodes and add the nodes of the outline and of breaklines.

    Parameters
    ----------
    detection : Detection
    grid : Grid
        The pixel grid of the source.
    recipe : Recipe
        Used are min_spacing, nodes, domain, border_spacing and min_hole.
    breaklines : PixelLines, optional
        From `geomesh.pipeline.breaklines.read_breaklines`.
    """
    features = _features(detection, grid, recipe)
    thinned = len(detection.keypoints) - len(features)
    loops, facts = _domain(detection, grid, recipe)
    notes = _notes_on_domain(facts, recipe)
    if not loops:
        chosen = _strongest(features, recipe, facts)
        if len(delaunay(chosen.xy).triangles):
            area = shapely.convex_hull(shapely.multipoints(chosen.xy)).area
            return replace(_join(chosen, [], replace(facts, area=float(area))), notes=tuple(notes))
        notes.append(
            f"{len(chosen)} of {len(features)} keypoints were chosen, and they span no area: the "
            "mesh covers the whole frame instead of their hull"
        )
        loops, facts = _frame(grid, facts.valid_pixels)
    elif facts.islands_dropped or recipe.resize is not None:
        # Remove keypoints outside the outline: dropped islands are not part of the domain, and
        # the pixels of a resized image do not follow the outline.
        features = features.take(_inside(features.xy, loops))
    laid, lines = Laid(loops, []), None
    if breaklines is not None:
        budget = recipe.node_budget(facts.valid_pixels)
        laid, lines, more = fit_breaklines(breaklines, detection, loops, budget)
        notes += more
        features = features.take(away_from(laid.chains, features.xy, recipe.min_spacing))
    from scipy.spatial import cKDTree  # takes a while to import

    # An unbalanced tree takes half the time to build and gives the same distances.
    inner = cKDTree(_strongest(features, recipe, facts).xy, balanced_tree=False)
    spacing = recipe.border_spacing or _median_spacing(inner)
    if recipe.refine:
        spacing = np.inf  # refinement divides the outline where it needs nodes
    border = [_lattice_loop(subdivide(loop, spacing, inner), recipe) for loop in laid.loops]
    facts = replace(facts, area=sum(map(loop_area, border)))
    pieces = divide_chains(laid.chains, border, spacing, inner)
    taken = len(_unite(np.concatenate([*border, *pieces]))[0])
    if facts.kind == recipe.domain and not recipe.refine:  # refinement has notes of its own
        notes += notes_on_features(
            *(len(features), taken, recipe, facts), thinned=thinned, has_breaklines=len(pieces) > 0
        )
    chosen = _strongest(features, recipe, facts, taken=taken)
    return replace(_join(chosen, border, facts, pieces), notes=tuple(notes), breaklines=lines)


def _notes_on_domain(facts: DomainFacts, recipe: Recipe) -> list[str]:
    changes = []
    if facts.holes_bridged:
        changes.append(f"{facts.holes_bridged} holes of nodata were bridged")
    if facts.islands_dropped:
        changes.append(f"{facts.islands_dropped} islands of data were dropped")
    small = f"smaller than {recipe.min_hole} pixels (min_hole)"
    return [f"{' and '.join(changes)}, each {small}"] if changes else []


def _features(detection: Detection, grid: Grid, recipe: Recipe) -> Keypoints:
    """Return the keypoints in source pixels, thinned and sorted by strength."""
    keypoints = detection.keypoints
    if recipe.resize is None:
        keypoints = keypoints.moved(snap(keypoints.xy))
    # Two tiles may both find the same keypoint on their common border.
    spacing = max(recipe.min_spacing, SEAM) if recipe.is_local else recipe.min_spacing
    keypoints = thin(keypoints, spacing)
    if recipe.resize is None:
        return keypoints
    width, height = detection.size
    return keypoints.moved(keypoints.xy * (grid.width / width, grid.height / height))


def _strongest(
    features: Keypoints, recipe: Recipe, facts: DomainFacts, taken: int = 0
) -> Keypoints:
    """Return as many features as the node budget allows, if `taken` nodes exist already."""
    budget = recipe.node_budget(facts.valid_pixels)
    if recipe.refine:
        # Refinement finds its own places for the other nodes.
        share = _SHARE_KEPT if recipe.keep_features else _SHARE_OF_FEATURES
        budget = round(share * wanted_nodes(recipe, facts.valid_pixels))
    if budget is None or len(features) + taken <= budget:
        return features
    room = budget - taken
    if room <= 0:
        return features.take(np.empty(0, np.intp))
    # The cells depend only on the budget, so all calls choose in the same order.
    return features.take(spread_evenly(features, budget, float(facts.valid_pixels))[:room])


def _domain(detection: Detection, grid: Grid, recipe: Recipe) -> tuple[Loops, DomainFacts]:
    valid_pixels = detection.survey.valid_pixels
    if recipe.domain == "hull":
        return [], DomainFacts("hull", 0.0, 1, 0, valid_pixels)
    if recipe.domain == "image":
        return _frame(grid, valid_pixels)
    outline = trace(detection.survey.turns)
    outline, dropped = drop_small_loops(outline, recipe.min_hole)
    loops = simplify(outline, grid.extent)
    return loops, describe_domain(
        "valid",
        loops,
        valid_pixels=valid_pixels,
        pixels=int(outline.areas().sum()),
        islands_dropped=dropped.islands,
        holes_bridged=dropped.holes,
        pixels_dropped=dropped.pixels,
    )


def _inside(points: NDArray[np.float64], loops: Loops) -> NDArray[np.bool_]:
    """Return which points (N, 2) are inside the loops: those in a triangle between them."""
    border = np.concatenate(loops)
    distinct, position = _unite(np.concatenate([border, points]))
    segments = position[_around(loops)]
    used = np.zeros(len(distinct), np.bool_)
    used[constrained_delaunay(distinct, segments).used] = True
    inside: NDArray[np.bool_] = used[position[len(border) :]]
    return inside


def _around(loops: Loops) -> NDArray[np.intp]:
    """Return pairs (S, 2) of consecutive points of each loop, numbered through all loops."""
    sizes = np.array([len(loop) for loop in loops], int)
    ends = np.cumsum(sizes)
    following = np.arange(1, sizes.sum() + 1)
    following[ends - 1] = ends - sizes
    return np.column_stack([np.arange(len(following)), following])


def _frame(grid: Grid, valid_pixels: int) -> tuple[Loops, DomainFacts]:
    loops = frame(grid.width, grid.height)
    pixels = grid.width * grid.height
    return loops, describe_domain("image", loops, valid_pixels=valid_pixels, pixels=pixels)


def _median_spacing(points: cKDTree) -> float:
    """Return the median distance to the third nearest point; infinite with fewer than four."""
    if points.n < _NEAREST:
        return np.inf
    step = -(-points.n // _SPACING_SAMPLE)
    distances, _ = points.query(points.data[::step], k=_NEAREST)
    return float(np.median(distances[:, -1]))


def _lattice_loop(loop: NDArray[np.float64], recipe: Recipe) -> NDArray[np.float64]:
    return loop if recipe.resize is not None else snap(loop)


_NO_PIECES = np.empty((0, 2, 2))


def _join(
    features: Keypoints, loops: Loops, facts: DomainFacts, pieces: NDArray[np.float64] = _NO_PIECES
) -> NodeSet:
    """Merge features, loops and pieces of breaklines (P, 2, 2) into one set of points.

    It is sorted by y, then x.
    """
    border = np.concatenate([*loops, np.empty((0, 2))])
    fixed = np.concatenate([border, pieces.reshape(-1, 2)])
    points, position = _unite(np.concatenate([fixed, features.xy]))
    segments = np.concatenate(
        [position[_around(loops)], position[len(border) : len(fixed)].reshape(-1, 2)]
    )
    is_breakline = np.arange(len(segments)) >= len(border)
    kind = np.full(len(points), "feature", "U9" if len(pieces) else "U7")
    kind[position[len(border) : len(fixed)]] = "breakline"
    kind[position[: len(border)]] = "border"
    columns: dict[str, NDArray[Any]] = {"kind": kind}
    for name in ("scale", "response", "octave", "angle"):
        column = np.full(len(points), np.nan, np.float32)
        column[position[len(fixed) :]] = getattr(features, name)
        column[kind != "feature"] = np.nan
        columns[name] = column
    return NodeSet(points, Table(columns), segments.astype(np.int32), is_breakline, facts)


def _unite(points: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    """Return the distinct points sorted by y, then x, and the index of each of `points`."""
    # Complex numbers are sorted in this order, much faster than rows.
    numbers = np.ascontiguousarray(points[:, ::-1]).view(np.complex128)[:, 0]
    distinct, position = np.unique(numbers, return_inverse=True)
    return np.column_stack([distinct.imag, distinct.real]), position
