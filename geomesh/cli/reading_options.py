"""Options that say which raster to read, and which of its pixels and bands."""

from __future__ import annotations

from typing import Any

import click

from geomesh.errors import BandError
from geomesh.parameters import ALPHA

# Keywords of `geomesh.raster.open.open_scene`.
READING = ("bidx", "nodata", "alpha", "unscale", "crs", "bounds", "mask", "mask_layer", "name")


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

READING_OPTIONS = (
    click.option(
        "-b",
        "--bidx",
        callback=numbers,
        metavar="N,N,...",
        help="Bands to use; the first is 1. Three bands are used as red, green and blue. "
        "Default: all except alpha.",
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
)
