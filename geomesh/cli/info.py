"""`geomesh info`: describe a mesh file or a raster."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from geomesh.cli.console import exit_code, guarded, open_console, spell
from geomesh.cli.kinds import is_mesh
from geomesh.cli.streams import echo, printable
from geomesh.errors import EmptyError

if TYPE_CHECKING:
    import rasterio

    from geomesh.raster.bands import Band
    from geomesh.raster.scene import Scene

# Whole numbers from here on are shown as 1e+16.
_LONG_NUMBER = 1e16

# Files of overviews, masks and metadata that GDAL finds beside a raster.
_SIDE_FILES = (".ovr", ".msk", ".aux", ".aux.xml")

# Longer texts, such as the pixels of an area of interest, are cut. `--json` has all of them.
_LONGEST = 200


@click.command()
@click.argument("path", metavar="MESH|SRC")
@click.option("--json", "as_json", is_flag=True, help="Print everything as JSON.")
@click.pass_obj
def info(debug: bool, /, path: str, as_json: bool) -> None:
    """Describe a mesh file or a raster.

    \b
    Examples:
      geomesh info mesh.gpkg
      geomesh info scene.tif
      geomesh info mesh.gpkg --json > recipe.json   # for geomesh mesh --recipe
    """
    with guarded(open_console("none"), debug) as failures:
        facts = _describe_mesh(path) if is_mesh(path) else _describe_raster(path)
        echo(json.dumps(facts, indent=2) if as_json else _as_text(facts))
    sys.exit(exit_code(failures, printed=True))


def _describe_mesh(path: str) -> dict[str, Any]:
    from pyproj import CRS

    from geomesh.io.read import read_document
    from geomesh.raster.crs import crs_label

    document = read_document(path)
    stored = document.pop("mesh")
    grid = stored["grid"]
    return {
        "mesh": str(path),
        **stored["counts"],
        "crs": crs_label(CRS.from_wkt(grid["crs"])) if grid["crs"] else None,
        "raster_size": [grid["width"], grid["height"]],
        "plane_size": stored["plane_size"],
        "height": stored.get("height"),
        "domain": stored["domain"],
        "columns": {
            layer: [name for name, _ in pairs] for layer, pairs in stored["columns"].items()
        },
        **document,
    }


def _describe_raster(path: str) -> dict[str, Any]:
    from geomesh.cli.mesh import mesh
    from geomesh.features.overview import read_overview
    from geomesh.parallel.progress import silent
    from geomesh.parallel.tiles import plan_tiles
    from geomesh.parallel.workers import open_workers
    from geomesh.raster.crs import crs_label
    from geomesh.raster.open import open_scene

    scene = open_scene(path)
    grid = scene.grid
    valid_share, notes = 0.0, list(scene.notes)
    with open_workers() as workers, scene.open():
        # A raster without a valid pixel is described too: its nodata value may be wrong.
        try:
            valid_share = float(read_overview(scene, workers, silent)[1].mean())
        except EmptyError as error:
            notes.append(str(error))
        bands, facts = _describe_values(scene)
    # The options that notes name are those of `geomesh mesh`.
    with click.Context(mesh):
        notes = [spell(note) for note in notes]
    return {
        "raster": str(path),
        "size": [grid.width, grid.height],
        "bands": bands,
        "dtype": str(scene.dtype),
        "crs": crs_label(grid.crs) if grid.crs else None,
        "transform": list(grid.transform[:6]),
        "bounds": list(grid.bounds()),
        **facts,
        "valid_share": valid_share,
        "tiles": len(plan_tiles(grid.extent)),
        "notes": notes,
    }


def _describe_values(scene: Scene) -> tuple[list[dict[str, Any]], dict[str, Any]]:
    """Return the facts about each band, and what hides pixels or is not used."""
    from geomesh.raster.bands import alpha_indexes, palette
    from geomesh.raster.pixels import masked_bands

    with scene.borrow() as dataset:
        colors = palette(dataset, nodata=math.nan)  # without the colour of nodata
        indexes = [band.index for band in scene.classes.bands]
        bands = [_describe_band(dataset, band) for band in scene.classes.bands]
        alphas = alpha_indexes(dataset, scene.alpha)
        masked = masked_bands(dataset, indexes, alpha=scene.alpha)
        facts = {
            "hides_pixels": [
                *(
                    f"nodata of band {band['index']}"
                    for band in bands
                    if band["nodata"] is not None
                ),
                *(f"alpha in band {index}" for index in alphas),
                *(["transparent colours"] if colors is not None and not colors[:, 3].all() else []),
                *(f"mask of band {index}" if len(masked) > 1 else "mask" for index in masked),
            ],
            "unused_overviews": dataset.overviews(1),
            "side_files": [
                Path(name).name for name in dataset.files if name.lower().endswith(_SIDE_FILES)
            ],
        }
    return bands, facts


def _describe_band(dataset: rasterio.DatasetReader, band: Band) -> dict[str, Any]:
    from geomesh.raster.band_texts import read_units
    from geomesh.raster.scaling import PLAIN

    k = band.index - 1
    nodata, unit = dataset.nodatavals[k], read_units(dataset)[k]
    facts = {
        "index": band.index,
        "name": band.name,
        "description": band.description,
        "color": dataset.colorinterp[k].name,
        "dtype": dataset.dtypes[k],
        "nodata": None if nodata is None else _plain(nodata),
    }
    if (dataset.scales[k], dataset.offsets[k]) != PLAIN:
        facts |= {"scale": _plain(dataset.scales[k]), "offset": _plain(dataset.offsets[k])}
    return facts | ({"unit": unit} if unit else {})


def _plain(value: float) -> int | float | str:
    """Return a number of a band as JSON can have it, and a whole number as one."""
    if not math.isfinite(value):
        return str(value)
    return int(value) if value == int(value) and abs(value) < _LONG_NUMBER else value


def _as_text(facts: Mapping[str, Any], indent: str = "") -> str:
    """Return facts as indented lines. Nested mappings come below their name."""
    lines = []
    for name, value in facts.items():
        label = f"{indent}{name.replace('_', ' ')}:"
        if isinstance(value, Mapping):
            lines += [label, _as_text(value, indent + "  ")]
        elif isinstance(value, list) and value and isinstance(value[0], Mapping):
            lines += [label]
            lines += [
                "  " + indent + ", ".join(f"{k} {v}" for k, v in row.items() if v is not None)
                for row in value
            ]
        elif isinstance(value, list):
            lines.append(f"{label} {', '.join(str(item) for item in value) or 'none'}")
        else:
            text = "none" if value is None else printable(str(value))
            rest = len(text) - _LONGEST
            lines.append(f"{label} {text if rest <= 0 else f'{text[:_LONGEST]} ... ({rest} more)'}")
    return "\n".join(lines)
