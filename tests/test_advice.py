"""Each advice is followed: what an error or warning names works on the input that caused it."""

from __future__ import annotations

import json
import re
import shutil
import tomllib
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import geopandas as gpd
import numpy as np
import pytest
import rasterio
import rasterio.shutil
import shapely
import xarray as xr
from scipy.ndimage import gaussian_filter

import geomesh
from geomesh.errors import GeomeshError, SourceError
from geomesh.io.read import read_mesh
from geomesh.raster.open import open_scene
from geomesh.recipe import Recipe
from support.cases import container, with_alpha
from support.rasters import NORTH_UP, UTM, constant, holed, picture, write_raster
from support.samples import OLINDA, ROOT

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from support.commands import Geomesh

pytestmark = pytest.mark.filterwarnings("ignore::PendingDeprecationWarning")


def scene(folder: Path) -> None:
    write_raster(folder)


def smooth(folder: Path, side: int = 400) -> None:
    noise = gaussian_filter(np.random.default_rng(0).standard_normal((side, side)), 10)
    levels = (noise - noise.min()) / np.ptp(noise) * 249 + 1
    write_raster(folder, data=levels.astype(np.uint8)[None])


def mesh_of(*options: str) -> Callable[[Path], None]:
    """Return a function that writes a raster, and its mesh with the library."""

    def make(folder: Path) -> None:
        mesh = geomesh.mesh_raster(write_raster(folder))
        mesh.to_file(folder / "mesh.gpkg", layers=[*options] or None)

    return make


def two_of_one_name(folder: Path) -> None:
    for part in ("a", "b"):
        write_raster(folder / part)


def existing(folder: Path) -> None:
    scene(folder)
    (folder / "mesh.gpkg").write_bytes(b"old")


def beside_its_folder(folder: Path) -> None:
    scene(folder)
    (folder / "folder.gpkg").mkdir()
    (folder / "so!").mkdir()


def nodata_everywhere(folder: Path) -> None:
    write_raster(folder, data=constant(20, 20), nodata=7)


def overviews(folder: Path) -> None:
    path = write_raster(folder, data=picture(1, 600, 600))
    with rasterio.Env(TIFF_USE_OVR=True), rasterio.open(path, "r+") as dataset:
        dataset.build_overviews([2])


def header(folder: Path) -> None:
    scene(folder)
    with rasterio.open(folder / "scene.tif") as dataset:
        rasterio.shutil.copy(dataset, folder / "scene.bil", driver="EHdr")


def area(folder: Path) -> None:
    scene(folder)
    box = shapely.box(NORTH_UP.c, NORTH_UP.f - 600, NORTH_UP.c + 600, NORTH_UP.f)
    gpd.GeoSeries([box], crs=UTM).to_file(folder / "aoi.gpkg")


def edited(folder: Path) -> None:
    """Write a mesh whose metadata another program lost, beside the one that geomesh wrote."""
    mesh_of()(folder)
    shutil.copy(folder / "mesh.gpkg", folder / "whole.gpkg")
    frame = gpd.read_file(folder / "mesh.gpkg", layer="triangles")
    frame.to_file(folder / "edited.gpkg", layer="triangles")
    gpd.read_file(folder / "mesh.gpkg", layer="nodes").to_file(
        folder / "edited.gpkg", layer="nodes"
    )


@dataclass(frozen=True)
class Advice:
    """An advice of the command line.

    Parameters
    ----------
    make : callable(folder)
        Writes the input.
    given : str
        Arguments that cause the message.
    told : str
        Pattern of the message.
    followed : tuple of str
        Arguments as the message advises them; each must succeed, without that message.
    more : str
        Name of a mesh that must have more nodes after the advice was followed.
    """

    make: Callable[[Path], Any]
    given: str
    told: str
    followed: tuple[str, ...]
    more: str = ""


MESH = "mesh scene.tif -o mesh.gpkg"
FEATURES = f"{MESH} --preset features"

ADVICE: dict[str, Advice] = {
    "overwrite": Advice(
        existing, MESH, "mesh.gpkg exists; use --overwrite to replace it", (f"{MESH} --overwrite",)
    ),
    "skip existing": Advice(
        existing,
        f"{MESH} --skip-existing",
        "is not a complete mesh file of geomesh; use --overwrite to replace it",
        (f"{MESH} --skip-existing --overwrite",),
    ),
    "missing folder": Advice(
        scene,
        "mesh scene.tif -o new/mesh.gpkg",
        "the folder of new/mesh.gpkg does not exist; create it first",
        ("mesh scene.tif -o new/",),  # which creates it
    ),
    "folder": Advice(
        beside_its_folder,
        "convert made.gpkg -o folder.gpkg",
        "folder.gpkg is a folder; name a file inside it",
        ("convert made.gpkg -o folder.gpkg/mesh.gpkg",),
    ),
    "exclamation mark": Advice(
        beside_its_folder,
        "mesh scene.tif -o so!/mesh.gpkg",
        "choose a folder without '!'",
        (MESH,),
    ),
    "no extension": Advice(
        scene,
        "mesh scene.tif -o mesh",
        r"choose from \.gpkg, \.geojson, .*, \.nc$",
        (
            *(
                f"mesh scene.tif -o mesh{end}"
                for end in (".gpkg", ".geojson", ".fgb", ".parquet", ".nc")
            ),
            *(f"mesh scene.tif -o mesh{end} --z 1" for end in (".2dm", ".stl", ".glb")),
        ),
    ),
    "no extension, quality": Advice(
        mesh_of(),
        "quality mesh.gpkg -o measured",
        r"choose from \.gpkg, [^`]*$",
        ("quality mesh.gpkg -o measured.parquet",),
    ),
    "unknown driver": Advice(
        scene,
        f"{MESH} -f Shapefile",
        "choose from GPKG, GeoJSON, .*, UGRID",
        (f"{MESH} -f GPKG",),
    ),
    "several layers": Advice(
        scene,
        "mesh scene.tif -o mesh.fgb --layers nodes,edges",
        "choose one of them, or write .gpkg",
        (
            "mesh scene.tif -o mesh.fgb --layers nodes",
            "mesh scene.tif -o mesh.gpkg --layers nodes,edges",
        ),
    ),
    "nodes in UGRID": Advice(
        scene,
        "mesh scene.tif -o mesh.nc --layers nodes",
        "write .gpkg for all layers",
        ("mesh scene.tif -o mesh.gpkg --layers nodes",),
    ),
    "a part of the layers": Advice(
        mesh_of("triangles"),
        "quality mesh.gpkg",
        "has no layer nodes; write the mesh with all its layers",
        (f"{MESH} --layers triangles,edges,nodes --overwrite", "quality mesh.gpkg"),
    ),
    "saved by another program": Advice(
        edited,
        "quality edited.gpkg",
        "use the file that geomesh wrote",
        ("quality whole.gpkg",),
    ),
    "not a GeoPackage": Advice(
        scene,
        "quality scene.tif",
        "cannot be read as a GeoPackage; use a .gpkg that geomesh wrote|is not a GeoPackage",
        (MESH, "quality mesh.gpkg"),
    ),
    "one name for two": Advice(
        two_of_one_name,
        "mesh a/scene.tif b/scene.tif -o out",
        "write them to different folders",
        ("mesh a/scene.tif -o out/a/", "mesh b/scene.tif -o out/b/"),
    ),
    "several in one file": Advice(
        two_of_one_name,
        "mesh a/scene.tif b/scene.tif -o mesh.gpkg",
        "for several rasters give a folder",
        ("mesh a/scene.tif -o out/a/",),
    ),
    "the input itself": Advice(
        area,
        "mesh scene.tif -o aoi.gpkg --mask aoi.gpkg --overwrite",
        "aoi.gpkg is the input aoi.gpkg; choose another name",
        ("mesh scene.tif -o other.gpkg --mask aoi.gpkg",),
    ),
    "container": Advice(
        container,
        "mesh tables.gpkg -o mesh.gpkg",
        "name one of its subdatasets: GPKG:tables.gpkg:one, GPKG:tables.gpkg:two",
        ("mesh GPKG:tables.gpkg:one -o one.gpkg", "mesh GPKG:tables.gpkg:two -o two.gpkg"),
    ),
    "folder as a source": Advice(
        partial(write_raster, name="sub/scene.tif"),
        "mesh sub -o mesh.gpkg",
        "sub: is a folder; name the raster files in it",
        ("mesh sub/scene.tif -o mesh.gpkg",),
    ),
    "overviews": Advice(
        overviews, "mesh scene.tif.ovr -o mesh.gpkg", "give scene.tif instead", (MESH,)
    ),
    "header": Advice(
        header,
        "mesh scene.hdr -o mesh.gpkg",
        "it describes scene.bil; give scene.bil instead",
        ("mesh scene.bil -o mesh.gpkg",),
    ),
    "luma of five bands": Advice(
        partial(write_raster, data=picture(5)),
        f"{MESH} --gray luma",
        "choose three with --bidx, if there are three, or set --gray to mean, pca or band:N",
        (
            f"{MESH} --gray luma --bidx 3,2,1",
            *(f"{MESH} --overwrite --gray {gray}" for gray in ("mean", "pca", "band:4")),
        ),
    ),
    "luma of two bands": Advice(
        partial(write_raster, data=picture(2)),
        f"{MESH} --gray luma",
        "if there are three, or set --gray to mean, pca or band:N",
        tuple(f"{MESH} --overwrite --gray {gray}" for gray in ("mean", "pca", "band:2")),
    ),
    "nodata everywhere": Advice(
        nodata_everywhere,
        MESH,
        "or override the nodata value with --nodata",
        (f"{MESH} --nodata 0",),
    ),
    "alpha among bands": Advice(
        with_alpha(255), f"{MESH} --bidx 1,2,3,1", "give each band once", (f"{MESH} --bidx 1,2,3",)
    ),
    "missing band": Advice(
        scene, f"{MESH} --bidx 2", "scene.tif has bands 1 to 1", (f"{MESH} --bidx 1",)
    ),
    "unknown setting": Advice(
        scene,
        f"{MESH} --set cany_low=50",
        "choose from .*canny_low",
        (f"{MESH} --set canny_low=50",),
    ),
    "nodes": Advice(
        scene,
        f"{MESH} --nodes many",
        "give a number such as 5000 or a percentage such as 1%",
        (f"{MESH} --nodes 5000", f"{MESH} --overwrite --nodes 1%"),
    ),
    "smooth": Advice(
        smooth,
        FEATURES,
        "the image is smooth; --set sobel=true gives more",
        (f"{FEATURES} --overwrite --set sobel=true",),
        more="mesh.gpkg",
    ),
    "smoother": Advice(
        partial(smooth, side=300),
        FEATURES,
        "the mesh is the outline only; if it is not, --set sobel=true gives more",
        (f"{FEATURES} --overwrite --set sobel=true",),
        more="mesh.gpkg",
    ),
    "smooth, with a budget": Advice(
        smooth,
        f"{FEATURES} --nodes 300",
        "of the 300 requested nodes: .*; --set sobel=true gives more",
        (f"{FEATURES} --nodes 300 --overwrite --set sobel=true",),
        more="mesh.gpkg",
    ),
    "more nodes than keypoints": Advice(
        lambda folder: shutil.copy(OLINDA, folder / "scene.tif"),
        f"{FEATURES} --nodes 20000",
        "; --set edge_distance=null or --set min_spacing=1 gives more",
        (
            f"{FEATURES} --overwrite --nodes 20000 --set edge_distance=null",
            f"{FEATURES} --overwrite --nodes 20000 --set min_spacing=1",
        ),
        more="mesh.gpkg",
    ),
    "refinement of a hull": Advice(
        scene,
        f"{MESH} --set domain=hull",
        "a refined mesh covers the pixels of the raster: use --preset features$",
        (f"{FEATURES} --set domain=hull",),
    ),
    "refinement of a resized image": Advice(
        scene,
        f"{MESH} --set resize=[32,32]",
        "a refined mesh covers the pixels of the raster: use --preset features$",
        (f"{FEATURES} --set resize=[32,32]",),
    ),
    "time limit": Advice(
        scene,
        f"{FEATURES} --time-limit 60",
        "--time-limit is 60.0, but the preset features is not refined: use --preset adaptive",
        (f"{MESH} --preset adaptive --time-limit 60",),
    ),
    "picture": Advice(
        scene,
        "stages scene.tif -o stages.gif",
        r"choose from \.png, \.pdf, \.svg, \.jpg",
        ("stages scene.tif -o stages.png",),
    ),
    "geotiff": Advice(
        mesh_of(),
        "render mesh.gpkg --like scene.tif -o painted.png",
        "use a name that ends in .tif or .tiff",
        ("render mesh.gpkg --like scene.tif -o painted.tif",),
    ),
    "creation option": Advice(
        mesh_of(),
        "render mesh.gpkg --like scene.tif -o painted.tif --co DTYPE=int16",
        "is not a creation option of GTiff: .* leave it out",
        ("render mesh.gpkg --like scene.tif -o painted.tif",),
    ),
    "images of a folder": Advice(
        partial(write_raster, name="sub/deep/scene.tif"),
        "evaluate sub",
        "the folder sub has no images .*name a folder with",
        ("evaluate sub/deep",),
    ),
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.mark.parametrize("advice", ADVICE.values(), ids=ADVICE)
def test_the_command_that_is_advised_works(folder: Path, advice: Advice, command: Geomesh) -> None:
    advice.make(folder)
    if "made.gpkg" in advice.given:
        assert command("mesh", "scene.tif", "-o", "made.gpkg").code == 0
    run = command(*advice.given.split())
    assert re.search(advice.told, run.err), run
    assert "defect of geomesh" not in run.err
    assert "`" not in run.err  # each parameter was spelled as an option
    before = len(read_mesh(advice.more).nodes) if advice.more else 0
    for arguments in advice.followed:
        done = command(*arguments.split())
        assert done.code == 0, done
        assert advice.told not in done.err
        if advice.more:
            assert len(read_mesh(advice.more).nodes) > before


@pytest.mark.slow
def test_a_warning_of_a_batch_names_its_raster_once(folder: Path, command: Geomesh) -> None:
    sources = [write_raster(folder, f"{name}.tif", crs=None) for name in ("a", "b")]
    smooth(folder)
    run = command("mesh", *sources, "scene.tif", "-o", "out/", "--preset", "features")
    warnings = [line for line in run.err.splitlines() if line.startswith("Warning: ")]
    assert len(warnings) == 3
    for source, line in zip([*sources, "scene.tif"], warnings, strict=True):
        assert line.startswith(f"Warning: {source}")
        assert line.count(source) == 1


def test_the_recipe_that_works_tile_by_tile_does() -> None:
    whole = Recipe.from_preset("paper").with_values(resize=None, sift_sigma=3.0)
    assert not whole.is_local
    advised = {"sift_max_octave": 2, "sift_source": "gray", "sift_sigma": 1.6}
    assert whole.with_values(**advised, sift_octave_layers=3).is_local
    from geomesh.pipeline import mesh_scene

    text = Path(mesh_scene.__file__).read_text()
    for name, value in {**advised, "sift_octave_layers": 3}.items():
        assert f"`{name}={value}`" in text


def test_memory_is_saved_by_options_that_the_command_has(
    folder: Path, command: Geomesh, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: Any, **__: Any) -> None:
        raise MemoryError

    mesh_of()(folder)
    monkeypatch.setattr("geomesh.io.read.read_mesh", full)
    assert command("quality", "mesh.gpkg").error() == "not enough memory"
    monkeypatch.setattr("geomesh.pipeline.mesh_file.open_scene", full)
    error = command("mesh", "scene.tif", "-o", "other.gpkg").error()
    assert error == "not enough memory: choose a smaller part with --bounds"


def test_extras_that_are_named_exist() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    named = {
        extra
        for path in (ROOT / "geomesh").rglob("*.py")
        for extra in re.findall(
            r'extra_required\([^)]*"([a-z]+)"\)|geomesh-toolkit\[([a-z]+)\]', path.read_text()
        )
        for extra in extra
        if extra
    }
    assert named
    assert named <= set(project["optional-dependencies"])


def test_buttons_that_the_plugin_advises_exist() -> None:
    plugin = ROOT / "qgis_plugin" / "geomesh_qgis"
    labels = "".join(path.read_text() for path in (plugin / "options").glob("*.py"))
    advised = {
        label
        for path in (plugin / "engine").glob("*.py")
        for label in re.findall(r"(?:press|with) (Reinstall|Install|Verify)", path.read_text())
    }
    assert advised == {"Reinstall", "Install", "Verify"}
    for label in advised:
        assert re.search(f'"{label}( geomesh)?"', labels), label


def test_a_raster_without_a_valid_pixel_is_described(folder: Path, command: Geomesh) -> None:
    """The command has no --nodata, which the error of the others advises."""
    nodata_everywhere(folder)
    run = command("info", "scene.tif")
    assert (run.code, run.err) == (0, "")
    assert "valid share: 0.0" in run.out


def test_the_recipe_of_info_is_accepted(folder: Path, command: Geomesh) -> None:
    mesh_of()(folder)
    Path("recipe.json").write_text(command("info", "mesh.gpkg", "--json").out)
    assert command("mesh", "scene.tif", "-o", "again.gpkg", "--recipe", "recipe.json").code == 0
    Path("bad.json").write_text(json.dumps({"recipe": {"nodes": "many"}}))
    error = command("mesh", "scene.tif", "-o", "a.gpkg", "--recipe", "bad.json").error()
    assert "bad.json" in error


# ------------------------------------------------------------------------ the library


def refused(source: Any, told: str) -> None:
    with pytest.raises(GeomeshError, match=told):
        open_scene(source)


def test_dimensions_that_are_renamed_as_advised() -> None:
    array = xr.DataArray(picture()[0], dims=("line", "sample"))
    refused(array, re.escape("rename them, as in .rename(sample='x', line='y')"))
    open_scene(array.rename(sample="x", line="y"))


def test_a_dimension_that_is_chosen_or_renamed_as_advised() -> None:
    array = xr.DataArray(picture(3), dims=("time", "y", "x"))
    refused(array, re.escape("choose one index with .isel(time=0), or .rename(time='band') if"))
    assert len(open_scene(array.isel(time=0)).bands) == 1
    assert len(open_scene(array.rename(time="band")).bands) == 3


def test_a_dataset_that_is_taken_apart_as_advised() -> None:
    dataset = xr.Dataset({"red": (("y", "x"), picture()[0]), "nir": (("y", "x"), picture()[0])})
    refused(dataset, re.escape("as in ds['red'], or stack the variables of one grid as bands with"))
    assert len(open_scene(dataset["red"]).bands) == 1
    assert len(open_scene(dataset.to_dataarray()).bands) == 2


def test_coordinates_that_are_made_even_as_advised() -> None:
    x = NORTH_UP.c + np.arange(64) ** 1.1
    y = NORTH_UP.f - 30 * np.arange(48)
    array = xr.DataArray(picture()[0].astype(float), dims=("y", "x"), coords={"y": y, "x": x})
    refused(array, r"resample it to a regular grid, as with \.interp\(x=numpy\.linspace\(")
    even = array.interp(x=np.linspace(x[0], x[-1], 64))
    assert open_scene(even).grid.bounds()[0] == pytest.approx(x[0] - (x[-1] - x[0]) / 63 / 2)


def test_an_invalid_crs_is_replaced_as_advised() -> None:
    refused((picture(), NORTH_UP, "EPSG:999999"), "give a code such as EPSG:32722")
    assert open_scene((picture(), NORTH_UP, "EPSG:32722")).grid.crs is not None


def test_bands_are_numbered_as_advised(tmp_path: Path) -> None:
    source = write_raster(tmp_path, data=picture(3))
    for bidx in (2, "1,2", [1.0]):
        with pytest.raises(GeomeshError, match=r"give a list of band numbers such as \[3, 2, 1\]"):
            open_scene(source, bidx=bidx)  # type: ignore[arg-type]
    assert len(open_scene(source, bidx=[3, 2, 1]).bands) == 3


@pytest.mark.parametrize(
    ("values", "told", "convert"),
    [
        (picture() * 1j, "take the magnitude or one part first", (np.abs, np.real, np.imag)),
        (picture() > 60, "convert them first", (lambda values: values.astype(np.uint8),)),
    ],
)
def test_values_that_are_converted_as_advised(
    values: np.ndarray, told: str, convert: Sequence[Callable[[np.ndarray], np.ndarray]]
) -> None:
    refused((values, NORTH_UP, UTM), told)
    for each in convert:
        open_scene((each(values), NORTH_UP, UTM))


def test_a_closed_dataset_is_opened_again_as_advised(tmp_path: Path) -> None:
    path = write_raster(tmp_path, data=holed(0))
    with rasterio.open(path) as dataset:
        pass
    with pytest.raises(SourceError, match="give an open dataset, or its path"):
        open_scene(dataset)
    open_scene(path)
    with rasterio.open(path) as dataset:
        open_scene(dataset)
