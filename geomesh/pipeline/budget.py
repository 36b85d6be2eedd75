"""How many nodes a mesh should have, and what is said if it has another number."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from geomesh.mesh.certificate import DomainFacts
    from geomesh.recipe import Recipe

# With fewer keypoints per pixel than this, a mesh shows almost nothing of the image.
_FEW = 1e-4

# Nodes for which a start is chosen if the goal is an error: a share of the pixels.
_USUAL_SHARE = 0.01

# If the user gave no goal, at least half of the nodes are free to show what is inside.
_TIMES_FIXED = 2


def wanted_nodes(recipe: Recipe, valid_pixels: int) -> int:
    """Return the number of nodes for which the start of refinement is chosen."""
    budget = recipe.node_budget(valid_pixels)
    return min(budget or max(round(_USUAL_SHARE * valid_pixels), 1), valid_pixels)


def refined_budget(recipe: Recipe, valid_pixels: int, fixed: int) -> int | None:
    """Return how many nodes a refined mesh gets, or may have at most. None: any number.

    Without a goal of the user it is 1 % of the valid pixels, but at least twice as many as
    outline and breaklines have, because a long outline would leave no nodes for the inside.

    Parameters
    ----------
    recipe : Recipe
    valid_pixels : int
    fixed : int
        Number of nodes of outline and breaklines.
    """
    budget = recipe.node_budget(valid_pixels)
    if budget is None or recipe.nodes is not None:
        return budget
    return max(budget, fixed, min(_TIMES_FIXED * fixed, valid_pixels))


def note_on_refined(count: int, budget: int, recipe: Recipe, *, has_breaklines: bool) -> str:
    """Return why a refined mesh has another number of nodes than wanted. Empty: it has not."""
    if count > budget:
        return _note_on_outline(count, budget, has_breaklines=has_breaklines)
    if count < budget:
        asked = recipe.nodes is not None
        number = f"{count} of the {budget} requested nodes" if asked else f"only {count} nodes"
        return f"{number}: no more fit where the surface differs from the raster"
    return ""


def notes_on_features(
    features: int,
    border: int,
    recipe: Recipe,
    facts: DomainFacts,
    *,
    thinned: int,
    has_breaklines: bool,
) -> list[str]:
    """Return what to tell the user about the number of nodes of a mesh that is not refined.

    Parameters
    ----------
    features : int
        Number of keypoints to choose from.
    border : int
        Number of nodes of outline and breaklines.
    recipe : Recipe
    facts : DomainFacts
    thinned : int
        Number of keypoints that were dropped because they are near others.
    has_breaklines : bool
    """
    budget = recipe.node_budget(facts.valid_pixels)
    if budget is not None and border > budget:
        return [_note_on_outline(border, budget, has_breaklines=has_breaklines)]
    if features == 0:
        text = "no keypoints found (the image may be constant): the mesh is the outline only"
        return [text if recipe.sobel else f"{text}; if it is not, `sobel=True` gives more"]
    is_smooth = features < _FEW * facts.valid_pixels
    ways = ["`sobel=True`"]
    if recipe.sobel or not is_smooth:
        ways = ["`edge_distance=None`"] * (recipe.edge_distance is not None)
        ways += ["`min_spacing=1`"] * (recipe.min_spacing > 1 and thinned > 0)
    more = f"; {' or '.join(ways)} gives more" if ways else ""
    if budget is not None and features + border < budget:
        return [
            f"{features + border} of the {budget} requested nodes: the image has no more keypoints "
            f"on edges{more}"
        ]
    if is_smooth:
        smooth = f"only {features} keypoints in {facts.valid_pixels} pixels: the image is smooth"
        return [f"{smooth}{more}"]
    return []


def _note_on_outline(count: int, budget: int, *, has_breaklines: bool) -> str:
    what = "outline and breaklines need" if has_breaklines else "outline alone needs"
    return f"the {what} {count} nodes, more than the {budget} requested"
