"""Meshes painted as GeoTIFFs: the content of the files, read with rasterio, and errors."""

from __future__ import annotations

import json
import re
import warnings
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import rasterio

import geomesh
from geomesh.errors import GeomeshWarning
from geomesh.mesh.topology import FILL
from geomesh.zonal.owners import find_owners
from support.cases import SOURCES, Case
from support.commands import OLD, Geomesh, run_program, snapshot
from support.rasters import picture, write_raster
from support.samples import write_mirrored

if TYPE_CHECKING:
    from collections.abc import Mapping

MESHED = {name: case for name, case in SOURCES.items() if case.refused is None}


def mesh_of(source: Any, **options: Any) -> geomesh.Mesh:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GeomeshWarning)
        return geomesh.mesh_raster(source, **options)


def owned(mesh: geomesh.Mesh, model: str = "linear") -> np.ndarray:
    """Return which pixels a triangle with a value owns. Nodes have values, but for nodata alone."""
    owners = find_owners(mesh.nodes, mesh.triangles, mesh.grid.extent)
    if model == "linear":
        return owners != FILL
    assert mesh.provenance is not None
    mean = mesh.triangle_table[f"{mesh.provenance.source.bands[0].name}_mean"]
    return np.append(~np.isnan(mean), False)[owners]  # the last one is FILL


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Path]:
    """A raster and the file of its mesh."""
    folder = tmp_path_factory.mktemp("made")
    source = Path(write_raster(folder, data=picture(3, 120, 100), photometric="rgb"))
    return source, mesh_of(source).to_file(folder / "mesh.gpkg")


# ---------------------------------------------------------------- content of the file


@pytest.mark.slow
@pytest.mark.parametrize("model", ["linear", "constant"])
def test_each_sample_is_painted_on_its_pixels(tmp_path: Path, sample: Path, model: Any) -> None:
    mesh, path = mesh_of(sample), tmp_path / "painted.tif"
    told = mesh.render(sample, path, model=model)
    with rasterio.open(sample) as source, rasterio.open(path) as painted:
        assert painted.shape == source.shape
        assert painted.transform == source.transform
        assert painted.crs == source.crs
        for name in ("dtypes", "nodatavals", "descriptions", "colorinterp", "count"):
            assert getattr(painted, name) == getattr(source, name), name
        true, shown = source.read().astype(float), painted.read().astype(float)
        valid, covered = ((file.read_masks() > 0).all(axis=0) for file in (source, painted))
        dtype = np.dtype(source.dtypes[0])
        profile = painted.profile
    assert (covered == owned(mesh, model)).all()
    assert (profile["tiled"], profile["compress"]) == (True, "deflate")
    errors = (shown - true)[:, valid & covered]
    rmse = np.sqrt((errors**2).mean(axis=1))
    counted = true[:, valid & covered]
    peak = 255 if dtype == np.uint8 else np.ptp(counted, axis=1)
    np.testing.assert_allclose(told.rmse, rmse, rtol=1e-9)
    np.testing.assert_allclose(told.psnr, 20 * np.log10(peak / rmse), rtol=1e-9)
    # Rounding and clipping to the range of the data type change little.
    surface = mesh.psnr(sample, model=model)
    np.testing.assert_allclose(told.psnr, surface.psnr, atol=0.2)
    if dtype.kind != "f":
        step = 0.3  # the standard deviation of rounding is 1 / sqrt(12)
        assert (np.array(told.rmse) <= np.array(surface.rmse) + step).all()


@pytest.mark.slow
@pytest.mark.parametrize("case", MESHED.values(), ids=MESHED)
def test_whatever_can_be_meshed_can_be_painted(tmp_path: Path, case: Case) -> None:
    source, options = case.prepare(tmp_path / "in")
    mesh, path = mesh_of(source, **options), tmp_path / "painted.tif"
    told = mesh.render(source, path)
    assert told.pixels == mesh.metadata["pixels"]["counted"]
    with rasterio.open(path) as painted:
        assert ((painted.dataset_mask() > 0) == owned(mesh)).all()
        assert painted.count == len(told.bands)
    assert sorted(found.name for found in tmp_path.iterdir()) == ["in", "painted.tif"]


def test_values_that_would_be_nodata_are_moved_beside_it(tmp_path: Path) -> None:
    bands = picture(1, 60, 60).astype(np.int16) - 100
    bands[bands == 0] = 1
    bands[:, :6, :30] = 0
    source = write_raster(tmp_path, data=bands, nodata=0)
    mesh, path = mesh_of(source), tmp_path / "painted.tif"
    mesh.render(source, path)
    with rasterio.open(path) as painted:
        shown = painted.read(1)
        assert painted.nodata == 0
    assert ((shown != 0) == owned(mesh)).all()
    assert (shown.min(), shown.max()) < (0, 100)
    assert (shown[owned(mesh)] == 1).any()


def test_scales_offsets_and_units_are_kept(tmp_path: Path) -> None:
    def tell(dataset: Any) -> None:
        dataset.scales, dataset.offsets, dataset.units = (0.1, 1), (5, 0), ("m", "")

    source = write_raster(tmp_path, data=picture(2), change=tell)
    path = tmp_path / "painted.tif"
    mesh_of(source, bidx=[2, 1]).render(source, path)
    with rasterio.open(path) as painted:
        assert (painted.scales, painted.offsets, painted.units) == ((1, 0.1), (0, 5), (None, "m"))


@pytest.mark.parametrize("dtype", ["float16", ">u2", "int8", "uint64", "float64"])
def test_arrays_of_every_type_become_files(tmp_path: Path, dtype: str) -> None:
    bands = (picture(1) // 4).astype(dtype)
    source = (bands, rasterio.Affine(2, 0, 0, 0, -2, 0), "EPSG:32631")
    path = tmp_path / "painted.tif"
    told = mesh_of(source).render(source, path)
    with rasterio.open(path) as painted:
        kind = {"float16": "float32", ">u2": "uint16"}.get(dtype, dtype)
        assert painted.dtypes == (kind,)
        errors = painted.read(1).astype(float) - bands[0].astype(float)
    assert told.rmse[0] == pytest.approx(np.sqrt((errors**2).mean()))


def test_a_mesh_of_a_part_is_painted_on_that_part(tmp_path: Path, olinda: Path) -> None:
    bounds = (290_000, 9_114_000, 295_000, 9_119_000)
    mesh, path = mesh_of(olinda, bounds=bounds), tmp_path / "painted.tif"
    mesh.render(olinda, path)
    with rasterio.open(olinda) as source, rasterio.open(path) as painted:
        window = source.window(*painted.bounds)
        assert (painted.width, painted.height) == (mesh.grid.width, mesh.grid.height)
        assert painted.width < source.width
        true = source.read(window=window.round_offsets().round_lengths()).astype(float)
        assert np.sqrt(((painted.read() - true) ** 2).mean()) < 20


def test_workers_do_not_change_a_byte_and_tiles_leave_no_seam(tmp_path: Path) -> None:
    source = write_mirrored(tmp_path / "s.tif", "iguacu_landsat8_rgb_uint16.tif", 1300, 1100)
    mesh = mesh_of(source, nodes=800)
    outputs = [tmp_path / f"{workers}.tif" for workers in (1, 2)]
    told = [
        mesh.render(source, output, workers=workers)
        for workers, output in enumerate(outputs, start=1)
    ]
    assert told[0] == told[1]
    assert outputs[0].read_bytes() == outputs[1].read_bytes()
    with rasterio.open(outputs[0]) as painted:
        shown = painted.read(1).astype(float)
    steps = np.abs(np.diff(shown, axis=1)).mean(axis=0)
    assert steps[1023] < np.quantile(steps, 0.99)


# ---------------------------------------------------------------- the command


def test_command_tells_decibels_on_stderr_and_the_file_on_stdout(
    tmp_path: Path, made: tuple[Path, Path], command: Geomesh
) -> None:
    source, mesh = made
    output = tmp_path / "painted.tif"
    run = command("render", mesh, "--like", source, "-o", output)
    told = geomesh.read_mesh(mesh).render(source, tmp_path / "again.tif")
    assert run.code == 0
    assert re.fullmatch(
        rf"{output}: {mesh} on the pixels of {source}, PSNR \d\d\.\d\d dB\n", run.out
    )
    assert all(
        re.search(rf"{band} .* {value:.2f} ", run.err)
        for band, value in zip(told.bands, told.psnr, strict=True)
    )


def test_command_tells_json(tmp_path: Path, made: tuple[Path, Path], command: Geomesh) -> None:
    source, mesh = made
    for fit, model in (("sampled", "constant"), ("least-squares", "linear")):
        output = tmp_path / f"{model}.tif"
        run = command(
            "render", mesh, "--like", source, "-o", output, "--fit", fit, "--model", model, "--json"
        )
        assert (run.code, run.err) == (0, "")
        (result,) = json.loads(run.out)["results"]
        expected = geomesh.read_mesh(mesh).render(
            source, tmp_path / "again.tif", model=model, fit=fit.replace("-", "_"), overwrite=True
        )
        assert (tmp_path / "again.tif").read_bytes() == output.read_bytes()
        assert result["psnr"] == expected.overall
        assert list(result["bands"]) == list(expected.bands)
        assert [band["psnr"] for band in result["bands"].values()] == list(expected.psnr)
        assert (result["model"], result["fit"], result["output"]) == (model, fit, str(output))


def test_command_tells_json_lines(
    tmp_path: Path, made: tuple[Path, Path], command: Geomesh
) -> None:
    source, mesh = made
    output = tmp_path / "painted.tif"
    run = command("render", mesh, "--like", source, "-o", output, "--progress", "jsonl")
    start, *steps, result = map(json.loads, run.out.splitlines())
    assert (run.code, run.err, start["command"]) == (0, "", "render")
    fractions = [step["fraction"] for step in steps]
    assert fractions == sorted(set(fractions))
    assert (fractions[0], fractions[-1]) == (0, 1)
    assert result["outputs"] == [str(output)]
    assert set(result["figures"]) == {"model", "fit", "pixels", "psnr", "bands"}


@pytest.mark.parametrize(
    "given", [(), ("--like=s.tif", "--co=COMPRESS"), ("--like=s.tif", "--model=cubic")]
)
def test_wrong_usage_exits_with_2(given: tuple[str, ...], command: Geomesh) -> None:
    assert command("render", "mesh.gpkg", "-o", "out.tif", *given).code == 2


def test_exact_pictures_are_null_in_json(tmp_path: Path, command: Geomesh) -> None:
    source = write_raster(tmp_path, data=np.full((1, 20, 30), 9, np.uint8))
    mesh = mesh_of(source).to_file(tmp_path / "mesh.gpkg")
    output = tmp_path / "painted.tif"
    run = command("render", mesh, "--like", source, "-o", output, "--json")
    (result,) = json.loads(run.out)["results"]
    assert (result["psnr"], result["bands"]["b1"]["rmse"]) == (None, 0)
    assert "inf" in command("render", mesh, "--like", source, "-o", output, "--overwrite").err


def test_creation_options_are_those_of_gdal(
    tmp_path: Path, made: tuple[Path, Path], command: Geomesh
) -> None:
    source, mesh = made
    output = tmp_path / "painted.tif"
    given = ("--co", "COMPRESS=JPEG", "--co", "photometric=ycbcr", "--co", "JPEG_QUALITY=30")
    run = command("render", mesh, "--like", source, "-o", output, *given, "--json")
    (result,) = json.loads(run.out)["results"]
    with rasterio.open(source) as true, rasterio.open(output) as painted:
        assert painted.profile["compress"] == "jpeg"
        assert painted.dataset_mask().all()
        errors = painted.read().astype(float) - true.read()
    # The error includes the loss from compression.
    assert result["psnr"] == pytest.approx(20 * np.log10(255 / np.sqrt((errors**2).mean())))


REFUSED: dict[str, tuple[tuple[str, ...], str]] = {
    "no mesh": (("scene.tif", "--like=scene.tif"), "scene.tif .* (GeoPackage|GTiff)"),
    "missing mesh": (("gone.gpkg", "--like=scene.tif"), "gone.gpkg does not exist"),
    "missing raster": (("mesh.gpkg", "--like=gone.tif"), "gone.tif: no such file; check the path"),
    "no raster": (("mesh.gpkg", "--like=notes.txt"), "notes.txt: is not a raster that GDAL can"),
    "truncated raster": (
        ("mesh.gpkg", "--like=truncated.tif"),
        "truncated.tif: cannot read columns .* damaged",
    ),
    "other size": (
        ("mesh.gpkg", "--like=small.tif"),
        r"mesh \(100 x 120 of .* not among those of small.tif \(90 x 120 .*: use the raster",
    ),
    "other CRS": (
        ("mesh.gpkg", "--like=crs.tif"),
        "the mesh is in EPSG:32725 and crs.tif in EPSG:31985: use the raster .*--crs",
    ),
    "other band": (("mesh.gpkg", "--like=scene.tif", "-b4"), "band 4 does not exist: scene.tif"),
    "one band": (("mesh.gpkg", "--like=gray.tif"), "band 2 does not exist: gray.tif .*--bidx"),
    "picture": (
        ("mesh.gpkg", "--like=scene.tif", "-oout.png"),
        "out.png is not named as a GeoTIFF; use",
    ),
    "no folder": (("mesh.gpkg", "--like=scene.tif", "-ono/out.tif"), "folder of no/out.tif does"),
    "unknown compression": (
        ("mesh.gpkg", "--like=scene.tif", "--co=COMPRESS=FOO"),
        "creation option compress is refused by GDAL: .*FOO",
    ),
    "unknown option": (
        ("mesh.gpkg", "--like=scene.tif", "--co=FOO=1"),
        "creation option foo is refused by GDAL: driver GTiff does not",
    ),
    "options at odds": (
        ("mesh.gpkg", "--like=scene.tif", "--co=COMPRESS=LZW", "--co=PREDICTOR=3"),
        "creation options cannot be used together: .*PREDICTOR=3",
    ),
    "settled option": (
        ("mesh.gpkg", "--like=scene.tif", "--co=nodata=7"),
        "nodata is not a creation option of GTiff: .* leave it out",
    ),
    "lossy nodata": (
        ("holed.gpkg", "--like=holed.tif", "--co=COMPRESS=JPEG"),
        "does not contain what was written to it: .* other creation options",
    ),
}


@pytest.mark.parametrize(("given", "refused"), REFUSED.values(), ids=REFUSED)
def test_bad_input_is_refused_in_one_line_and_nothing_is_lost(
    tmp_path: Path,
    made: tuple[Path, Path],
    given: tuple[str, ...],
    refused: str,
    command: Geomesh,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    source, mesh = made
    Path("scene.tif").write_bytes(source.read_bytes())
    Path("mesh.gpkg").write_bytes(mesh.read_bytes())
    Path("notes.txt").write_text("not a raster")
    whole = Path(write_raster(tmp_path, "truncated.tif", picture(3, 120, 100), compress="deflate"))
    whole.write_bytes(whole.read_bytes()[:-2000])
    write_raster(tmp_path, "small.tif", picture(3, 120, 90))
    write_raster(tmp_path, "crs.tif", picture(3, 120, 100), crs="EPSG:31985")
    write_raster(tmp_path, "gray.tif", picture(1, 120, 100))
    holed = picture(1, 300, 300)
    holed[:, :100] = 0
    mesh_of(write_raster(tmp_path, "holed.tif", holed, nodata=0), nodes=100).to_file("holed.gpkg")
    Path("old.tif").write_bytes(OLD)
    before = snapshot(tmp_path)
    output = () if any(argument.startswith("-o") for argument in given) else ("-o", "old.tif")
    error = command("render", *given, *output, "--overwrite").error()
    assert re.search(refused, error), error
    assert snapshot(tmp_path) == before


def test_existing_output_is_kept_or_replaced_whole(
    tmp_path: Path, made: tuple[Path, Path], command: Geomesh
) -> None:
    source, mesh = made
    output = tmp_path / "painted.tif"
    output.write_bytes(OLD)
    error = command("render", mesh, "--like", source, "-o", output).error()
    assert "exists; use --overwrite" in error
    assert output.read_bytes() == OLD
    assert command("render", mesh, "--like", source, "-o", output, "--overwrite").code == 0
    assert sorted(snapshot(tmp_path)) == ["painted.tif"]
    for place in (mesh, source):
        error = command("render", mesh, "--like", source, "-o", place, "--overwrite").error()
        assert "choose another name" in error or "GeoTIFF" in error


# ---------------------------------------------------------------- separate programs


@pytest.mark.slow
@pytest.mark.parametrize(("rows", "fits"), [(200, True), (240, False), (260, False), (400, False)])
def test_full_disk_is_told_and_the_old_file_is_kept(
    tmp_path: Path, small_disk: tuple[Path, Mapping[str, Any]], rows: int, fits: bool
) -> None:
    """This includes files that are only slightly too large: GDAL notices it on closing."""
    folder, options = small_disk
    source = write_raster(tmp_path, data=picture(1, rows, 300).astype(np.float64))
    mesh = mesh_of(source, nodes=200, preset="features").to_file(tmp_path / "mesh.gpkg")
    whole, output = tmp_path / "whole.tif", folder / "painted.tif"
    assert run_program("render", mesh, "--like", source, "-o", whole).code == 0
    output.write_bytes(OLD)
    run = run_program("render", mesh, "--like", source, "-o", output, "--overwrite", **options)
    assert (run.code == 0) == fits, (whole.stat().st_size, run.err)
    assert snapshot(folder) == {"painted.tif": whole.read_bytes() if fits else OLD}
    # libtiff also prints its own lines.
    errors = [line for line in run.err.splitlines() if line.startswith("Error")]
    assert len(errors) == (0 if fits else 1)
    for error in errors:
        assert re.match(rf"Error: {output} .*free some space,? or choose another folder", error)
    assert "Traceback" not in run.err
