"""Options that several commands share, and those of every command that meshes a raster."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from typing import Any, TypeVar

import click

from geomesh.cli.height_options import HEIGHT_OPTIONS
from geomesh.cli.reading_options import READING, READING_OPTIONS
from geomesh.cli.recipe_options import FEATURE_OPTIONS, GOAL_OPTIONS, RECIPE
from geomesh.formats.format import MOST_DECIMALS, WriteOptions
from geomesh.formats.registry import DRIVERS
from geomesh.parameters import LAYERS

# Options of which each is for some formats only: the fields of `WriteOptions`.
_WRITE_OPTIONS = ("solid", "precision", "columns")

Command = TypeVar("Command", bound=Callable[..., Any])


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


def _until_eof(_ctx: click.Context, _param: click.Parameter, value: bool) -> None:
    if value:
        from geomesh.cli.until_eof import watch_stdin

        watch_stdin()


def raster_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add the options about the raster and about the recipe.

    The command gets them as two dicts: `reading`, the keywords of
    `geomesh.raster.open.open_scene`, and `recipe_options`, the keywords of
    `geomesh.cli.recipe_options.build_recipe`.
    """

    @wraps(command)
    def gathered(*arguments: Any, **options: Any) -> None:
        reading = {name: options.pop(name) for name in READING}
        recipe_options = {name: options.pop(name) for name in RECIPE if name in options}
        command(*arguments, reading=reading, recipe_options=recipe_options, **options)

    decorated: Callable[..., None] = gathered
    for option in reversed((*GOAL_OPTIONS, *HEIGHT_OPTIONS, *READING_OPTIONS, *FEATURE_OPTIONS)):
        decorated = option(decorated)
    return decorated


def column_names(
    _ctx: click.Context, _param: click.Parameter, value: str | None
) -> tuple[str, ...] | None:
    """Parse the names of columns: separated by commas, in quotation marks if they have one."""
    if value is None:
        return None
    import csv

    names = next(csv.reader([value], skipinitialspace=True), [])
    names = [name.strip() for name in names if name.strip()]
    if names == ["none"]:
        return ()
    if not names:
        raise click.BadParameter("name columns, separated by commas, or none")
    return tuple(names)


def layer_options(command: Callable[..., None]) -> Callable[..., None]:
    """Add the options about the layers and the format of a mesh file.

    The command gets those that only some formats know as one value: `options`, a `WriteOptions`.
    """

    @wraps(command)
    def gathered(*arguments: Any, **options: Any) -> None:
        chosen = WriteOptions(**{name: options.pop(name) for name in _WRITE_OPTIONS})
        command(*arguments, options=chosen, **options)

    decorated: Callable[..., None] = gathered
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
        click.option(
            "--solid",
            type=float,
            metavar="BASE",
            help="Of an STL file: a closed solid with its base at the height BASE, to print.",
        ),
        click.option(
            "--precision",
            type=click.IntRange(0, MOST_DECIMALS),
            metavar="N",
            help="Of GeoJSON: number of decimals of longitudes and latitudes. 5 is about a metre. "
            "Corners of triangles that would collapse have more. Default: 7.",
        ),
        click.option(
            "--columns",
            callback=column_names,
            metavar="NAME,...",
            help="Of GeoJSON, FlatGeobuf and GeoParquet: the only attributes to write, such as "
            "color,area; none: only the geometry. Default: all.",
        ),
    ):
        decorated = option(decorated)
    return decorated


def output_options(command: Command) -> Command:
    """Add the options about existing outputs and about the messages of the command."""
    overwrite = click.option("--overwrite", is_flag=True, help="Replace an existing output.")
    return overwrite(message_options(command))


def message_options(command: Command) -> Command:
    """Add the options about the messages of the command."""
    for option in (
        click.option("--json", "as_json", is_flag=True, help="Print the result as JSON."),
        click.option(
            "--progress",
            type=click.Choice(["bar", "jsonl", "none"]),
            help="Show a bar (the default on a terminal), JSON lines for programs, or nothing.",
        ),
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
