"""Put one mutant through geomesh, and say what came: a mesh, a refusal, or a fault."""

from __future__ import annotations

import json
import warnings
from contextlib import suppress
from typing import TYPE_CHECKING, Any

import numpy as np
import rasterio
from click.testing import CliRunner
from rasterio.enums import ColorInterp, MaskFlags

import geomesh
from geomesh.cli import cli
from geomesh.errors import GeomeshError
from geomesh.raster.gdal import GDAL_ERRORS
from geomesh.raster.grid import Window
from geomesh.raster.open import open_scene
from support.files import assert_same

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

NODES = 60
SUFFIXES = (".gpkg", ".geojson", ".fgb", ".parquet", ".nc")

_ALPHA = ColorInterp.alpha

# Of a raster with more pixels, only a corner is meshed.
_LARGE = 4_000_000

# Options of every eighth mutant.
_OPTIONS: dict[int, dict[str, Any]] = {6: {"unscale": True}, 7: {"preset": "paper"}}


def check(path: Path, number: int) -> str:
    """Return "mesh" or the class of the error that refused the mutant.

    The number decides what else is tried: the command, `info`, the writers, `psnr` or `render`.

    Raises
    ------
    Exception
        Whatever is wrong with geomesh.
    """
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        corner: dict[str, Any] = {}
        try:
            scene = open_scene(path)
            if scene.grid.width * scene.grid.height > _LARGE:
                part = Window(0, 0, 64, 48).clip(scene.window)
                corner["bounds"] = scene.grid.window(part).bounds()
            options = _OPTIONS.get(number % 8, {})
            mesh = geomesh.mesh_raster(path, nodes=NODES, workers=1, **corner, **options)
        except GeomeshError as error:
            _assert_one_line(error, path.name)
            _try_more(path, number, None)
            return type(error).__name__
        _assert_sound(mesh, path, compared=not corner and "unscale" not in options)
        if corner:
            return "corner"
        _try_more(path, number, mesh)
        return "mesh"


def _assert_one_line(error: GeomeshError, name: str = "") -> None:
    assert name in str(error), f"does not name the file: {error}"
    assert len(str(error).splitlines()) == 1, f"not one line: {error}"


def _assert_sound(mesh: geomesh.Mesh, path: Path, *, compared: bool) -> None:
    failed = [check for check in mesh.certify().checks if not check.passed]
    assert failed == []
    pixels, valid = mesh.grid.width * mesh.grid.height, mesh.domain.valid_pixels
    counted = int(mesh.triangle_table["count"].sum())
    assert 0 < counted <= valid <= pixels, (counted, valid, pixels)
    covers_all = mesh.domain.kind != "hull" and not mesh.domain.islands_dropped
    assert counted == valid or not covers_all, (counted, valid)
    areas = mesh.attributes("triangles")["area"]
    assert np.isfinite(areas).all(), "areas that are not finite"
    if compared:
        read = list(_readings(path))
        sizes = [values.shape[1] for values in read]
        assert valid in sizes, f"{valid} valid pixels; rasterio finds {sizes}"
        if covers_all:
            _assert_range(mesh, read[sizes.index(valid)])


def _readings(path: Path) -> Iterator[np.ndarray]:
    """Yield the values as GDAL understands them, and as geomesh does where the two differ.

    GDAL ignores nodata values if there is a mask, and truncates them to the type of the band. A
    side file that contradicts the raster is not used.
    """
    yield _values(path)
    yield _values(path, exact=True)
    if path.with_name(f"{path.name}.aux.xml").exists():
        with rasterio.Env(GDAL_PAM_ENABLED=False):
            yield _values(path)
            yield _values(path, exact=True)


def _assert_range(mesh: geomesh.Mesh, values: np.ndarray) -> None:
    """Compare the least and the largest value of each band with those of rasterio."""
    table = mesh.triangle_table
    for end, extreme in (("min", np.nanmin), ("max", np.nanmax)):
        columns = [table[name] for name in table if name.endswith(f"_{end}")]
        if len(columns) == len(values):  # a palette has colours instead of its values
            found = [extreme(column) for column in columns]
            np.testing.assert_array_equal(found, extreme(values, axis=1).astype(np.float64))


def _values(path: Path, *, exact: bool = False) -> np.ndarray:
    """Read the values (bands, valid pixels) of a raster with rasterio alone.

    If `exact`, a pixel is valid if it has no nodata value, whatever a mask says.
    """
    with rasterio.open(path) as dataset:
        with suppress(*GDAL_ERRORS):
            _ = dataset.colorinterp  # raises what GDAL reported when it opened the file
        colors = dataset.colorinterp
        alphas = [i for i in dataset.indexes if dataset.count > 1 and colors[i - 1] == _ALPHA]
        used = [index for index in dataset.indexes if index not in alphas]
        bands = dict(zip(used, map(dataset.read, used), strict=True))
        valid = np.ones(dataset.shape, np.bool_)
        for index, band in bands.items():
            flags = dataset.mask_flag_enums[index - 1]
            nodata = dataset.nodatavals[index - 1]
            if exact and nodata is not None:
                valid &= band != nodata
            if not (exact and flags == [MaskFlags.nodata]):
                valid &= dataset.read_masks(index) > 0
            valid &= np.isfinite(band)
        for index in alphas:
            valid &= dataset.read(index) > 0
        entries = _palette(dataset)
        if entries:
            clear = [value for value, color in entries.items() if color[3] == 0]
            valid &= ~np.isin(np.clip(bands[1], 0, max(entries)), clear)
        return np.stack([band[valid] for band in bands.values()])


def _palette(dataset: rasterio.DatasetReader) -> dict[int, tuple[int, ...]]:
    if dataset.count == 1 and dataset.colorinterp[0] == ColorInterp.palette:
        with suppress(ValueError):  # there are no colours
            return dataset.colormap(1)
    return {}


def _try_more(path: Path, number: int, mesh: geomesh.Mesh | None) -> None:
    output = path.parent / f"mesh{SUFFIXES[number // 8 % len(SUFFIXES)]}"
    what = number % 8
    if what == 0:
        _run("mesh", path, "-o", output, f"--nodes={NODES}", "--workers=1")
    elif what == 1:
        _run("info", path, "--json")
    elif what in (3, 4) and mesh is not None:
        try:
            mesh.to_file(output)
        except GeomeshError as error:  # such as GeoJSON without a CRS
            _assert_one_line(error)
        else:
            if output.suffix == ".gpkg":
                assert_same(geomesh.read_mesh(output), mesh)
    elif what in (5, 6) and mesh is not None and _is_moderate(mesh):
        if what == 5:
            mesh.psnr(path)
        else:
            mesh.render(path, path.parent / "render.tif")


def _is_moderate(mesh: geomesh.Mesh) -> bool:
    """Return whether no value is so large that a sum of squares overflows."""
    table = mesh.triangle_table.take(np.flatnonzero(mesh.triangle_table["count"]))
    return all(np.isfinite(table[name]).all() for name in table if table[name].dtype.kind == "f")


def _run(*arguments: str | Path) -> None:
    done = CliRunner().invoke(cli, [str(argument) for argument in arguments])
    if done.exception is not None and not isinstance(done.exception, SystemExit):
        raise done.exception
    errors = [line for line in done.stderr.splitlines() if line.startswith("Error: ")]
    assert "defect of geomesh" not in done.stderr, done.stderr
    assert done.exit_code in (0, 1), done
    assert len(errors) == done.exit_code, done.stderr
    if done.exit_code == 0 and "--json" in arguments:
        json.loads(done.stdout, parse_constant=_refuse)


def _refuse(constant: str) -> None:
    raise AssertionError(f"{constant} is not JSON")
