"""Web maps of odd meshes: grids and CRSs of all kinds, no colours, missing values, classes."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
import pytest
from affine import Affine
from pyproj import Transformer

import geomesh
from geomesh import Mesh
from geomesh.arrays.table import Table
from geomesh.mesh.certificate import DomainFacts
from support.browser import open_browser
from support.browser_process import NAMES
from support.meshes import GEOREFERENCES, ORIENTATIONS, frame_mesh, lattice_mesh, random_mesh
from support.rasters import picture, write_raster
from support.web_map import BACKGROUND, MapPage, assert_flat, brighter, flat_colors, gain

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    ShowMap = Callable[..., MapPage]

pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::geomesh.errors.GeomeshWarning"),
]
GRIDS = ORIENTATIONS | GEOREFERENCES


def colorful(mesh: Mesh) -> Mesh:
    """Return a mesh whose triangles have random colours."""
    values = np.random.default_rng(3).integers(0, 1 << 24, len(mesh.triangles))
    colors = np.array([f"#{value:06x}" for value in values])
    return replace(mesh, triangle_table=Table({**mesh.triangle_table, "color": colors}))


@pytest.mark.parametrize("grid", GRIDS)
def test_every_grid_is_shown_as_it_lies_on_the_map(show_map: ShowMap, grid: str) -> None:
    mesh = colorful(frame_mesh(GRIDS[grid]))
    page = show_map(mesh)
    assert_flat(page, brighter(flat_colors(mesh), gain(mesh)))
    x, y = page.on_screen(mesh.nodes).T
    assert 0.9 < max(np.ptp(x) / 800, np.ptp(y) / 600) < 1
    page.browser.move(300, 280)
    page.browser.wait_for("document.getElementById('at').innerText !== ''")
    own, *_ = page.text("at").removesuffix(" px").splitlines()
    found = [float(each.removesuffix(" px")) for each in own.split(", ")]
    # A tenth of a pixel is told.
    assert np.allclose(mesh.grid.to_pixel(np.array([found]))[0], page.to_raster(300, 280), atol=0.1)


@pytest.mark.parametrize(
    ("code", "transform"),
    [
        (32601, Affine(5000, 0, 150_000, 0, -5000, 1_100_000)),  # UTM 1: the meridian 180 inside
        (3832, Affine(20_000, 0, 3_200_000, 0, -20_000, 900_000)),
        (4326, Affine(0.1, 0, 179, 0, -0.1, 20)),
    ],
)
def test_the_antimeridian(show_map: ShowMap, code: int, transform: Affine) -> None:
    mesh = colorful(lattice_mesh(f"EPSG:{code}", transform))
    page = show_map(mesh)
    assert_flat(page, brighter(flat_colors(mesh), gain(mesh)))
    to_lonlat = Transformer.from_crs(code, 4326, always_xy=True)
    for px in (330, 470):
        page.browser.move(px, 300)
        page.browser.wait_for("document.getElementById('at').innerText !== ''")
        degrees = [float(each.strip(" °")) for each in page.text("at").splitlines()[-1].split(",")]
        own = mesh.grid.to_map(page.to_raster(px, 300)[None])[0]
        lon, lat = to_lonlat.transform(*own)
        assert abs((degrees[0] - lon + 180) % 360 - 180) < 0.02
        assert abs(degrees[1] - lat) < 0.02
        page.browser.evaluate("document.getElementById('at').textContent = ''")


def test_one_triangle(show_map: ShowMap) -> None:
    nodes = np.array([[0, 0], [0, 30], [40, 10]], np.float64)
    mesh = Mesh(
        nodes,
        np.array([[0, 1, 2]], np.int32),
        GRIDS["north-up"],
        DomainFacts("hull", 600.0, 1, 0, 600),
        triangle_table=Table({"color": np.array(["#ff8000"])}),
    )
    page = show_map(mesh)
    assert_flat(page, flat_colors(mesh))
    page.browser.click(400, 300)
    page.browser.wait_for("!document.getElementById('info').hidden")
    found = page.attributes()
    assert (found["id"], found["n0"], found["n1"], found["n2"]) == ("0", "0", "1", "2")
    page.browser.evaluate("document.querySelector('#info button').click()")
    page.choose("column", "ki")
    assert len(np.unique(page.picture().reshape(-1, 3), axis=0)) == 2


def test_a_mesh_without_colours_is_gray(show_map: ShowMap) -> None:
    mesh = lattice_mesh("EPSG:32725", Affine(30, 0, 288_000, 0, -30, 9_120_000))
    page = show_map(mesh)
    assert page.browser.evaluate("column.selectedOptions[0].text") == "none"
    assert_flat(page, np.full((len(mesh.triangles), 3), 128))
    assert not page.is_shown("bright")
    page.browser.click(400, 300)
    page.browser.wait_for("!document.getElementById('info').hidden")
    assert "color" not in page.attributes()


def test_missing_values_are_gray_and_told_as_missing(show_map: ShowMap) -> None:
    mesh = random_mesh()
    page = show_map(mesh)
    page.choose("column", "b1_mean")
    values = mesh.attributes("triangles")["b1_mean"]
    missing = np.isnan(values)
    assert missing.any()
    low, high = np.percentile(values[~missing], (2, 98))
    share = np.where(missing, 0, (values - low) / (high - low))
    expected = mpl.colormaps["viridis"](np.clip(share * 256, 0, 255).astype(int))[:, :3] * 255
    expected[missing] = 153
    assert_flat(page, expected, tolerance=6)
    large = np.argmax(np.where(missing, mesh.attributes("triangles")["area"], 0))
    x, y = mesh.nodes[mesh.triangles[large]].mean(axis=0)
    page.set_view(float(x), float(y), 2 / abs(mesh.grid.transform.a))
    page.browser.click(400, 300)
    page.browser.wait_for("!document.getElementById('info').hidden")
    assert page.attributes()["id"] == str(large)
    assert page.attributes()["b1_mean"] == "–"


@pytest.mark.parametrize("column", ["name", "inside"])
def test_texts_and_truth_have_the_colours_of_their_legend(show_map: ShowMap, column: str) -> None:
    mesh = random_mesh()
    page = show_map(mesh, column=column)
    values = mesh.attributes("triangles")[column]
    texts = values if values.dtype.kind != "b" else np.where(values, "true", "false")
    assert_legend(page, texts)


def assert_legend(page: MapPage, texts: np.ndarray) -> None:
    """Each triangle has the colour that the legend has for its text; without a text, gray."""
    legend = page.browser.evaluate("""[...document.querySelectorAll("#classes li")].map((row) =>
        [row.innerText, getComputedStyle(row.querySelector("span")).backgroundColor])""")
    assert [text for text, _ in legend] == sorted(set(texts) - {""}, key=_as_listed)
    levels = {
        text: [int(each) for each in color.removeprefix("rgb(").removesuffix(")").split(",")]
        for text, color in legend
    }
    assert len({tuple(color) for color in levels.values()}) == len(levels)
    assert_flat(page, np.array([levels.get(text, (153, 153, 153)) for text in texts]))


def _as_listed(text: str) -> tuple[float, str]:
    return (float(text), "") if text.isdecimal() else (0.0, text)


def test_classes_of_a_raster(show_map: ShowMap, tmp_path: Path) -> None:
    data = (picture(rows=120, cols=160) // 24).astype(np.uint8)
    colors = {k: (30 * k, 200 - 20 * k, (77 * k) % 256, 255) for k in range(11)}
    path = write_raster(
        tmp_path, data=data, photometric="palette", change=lambda d: d.write_colormap(1, colors)
    )
    mesh = geomesh.mesh_raster(path, nodes=400)
    (column,) = (name for name in mesh.attributes("triangles") if name.endswith("_majority"))
    page = show_map(mesh, column=column)
    values = mesh.attributes("triangles")[column]
    known = values >= 0
    assert len(np.unique(values[known])) > 4
    assert_legend(page, np.where(known, values.astype(int).astype(str), ""))


def test_colours_of_another_program_are_left_out(show_map: ShowMap) -> None:
    mesh = frame_mesh(GRIDS["north-up"])
    table = {**mesh.triangle_table, "color": np.full(len(mesh.triangles), "red")}
    page = show_map(replace(mesh, triangle_table=Table(table)))
    assert_flat(page, np.full((len(mesh.triangles), 3), 128))


def test_only_the_columns_that_are_asked_for(show_map: ShowMap) -> None:
    mesh = colorful(frame_mesh(GRIDS["north-up"]))
    page = show_map(mesh, columns=["b1_std"])
    names = page.browser.evaluate("[...column.options].map((option) => option.value)")
    assert set(names) == {"", "b1_std", "area", "ab", "bc", "ca", "ki", "min_angle", "shape"}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.xdist_group(name)) for name in NAMES]
)
def test_without_webgl_the_page_says_so(name: str, tmp_path: Path) -> None:
    path = frame_mesh(GRIDS["north-up"]).to_html(tmp_path / "map.html")
    with open_browser(name, webgl=False) as browser:
        browser.open(path)
        browser.wait_for("document.getElementById('failure').checkVisibility()")
        text = browser.evaluate("document.getElementById('failure').innerText")
        assert "WebGL 2" in text
        assert browser.errors == browser.outside == []


def test_an_empty_place_of_the_map_shows_the_page(show_map: ShowMap) -> None:
    """Far from the mesh."""
    page = show_map(colorful(frame_mesh(GRIDS["north-up"])))
    page.set_view(1e5, 1e5, 1.0)
    assert np.unique(page.picture().reshape(-1, 3), axis=0).tolist() == [list(BACKGROUND)]
    page.browser.click(400, 300)
    assert not page.is_shown("info")
