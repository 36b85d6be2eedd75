"""A mesh painted on the pixels of its raster: a GeoTIFF, there whole or not at all."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
import rasterio.windows
from numpy.typing import NDArray
from rasterio.crs import CRS
from rasterio.enums import ColorInterp
from rasterio.errors import RasterioError

from geomesh.bands import palette
from geomesh.errors import OutputError, SourceError, one_line
from geomesh.fidelity import Fidelity, summarise
from geomesh.grid import IDENTITY, Window
from geomesh.io.atomic import check_place, staged
from geomesh.mesh import Mesh
from geomesh.original import open_original
from geomesh.progress import reporting
from geomesh.raster import Excerpt, Scene, can_hold
from geomesh.render import Errors, Fit, Model, find_errors, to_pixels
from geomesh.sources import Source, open_scene
from geomesh.surface import Surface, Task, fit_surface, walk
from geomesh.tiles import Progress, Tile, map_tiles, part_of, plan_tiles
from geomesh.workers import Crew, open_crew

_EXTENSIONS = (".tif", ".tiff")

# What the file has as the raster has it: no creation option is to change that.
_SETTLED = frozenset(
    ("driver", "width", "height", "count", "dtype", "crs", "transform", "nodata", "gcps", "rpcs")
)

# What a raster says of each band, beside its description.
_TOLD = ("colorinterp", "scales", "offsets", "units")

Painted = tuple[Window, NDArray[Any], NDArray[np.bool_]]


def render_file(
    mesh: Mesh,
    source: Source,
    path: str | PathLike[str],
    *,
    model: Model = "linear",
    fit: Fit = "least_squares",
    bidx: Sequence[int] | None = None,
    crs: Any = None,
    creation: Mapping[str, str] | None = None,
    overwrite: bool = False,
    workers: int | None = None,
    progress: bool | Progress = False,
) -> Fidelity:
    """Paint a mesh as a GeoTIFF on the pixels of its raster; return how faithful that is.

    The file has the mesh's part of the raster's grid, the raster's type, the bands, and what
    the raster says of them. Integers are rounded, and cut off at what the type can hold.
    Where no triangle owns the pixel there is the raster's nodata value; if it has none, the
    file has a mask.

    Parameters
    ----------
    mesh : Mesh
    source, model, fit, bidx, crs, workers, progress
        As in `geomesh.fidelity.judge`.
    path : path-like
        Ends in .tif or .tiff.
    creation : mapping of str to str, optional
        Creation options of GDAL's GTiff driver, such as ``{"COMPRESS": "ZSTD"}``; compressed
        tiles of 256 x 256 pixels by default.
    overwrite : bool
        Replace an existing file, at the very end.

    Returns
    -------
    Fidelity
        Of the file as it is read back.

    Raises
    ------
    GeomeshError
        With one line that says what is wrong and what to do; an old file stays as it was.
    """
    target, options = Path(path), _choose_options(creation or {})
    check_geotiff(target, overwrite=overwrite)
    scene = open_original(mesh, source, bidx=bidx, crs=crs)
    with (
        reporting(progress) as report,
        open_crew(workers) as crew,
        scene.open(),
        staged(target, ".tif", overwrite=overwrite) as temporary,
    ):
        surface = fit_surface(
            mesh.nodes,
            mesh.triangles,
            scene,
            model=model,
            fit=fit,
            crew=crew,
            progress=part_of(report, 0, 0.6),
        )
        with _failures_told(target):
            covered = _write(temporary, options, surface, scene, crew, part_of(report, 0.6, 0.9))
        return _read_back(target, temporary, covered, scene, crew, part_of(report, 0.9, 1))


def check_geotiff(path: str | PathLike[str], *, overwrite: bool) -> None:
    """Refuse a file that could not be written; meant to be called before any work.

    Raises
    ------
    OutputError
    """
    if Path(path).suffix.lower() not in _EXTENSIONS:
        raise OutputError(f"{path} is to be a GeoTIFF: name it with {' or '.join(_EXTENSIONS)}")
    check_place(Path(path), overwrite=overwrite)


def _choose_options(creation: Mapping[str, str]) -> dict[str, Any]:
    given = {name.lower(): value for name, value in creation.items()}
    for name in sorted(_SETTLED & set(given)):
        raise OutputError(
            f"{name} is no creation option of GTiff: the file has the raster's; leave it out"
        )
    return given


@dataclass(frozen=True)
class _Style:
    """What a raster says of the bands of a scene, as far as a GeoTIFF can say the same."""

    dtype: np.dtype[Any]
    nodata: float | None
    told: Mapping[str, Sequence[Any]]


def _ask(scene: Scene) -> _Style:
    dtype, nodata = scene.dtype.newbyteorder("="), scene.nodata
    if dtype.kind == "f" and dtype.itemsize not in (4, 8):  # GDAL has no other
        dtype = np.dtype(np.float32 if dtype.itemsize < 4 else np.float64)
    if isinstance(scene.source, Excerpt):
        return _Style(dtype, nodata, {})
    with scene.lend() as dataset:
        if palette(dataset) is not None:
            told = {"colorinterp": [ColorInterp.red, ColorInterp.green, ColorInterp.blue]}
            return _Style(dtype, None, told)
        positions = [band.index - 1 for band in scene.bands]
        told = {name: [getattr(dataset, name)[k] for k in positions] for name in _TOLD}
        nodata = dataset.nodatavals[positions[0]] if nodata is None else nodata
    fits = nodata is not None and can_hold(dtype, nodata)
    return _Style(dtype, nodata if fits else None, told)


@contextmanager
def _created(path: Path, scene: Scene, style: _Style, options: Mapping[str, Any]) -> Iterator[Any]:
    """Yield the dataset to write to."""
    grid = scene.grid
    profile = {
        "driver": "GTiff",
        "width": grid.width,
        "height": grid.height,
        "count": len(scene.bands),
        "dtype": style.dtype,
        "nodata": style.nodata,
        "crs": None if grid.crs is None else CRS.from_wkt(grid.crs.to_wkt()),
        "transform": None if grid.transform == IDENTITY else grid.transform,
        "tiled": True,
        "bigtiff": "if_safer",
    }
    if "compress" not in options:
        profile |= {"compress": "deflate", "predictor": 3 if style.dtype.kind == "f" else 2}
    # The mask inside the file, not beside it.
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True):
        with _complaints(options):
            dataset = rasterio.open(path, "w", **{**profile, **options})
        with dataset:
            for number, band in enumerate(scene.bands, start=1):
                if band.description is not None:
                    dataset.set_band_description(number, band.description)
            for name, values in style.told.items():
                if tuple(values) != getattr(dataset, name):
                    setattr(dataset, name, values)
            yield dataset


@contextmanager
def _complaints(options: Mapping[str, Any]) -> Iterator[None]:
    """Raise OutputError for creation options that GDAL would only log a complaint about."""
    found: list[str] = []
    handler = logging.Handler()
    handler.emit = lambda record: found.append(record.getMessage())  # type: ignore[method-assign]
    log = logging.getLogger("rasterio")
    log.addHandler(handler)
    try:
        yield
    except (RasterioError, ValueError, TypeError) as error:
        raise OutputError(f"the creation options do not go together: {one_line(error)}") from error
    finally:
        log.removeHandler(handler)
    for name in options:
        for complaint in found:
            if name in complaint.lower():
                raise OutputError(f"creation option {name}: {complaint}")


@dataclass(frozen=True)
class _Painter:
    """Paints a tile: its window, its pixels and which of them the mesh covers."""

    style: _Style

    def __call__(self, task: Task) -> Painted:
        _, tile, surface = task
        image = surface.image(tile.core)
        pixels = to_pixels(image, self.style.dtype, self.style.nodata)
        return tile.core, pixels, ~np.isnan(image[0])


def _write(
    path: Path,
    options: Mapping[str, Any],
    surface: Surface,
    scene: Scene,
    crew: Crew,
    progress: Progress,
) -> list[int]:
    """Write the picture; return how many pixels of each tile have a value."""
    style, covered = _ask(scene), []
    with _created(path, scene, style, options) as dataset:
        painted = walk(_Painter(style), surface, scene, crew, progress, "Painting")
        for _, (core, pixels, known) in painted:
            window = rasterio.windows.Window(core.col, core.row, core.width, core.height)
            dataset.write(pixels, window=window)
            if style.nodata is None:
                dataset.write_mask(known, window=window)
            covered.append(int(known.sum()))
    return covered


@contextmanager
def _failures_told(target: Path) -> Iterator[None]:
    try:
        yield
    except RasterioError as error:
        raise OutputError(
            f"{target} could not be written: {one_line(error)}; free some space, or choose another "
            "folder"
        ) from error


def _read_back(
    target: Path, path: Path, covered: Sequence[int], scene: Scene, crew: Crew, progress: Progress
) -> Fidelity:
    """Compare the file with the raster: that it is whole GDAL tells only when it is read."""
    shown = open_scene(path, name=str(target))
    tiles = plan_tiles(scene.grid.extent, halo=0)
    tasks = ((shown, scene.excerpt(tile.core), tile) for tile in tiles)
    with shown.open():
        results = map_tiles(
            _compare_tile, tasks, len(tiles), crew, progress=progress, message="Comparing"
        )
        parts = []
        for expected, (errors, found) in zip(covered, results, strict=True):
            if found != expected:
                raise _spoilt(target)
            parts.append(errors)
    return summarise(scene, parts)


def _compare_tile(task: tuple[Scene, Scene, Tile]) -> tuple[Errors, int]:
    shown, scene, tile = task
    try:
        pixels, known = shown.read(tile.core)
    except SourceError as error:
        raise _spoilt(shown.name) from error
    bands, valid = scene.read(tile.core)
    return find_errors(pixels, bands, valid & known), int(known.sum())


def _spoilt(target: str | Path) -> OutputError:
    return OutputError(
        f"{target} does not read back as it was written: free some space, or choose another "
        "folder or other creation options"
    )
