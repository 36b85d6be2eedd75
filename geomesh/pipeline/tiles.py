"""Turn a mesh into the tiles of a map on the web: a whole mesh at every zoom."""

from __future__ import annotations

import re
from concurrent.futures import FIRST_EXCEPTION, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, replace
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any

import numpy as np

from geomesh._version import __version__
from geomesh.arrays.plain import plain_json
from geomesh.arrays.table import Table
from geomesh.errors import CertificateError, OutputError
from geomesh.formats.document import KEY
from geomesh.formats.pmtiles import Archive, Place
from geomesh.formats.tile_layer import TileLayer, require_place
from geomesh.io.atomic import check_place, staged, undisturbed, writing_to
from geomesh.io.gdal_process import WriterPool
from geomesh.io.tile_check import LevelCheck, check_level
from geomesh.io.tiles import LAYER, LevelFile, describe_fields, join_levels, write_level
from geomesh.parallel.cores import available_cores
from geomesh.parallel.processes import Process
from geomesh.parallel.progress import Progress, part_of, silent
from geomesh.pipeline.coarse_mesh import coarse_mesh, count_owned, with_values_of
from geomesh.pipeline.level_image import paint_image
from geomesh.pipeline.tile_levels import TilePlan, plan_levels

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from os import PathLike

    from geomesh.mesh.triangle_mesh import TriangleMesh
    from geomesh.parallel.workers import Workers

EXTENSION = ".pmtiles"

# Attributes that every triangle gets, if the mesh has them, and those that end so.
_USUAL = ("id", "area", "count", "color")
_ENDING = "_mean"

# Of the values of an attribute, a ramp of colours spans these percentiles.
_RAMP = (2, 98)

_POLL = 0.5


@dataclass(frozen=True)
class TileLevel:
    """One zoom of a map that was written.

    Attributes
    ----------
    zoom : int
    nodes, triangles : int
        Of its mesh.
    own : bool
        Whether it is the mesh itself, not a smaller one.
    check : LevelCheck
        What its tiles show.
    """

    zoom: int
    nodes: int
    triangles: int
    own: bool
    check: LevelCheck


@dataclass(frozen=True)
class TileSummary:
    """A map that was written.

    Attributes
    ----------
    levels : tuple of TileLevel
        The farthest zoom first.
    size : int
        Bytes of the file.
    """

    levels: tuple[TileLevel, ...]
    size: int


def check_tiles(path: str | PathLike[str], *, overwrite: bool = False) -> None:
    """Raise OutputError if tiles cannot be written; call this before any work is done."""
    if Path(path).suffix.lower() != EXTENSION:
        raise OutputError(f"{path} is not named as tiles; use a name that ends in {EXTENSION}")
    check_place(Path(path), overwrite=overwrite)


def write_tiles(
    mesh: TriangleMesh,
    path: str | PathLike[str],
    workers: Workers,
    *,
    min_zoom: int | None = None,
    max_zoom: int | None = None,
    columns: Sequence[str] | None = None,
    overwrite: bool = False,
    progress: Progress = silent,
) -> TileSummary:
    """Write a mesh as PMTiles; the file is complete or does not exist.

    Parameters
    ----------
    mesh : TriangleMesh
    path : path-like
        Ends in .pmtiles.
    workers : Workers
    min_zoom, max_zoom : int, optional
        See `geomesh.pipeline.tile_levels.plan_levels`.
    columns : sequence of str, optional
        Attributes of the triangles. Default: id, area, count, color and all means.
    overwrite : bool
        Replace an existing file, as the last step.
    progress : callable(fraction, message), optional

    Raises
    ------
    OutputError
        If the file cannot be written; then an existing one does not change.
    GeoreferenceError
        If the mesh has no place on a map on the web.
    CertificateError
        If the mesh is not sound, or a zoom is not complete or has a gap.
    """
    target = Path(path)
    check_tiles(target, overwrite=overwrite)
    plan = plan_levels(mesh, require_place(mesh), min_zoom, max_zoom)
    names = _choose(mesh, columns)
    mesh.certify().require()
    with (
        staged(target, EXTENSION, overwrite=overwrite) as temporary,
        writing_to(target, "pyogrio", "pyarrow", "sqlite3"),
        _Writers(len(plan.levels)) as writers,
    ):
        own = tile_layer(mesh, names)
        levels: list[tuple[LevelFile, TriangleMesh]] = []
        for zoom, shown in _meshes(mesh, plan, names, workers, progress):
            layer = own if shown is mesh else tile_layer(shown, names)
            level = LevelFile(zoom, layer, temporary.with_name(f"{zoom}.mbtiles"))
            writers.start(level)
            levels.insert(0, (level, shown))
        writers.wait(part_of(progress, 0.5, 0.8))
        place = Place(levels[0][0].zoom, levels[-1][0].zoom, plan.bounds)
        join_levels(
            [level for level, _ in levels], temporary, place, _metadata(target, mesh, plan, levels)
        )
        outline, checked = list(own.rings()), []
        with temporary.open("rb") as file:
            archive = Archive(file)
            for k, (level, shown) in enumerate(levels):
                progress(0.8 + 0.2 * k / len(levels), f"Checking zoom {level.zoom}")
                check = check_level(archive, level.zoom, level.layer, outline)
                _require(target, level.zoom, check)
                checked.append(
                    TileLevel(
                        level.zoom, len(shown.nodes), len(shown.triangles), shown is mesh, check
                    )
                )
        size = temporary.stat().st_size
    progress(1.0, "Written")
    return TileSummary(tuple(checked), size)


def tile_layer(mesh: TriangleMesh, columns: Sequence[str]) -> TileLayer:
    """Return the triangles of a mesh with some of their attributes."""
    layer = TileLayer.of(mesh, "triangles")
    assert isinstance(layer, TileLayer)
    kept = {}
    for name in columns:
        values = layer.columns[name]
        # Half the size, and as many digits as there are.
        kept[name] = values.astype(np.float32) if values.dtype == np.float64 else values
    return replace(layer, columns=Table(kept), heights=None, lift=None)


def _choose(mesh: TriangleMesh, columns: Sequence[str] | None) -> tuple[str, ...]:
    """Return the attributes to write; the number of a triangle comes first."""
    known = tuple(mesh.attributes("triangles"))
    if columns is None:
        return tuple(name for name in known if name in _USUAL or name.endswith(_ENDING))
    for name in columns:
        if name not in known:
            raise OutputError(
                f"the triangles have no attribute {name!r}; choose from {', '.join(known)}"
            )
    return ("id", *(name for name in known if name in columns and name != "id"))


def _meshes(
    mesh: TriangleMesh,
    plan: TilePlan,
    columns: Sequence[str],
    workers: Workers,
    progress: Progress,
) -> Iterator[tuple[int, TriangleMesh]]:
    """Yield the mesh of each zoom, the nearest first."""
    image, owned = None, np.empty(0, np.int64)
    for k, level in enumerate(plan.levels):
        if level.nodes is None:
            yield level.zoom, mesh
            continue
        start, stop = 0.5 * k / len(plan.levels), 0.5 * (k + 1) / len(plan.levels)
        report = _about(level.zoom, part_of(progress, start, stop))
        if image is None:
            owned = count_owned(mesh)
            image = paint_image(mesh, level.factor, part_of(report, 0, 0.2))
        else:
            image = image.halved()
        wide = image.widened()
        coarse = coarse_mesh(wide, level.nodes, workers, part_of(report, 0.2, 0.8))
        more = part_of(report, 0.8, 1)
        yield level.zoom, with_values_of(coarse, mesh, wide, columns, owned, more)


def _about(zoom: int, progress: Progress) -> Progress:
    return lambda fraction, message: progress(fraction, f"Zoom {zoom}: {message}")


class _Writers:
    """Processes that write the tiles of zooms while other zooms are meshed."""

    def __init__(self, levels: int) -> None:
        self._count = min(available_cores(), levels)
        self._pool = WriterPool(self._count)
        self._threads = ThreadPoolExecutor(self._count, "geomesh-tiles")
        self._events: SimpleQueue[None] = SimpleQueue()
        self._written: list[Future[None]] = []

    def __enter__(self) -> _Writers:
        return self

    def __exit__(self, *_: object) -> None:
        with undisturbed():
            self._pool.stop(Process.kill)
            self._threads.shutdown(wait=True, cancel_futures=True)
            self._pool.__exit__()

    def start(self, level: LevelFile) -> None:
        """Write a zoom in the background."""
        self._written.append(self._threads.submit(write_level, level, self._events, self._pool))

    def wait(self, progress: Progress) -> None:
        """Wait until all zooms are written; raise the first error."""
        waiting = set(self._written)
        while waiting:
            done, waiting = wait(waiting, _POLL, FIRST_EXCEPTION)
            for future in done:
                future.result()
            share = 1 - len(waiting) / len(self._written)
            progress(share, "Writing tiles")


def _require(target: Path, zoom: int, check: LevelCheck) -> None:
    if check.missing or check.gap_pixels:
        raise CertificateError(
            f"{target} was not written: at zoom {zoom}, {check.missing} triangles are missing and "
            f"{check.gap_pixels} of {check.pixels} pixels are gaps. This is a defect of geomesh: "
            "please report it with the mesh"
        )


def _metadata(
    target: Path,
    mesh: TriangleMesh,
    plan: TilePlan,
    levels: Sequence[tuple[LevelFile, TriangleMesh]],
) -> dict[str, Any]:
    """Return the metadata of the file: what is usual for vector tiles, and how they were made."""
    layer = levels[-1][0].layer
    about = {
        "version": __version__,
        "source": None if mesh.provenance is None else _file_name(mesh.provenance.source.name),
        "triangles": len(mesh.triangles),
        "bounds": plan.view,
        "levels": [
            {
                "zoom": level.zoom,
                "nodes": len(shown.nodes),
                "triangles": len(shown.triangles),
                "own": shown is mesh,
            }
            for level, shown in levels
        ],
        "ramps": _ramps(layer),
    }
    return {
        "name": target.stem,
        "description": f"Triangle mesh, written by geomesh {__version__}",
        "type": "overlay",
        "version": "2",
        "vector_layers": [
            {
                "id": LAYER,
                "description": "",
                "minzoom": levels[0][0].zoom,
                "maxzoom": levels[-1][0].zoom,
                "fields": describe_fields(layer),
            }
        ],
        KEY: plain_json(about),
    }


def _file_name(source: str) -> str:
    """Return a name without folders: a map on the web should not tell them."""
    return re.split(r"[/\\]", source.rstrip("/\\"))[-1]


def _ramps(layer: TileLayer) -> dict[str, list[float]]:
    """Return the range of a ramp of colours for each attribute that is a number."""
    ramps = {}
    for name, values in layer.columns.items():
        if name != "id" and values.dtype.kind in "iuf":
            known = values[np.isfinite(values)]
            if len(known):
                ramps[name] = np.percentile(known, _RAMP).astype(float).tolist()
    return ramps
