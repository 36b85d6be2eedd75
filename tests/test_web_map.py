"""The pixels of web maps, in real browsers: every one has the colour that the mesh has there."""

from __future__ import annotations

from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
import pytest
from scipy.ndimage import label, maximum_filter, minimum_filter

import geomesh
from support.samples import OLINDA, ROTATED
from support.web_map import (
    MapPage,
    assert_between,
    assert_flat,
    assert_smooth,
    band_colors,
    brighter,
    flat_colors,
    gain,
    olinda_mesh,
)

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    ShowMap = Callable[..., MapPage]

pytestmark = pytest.mark.slow
RGB = ("red", "green", "blue")


def ramp_colors(values: NDArray, low: float, high: float, name: str = "viridis") -> NDArray:
    """Return colours (n, 3) of matplotlib, 0 to 255."""
    places = np.clip((values - low) / (high - low) * 256, 0, 255).astype(int)
    return np.asarray(mpl.colormaps[name](places))[:, :3] * 255


def test_colours_of_nodes_are_interpolated(show_map: ShowMap) -> None:
    mesh = olinda_mesh()
    page = show_map(mesh)
    raw = band_colors(mesh, RGB)
    assert gain(mesh) > 1.2
    assert_smooth(page, raw, gain(mesh))
    page.choose("bright", False)
    assert_smooth(page, raw)
    page.choose("smooth", False)
    assert_flat(page, flat_colors(mesh))


@pytest.mark.parametrize("ratio", [1, 2])
def test_every_pixel_has_the_colour_of_its_triangle(show_map: ShowMap, ratio: int) -> None:
    """Before and after moving, zooming, and other sizes of the window."""
    mesh = olinda_mesh()
    page = show_map(mesh)
    page.browser.resize(500, 400, ratio)
    page.choose("smooth", False)
    expected = brighter(flat_colors(mesh), gain(mesh))
    assert_flat(page, expected)
    page.browser.drag((250, 200), (311, 177))
    assert_flat(page, expected)
    scale = page.view[2]
    page.browser.wheel(330, 250, -300)
    page.browser.wheel(330, 250, -300)
    assert page.view[2] > 2 * scale
    assert_flat(page, expected)
    page.browser.resize(640, 300, ratio)
    assert_flat(page, expected)


def test_the_whole_mesh_is_shown_first_in_the_middle(show_map: ShowMap) -> None:
    mesh = olinda_mesh()
    page = show_map(mesh)
    x, y = page.on_screen(mesh.nodes).T
    assert np.allclose([(x.min() + x.max()) / 2, (y.min() + y.max()) / 2], [400, 300], atol=0.01)
    assert 0.9 < max(np.ptp(x) / 800, np.ptp(y) / 600) < 1


@pytest.mark.parametrize("column", ["red_mean", "count", "min_angle", "area"])
def test_colours_by_an_attribute(show_map: ShowMap, column: str) -> None:
    mesh = olinda_mesh()
    page = show_map(mesh)
    values = mesh.attributes("triangles")[column].astype(float)
    low, high = np.percentile(values, (2, 98))
    page.choose("column", column)
    # The ramp of OpenCV differs by 1 from that of matplotlib, and a code may fall just beside.
    assert_flat(page, ramp_colors(values, low, high), tolerance=6)
    legend = page.browser.evaluate("[low, high].map((field) => Number(field.value))")
    np.testing.assert_allclose(legend, [low, high], rtol=0.01)
    page.browser.evaluate("document.getElementById('cut').click()")
    assert_flat(page, ramp_colors(values, values.min(), values.max()), tolerance=6)
    page.choose("ramps", "magma")
    assert_flat(page, ramp_colors(values, values.min(), values.max(), "magma"), tolerance=8)
    page.choose("column", "")
    assert_smooth(page, band_colors(mesh, RGB), gain(mesh))


def test_the_surface_of_a_band(show_map: ShowMap) -> None:
    mesh = olinda_mesh()
    page = show_map(mesh)
    page.choose("column", "red")
    page.choose("ramps", "gray")
    values = mesh.node_table["red"].astype(float)
    low, high = np.percentile(values, (2, 98))
    picture, shown = page.picture().astype(int), page.triangles_on_screen()
    inside = (shown.triangle >= 0) & shown.inner
    levels = (values[:, None] - low) / (high - low) * 255
    assert_between(picture[inside], shown, mesh, np.repeat(levels, 3, axis=1))


@pytest.mark.parametrize(("dx", "dy"), [(0, 0), (2.75, -1.5)])
@pytest.mark.parametrize("ratio", [1, 2])
def test_deepest_zoom_shows_a_node_where_it_is(
    show_map: ShowMap, ratio: int, dx: float, dy: float
) -> None:
    """A step of the lattice of 1/256 pixel is 40 CSS pixels: a node is there to a device pixel."""
    mesh = olinda_mesh()
    page = show_map(mesh)
    page.browser.resize(600, 500, ratio)
    pixel = abs(mesh.grid.transform.a)
    for node in mesh.nodes[[0, len(mesh.nodes) // 2, -1]]:
        x, y = node - np.array([dx, dy]) / 256
        page.set_view(float(x), float(y), 40 * 256 / pixel)
        page.choose("nodes", True)
        picture = page.picture().astype(int)
        red, green, blue = np.moveaxis(picture, -1, 0)
        is_mark = (np.abs(red - 217) < 12) & (np.abs(green - 26) < 12) & (np.abs(blue - 26) < 12)
        marks, count = label(is_mark)
        assert count == 1
        rows, cols = np.nonzero(marks)
        found = np.array([cols.mean() + 0.5, rows.mean() + 0.5])
        expected = np.array([300 + 40 * dx, 250 + 40 * dy]) * ratio
        assert np.abs(found - expected).max() <= 0.5


def test_edges_are_drawn_between_their_nodes(show_map: ShowMap) -> None:
    """The middles of edges become darker, the middles of large triangles do not."""
    mesh = olinda_mesh()
    page = show_map(mesh)
    page.choose("smooth", False)
    page.set_view(170.0, 170.0, 8 / abs(mesh.grid.transform.a))
    page.picture()
    before = page.picture().astype(int).sum(axis=2)
    page.choose("edges", True)
    after = page.picture().astype(int).sum(axis=2)
    nodes = mesh.nodes[mesh.edges.nodes]
    middles = np.floor(page.on_screen(nodes.mean(axis=1))).astype(int)
    seen = ((middles > 2) & (middles < (797, 597))).all(axis=1)
    assert seen.sum() > 100
    cols, rows = middles[seen].T
    darker = [
        (before - after)[row - 1 : row + 2, col - 1 : col + 2].max()
        for row, col in zip(rows, cols, strict=True)
    ]
    level = before[rows, cols]
    assert (np.array(darker) > 0.3 * level).all()
    shown = page.triangles_on_screen()
    # An edge just outside the window is not seen by the filters.
    far = minimum_filter(shown.triangle, 5) == maximum_filter(shown.triangle, 5)
    far[[0, 1, -2, -1]] = far[:, [0, 1, -2, -1]] = False
    np.testing.assert_array_equal(before[far], after[far])


@pytest.mark.filterwarnings("ignore::geomesh.errors.GeomeshWarning")
def test_a_rotated_raster(show_map: ShowMap) -> None:
    mesh = geomesh.mesh_raster(ROTATED, nodes=800, effort="fast")
    page = show_map(mesh)
    page.choose("smooth", False)
    assert_flat(page, brighter(flat_colors(mesh), gain(mesh)))


def test_the_preset_paper(show_map: ShowMap) -> None:
    mesh = geomesh.mesh_raster(OLINDA, preset="paper")
    page = show_map(mesh)
    assert not page.is_shown("smooth")
    assert_flat(page, brighter(flat_colors(mesh), gain(mesh)))
