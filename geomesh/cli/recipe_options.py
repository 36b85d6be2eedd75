"""Options that say how the raster becomes a mesh: the recipe."""

from __future__ import annotations

import json
from dataclasses import fields
from pathlib import Path
from typing import Any

import click

from geomesh.errors import RecipeError
from geomesh.parameters import DOMAINS, EFFORTS, MODELS
from geomesh.recipe import DEFAULT_PRESET, PRESETS, Recipe

# Keywords of `build_recipe`.
RECIPE = (
    *("preset", "recipe_file", "nodes", "max_error", "rmse", "min_angle", "model", "effort"),
    *(
        "keep_features",
        "z",
        "z_factor",
        "gray",
        "sift_upsample",
        "domain",
        "statistics",
        "settings",
    ),
)

_NAMES = ", ".join(field.name for field in fields(Recipe) if field.name != "preset")


def _budget(_ctx: click.Context, _param: click.Parameter, value: str | None) -> Any:
    """Parse a whole number. Return any other text unchanged: the recipe checks it."""
    return int(value) if value is not None and value.isdecimal() else value


def _limits(_ctx: click.Context, _param: click.Parameter, value: str | None) -> Any:
    """Parse one number, or one number for each band."""
    if value is None:
        return None
    try:
        limits = tuple(float(part) for part in value.split(","))
    except ValueError as error:
        raise click.BadParameter(f"{value!r}: give a number such as 2.5, or 5,5,8") from error
    return limits if len(limits) > 1 else limits[0]


def _settings(_ctx: click.Context, _param: click.Parameter, value: tuple[str, ...]) -> Any:
    """Parse NAME=VALUE. The value is JSON if it is valid JSON, else text."""
    settings = {}
    for item in value:
        name, equals, text = item.partition("=")
        if not equals:
            raise click.BadParameter(f"{item!r}: give NAME=VALUE, such as canny_low=50")
        try:
            parsed = json.loads(text)
        except ValueError:
            parsed = text
        settings[name.strip()] = tuple(parsed) if isinstance(parsed, list) else parsed
    return settings


GOAL_OPTIONS = (
    click.option(
        "--preset",
        type=click.Choice(list(PRESETS)),
        default=DEFAULT_PRESET,
        show_default=True,
        help="adaptive: the nodes that show the raster best. features: nodes at the features of "
        "the image. Both cover the valid area. paper: exactly the published system, at 256 x 256 "
        "pixels.",
    ),
    click.option(
        "--recipe",
        "recipe_file",
        type=click.Path(dir_okay=False),
        help="JSON file with all parameters, as printed by `geomesh info MESH --json`. "
        "Used instead of --preset.",
    ),
    click.option(
        "--nodes",
        callback=_budget,
        metavar="N|P%",
        help="Node budget: a number, or a percentage of the valid pixels, such as 1%. "
        "Default of adaptive: 1%, at least twice the nodes of outline and breaklines. Default of "
        "the others: all features.",
    ),
    click.option(
        "--max-error",
        callback=_limits,
        metavar="E[,E...]",
        help="Goal of adaptive: no valid pixel is farther than E from the surface, in the "
        "raster's units. One E for all bands, or one for each.",
    ),
    click.option(
        "--rmse",
        callback=_limits,
        metavar="R[,R...]",
        help="Goal of adaptive: a root mean square error of at most R.",
    ),
    click.option(
        "--min-angle",
        type=float,
        metavar="DEGREES",
        help="Smallest angle of adaptive meshes, 0 to 25. Default: 10.",
    ),
    click.option(
        "--model",
        type=click.Choice(MODELS),
        help="What adaptive shows the raster with: a linear surface with values at the "
        "nodes (the default), or one value for each triangle.",
    ),
    click.option(
        "--effort",
        type=click.Choice(EFFORTS),
        help="Time that adaptive takes for a better mesh. Default: normal.",
    ),
    click.option(
        "--keep-features",
        is_flag=True,
        default=None,
        help="adaptive does not move the nodes at features.",
    ),
)

FEATURE_OPTIONS = (
    click.option(
        "--gray",
        metavar="band:N|mean|pca|luma",
        help="How the bands become one gray image. Default: luma if the bands are red, "
        "green and blue; the band itself if there is only one; else the first principal "
        "component.",
    ),
    click.option(
        "--sift-upsample/--no-sift-upsample",
        default=None,
        help="Search for keypoints in the image at twice its size (the default), or at its "
        "own size, which is faster but finds fewer.",
    ),
    click.option(
        "--domain",
        type=click.Choice(DOMAINS),
        help="Area of the mesh: the valid data, the whole image, or the convex hull of the "
        "keypoints.",
    ),
    click.option(
        "--set",
        "settings",
        multiple=True,
        callback=_settings,
        metavar="NAME=VALUE",
        help="Set a parameter of the recipe, such as canny_low=50 (repeatable). "
        f"Parameters: {_NAMES}.",
    ),
)


def build_recipe(
    preset: str, recipe_file: str | None, settings: dict[str, Any], **values: Any
) -> Recipe:
    """Return the recipe from the options."""
    recipe = Recipe.from_preset(preset)
    if recipe_file is not None:
        try:
            document = json.loads(Path(recipe_file).read_text(encoding="utf-8"))
            recipe = Recipe.from_dict(document.get("recipe", document))
        except RecipeError as error:
            raise RecipeError(f"{recipe_file}: {error}") from error
        except FileNotFoundError as error:
            raise RecipeError(f"{recipe_file}: no such file; check the path") from error
        except (OSError, ValueError, AttributeError) as error:
            raise RecipeError(f"{recipe_file} is not a recipe in JSON ({error})") from error
    given = {name: value for name, value in values.items() if value is not None}
    return recipe.with_values(**(given | settings))
