"""What a format cannot hold is refused before any pixel is worked on, with a way out that works."""

from __future__ import annotations

import re
from dataclasses import replace
from typing import TYPE_CHECKING, NoReturn

import numpy as np
import pytest

import geomesh
from geomesh.arrays.table import Table
from geomesh.errors import OutputError
from geomesh.formats.registry import find_format
from geomesh.io.read import read_mesh
from geomesh.io.write import write_mesh
from geomesh.parameters import LAYERS
from geomesh.pipeline import mesh_file
from geomesh.pipeline.attributes import name_columns
from geomesh.raster.open import open_scene
from geomesh.recipe import Recipe
from support.cases import palette
from support.files import read_layer
from support.meshes import two_triangles
from support.rasters import picture, raster, write_raster

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from support.commands import Geomesh


def many_bands(folder: Path, count: int) -> str:
    return write_raster(folder, data=picture(3, 12, 12).repeat(count // 3 + 1, axis=0)[:count])


@pytest.mark.parametrize(
    "statistics", [("mean",), ("mean", "std", "min", "max"), ("max", "variety", "max"), ()]
)
@pytest.mark.parametrize("make", [raster(picture(1)), raster(picture(5)), palette("GTiff", 8)])
def test_the_columns_of_a_mesh_are_known_in_advance(
    tmp_path: Path, make: Callable[[Path], str], statistics: tuple[str, ...]
) -> None:
    source = make(tmp_path)
    for values in ({}, {"refine": True}, {"refine": True, "model": "constant"}):
        recipe = Recipe().with_values(statistics=statistics, **values)
        mesh = geomesh.mesh_raster(source, recipe=recipe)
        for layer in LAYERS:
            expected = name_columns(layer, open_scene(source), recipe)
            assert expected == list(mesh.attributes(layer)), (layer, values)


@pytest.mark.parametrize(("preset", "columns"), [("adaptive", 3133), ("features", 2093)])
def test_too_many_bands_for_a_geopackage_are_refused_before_the_work(
    tmp_path: Path, command: Geomesh, monkeypatch: pytest.MonkeyPatch, preset: str, columns: int
) -> None:
    source, output = many_bands(tmp_path, 520), tmp_path / "mesh.gpkg"

    def work(*_: object, **__: object) -> NoReturn:
        pytest.fail("pixels were worked on")

    with monkeypatch.context() as patched:
        patched.setattr(mesh_file, "mesh_scene", work)
        error = command("mesh", source, "-o", output, "--preset", preset).error()
    assert re.search(
        rf"mesh\.gpkg .* at most 1998 attributes .* triangles would have {columns}: compute one "
        r"statistic with --stats mean, or choose fewer bands with --bidx, or write \.parquet$",
        error,
    )
    if preset == "adaptive":
        return  # it takes long with so many bands, and its columns are counted in the same way
    # Each way out that it names:
    for options in (("--stats", "mean"), ("--bidx", "1,2,3"), ("-f", "Parquet")):
        done = command("mesh", source, "-o", output, "--overwrite", "--preset", preset, *options)
        assert done.code == 0


@pytest.mark.slow
def test_even_one_statistic_may_be_too_many(tmp_path: Path, command: Geomesh) -> None:
    source, faster = many_bands(tmp_path, 1991), ("--preset", "features")
    output = tmp_path / "mesh.gpkg"
    error = command("mesh", source, "-o", output, "--layers=nodes,edges", *faster).error()
    assert "the nodes would have 1999: choose fewer bands with --bidx" in error
    assert error.endswith("write .parquet with --layers nodes")
    output = tmp_path / "mesh.parquet"
    done = command("mesh", source, "-o", output, "--layers", "nodes", *faster)
    assert done.code == 0
    assert len(read_layer(tmp_path / "mesh.parquet").columns) == 1999 + 1  # the geometry


@pytest.mark.parametrize(("extension", "most"), [(".gpkg", 1998), (".fgb", 65_536)])
def test_the_limit_is_that_of_the_format(tmp_path: Path, extension: str, most: int) -> None:
    """As many columns as the limit are written and read back; one more is refused."""
    if extension == ".fgb":
        with pytest.raises(OutputError, match="at most 65536 attributes"):
            find_format("mesh.fgb").require_room("triangles", columns=most + 1)
        return
    mesh = two_triangles()
    own = len(mesh.attributes("triangles"))

    def with_columns(count: int) -> geomesh.Mesh:
        table = Table({f"c{k}": np.full(2, float(k)) for k in range(count - own)})
        return replace(mesh, triangle_table=table)

    path = write_mesh(with_columns(most), tmp_path / f"mesh{extension}")
    assert read_mesh(path).triangle_table[f"c{most - own - 1}"].tolist() == [most - own - 1] * 2
    with pytest.raises(OutputError, match=rf"at most {most} attributes .* write \.parquet"):
        write_mesh(with_columns(most + 1), path, overwrite=True)
    write_mesh(with_columns(most + 1), tmp_path / "mesh.parquet")


@pytest.mark.parametrize("length", [255, 250, 246])
def test_a_name_may_be_as_long_as_the_system_allows(
    tmp_path: Path, length: int, command: Geomesh
) -> None:
    """SQLite keeps files beside a database whose names would be too long."""
    source, name = write_raster(tmp_path), "n" * (length - 5) + ".gpkg"
    for options in ((), ("--overwrite",)):
        assert command("mesh", source, "-o", tmp_path / name, *options).code == 0
        assert read_mesh(tmp_path / name).certify().passed
    longer = "n" * 251 + ".gpkg"
    assert (
        command("mesh", source, "-o", tmp_path / longer)
        .error()
        .endswith("cannot be written: file name too long; give it a shorter name")
    )
