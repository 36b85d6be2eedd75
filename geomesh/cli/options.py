"""Options that several commands share, and how their values are parsed."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import fields
from functools import wraps
from pathlib import Path
from typing import Any, TypeVar

import click

from geomesh.errors import RecipeError
from geomesh.formats.registry import DRIVERS
from geomesh.parameters import DOMAINS, LAYERS
from geomesh.recipe import PRESETS, Recipe

Command = TypeVar("Command", bound=Callable[..., Any])

_NAMES = ", ".join(field.name for field in fields(Recipe) if field.name != "preset")

_READING = ("bidx", "nodata", "crs", "bounds", "mask", "name")
_RECIPE = (
    *("preset", "recipe_file", "nodes", "gray", "sift_upsample", "domain", "statistics"),
    "settings",
)


def numbers(_ctx: click.Context, _param: click.Parameter, value: str | None) -> Any:
    """Parse '3,2,1' as rio does."""
    if value is None:
        return None
    try:
        return [int(part) for part in value.split(",")]
    except ValueError as error:
        raise click.BadParameter(f"{value!r}: give band numbers such as 3,2,1") from error


def _budget(_ctx: click.Context, _param: click.Parameter, value: str | None) -> Any:
    """Parse a number as a number; anything else is for the recipe to measure_fidelity."""
    return int(value) if value is not None and value.isdecimal() else value


def words(choices: tuple[str, ...]) -> Callable[..., Any]:
    """Return a callback that parses comma-separated words."""

    def parse(_ctx: click.Context, _param: click.Parameter, value: str | None) -> Any:
        if value is None:
            return None
        words = tuple(word.strip() for word in value.split(",") if word.strip())
        for word in words:
            if word not in choices:
                raise click.BadParameter(f"{word!r}: choose from {', '.join(choices)}")
        return words

    return parse


def _settings(_ctx: click.Context, _param: click.Parameter, value: tuple[str, ...]) -> Any:
    """Parse NAME=VALUE, the value as JSON where it is that, else as text."""
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


def _until_eof(_ctx: click.Context, _param: click.Parameter, value: bool) -> None:
    if value:
        from geomesh.cli.until_eof import hold

        hold()


def raster_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add the options that say what to read and how to make a mesh of it.

    The command gets them as `reading`, keywords of `geomesh.raster.open.open_scene`, and
    `recipe_options`, keywords of `build_recipe`.
    """

    @wraps(command)
    def gathered(*arguments: Any, **options: Any) -> None:
        reading = {name: options.pop(name) for name in _READING}
        recipe_options = {name: options.pop(name) for name in _RECIPE if name in options}
        command(*arguments, reading=reading, recipe_options=recipe_options, **options)

    return _decorated(gathered)


def _decorated(command: Callable[..., None]) -> Callable[..., None]:
    for option in reversed(
        (
            click.option(
                "--preset",
                type=click.Choice(list(PRESETS)),
                default="features",
                show_default=True,
                help="features: nodes at native resolution over the valid area. "
                "paper: the published system to the letter, at 256 x 256 pixels.",
            ),
            click.option(
                "--recipe",
                "recipe_file",
                type=click.Path(dir_okay=False),
                help="JSON file with all parameters, as `geomesh info MESH --json` prints them; "
                "takes the place of --preset.",
            ),
            click.option(
                "--nodes",
                callback=_budget,
                metavar="N|P%",
                help="Node budget: a number, or a share of the valid pixels, such as 1%.",
            ),
            click.option(
                "-b",
                "--bidx",
                callback=numbers,
                metavar="N,N,...",
                help="Bands to use, from 1; three are taken as red, green, blue. "
                "Default: all but alpha.",
            ),
            click.option(
                "--gray",
                metavar="band:N|mean|pca|luma",
                help="How bands become gray. Default: luma of red, green and blue; the band "
                "itself if there is one; else the first principal component.",
            ),
            click.option(
                "--nodata",
                type=float,
                metavar="VALUE",
                help="Nodata value, in place of the file's own (nan is a value too).",
            ),
            click.option(
                "--crs",
                metavar="CRS",
                help="Coordinate system, in place of the file's own: EPSG:32722, or WKT.",
            ),
            click.option(
                "--bounds",
                nargs=4,
                type=float,
                metavar="W S E N",
                help="Crop to a box in the raster's coordinates.",
            ),
            click.option(
                "--mask",
                type=click.Path(),
                metavar="AOI",
                help="Area of interest: a file of polygons; pixels outside are left out.",
            ),
            click.option(
                "--source-name",
                "name",
                metavar="NAME",
                help="What messages and metadata call SRC, if its path does not tell.",
            ),
            click.option(
                "--sift-upsample/--no-sift-upsample",
                default=None,
                help="Look for keypoints at twice the image's size (the default), or at its own: "
                "faster, with fewer nodes.",
            ),
            click.option(
                "--domain",
                type=click.Choice(DOMAINS),
                help="What the mesh covers: the valid data, the whole image, or the "
                "convex hull of the keypoints.",
            ),
            click.option(
                "--set",
                "settings",
                multiple=True,
                callback=_settings,
                metavar="NAME=VALUE",
                help=f"Any parameter of the recipe, such as canny_low=50 (repeatable): {_NAMES}.",
            ),
        )
    ):
        command = option(command)
    return command


def layer_options(command: Command) -> Command:
    """Add the options that say what a mesh file is to hold, and how."""
    for option in (
        click.option(
            "-f",
            "--driver",
            metavar="FORMAT",
            help=f"{', '.join(DRIVERS)}. Default: by the extension of OUT.",
        ),
        click.option(
            "--layers",
            callback=words(LAYERS),
            metavar="LAYER,...",
            help=f"Layers to write: {', '.join(LAYERS)}. "
            "Default: all in a GeoPackage, else triangles.",
        ),
    ):
        command = option(command)
    return command


def output_options(command: Command) -> Command:
    """Add the options that say how the outcome is told."""
    for option in (
        click.option("--json", "as_json", is_flag=True, help="Print the outcome as JSON."),
        click.option(
            "--progress",
            type=click.Choice(["bar", "jsonl", "none"]),
            help="Bar (on a terminal the default), JSON lines for programs, or none.",
        ),
        click.option("--overwrite", is_flag=True, help="Replace an output that exists."),
        click.option(
            "--until-eof",
            is_flag=True,
            expose_value=False,
            callback=_until_eof,
            help="Stop, as if terminated, once standard input ends: for programs that start "
            "geomesh and may be killed themselves.",
        ),
    ):
        command = option(command)
    return command


def build_recipe(
    preset: str, recipe_file: str | None, settings: dict[str, Any], **values: Any
) -> Recipe:
    """Return the recipe that the options ask for."""
    recipe = Recipe.from_preset(preset)
    if recipe_file is not None:
        try:
            document = json.loads(Path(recipe_file).read_text(encoding="utf-8"))
            recipe = Recipe.from_dict(document.get("recipe", document))
        except RecipeError as error:
            raise RecipeError(f"{recipe_file}: {error}") from error
        except FileNotFoundError as error:
            raise RecipeError(f"{recipe_file}: no such file") from error
        except (OSError, ValueError, AttributeError) as error:
            raise RecipeError(f"{recipe_file} is not a recipe in JSON ({error})") from error
    given = {name: value for name, value in values.items() if value is not None}
    return recipe.with_values(**(given | settings))
