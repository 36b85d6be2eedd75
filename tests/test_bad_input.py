"""Bad input is normal: each file gives a valid mesh or a helpful error of one line.

Every case is a real file. It is tested with the library and with the command line, and has one of
two results:

- a mesh that passes its certificate, with exactly the expected warnings;
- a GeomeshError with a text of one line, which names the source or option, says what is wrong and
  how to correct it. On the command line, the exit code is 1 and no file is changed.
"""

from __future__ import annotations

import json
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import Any

import geopandas as gpd
import numpy as np
import pytest
import rasterio
import shapely
import shapely.affinity
from affine import Affine
from pyproj import Geod
from rasterio.io import MemoryFile
from rasterio.vrt import WarpedVRT

import geomesh
from geomesh.errors import GeomeshError, GeomeshWarning
from geomesh.io.read import read_mesh
from geomesh.recipe import DEFAULT_PRESET
from support.cases import FEWER, FLAT, NO_MORE, SOURCES, Case, text_file
from support.commands import Geomesh, assert_refused, snapshot
from support.rasters import COLS, MARS, NORTH_UP, ROWS, SIZE, UTM, picture, raster, write_raster

# ------------------------------------------------------------------------- cases


def vector(
    *shapes: Any, name: str = "aoi.gpkg", crs: Any = UTM
) -> Callable[[Path], dict[str, Any]]:
    """Return a function that writes a mask and returns the option for it."""

    def make(folder: Path) -> dict[str, Any]:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # the CRS is missing on purpose
            gpd.GeoDataFrame(geometry=list(shapes), crs=crs).to_file(folder / name)
        return {"mask": str(folder / name)}

    return make


def file_option(name: str, content: str) -> Callable[[Path], dict[str, Any]]:
    """Return a function that writes a text file and returns the option to use it as a mask."""
    return lambda folder: {"mask": text_file(name, content)(folder)}


WEST, NORTH = NORTH_UP.c, NORTH_UP.f
LEFT_HALF = shapely.box(WEST, NORTH - 30 * ROWS, WEST + 30 * COLS / 2, NORTH)
LONLAT_HALF = gpd.GeoSeries([LEFT_HALF], crs=UTM).to_crs("EPSG:4326").iloc[0]
BOW_TIE = shapely.Polygon(
    [
        (WEST, NORTH),
        (WEST + 30 * COLS, NORTH - 30 * ROWS),
        (WEST + 30 * COLS, NORTH),
        (WEST, NORTH - 30 * ROWS),
    ]
)


def bounds(west: float, south: float, east: float, north: float, **rest: Any) -> Case:
    return Case(raster(), {"bounds": (west, south, east, north)}, **rest)


def has_preset(case: Case) -> bool:
    return not callable(case.options) and "preset" in case.options


def setting(name: str, value: Any, **rest: Any) -> Case:
    """Return a case with a recipe value. Unless `rest` says otherwise, the error names it."""
    return Case(raster(), {name: value}, **({"refused": name, "names": name} | rest))


# What presets say if they cannot have so many nodes.
MANY = {"adaptive": f"of the .* requested {NO_MORE}", "features": FEWER}

OPTIONS: dict[str, Case] = {
    "--bounds of a part": bounds(WEST, NORTH - 300, WEST + 600, NORTH, valid=200),
    "--bounds around one centre": bounds(
        WEST + 41, NORTH - 49, WEST + 49, NORTH - 41, valid=1, of_preset=FLAT
    ),
    "--bounds between pixel centres": bounds(
        WEST + 31, NORTH - 39, WEST + 39, NORTH - 31, refused="--bounds contains no centre"
    ),
    "--bounds wider than all": bounds(-1e300, -1e300, 1e300, 1e300, valid=SIZE),
    "--bounds beside": bounds(0, 0, 1, 1, refused="--bounds lies outside .* whose bounds are"),
    "--bounds inverted": bounds(
        WEST + 600, NORTH, WEST, NORTH - 300, names="bounds", refused="expected west < east"
    ),
    "--bounds nan": bounds(np.nan, 0, 1, 1, names="bounds", refused="expected west < east"),
    "--bounds infinite": bounds(-np.inf, -np.inf, np.inf, np.inf, names="bounds", refused="bounds"),
    "--mask missing": Case(
        raster(),
        lambda folder: {"mask": str(folder / "aoi.gpkg")},
        names="aoi.gpkg",
        refused="cannot be read as a vector file",
    ),
    "--mask of text": Case(
        raster(),
        file_option("aoi.gpkg", "no polygons\n"),
        names="aoi.gpkg",
        refused="cannot be read as a vector file",
    ),
    "--mask is the raster": Case(
        raster(),
        lambda folder: {"mask": str(folder / "scene.tif")},
        refused="cannot be read as a vector file",
    ),
    "--mask of a table": Case(
        raster(), file_option("aoi.csv", "a,b\n1,2\n"), names="aoi.csv", refused="polygon"
    ),
    "--mask of points": Case(
        raster(), vector(shapely.Point(WEST, NORTH)), names="aoi.gpkg", refused="give polygons"
    ),
    "--mask without rows": Case(
        raster(),
        file_option("aoi.geojson", '{"type": "FeatureCollection", "features": []}'),
        names="aoi.geojson",
        refused="give polygons",
    ),
    "--mask of empty polygons": Case(
        raster(), vector(shapely.Polygon()), names="aoi.gpkg", refused="give polygons"
    ),
    "--mask of a null and a polygon": Case(raster(), vector(None, LEFT_HALF), valid=SIZE // 2),
    "--mask in longitude and latitude": Case(
        raster(), vector(LONLAT_HALF, crs="EPSG:4326"), valid=SIZE // 2
    ),
    "--mask without crs": Case(
        raster(), vector(LEFT_HALF, crs=None), valid=SIZE // 2, warns=("has no CRS",)
    ),
    "--mask beside": Case(
        raster(), vector(shapely.box(0, 0, 1, 1)), refused="--mask lies outside .* whose bounds are"
    ),
    "--mask between pixel centres": Case(
        raster(),
        vector(shapely.box(WEST + 1, NORTH - 5, WEST + 5, NORTH - 1)),
        refused="--mask contains no centre",
    ),
    "--mask crossing itself": Case(raster(), vector(BOW_TIE), warns=("1 polygon repaired",)),
    "--mask twice crossing itself": Case(
        raster(),
        vector(BOW_TIE, shapely.affinity.translate(BOW_TIE, 45, 60)),
        warns=("2 polygons repaired",),
    ),
    "--mask of the world": Case(
        raster(crs="EPSG:3857"),
        vector(shapely.box(-180, -90, 180, 90), crs="EPSG:4326"),
        valid=SIZE,
    ),
    "--mask on another planet": Case(
        raster(), vector(shapely.box(0, 0, 1, 1), crs=MARS), names="aoi.gpkg", refused="CRS"
    ),
    "--mask with crs for a raster without": Case(
        raster(crs=None), vector(LEFT_HALF), refused="georeference the raster, or give a mask"
    ),
    **{
        f"--nodes {value!r}": setting("nodes", value, refused="give a number such as 5000")
        for value in (0, -5, "abc", "0%", "-1%", "nan%", "inf%", "%", "", 2.5, True, "1e9")
    },
    "--nodes 1": setting(
        "nodes", 1, refused=None, warns=("the outline alone needs .* more than the 1 requested",)
    ),
    "--nodes 200%": setting("nodes", "200%", refused=None, of_preset=MANY, valid=SIZE),
    "--nodes 10**18": setting("nodes", 10**18, refused=None, of_preset=MANY, valid=SIZE),
    "--set of an unknown name": setting("cany_low", 50, refused="choose from .*canny_low"),
    **{
        f"--set {name}={json.dumps(value)}": setting(name, value)
        for name, value in (
            ("canny_low", "abc"),
            ("canny_low", -1),
            ("canny_low", [50]),
            ("canny_high", True),
            ("canny_l2", "no"),
            ("sobel", "no"),
            ("resize", 5),
            ("resize", [256]),
            ("resize", [256, 0]),
            ("resize", [2.5, 3]),
            ("resize", "256x256"),
            ("stretch", [98, 2]),
            ("stretch", [2]),
            ("stretch", 5),
            ("stretch", ["2", "98"]),
            ("min_hole", -1),
            ("min_hole", "few"),
            ("min_spacing", None),
            ("nodes", True),
            ("nodes", [5]),
            ("nodes", {"max": 5}),
            ("gray", 5),
            ("gray", None),
            ("gray", "band:0"),
            ("gray", "sepia"),
            ("domain", "sea"),
            ("domain", ["valid"]),
            ("statistics", 5),
            ("statistics", ["mode"]),
            ("sift_octave_layers", 2.5),
            ("sift_octave_layers", "3"),
            ("sift_max_octave", "two"),
            ("sift_sigma", 0),
            ("sift_source", None),
            ("edge_distance", "near"),
            ("border_spacing", float("inf")),
        )
    },
}

CASES = SOURCES | OPTIONS

# Cases that end with a mesh are tested with each preset that users are likely to use; what is
# refused does not depend on it.
WITH_PRESETS = [
    pytest.param(case, preset, id=name if preset == DEFAULT_PRESET else f"{name}, {preset}")
    for name, case in CASES.items()
    for preset in ("adaptive", "features")
    if preset == DEFAULT_PRESET or (case.refused is None and not has_preset(case))
]


# Sources for the library only: callables that get a folder and an ExitStack.
Open = Callable[[Path, ExitStack], Any]


def opened(folder: Path, stack: ExitStack, mode: str = "r", **options: Any) -> Any:
    return stack.enter_context(rasterio.open(write_raster(folder, **options), mode))


def in_memory(folder: Path, stack: ExitStack) -> Any:
    memory = stack.enter_context(MemoryFile(Path(write_raster(folder)).read_bytes()))
    return stack.enter_context(memory.open())


def warped(folder: Path, stack: ExitStack) -> Any:
    dataset = opened(folder, stack)
    return stack.enter_context(WarpedVRT(dataset, crs="EPSG:4326", add_alpha=True))


def closed(folder: Path, stack: ExitStack) -> Any:
    dataset = opened(folder, stack)
    dataset.close()
    return dataset


def array(data: Any, transform: Any = NORTH_UP, crs: Any = UTM) -> Open:
    return lambda _folder, _stack: (data, transform, crs)


HIDDEN = np.zeros((2, ROWS, COLS), np.bool_)
HIDDEN[1, 10:22, 20:30] = True

OBJECTS: dict[str, tuple[Open, tuple[str, ...], int | None]] = {
    "path": (lambda folder, _stack: Path(write_raster(folder)), (), SIZE),
    "dataset": (opened, (), SIZE),
    "dataset open for changes": (partial(opened, mode="r+"), (), SIZE),
    "file in memory": (in_memory, (), SIZE),
    "warped dataset": (warped, (), None),
    "array": (array(picture(3)), (), SIZE),
    "array of one band": (array(picture()[0]), (), SIZE),
    "array without a place": (
        array(picture(), None, None),
        ("the array has no georeference",),
        SIZE,
    ),
    "array with an epsg number": (array(picture(), crs=32725), (), SIZE),
    "array, masked in one band": (array(np.ma.array(picture(2), mask=HIDDEN)), (), SIZE - 120),
    "array, masked nowhere": (array(np.ma.array(picture(2))), (), SIZE),
    "array of lists": (array(picture()[0].tolist()), (), SIZE),
    "array of halves": (array(picture().astype(np.float16)), (), SIZE),
    "array of long doubles": (array(picture().astype(np.longdouble)), (), SIZE),
    "array of big-endian floats": (array(picture().astype(">f4")), (), SIZE),
    "array in columns": (array(np.asfortranarray(picture(3))), (), SIZE),
    "array that is a view": (array(picture(3, ROWS, 2 * COLS)[::-1, :, ::2]), (), SIZE),
}

NO_OBJECTS: dict[str, tuple[Open, str]] = {
    "closed dataset": (closed, "closed"),
    "array of size 0": (array(np.zeros((3, 0, 5))), r"\(3, 0, 5\) is not a raster"),
    "array without bands": (array(np.zeros((0, 4, 5))), r"\(0, 4, 5\) is not a raster"),
    "array of 4 dimensions": (array(np.zeros((1, 2, 3, 4))), r"\(1, 2, 3, 4\) is not a raster"),
    "array of 1 dimension": (array(np.zeros(4)), r"\(4,\) is not a raster"),
    "array of truths": (array(picture() > 60), "bool"),
    "array of texts": (array(np.full((1, 4, 4), "water")), "<U5"),
    "array of objects": (array(np.full((1, 4, 4), None)), "object"),
    "array of complex numbers": (array(picture() * 1j), "complex128"),
    "array, all masked": (array(np.ma.masked_all((1, 4, 4))), "no valid pixel"),
    "array in an unknown crs": (array(picture(), crs="EPSG:999999"), "EPSG:999999"),
    "array with gdal's transform": (array(picture(), NORTH_UP.to_gdal()), "transform"),
    "array with half a transform": (array(picture(), (30, 0, 0)), "transform"),
    "array with a flat transform": (array(picture(), Affine.scale(1, 0)), "maps every pixel onto"),
    "array with a nan in its transform": (array(picture(), Affine.scale(np.nan)), "not finite"),
    "array alone": (lambda _folder, _stack: picture(), r"\(array, transform, crs\)"),
    "array alone in a tuple": (lambda _folder, _stack: (picture(),), r"\(array, transform, crs\)"),
    "nothing": (lambda _folder, _stack: None, r"\(array, transform, crs\)"),
    "list of paths": (lambda folder, _stack: [write_raster(folder)], r"\(array, transform, crs\)"),
}

# Sources from above, written as GeoJSON: None if this must work, or else the expected error.
AS_GEOJSON: dict[str, str | None] = {
    "geographic": None,
    "rotated": None,
    "south up": None,
    "east left": None,
    "rows to the east": None,
    "gcps": None,
    "antimeridian": None,
    "antimeridian, projected": None,
    "no crs": "the mesh has no CRS: georeference the raster, or write .gpkg",
    "no georeference": "the mesh has no CRS: georeference the raster, or write .gpkg",
    "rpc": "the mesh has no CRS: georeference the raster, or write .gpkg",
    "local crs": "no transformation from 'site grid' to them: write .gpkg",
    "Mars": "no transformation from .*Mars.* to them: write .gpkg",
    "geostationary": "nodes have none: leave them out with --bounds or --mask, or write .gpkg",
    "half a pixel beyond the poles": None,
}

# Wrong usage: exit code 2, before any file is read. SRC is a raster.
USAGE: dict[str, Sequence[str]] = {
    "bands that are no numbers": ("SRC", "--bidx=red"),
    "bands with a gap": ("SRC", "--bidx=1,,2"),
    "three bounds": ("SRC", "--bounds", "1", "2", "3"),
    "bounds that are no numbers": ("SRC", "--bounds", "w", "s", "e", "n"),
    "nodata that is no number": ("SRC", "--nodata=none"),
    "unknown preset": ("SRC", "--preset=best"),
    "unknown layer": ("SRC", "--layers=faces"),
    "unknown statistic": ("SRC", "--stats=mode"),
    "setting without a value": ("SRC", "--set=canny_low"),
    "unknown option": ("SRC", "--best"),
    "recipe that is a folder": ("SRC", "--recipe=."),
    "no source": (),
}

RECIPES: dict[str, tuple[bytes | None, str]] = {
    "missing": (None, "no such file"),
    "empty": (b"", "not a recipe in JSON"),
    "no json": (b"canny_low = 5", "not a recipe in JSON"),
    "list": (b"[1, 2]", "not a recipe in JSON"),
    "number": (b"5", "not a recipe in JSON"),
    "recipe that is a list": (b'{"recipe": [1]}', "is not a recipe"),
    "utf-16": ('{"canny_low": 5}'.encode("utf-16"), "not a recipe in JSON"),
    "unknown name": (b'{"cany_low": 5}', "cany_low.* choose from"),
    "wrong type": (b'{"canny_low": "abc"}', "canny_low"),
    "wrong value": (b'{"recipe": {"canny_low": -5}}', "canny_low.* 0 or more"),
}


# --------------------------------------------------------------------- checks


def mesh_of(source: Any, options: Mapping[str, Any]) -> tuple[geomesh.Mesh, list[str]]:
    """Return the mesh and its warnings. All warnings must come from geomesh."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warnings.simplefilter("ignore", DeprecationWarning)
        mesh = geomesh.mesh_raster(source, **options)
    foreign = [str(item.message) for item in caught if item.category is not GeomeshWarning]
    assert foreign == []
    return mesh, [str(item.message) for item in caught]


def assert_warned(told: Sequence[str], patterns: Sequence[str]) -> None:
    """Check that each message matches a pattern and each pattern a message ("|^$": optional)."""
    unexpected = [text for text in told if not any(re.search(p, text) for p in patterns)]
    missed = [p for p in patterns if not any(re.search(p, text) for text in (*told, ""))]
    assert (unexpected, missed) == ([], [])
    assert all(len(text.splitlines()) == 1 for text in told)


def assert_sound(mesh: geomesh.Mesh, valid: int | None = None) -> None:
    """Check the certificate, and check its statements again on the map and with the pixels."""
    certificate = mesh.certify()
    assert [check for check in certificate.checks if not check.passed] == []
    assert len(mesh.triangles) >= 1
    corners = mesh.map_nodes[mesh.triangles]
    ab, ac = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    assert (ab[:, 0] * ac[:, 1] > ab[:, 1] * ac[:, 0]).all()
    if valid is not None:
        assert mesh.domain.valid_pixels == valid
    if mesh.domain.kind != "hull" and not mesh.domain.islands_dropped:
        assert mesh.triangle_table["count"].sum() == mesh.domain.valid_pixels
    areas = mesh.attributes("triangles")["area"]
    assert np.isfinite(areas).all()
    assert areas.min() >= 0 < areas.sum()  # two corners may be at the same pole


def assert_helpful(text: str, case: Case, source: Any, *, of_command: bool = True) -> None:
    """Check that the error is one line and fits the case. The library writes `x` for --x."""
    assert case.refused is not None
    refused = case.refused if of_command else re.sub(r"--(\w+)", r"`\1`", case.refused)
    assert len(text.splitlines()) == 1
    assert re.search(refused, text), text
    assert (case.names or Path(source).name) in text, text


def arguments(options: Mapping[str, Any]) -> list[str]:
    """Convert options of mesh_raster to arguments of the command line."""
    found = []
    for name, value in options.items():
        if name == "bidx":
            found.append(f"--bidx={','.join(map(str, value))}")
        elif name == "bounds":
            found += ["--bounds", *(f"{number!r}" for number in map(float, value))]
        elif name in ("mask", "nodata", "preset") or (
            name in ("nodes", "gray") and isinstance(value, str)
        ):
            found.append(f"--{name}={value}")
        else:
            found.append(f"--set={name}={json.dumps(value)}")
    return found


# --------------------------------------------------------------------------- tests


@pytest.mark.parametrize(("case", "preset"), WITH_PRESETS)
def test_library_gives_a_sound_mesh_or_one_helpful_line(
    tmp_path: Path, case: Case, preset: str
) -> None:
    source, options = case.prepare(tmp_path / "in")
    if case.refused is None:
        mesh, told = mesh_of(source, {"preset": preset, **options})
        assert_sound(mesh, case.valid)
        assert_warned(told, case.warned(preset))
    else:
        with pytest.raises(GeomeshError) as refusal:
            mesh_of(source, options)
        assert_helpful(str(refusal.value), case, source, of_command=False)


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES.values(), ids=CASES)
def test_command_line_writes_a_mesh_or_changes_nothing(
    tmp_path: Path, case: Case, command: Geomesh
) -> None:
    source, options = case.prepare(tmp_path / "in")
    output = tmp_path / "mesh.gpkg"
    given = [*arguments(options), "--", source]
    if case.refused is None:
        before = snapshot(tmp_path)
        run = command("mesh", "-o", output, *given)
        assert run.code == 0, run.err
        assert_warned(run.warnings(), case.warned(DEFAULT_PRESET))
        assert snapshot(tmp_path).keys() - before.keys() == {"mesh.gpkg"}
        assert_sound(read_mesh(output), case.valid)
    else:
        error = assert_refused(command, *given, folder=tmp_path, output=output)
        assert_helpful(error, case, source)


@pytest.mark.parametrize(
    "case",
    [pytest.param(c, id=name) for name, c in SOURCES.items() if c.refused and not c.options],
)
def test_info_says_what_cannot_be_meshed(tmp_path: Path, case: Case, command: Geomesh) -> None:
    source, _ = case.prepare(tmp_path / "in")
    before = snapshot(tmp_path)
    run = command("info", source)
    if "valid share: 0.0" in run.out:  # what hides its pixels is shown
        (note,) = (line for line in run.out.splitlines() if line.startswith("notes: "))
        assert_helpful(note, case, source)
    else:
        # `geomesh info` does not have the options that would help, so the text is the library's.
        assert_helpful(run.error(), case, source, of_command=False)
    assert snapshot(tmp_path) == before


@pytest.mark.parametrize(("make", "warns", "valid"), OBJECTS.values(), ids=OBJECTS)
def test_objects_become_sound_meshes(
    tmp_path: Path, make: Open, warns: tuple[str, ...], valid: int | None
) -> None:
    with ExitStack() as stack:
        mesh, told = mesh_of(make(tmp_path, stack), {})
    assert_sound(mesh, valid)
    assert_warned(told, warns)


@pytest.mark.parametrize(("make", "refused"), NO_OBJECTS.values(), ids=NO_OBJECTS)
def test_objects_that_are_no_raster_are_refused(tmp_path: Path, make: Open, refused: str) -> None:
    with ExitStack() as stack, pytest.raises(GeomeshError, match=refused) as refusal:
        mesh_of(make(tmp_path, stack), {})
    assert len(str(refusal.value).splitlines()) == 1


@pytest.mark.slow
@pytest.mark.parametrize(("name", "refused"), AS_GEOJSON.items(), ids=AS_GEOJSON)
def test_geojson_lies_on_earth_or_is_refused(
    tmp_path: Path, name: str, refused: str | None, command: Geomesh
) -> None:
    source, _ = SOURCES[name].prepare(tmp_path / "in")
    output = tmp_path / "mesh.geojson"
    if refused is not None:
        error = assert_refused(command, source, folder=tmp_path, output=output)
        assert re.search(refused, error), error
        return
    run = command("mesh", "-o", output, source)
    assert run.code == 0, run.err
    found = gpd.read_file(output)
    west, south, east, north = found.total_bounds
    assert -180 <= west < east <= 180
    assert -90 <= south < north <= 90
    geod = Geod(ellps="WGS84")
    ground = sum(geod.geometry_area_perimeter(shape)[0] for shape in found.geometry)
    assert ground == pytest.approx(found["area"].sum(), rel=0.01)


def test_areas_on_mars_are_those_of_mars(tmp_path: Path) -> None:
    source, _ = SOURCES["Mars"].prepare(tmp_path / "in")
    mesh, _ = mesh_of(source, {})
    west, south, east, north = np.radians(mesh.grid.bounds())
    expected = 3_396_190**2 * (east - west) * (np.sin(north) - np.sin(south))
    assert mesh.attributes("triangles")["area"].sum() == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("given", USAGE.values(), ids=USAGE)
def test_wrong_usage_exits_with_2(tmp_path: Path, given: Sequence[str], command: Geomesh) -> None:
    source = write_raster(tmp_path)
    before = snapshot(tmp_path)
    run = command(
        "mesh", "-o", tmp_path / "mesh.gpkg", *(source if word == "SRC" else word for word in given)
    )
    assert run.code == 2
    assert run.out == ""
    assert [line for line in run.err.splitlines() if line.startswith("Error: ")] == [
        run.err.splitlines()[-1]
    ]
    assert snapshot(tmp_path) == before


@pytest.mark.parametrize(("content", "refused"), RECIPES.values(), ids=RECIPES)
def test_recipe_that_is_none_is_refused(
    tmp_path: Path, content: bytes | None, refused: str, command: Geomesh
) -> None:
    source, recipe = write_raster(tmp_path), tmp_path / "recipe.json"
    if content is not None:
        recipe.write_bytes(content)
    error = assert_refused(
        command, source, f"--recipe={recipe}", folder=tmp_path, output=tmp_path / "mesh.gpkg"
    )
    assert re.search(refused, error), error
    assert "recipe.json" in error


@pytest.mark.slow
@pytest.mark.parametrize("bad", ["missing.tif", "scene [2].tif", "x[/y].tif"])
def test_batch_goes_on_after_a_bad_source(
    tmp_path: Path, bad: str, command: Geomesh, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("one.tif", "two [1].tif"):
        write_raster(tmp_path, name)
    run = command("mesh", "-o", "meshes", "one.tif", bad, "two [1].tif")
    assert run.code == 1
    found = sorted(path.name for path in Path("meshes").iterdir())
    assert found == ["one.gpkg", "two [1].gpkg"]
    assert "Traceback" not in run.err
    errors = [line for line in run.err.splitlines() if line.startswith("Error: ")]
    assert errors == [f"Error: {bad}: no such file; check the path"]
    _, _, table = run.err.partition("2 meshed, 1 failed")
    for name in ("one.tif", bad, "two [1].tif"):
        assert name in table


@pytest.mark.parametrize("names", [("a/scene.tif", "b/scene.tif"), ("scene.tif", "scene.png")])
def test_sources_of_one_name_are_refused(
    tmp_path: Path, names: tuple[str, str], command: Geomesh
) -> None:
    sources = [
        write_raster(tmp_path, name, driver="PNG" if name.endswith("png") else "GTiff")
        for name in names
    ]
    before = snapshot(tmp_path)
    error = command("mesh", "-o", f"{tmp_path}/meshes/", *sources).error()
    assert re.search("the name 'scene', .* write them to different folders", error)
    assert snapshot(tmp_path) == before
