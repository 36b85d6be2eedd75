"""Options that say which band is the height of a mesh."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import click

Command = TypeVar("Command", bound=Callable[..., Any])


def _band(_ctx: click.Context, _param: click.Parameter, value: str | None) -> Any:
    """Parse the number or the name of a band."""
    return int(value) if value is not None and value.isdecimal() else value


HEIGHT_OPTIONS = (
    click.option(
        "--z",
        callback=_band,
        metavar="BAND",
        help="The band that is the height of the nodes: its number (the first is 1), or its name.",
    ),
    click.option(
        "--z-factor",
        type=float,
        metavar="F",
        help="Multiply the heights, such as by 0.3048 from feet to metres.",
    ),
)


def height_options(command: Command) -> Command:
    """Add the options about the height of a mesh."""
    for option in reversed(HEIGHT_OPTIONS):
        command = option(command)
    return command
