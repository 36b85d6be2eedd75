"""Two meshes, or a mesh and a raster, on one web map with a swipe."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
import rasterio

import geomesh
from support.samples import OLINDA
from support.web_map import MapPage, assert_flat, brighter, flat_colors, gain, olinda_mesh

if TYPE_CHECKING:
    from collections.abc import Callable

    from geomesh import Mesh

    ShowMap = Callable[..., MapPage]

pytestmark = pytest.mark.slow


def other_mesh() -> Mesh:
    return geomesh.mesh_raster(OLINDA, preset="features", nodes=400)


def test_each_side_shows_its_mesh(show_map: ShowMap) -> None:
    left, right = olinda_mesh(), other_mesh()
    page = show_map(left, other=right)
    page.choose("smooth", False)
    first, second = (brighter(flat_colors(mesh), gain(mesh)) for mesh in (left, right))
    for split in (0.5, 0.7):
        if split != 0.5:
            page.browser.drag((400, 300), (560, 300))
        at = round(800 * split)
        assert_flat(page, first, part=slice(0, at - 1))
        page.mesh = right
        assert_flat(page, second, part=slice(at + 1, None))
        page.mesh = left


def test_a_click_tells_the_attributes_of_the_side_where_it_is(show_map: ShowMap) -> None:
    left, right = olinda_mesh(), other_mesh()
    page = show_map(left, other=right)
    for x, mesh in ((300, left), (470, right)):
        page.mesh = mesh
        row = int(page.triangles_on_screen().triangle[300, x])
        page.browser.click(x, 300)
        page.browser.wait_for(f"document.querySelector('#info td')?.textContent === '{row}'")
        assert page.attributes()["count"] == str(mesh.attributes("triangles")["count"][row])


def test_arrow_keys_move_the_swipe(show_map: ShowMap) -> None:
    page = show_map(olinda_mesh(), other=other_mesh())
    page.browser.evaluate("document.getElementById('swipe').focus()")
    for _ in range(3):
        page.browser.key("ArrowRight")
    handle = "document.getElementById('swipe')"
    assert page.browser.evaluate(f"{handle}.getAttribute('aria-valuenow')") == "65"
    box = page.browser.evaluate(f"{handle}.getBoundingClientRect()")
    assert box["left"] + box["width"] / 2 == pytest.approx(0.65 * 800, abs=0.6)
    for _ in range(20):
        page.browser.key("ArrowLeft")
    assert page.browser.evaluate(f"{handle}.getAttribute('aria-valuenow')") == "0"


def test_both_sides_have_the_same_colours_for_the_same_values(show_map: ShowMap) -> None:
    """The range of the legend holds for both meshes."""
    left, right = olinda_mesh(), other_mesh()
    page = show_map(left, other=right, column="red_mean")
    lows, highs = [], []
    for mesh in (left, right):
        low, high = np.percentile(mesh.attributes("triangles")["red_mean"], (2, 98))
        lows.append(low)
        highs.append(high)
    found = page.browser.evaluate("[low, high].map((field) => Number(field.value))")
    np.testing.assert_allclose(found, [min(lows), max(highs)], rtol=1e-3)


def test_a_column_of_one_mesh_leaves_the_other_gray(show_map: ShowMap) -> None:
    left, right = olinda_mesh(), other_mesh()
    page = show_map(left, other=right)
    page.choose("column", "red_rmse")
    page.mesh = right
    gray = np.full((len(right.triangles), 3), 153)
    assert_flat(page, gray, part=slice(401, None))


def test_the_raster_is_beside_its_mesh(show_map: ShowMap) -> None:
    """Its pixels are where they belong, in their brightened colours, as well as WebP keeps them."""
    mesh = olinda_mesh()
    page = show_map(mesh, embed=OLINDA)
    page.set_view(250.0, 170.0, 8 / abs(mesh.grid.transform.a))
    page.browser.wait_for("document.getElementById('right').textContent !== ''")
    with rasterio.open(OLINDA) as dataset:
        bands = np.moveaxis(dataset.read(), 0, -1)
    # A pixel of the raster is 8 x 8 pixels on the screen: look at their middles.
    rows, cols = np.mgrid[140:200, 255:295]
    places = page.on_screen(np.column_stack([cols.ravel(), rows.ravel()]) + 0.5)
    x, y = np.floor(places).astype(int).T
    seen = (x > 405) & (x < 795) & (y > 5) & (y < 595)
    assert seen.sum() > 500
    expected = brighter(bands[rows.ravel(), cols.ravel()][seen], gain(mesh))
    page.browser.wait_for("geomesh.times.firstFrame")
    away = np.abs(page.picture()[y[seen], x[seen]].astype(int) - expected)
    # A shift by one pixel would be seen: neighbours differ much more.
    shifted = np.abs(
        brighter(bands[rows.ravel(), cols.ravel() + 1][seen], gain(mesh)) - expected
    ).mean()
    assert away.mean() < 0.5 * shifted
    assert away.mean() < 8
