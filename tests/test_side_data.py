"""What lies in or beside a raster does not change a mesh: overviews, .aux.xml, alpha tags."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import rasterio
import rasterio.shutil
from affine import Affine
from rasterio.enums import ColorInterp, Resampling
from rasterio.vrt import WarpedVRT

import geomesh
from geomesh.cli.console import spell
from geomesh.errors import BandError
from geomesh.features.overview import read_overview
from geomesh.parallel.progress import silent
from geomesh.parallel.workers import open_workers
from geomesh.raster.grid import Window
from geomesh.raster.open import open_scene
from support.rasters import COLS, NORTH_UP, ROWS, SIZE, picture, write_raster
from support.reading import notes, read
from support.samples import fingerprint

if TYPE_CHECKING:
    from collections.abc import Callable

    from support.commands import Geomesh


# --------------------------------------------------------------------------- overviews

HIGH, WIDE = 301, 263


def add_overviews(path: str) -> None:
    """Add overviews to a file, of the means of pixels."""
    with rasterio.open(path, "r+") as dataset:
        dataset.build_overviews([2, 4, 8], Resampling.average)


def put_overview(path: str) -> str:
    """Put an overview of zeros beside a file of any format."""
    with rasterio.open(path) as dataset:
        shape = (dataset.count, -(-dataset.height // 2), -(-dataset.width // 2))
    file = Path(path)
    write_raster(file.parent, f"{file.name}.ovr", np.zeros(shape, np.uint8), crs=None)
    with rasterio.open(path) as dataset:
        assert dataset.overviews(1) == [2]
    return path


def internal(folder: Path, **profile: Any) -> str:
    path = write_raster(folder, "internal.tif", picture(2, HIGH, WIDE), **profile)
    add_overviews(path)
    return path


def copied(folder: Path, name: str, driver: str, **options: Any) -> str:
    plain = write_raster(folder, "plain.tif", picture(1 if driver == "PNG" else 2, HIGH, WIDE))
    rasterio.shutil.copy(plain, folder / name, driver=driver, **options)
    return str(folder / name) if driver == "COG" else put_overview(str(folder / name))


def vrt_of_one_with_overviews(folder: Path) -> str:
    rasterio.shutil.copy(internal(folder), folder / "scene.vrt", driver="VRT")
    return str(folder / "scene.vrt")


WITH_OVERVIEWS: dict[str, Callable[[Path], str]] = {
    "inside": internal,
    "inside, in tiles": lambda folder: internal(
        folder, tiled=True, blockxsize=64, blockysize=64, compress="deflate"
    ),
    "in single rows": lambda folder: internal(folder, blockysize=1),
    "beside": lambda folder: put_overview(write_raster(folder, data=picture(2, HIGH, WIDE))),
    "of a VRT": lambda folder: copied(folder, "scene.vrt", "VRT"),
    "of the source of a VRT": vrt_of_one_with_overviews,
    "of a COG": lambda folder: copied(
        folder, "cog.tif", "COG", overview_resampling="average", overview_count="2", blocksize="128"
    ),
    "of a PNG": lambda folder: copied(folder, "scene.png", "PNG"),
}


@pytest.mark.parametrize("name", WITH_OVERVIEWS)
@pytest.mark.parametrize("step", [2, 3, 6, 20])
def test_decimated_pixels_are_those_in_the_middle_of_each_step(tmp_path, name, step):
    path = WITH_OVERVIEWS[name](tmp_path)
    height, width = HIGH // step, WIDE // step
    window = Window(0, 0, width * step, height * step)
    rows, cols = (np.floor((np.arange(n) + 0.5) * step).astype(int) for n in (height, width))
    with rasterio.open(path) as dataset, WarpedVRT(dataset) as warped:
        expected = dataset.read()[:, rows[:, None], cols]
        if step == 6:
            there = rasterio.windows.Window(0, 0, window.width, window.height)
            assert (dataset.read(window=there, out_shape=expected.shape) != expected).any()
        for source in (path, dataset, warped):
            scene = open_scene(source)
            with scene.open():
                bands, valid = scene.read(window, (height, width))
            np.testing.assert_array_equal(bands, expected)
            assert valid.all()


@pytest.mark.parametrize("kind", ["internal", "msk", "alpha", "nodata"])
def test_decimated_masks_are_of_full_resolution(tmp_path, kind):
    rng = np.random.default_rng(5)
    shown = np.where(rng.random((HIGH, WIDE)) < 0.5, 255, 0).astype("u1")
    data = picture(2, HIGH, WIDE).clip(3)
    if kind == "nodata":
        data[0][shown == 0] = 1

    def change(dataset: Any) -> None:
        if kind == "alpha":
            dataset.write(shown, 2)
        elif kind != "nodata":
            dataset.write_mask(shown)

    nodata = 1 if kind == "nodata" else None
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=kind == "internal"):
        path = write_raster(
            tmp_path,
            data=data,
            change=change,
            nodata=nodata,
            alpha="YES" if kind == "alpha" else "NO",
        )
        add_overviews(path)
    scene = open_scene(path)
    with scene.open():
        _, valid = scene.read(Window(0, 0, 260, 300), (75, 65))
    np.testing.assert_array_equal(valid, shown[2:300:4, 2:260:4] > 0)


def test_overviews_do_not_change_a_mesh(tmp_path):
    path = write_raster(tmp_path, data=picture(1, 700, 1100), tiled=True, compress="deflate")
    before = fingerprint(geomesh.mesh_raster(path, effort="fast"))
    put_overview(path)
    assert fingerprint(geomesh.mesh_raster(path, effort="fast")) == before


def test_a_vrt_of_larger_pixels_does_not_take_them_from_overviews(tmp_path):
    path = write_raster(tmp_path, data=picture(1, HIGH - 1, WIDE - 3))
    half = tmp_path / "half.vrt"
    place = ",".join(map(str, (NORTH_UP * NORTH_UP.scale(4)).to_gdal()))
    half.write_text(
        f'<VRTDataset rasterXSize="{260 // 4}" rasterYSize="{300 // 4}">'
        f"<GeoTransform>{place}</GeoTransform>"
        '<VRTRasterBand dataType="Byte" band="1"><SimpleSource>'
        '<SourceFilename relativeToVRT="1">scene.tif</SourceFilename><SourceBand>1</SourceBand>'
        '<SrcRect xOff="0" yOff="0" xSize="260" ySize="300"/>'
        '<DstRect xOff="0" yOff="0" xSize="65" ySize="75"/></SimpleSource></VRTRasterBand>'
        "</VRTDataset>"
    )

    def look() -> np.ndarray:
        with open_workers(2) as workers, open_scene(half).open() as scene:
            return read_overview(scene, workers, silent)[0]

    before = look()
    np.testing.assert_array_equal(before, picture(1, 300, 260)[:, 2::4, 2::4])
    add_overviews(path)
    np.testing.assert_array_equal(look(), before)


# --------------------------------------------------------------------------- .aux.xml


def put_beside(path: str, content: str) -> str:
    """Write what GDAL keeps beside a raster, and return its name."""
    side_file = Path(f"{path}.aux.xml")
    side_file.write_text(f"<PAMDataset>{content}</PAMDataset>")
    return side_file.name


def of_band(number: int, content: str) -> str:
    return f'<PAMRasterBand band="{number}">{content}</PAMRasterBand>'


ALPHA = "<ColorInterp>Alpha</ColorInterp>"


def full_raster(folder: Path) -> str:
    """Write a raster that says everything itself: four bands, nodata 200, scales."""

    def change(dataset: Any) -> None:
        dataset.scales, dataset.offsets = (2, 1, 1, 1), (5, 0, 0, 0)
        dataset.update_tags(NODATA_VALUES="200 200 200 200")

    data = picture(4).clip(1, 199)
    data[:, :4] = 200
    return write_raster(
        folder, data=data, photometric="rgb", alpha="unspecified", nodata=200, change=change
    )


OTHERWISE = {
    "<SRS>EPSG:3857</SRS>": "CRS EPSG:3857 instead of EPSG:32725",
    "<GeoTransform>7,2,0,3,0,-2</GeoTransform>": "another georeference",
    of_band(1, "<NoDataValue>60</NoDataValue>"): "nodata value 60 instead of 200 of band 1",
    of_band(1, ALPHA): "colour alpha instead of red of band 1",
    of_band(1, "<Scale>3</Scale><Offset>5</Offset>"): "scale 3 instead of 2 of band 1",
    of_band(1, "<Scale>2</Scale><Offset>6</Offset>"): "offset 6 instead of 5 of band 1",
    "<Metadata><MDI key='NODATA_VALUES'>9 9 9 9</MDI></Metadata>": "other NODATA_VALUES",
}


@pytest.mark.parametrize("content", OTHERWISE)
def test_a_side_file_that_contradicts_the_raster_is_not_believed(tmp_path, content):
    path = full_raster(tmp_path)
    expected = fingerprint(geomesh.mesh_raster(path, unscale=True))
    name = put_beside(path, content)
    with rasterio.open(path) as dataset:  # it does change what GDAL says
        told = notes(dataset, unscale=True)
    assert f"{name} contradicts the file itself ({OTHERWISE[content]}" in told[0]
    (note,) = notes(path, unscale=True)
    assert note.endswith(
        f"{path}: {name} contradicts the file itself ({OTHERWISE[content]}); the side file is not "
        "used"
    )
    made = geomesh.mesh_raster(path, unscale=True)
    assert {**fingerprint(made), "metadata": ""} == {**expected, "metadata": ""}
    assert made.psnr(path).pixels == SIZE - 4 * COLS


def test_side_files_of_erdas_imagine_are_not_believed_either(tmp_path):
    path = write_raster(tmp_path, nodata=60)
    other = write_raster(tmp_path, "other.tif", crs="EPSG:3857", nodata=80)
    aux = {"AUX": "YES", "DEPENDENT_FILE": "scene.tif"}
    rasterio.shutil.copy(other, tmp_path / "scene.aux", driver="HFA", **aux)
    with rasterio.open(path) as dataset:
        assert dataset.nodata == 80
    scene = open_scene(path)
    assert "scene.aux contradicts the file itself (CRS EPSG:3857" in scene.notes[0]
    assert scene.grid.crs == "EPSG:32725"
    np.testing.assert_array_equal(read(path)[1], picture()[0] != 60)


def test_a_side_file_is_not_believed_by_workers_in_other_processes(tmp_path):
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import get_context

    path = full_raster(tmp_path)
    put_beside(path, of_band(1, "<NoDataValue>60</NoDataValue>"))
    with ProcessPoolExecutor(1, get_context("spawn")) as pool:
        mesh = geomesh.mesh_raster(path, executor=pool)
    assert mesh.domain.valid_pixels == SIZE - 4 * COLS


def test_another_colour_table_is_not_believed(tmp_path):
    own = {0: (0, 0, 0, 255), 1: (9, 100, 3, 255), 2: (200, 50, 40, 255)}

    def change(dataset: Any) -> None:
        dataset.write_colormap(1, own)

    path = write_raster(tmp_path, data=picture() % 3, change=change)
    expected, _ = read(path)
    entries = "".join(f"<Entry c1='{k}' c2='0' c3='0' c4='0'/>" for k in range(256))
    put_beside(path, of_band(1, f"<ColorTable>{entries}</ColorTable>"))
    bands, valid = read(path)
    np.testing.assert_array_equal(bands, expected)
    assert valid.all()
    assert "another colour table" in notes(path)[0]


def test_a_side_file_adds_what_the_raster_does_not_say(tmp_path):
    plain = write_raster(tmp_path, data=picture().clip(2, 60))
    path = str(tmp_path / "scene.png")
    rasterio.shutil.copy(plain, path, driver="PNG")
    with rasterio.open(path) as dataset:
        assert dataset.crs is not None
    assert Path(f"{path}.aux.xml").exists()
    assert notes(path) == []
    scene = open_scene(path)
    assert scene.grid == open_scene(plain).grid
    plain = write_raster(tmp_path, data=picture().clip(2, 60), crs=None)
    marker = of_band(1, "<NoDataValue>60</NoDataValue><Scale>3</Scale><Offset>5</Offset>")
    put_beside(plain, f"<SRS>EPSG:32725</SRS>{marker}")
    assert open_scene(plain).grid.crs == "EPSG:32725"
    bands, valid = read(plain, unscale=True)
    np.testing.assert_array_equal(valid, picture()[0] < 60)
    np.testing.assert_array_equal(bands, picture().clip(2, 60) * 3.0 + 5)


def test_a_side_file_may_say_the_same_in_other_words(tmp_path):
    from rasterio.crs import CRS
    from rasterio.enums import WktVersion

    lowest = float(np.finfo("f4").min)
    place = Affine(1 / 3600, 0, -43.3, 0, -1 / 3600, -8.1)

    def change(dataset: Any) -> None:
        dataset.scales = (1 / 3,)

    path = write_raster(
        tmp_path,
        data=picture().astype("f4"),
        crs="EPSG:4326",
        transform=place,
        nodata=lowest,
        change=change,
    )
    wkt = CRS.from_epsg(4326).to_wkt(version=WktVersion.WKT1_ESRI)
    numbers = ",".join(f"{number:.14g}" for number in place.to_gdal())
    band = of_band(1, f"<NoDataValue>{lowest:.15g}</NoDataValue><Scale>0.333333333333</Scale>")
    put_beside(path, f"<SRS>{wkt}</SRS><GeoTransform>{numbers}</GeoTransform>{band}")
    assert not any("contradicts" in note for note in open_scene(path).notes)


def test_statistics_beside_a_raster_change_nothing(tmp_path):
    path = write_raster(tmp_path)
    expected = fingerprint(geomesh.mesh_raster(path))
    wrong = "".join(
        f"<MDI key='STATISTICS_{key}'>{value}</MDI>"
        for key, value in {"MINIMUM": 250, "MAXIMUM": 255, "MEAN": 7, "STDDEV": 0}.items()
    )
    put_beside(path, of_band(1, f"<Metadata>{wrong}</Metadata>"))
    assert notes(path) == []
    assert fingerprint(geomesh.mesh_raster(path)) == expected


def test_an_open_dataset_follows_its_side_file_and_says_so(tmp_path):
    path = full_raster(tmp_path)
    put_beside(path, of_band(1, "<NoDataValue>60</NoDataValue>"))
    with rasterio.open(path) as dataset, WarpedVRT(dataset) as warped:
        for source in (dataset, warped):
            scene = open_scene(source)
            assert "to use the file itself, give its path" in scene.notes[0]
    with rasterio.Env(GDAL_PAM_ENABLED=False), rasterio.open(path) as dataset:
        assert not any("contradicts" in note for note in open_scene(dataset).notes)


# --------------------------------------------------------------------------- alpha


# GDAL tags the fourth of four bands as alpha, if it is told nothing.
UNTAGGED = {"photometric": "minisblack", "alpha": "NO"}


def naip(folder: Path, *, tagged: tuple[int, ...] = (4,), **options: Any) -> tuple[str, np.ndarray]:
    """Write red, green, blue and the near infrared, which some writers tag as alpha."""
    data = picture(4).astype("u1")
    data[3] = data[3].T.reshape(ROWS, COLS) if ROWS == COLS else data[3][::-1, ::-1]
    data[3, :10] = 0

    def change(dataset: Any) -> None:
        dataset.colorinterp = [
            ColorInterp.alpha if k in tagged else color
            for k, color in enumerate(
                (ColorInterp.red, ColorInterp.green, ColorInterp.blue, ColorInterp.undefined), 1
            )
        ]

    return write_raster(folder, data=data, change=change, **UNTAGGED, **options), data


def test_alpha_is_a_mask_or_data_as_the_caller_says(tmp_path):
    path, data = naip(tmp_path)
    with rasterio.open(path) as dataset:
        for source in (path, dataset):
            bands, valid = read(source)
            np.testing.assert_array_equal(bands, data[:3])
            np.testing.assert_array_equal(valid, data[3] > 0)
            bands, valid = read(source, alpha="data")
            np.testing.assert_array_equal(bands, data)
            assert valid.all()
            bands, valid = read(source, alpha="data", bidx=[4, 1, 2])
            np.testing.assert_array_equal(bands, data[[3, 0, 1]])
            assert valid.all()


def test_data_is_not_hidden_by_masks_but_by_nodata(tmp_path):
    for internal_mask in (True, False):
        data = picture(2).clip(2)
        data[0, :3] = 1
        hidden = np.zeros((ROWS, COLS), np.uint8)

        def change(dataset: Any, mask: np.ndarray = hidden) -> None:
            dataset.write_mask(mask)

        with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=internal_mask):
            name = f"{internal_mask}.tif"
            path = write_raster(tmp_path, name, data, change=change, nodata=1)
        assert not read(path)[1].any()
        np.testing.assert_array_equal(read(path, alpha="data")[1], data[0] != 1)


def test_a_mesh_remembers_that_alpha_was_data(tmp_path, command: Geomesh):
    path, _ = naip(tmp_path)
    out, painted = tmp_path / "mesh.gpkg", tmp_path / "painted.tif"
    given = ("mesh", path, "-o", out, "--bidx", "4,1,2")
    error = command(*given).error()
    assert re.search(r"band 4 of .* tagged as alpha.* use it as data with --alpha data$", error)
    run = command(*given, "--alpha", "data")
    assert run.code == 0, run.err
    mesh = geomesh.read_mesh(out)
    assert mesh.provenance is not None
    assert mesh.provenance.source.alpha == "data"
    assert mesh.psnr(path).pixels == mesh.domain.valid_pixels == SIZE
    run = command("render", out, "--like", path, "-o", painted)
    assert run.code == 0, run.err
    assert read(painted)[0].shape[0] == 3
    mesh.render(path, painted, overwrite=True, bidx=[4, 2])
    bands, valid = read(painted)
    assert (len(bands), valid.all()) == (2, True)


def test_a_mesh_of_visible_bands_is_compared_with_the_near_infrared(tmp_path, command: Geomesh):
    path, data = naip(tmp_path)
    out, painted = tmp_path / "mesh.gpkg", tmp_path / "painted.tif"
    assert command("mesh", path, "-o", out).code == 0
    given = ("render", out, "--like", path, "-o", painted, "--bidx", "4")
    assert command(*given).error().endswith("use it as data with --alpha data")
    run = command(*given, "--alpha", "data")
    assert run.code == 0, run.err
    assert rasterio.open(painted).dtypes == ("uint8",)
    mesh = geomesh.read_mesh(out)
    with pytest.raises(BandError, match="alpha"):
        mesh.psnr(path, bidx=[4])
    assert mesh.psnr(path, bidx=[4], alpha="data").pixels == (data[3] > 0).sum()


def test_the_error_names_the_option_of_other_commands_too(tmp_path, command: Geomesh):
    path, _ = naip(tmp_path)
    out, figure = tmp_path / "table.csv", tmp_path / "stages.png"
    for given in (("evaluate", path, "-o", out), ("stages", path, "-o", figure)):
        run = command(*given, "--bidx", "4")
        assert run.code == 1
        assert "use it as data with --alpha data" in run.err
    run = command("stages", path, "-o", figure, "--bidx", "4", "--alpha", "data")
    assert run.code == 0, run.err


def test_quotation_marks_of_python_are_no_part_of_an_option():
    import click

    from geomesh.cli.mesh import mesh

    with click.Context(mesh):
        assert spell('use `alpha="data"`') == "use --alpha data"


def test_two_bands_tagged_as_alpha_are_both_masks(tmp_path):
    path, data = naip(tmp_path, tagged=(3, 4))
    data[2, :, :10] = 0
    with rasterio.open(path, "r+") as dataset:
        dataset.write(data[2], 3)
        assert dataset.colorinterp[2:] == (ColorInterp.alpha, ColorInterp.alpha)
    bands, valid = read(path)
    np.testing.assert_array_equal(bands, data[:2])
    np.testing.assert_array_equal(valid, (data[2] > 0) & (data[3] > 0))
    assert read(path, alpha="data")[1].all()
    with pytest.raises(BandError, match="band 3 of"):
        open_scene(path, bidx=[1, 3])


@pytest.mark.parametrize("count", [1, 2])
def test_bands_that_are_all_tagged_as_alpha_are_data(tmp_path, count):
    data = picture(count)
    data[:, :5] = 0
    path = write_raster(tmp_path, data=data, **UNTAGGED)
    put_beside(path, "".join(of_band(k + 1, ALPHA) for k in range(count)))
    bands, valid = read(path)
    np.testing.assert_array_equal(bands, data)
    assert valid.all()


@pytest.mark.parametrize("dtype", ["u1", "u2", "i2", "f4"])
def test_any_alpha_above_0_shows_a_pixel(tmp_path, dtype):
    data = picture(2).astype(dtype)
    data[1] = 1
    data[1, :5] = 0
    path = write_raster(tmp_path, data=data, photometric="minisblack", alpha="YES")
    np.testing.assert_array_equal(read(path)[1], data[1] > 0)


def test_an_alpha_band_that_looks_like_data_is_pointed_out(tmp_path, command: Geomesh):
    path, _ = naip(tmp_path)
    (told,) = notes(path)
    assert "band 4" in told
    assert 'if it is data, use `alpha="data"`' in told
    assert notes(path, alpha="data") == []
    text = command("info", path).out
    assert "alpha in band 4" in text
    assert "use --alpha data" in text


@pytest.mark.parametrize("kind", ["opaque", "hole", "soft edge", "half transparent"])
def test_an_alpha_band_that_looks_like_a_mask_is_not(tmp_path, kind):
    path, data = naip(tmp_path)
    data[3] = 255 if kind != "half transparent" else 128
    data[3, 10:20, 10:20] = 0
    if kind == "soft edge":
        data[3, :, :12] = np.arange(12) * 20
    with rasterio.open(path, "r+") as dataset:
        dataset.write(data[3], 4)
    assert notes(path) == []


@pytest.mark.parametrize("value", ["auto", None, True, "MASK"])
def test_another_use_of_alpha_is_refused(tmp_path, value):
    with pytest.raises(BandError, match=r"alpha is .*: choose from mask, data"):
        open_scene(write_raster(tmp_path), alpha=value)


def test_info_tells_what_hides_pixels_and_what_is_not_used(tmp_path, command: Geomesh):
    path = full_raster(tmp_path)
    put_overview(path)
    put_beside(path, of_band(1, "<NoDataValue>60</NoDataValue>"))
    text = command("info", path).out
    for words in (
        "nodata of band 1, nodata of band 2",
        "unused overviews: 2",
        "scene.tif.ovr",
        "scale 2, offset 5",
        "the side file is not used",
    ):
        assert words in text, text
