"""Web maps under a hand: clicks, the pointer, keys, fingers, and links to a view."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from pyproj import Transformer

import geomesh
from support.web_map import MapPage, assert_flat, brighter, flat_colors, gain, olinda_mesh

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from support.browser import Browser
    from support.commands import Geomesh

    ShowMap = Callable[..., MapPage]

pytestmark = pytest.mark.slow
MIDDLE = (400, 300)


def places_of(page: MapPage, rows: list[int]) -> np.ndarray:
    """Return the middles of triangles in the window."""
    nodes = page.mesh.nodes[page.mesh.triangles[rows]]
    return page.on_screen(nodes.mean(axis=1))


def show_near(page: MapPage, row: int) -> tuple[float, float]:
    """Show a triangle large, away from the boxes; return where its middle is."""
    x, y = page.mesh.nodes[page.mesh.triangles[row]].mean(axis=0)
    page.set_view(float(x), float(y), 20 / abs(page.grid.transform.a))
    return MIDDLE


def test_a_click_tells_every_attribute_of_the_triangle(
    browser: Browser, command: Geomesh, tmp_path: Path
) -> None:
    """From the command, compared with what is in the file."""
    olinda_mesh().to_file(tmp_path / "olinda.gpkg")
    made = command("view", tmp_path / "olinda.gpkg", "-o", tmp_path / "olinda.html")
    assert made.code == 0, made
    assert f"{tmp_path / 'olinda.html'}: a map of 2,334 triangles" in made.out
    mesh = geomesh.read_mesh(tmp_path / "olinda.gpkg")
    page = MapPage(browser, tmp_path / "olinda.html", mesh)
    table = mesh.attributes("triangles")
    for row in np.random.default_rng(1).choice(len(mesh.triangles), 12, replace=False).tolist():
        browser.click(*show_near(page, row))
        browser.wait_for(f"document.querySelector('#info td')?.textContent === '{row}'")
        found = page.attributes()
        assert set(found) == set(table)
        for name, text in found.items():
            assert_value(text, table[name], row)
    assert browser.errors == browser.outside == []


def assert_value(text: str, column: np.ndarray, row: int) -> None:
    """A text shows the value of a column: six digits of it, stored in 65,535 steps."""
    value = column[row]
    if isinstance(value, str):
        assert text == value
    elif column.dtype.kind in "iu":
        assert text == str(value)
    elif np.isnan(value):
        assert text == "–"
    else:
        number = float(text.removesuffix("m²").removesuffix("px").removesuffix("°"))
        step = float(np.nanmax(column) - np.nanmin(column)) / 65_534
        assert abs(number - value) <= step / 2 + 6e-6 * abs(value), text


def test_a_click_beside_the_mesh_and_escape_close_the_attributes(show_map: ShowMap) -> None:
    page = show_map(olinda_mesh())
    page.browser.click(*MIDDLE)
    page.browser.wait_for("!document.getElementById('info').hidden")
    page.browser.click(90, 400)
    page.browser.wait_for("document.getElementById('info').hidden")
    page.browser.click(*MIDDLE)
    page.browser.wait_for("!document.getElementById('info').hidden")
    page.browser.key("Escape")
    page.browser.wait_for("document.getElementById('info').hidden")
    page.browser.click(*MIDDLE)
    page.browser.wait_for("!document.getElementById('info').hidden")
    page.browser.evaluate("document.querySelector('#info button').click()")
    page.browser.wait_for("document.getElementById('info').hidden")


def test_the_chosen_triangle_is_marked(show_map: ShowMap) -> None:
    page = show_map(olinda_mesh())
    page.choose("smooth", False)
    before = page.picture().astype(int)
    page.browser.click(*MIDDLE)
    page.browser.wait_for("!document.getElementById('info').hidden")
    after = page.picture().astype(int)
    (row,) = page.triangles_on_screen().triangle[[300], [400]]
    corners = page.on_screen(page.mesh.nodes[page.mesh.triangles[row]])
    rows, cols = np.nonzero((before != after).any(axis=2))
    # The sides are marked, and nothing farther than their width of 4.5 pixels.
    low, high = corners.min(axis=0) - 5, corners.max(axis=0) + 5
    assert (cols >= low[0]).all()
    assert (cols <= high[0]).all()
    assert (rows >= low[1]).all()
    assert (rows <= high[1]).all()
    for k in range(3):
        x, y = np.floor((corners[k] + corners[(k + 1) % 3]) / 2).astype(int)
        red, green, blue = after[y, x]
        assert red > green + 80
        assert red > blue + 40


def test_the_pointer_tells_coordinates_and_value(show_map: ShowMap) -> None:
    mesh = olinda_mesh()
    page = show_map(mesh)
    page.choose("column", "green_mean")
    to_lonlat = Transformer.from_crs(mesh.grid.crs, 4326, always_xy=True)
    shown = page.triangles_on_screen()
    for px, py in [(300, 400), (400, 200), (470, 333)]:
        page.browser.move(px, py)
        page.browser.wait_for("document.getElementById('at').innerText !== ''")
        own, degrees, value = page.text("at").splitlines()
        expected = mesh.grid.to_map(page.to_raster(px, py)[None])[0]
        assert np.allclose([float(each) for each in own.split(", ")], expected, atol=0.5 + 1e-6)
        lonlat = [float(each.removesuffix("°")) for each in degrees.split(", ")]
        assert np.allclose(lonlat, to_lonlat.transform(*expected), atol=0.6e-4)
        row = shown.triangle[py, px]
        name, number = value.split(" ", 1)
        assert name == "green_mean"
        assert_value(number, mesh.attributes("triangles")["green_mean"], int(row))
        page.browser.evaluate("document.getElementById('at').textContent = ''")


def test_wheel_and_fingers_zoom_around_their_place(show_map: ShowMap) -> None:
    page = show_map(olinda_mesh())
    place, scale = page.to_raster(500, 150), page.view[2]
    for dy, larger in ((-200, True), (-100, True), (250, False)):
        page.browser.wheel(500, 150, dy)
        page.idle()
        assert np.allclose(page.to_raster(500, 150), place, atol=1e-6)
        assert (page.view[2] > scale) == larger
        scale = page.view[2]
    place = page.to_raster(300, 300)
    page.browser.pinch(300, 300, 60, 180)
    page.idle()
    assert page.view[2] == pytest.approx(3 * scale, rel=0.02)
    assert np.allclose(page.to_raster(300, 300), place, atol=0.5)
    page.browser.pinch(300, 300, 180, 60)
    page.idle()
    assert page.view[2] == pytest.approx(scale, rel=0.02)
    assert not page.is_shown("info")


def test_mouse_and_finger_take_the_map_along(show_map: ShowMap) -> None:
    page = show_map(olinda_mesh())
    for start, end in (((300, 300), (417, 256)), ((400, 200), (350, 420))):
        place = page.to_raster(*start)
        page.browser.drag(start, end)
        page.idle()
        assert np.allclose(page.to_raster(*end), place, atol=1e-6)
        place = page.to_raster(*end)
        page.browser.touch([end, start])
        page.idle()
        assert np.allclose(page.to_raster(*start), place, atol=1e-6)
    assert not page.is_shown("info")


def test_keys_move_zoom_and_toggle(show_map: ShowMap) -> None:
    mesh = olinda_mesh()
    page = show_map(mesh)
    whole = page.view
    for name, step in {"ArrowLeft": (-90, 0), "ArrowDown": (0, 90)}.items():
        expected = page.to_raster(400 + step[0], 300 + step[1])
        page.browser.key(name)
        page.idle()
        assert np.allclose(page.to_raster(*MIDDLE), expected, atol=1e-6)
    scale = page.view[2]
    page.browser.key("+")
    page.idle()
    assert page.view[2] == pytest.approx(scale / 0.7)
    page.browser.key("-")
    page.browser.key("-")
    page.idle()
    assert page.view[2] == pytest.approx(scale * 0.7)
    page.browser.key("0")
    page.idle()
    assert np.allclose(page.view, whole)
    for key, name in {"e": "edges", "n": "nodes", "b": "breaklines", "s": "smooth"}.items():
        before = page.browser.evaluate(f"document.getElementById('{name}').checked")
        page.browser.key(key)
        assert page.browser.evaluate(f"document.getElementById('{name}').checked") != before
    page.browser.key("Enter")
    page.browser.wait_for("!document.getElementById('info').hidden")


def test_zoom_ends_at_a_step_of_the_lattice(show_map: ShowMap) -> None:
    page = show_map(olinda_mesh())
    page.browser.click(90, 400)
    deepest = 40 * 256 / abs(page.grid.transform.a)
    page.set_view(170.0, 170.0, deepest / 3)
    for _ in range(6):
        page.browser.key("+")
    page.idle()
    assert page.view[2] == pytest.approx(deepest)
    page.set_view(170.0, 170.0, 0.002)
    for _ in range(6):
        page.browser.key("-")
    page.idle()
    x = page.on_screen(page.mesh.nodes)[:, 0]
    assert np.ptp(x) > 5


def test_an_address_leads_to_the_same_view(show_map: ShowMap) -> None:
    mesh = olinda_mesh()
    page = show_map(mesh)
    page.choose("column", "count")
    page.choose("edges", True)
    page.set_view(100.0, 120.0, 0.2)
    page.browser.wait_for(
        "decodeURIComponent(location.hash).endsWith(',5&column=count&show=edges')"
    )
    address = page.browser.evaluate("location.href")
    page.browser.open("about:blank")
    page.browser.open(address)
    page.browser.evaluate("geomesh.ready.then(() => true)")
    assert np.allclose(page.view, (100, 120, 0.2), atol=1e-6)
    assert page.browser.evaluate("[column.value, edges.checked, nodes.checked]") == [
        "count",
        True,
        False,
    ]
    page.browser.evaluate("void (location.hash = '#at=broken&column=nothing&show=a')")
    page.idle()
    page.choose("column", "")
    page.choose("smooth", False)
    assert_flat(page, brighter(flat_colors(mesh), gain(mesh)))


def test_the_scale_bar_is_as_long_as_it_says(show_map: ShowMap) -> None:
    page = show_map(olinda_mesh())
    metres = {"m": 1, "km": 1000, "mm": 0.001}
    for scale in (0.01, 0.056, 1.7, 60.0, 5000.0):
        page.set_view(170.0, 170.0, scale)
        number, unit = page.text("length").split()
        width = page.browser.evaluate(
            "document.getElementById('bar').getBoundingClientRect().width"
        )
        assert width == pytest.approx(float(number) * metres[unit] * scale, abs=0.6)
        assert 30 < width < 130


def test_on_a_phone_the_map_is_not_covered(show_map: ShowMap) -> None:
    mesh = olinda_mesh()
    page = show_map(mesh)
    page.browser.resize(390, 780, 3)
    page.browser.open(page.browser.evaluate("location.href.split('#')[0]"))
    page.browser.evaluate("geomesh.ready.then(() => true)")
    covered = page.browser.evaluate("""[...document.querySelectorAll(".box")]
        .filter((box) => box.checkVisibility()).map((box) => box.getBoundingClientRect())
        .reduce((sum, { width, height }) => sum + width * height, 0)""")
    assert covered < 0.15 * 390 * 780
    page.browser.touch([(195, 390), (195, 390)])
    page.browser.wait_for("!document.getElementById('info').hidden")
    box = page.browser.evaluate("document.getElementById('info').getBoundingClientRect()")
    assert box["left"] >= 0
    assert box["right"] <= 390
    assert box["bottom"] <= 780
