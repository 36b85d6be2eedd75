"""Options that several commands share, and the callbacks that parse their values."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import fields
from functools import wraps
from pathlib import Path
from typing import Any, TypeVar

import click

from geomesh.errors import BandError, RecipeError
from geomesh.formats.registry import DRIVERS
from geomesh.parameters import ALPHA, DOMAINS, EFFORTS, LAYERS, MODELS
from geomesh.recipe import DEFAULT_PRESET, PRESETS, Recipe

Command = TypeVar("Command", bound=Callable[..., Any])

_NAMES = ", ".join(field.name for field in fields(Recipe) if field.name != "preset")

_READING = ("bidx", "nodata", "alpha", "unscale", "crs", "bounds", "mask", "mask_layer", "name")
_RECIPE = (
    *("preset", "recipe_file", "nodes", "max_error", "rmse", "min_angle", "model", "effort"),
    *("keep_features", "gray", "sift_upsample", "domain", "statistics", "settings"),
)


def numbers(_ctx: click.Context, _param: click.Parameter, value: str | None) -> Any:
    """Parse numbers such as '3,2,1', in the same way as rio."""
    if value is None:
        return None
    try:
        return [int(part) for part in value.split(",")]
    except ValueError as error:
        raise click.BadParameter(f"{value!r}: give band numbers such as 3,2,1") from error


def number(_ctx: click.Context, _param: click.Parameter, value: str | None) -> Any:
    """Parse a nodata value. A whole number keeps all its digits."""
    if value is None:
        return None
    from geomesh.raster.nodata import parse_nodata

    try:
        return parse_nodata(value)
    except BandError as error:
        raise click.BadParameter(f"{value!r}: give a number such as -9999, or nan") from error


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


def _until_eof(_ctx: click.Context, _param: click.Parameter, value: bool) -> None:
    if value:
        from geomesh.cli.until_eof import watch_stdin

        watch_stdin()


nodata_option = click.option(
    "--nodata",
    callback=number,
    metavar="VALUE",
    help="Nodata value, used instead of the file's own, as stored. nan: there is none.",
)

alpha_option = click.option(
    "--alpha",
    type=click.Choice(ALPHA),
    default="mask",
    show_default=True,
    help="mask: bands tagged as alpha, and masks in the file or beside it, hide pixels. data: they "
    "do not; a band tagged as alpha is an ordinary band.",
)


def raster_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add the options about the raster and about the recipe.

    The command gets them as two dicts: `reading`, the keywords of
    `geomesh.raster.open.open_scene`, and `recipe_options`, the keywords of `build_recipe`.
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
                default=DEFAULT_PRESET,
                show_default=True,
                help="adaptive: the nodes that show the raster best, over the valid area. "
                "features: nodes at the features of the image. "
                "paper: exactly the published system, at 256 x 256 pixels.",
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
                "Default of adaptive: 1%.",
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
            click.option(
                "-b",
                "--bidx",
                callback=numbers,
                metavar="N,N,...",
                help="Bands to use; the first is 1. Three bands are used as red, green and blue. "
                "Default: all except alpha.",
            ),
            click.option(
                "--gray",
                metavar="band:N|mean|pca|luma",
                help="How the bands become one gray image. Default: luma if the bands are red, "
                "green and blue; the band itself if there is only one; else the first principal "
                "component.",
            ),
            nodata_option,
            alpha_option,
            click.option(
                "--unscale",
                is_flag=True,
                help="Use scale * stored value + offset instead of the stored values.",
            ),
            click.option(
                "--crs",
                metavar="CRS",
                help="Coordinate system, used instead of the file's own: EPSG:32722, or WKT.",
            ),
            click.option(
                "--bounds",
                nargs=4,
                type=float,
                metavar="W S E N",
                help="Use the pixels whose centre is in a box, in the raster's coordinates. In "
                "longitude and latitude, W may be greater than E.",
            ),
            click.option(
                "--mask",
                metavar="AOI",
                help="Area of interest: a file of polygons, or a polygon in WKT. The pixels whose "
                "centre is in a polygon are used.",
            ),
            click.option(
                "--mask-layer",
                metavar="LAYER",
                help="The layer of AOI to use, if the file has several.",
            ),
            click.option(
                "--source-name",
                "name",
                metavar="NAME",
                help="Name of SRC in messages and metadata. Default: its path.",
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
    ):
        command = option(command)
    return command


def layer_options(command: Command) -> Command:
    """Add the options about the layers and the format of a mesh file."""
    for option in (
        click.option(
            "-f",
            "--driver",
            metavar="FORMAT",
            help=f"{', '.join(DRIVERS)}. Default: from the extension of OUT.",
        ),
        click.option(
            "--layers",
            callback=words(LAYERS),
            metavar="LAYER,...",
            help=f"Layers to write: {', '.join(LAYERS)}. "
            "Default: all in a GeoPackage, triangles in other formats.",
        ),
    ):
        command = option(command)
    return command


def output_options(command: Command) -> Command:
    """Add the options about existing outputs and about the messages of the command."""
    for option in (
        click.option("--json", "as_json", is_flag=True, help="Print the result as JSON."),
        click.option(
            "--progress",
            type=click.Choice(["bar", "jsonl", "none"]),
            help="Show a bar (the default on a terminal), JSON lines for programs, or nothing.",
        ),
        click.option("--overwrite", is_flag=True, help="Replace an existing output."),
        click.option(
            "--until-eof",
            is_flag=True,
            expose_value=False,
            callback=_until_eof,
            help="Stop when standard input is closed, as after SIGTERM. For programs that start "
            "geomesh: it then stops if they are killed.",
        ),
    ):
        command = option(command)
    return command


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
