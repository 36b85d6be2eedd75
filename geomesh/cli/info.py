"""`geomesh info`: describe a mesh file or a raster."""

from __future__ import annotations

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import click

from geomesh.cli.console import exit_code, guarded, open_console
from geomesh.cli.streams import echo, printable


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
        is_mesh = Path(path).suffix.lower() == ".gpkg" and _has_layers(path)
        facts = _describe_mesh(path) if is_mesh else _describe_raster(path)
        echo(json.dumps(facts, indent=2) if as_json else _as_text(facts))
    sys.exit(exit_code(failures, printed=True))


def _has_layers(path: str) -> bool:
    """Return whether a GeoPackage contains vector layers. It may contain a raster instead."""
    import pyogrio
    from pyogrio.errors import DataSourceError

    try:
        return len(pyogrio.list_layers(path)) > 0
    except DataSourceError:
        return not Path(path).exists()  # an existing file may be a raster


def _describe_mesh(path: str) -> dict[str, Any]:
    from pyproj import CRS

    from geomesh.io.read import read_document

    document = read_document(path)
    stored = document.pop("mesh")
    grid = stored["grid"]
    return {
        "mesh": str(path),
        **stored["counts"],
        "crs": CRS.from_wkt(grid["crs"]).to_string() if grid["crs"] else None,
        "raster_size": [grid["width"], grid["height"]],
        "plane_size": stored["plane_size"],
        "domain": stored["domain"],
        "columns": {
            layer: [name for name, _ in pairs] for layer, pairs in stored["columns"].items()
        },
        **document,
    }


def _describe_raster(path: str) -> dict[str, Any]:
    from geomesh.features.overview import read_overview
    from geomesh.parallel.progress import silent
    from geomesh.parallel.tiles import plan_tiles
    from geomesh.parallel.workers import open_workers
    from geomesh.raster.open import open_scene

    scene = open_scene(path)
    grid = scene.grid
    with open_workers() as workers, scene.open():
        _, valid = read_overview(scene, workers, silent)
    return {
        "raster": str(path),
        "size": [grid.width, grid.height],
        "bands": [{"index": band.index, "description": band.description} for band in scene.bands],
        "dtype": str(scene.dtype),
        "crs": grid.crs.to_string() if grid.crs else None,
        "transform": list(grid.transform[:6]),
        "bounds": list(grid.bounds()),
        "valid_share": float(valid.mean()),
        "tiles": len(plan_tiles(grid.extent)),
        "notes": list(scene.notes),
    }


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
                "  " + indent + ", ".join(f"{k} {v}" for k, v in row.items()) for row in value
            ]
        elif isinstance(value, list):
            lines.append(f"{label} {', '.join(str(item) for item in value) or 'none'}")
        else:
            lines.append(f"{label} {'none' if value is None else printable(str(value))}")
    return "\n".join(lines)
