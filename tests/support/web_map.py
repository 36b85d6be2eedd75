"""Web maps in a browser: what a page shows, and what numpy and matplotlib say it should show."""

from __future__ import annotations

import json
from functools import cache, cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.tri import Triangulation
from scipy.ndimage import maximum_filter, minimum_filter

import geomesh
from support.samples import OLINDA

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from numpy.typing import ArrayLike, NDArray

    from geomesh import Mesh
    from support.browser import Browser

# The page around the mesh, in light colours.
BACKGROUND = (0xF4, 0xF4, 0xF2)

# Share of a device pixel: a pixel is surely in a triangle that its middle is in, by this much.
SURE = 0.25

# CSS pixels by which a place may be off.
SNAPPED = 0.125

SHOW_BOXES = """document.querySelectorAll(".box, #swipe")
    .forEach((element) => { element.style.visibility = IS_SHOWN ? "" : "hidden" })"""
TABLE = """[...document.querySelectorAll('#info tr')].map((row) =>
    [row.querySelector('th').textContent, row.querySelector('td').textContent])"""


@cache
def olinda_mesh() -> Mesh:
    """Return a mesh of three bands with smooth colours."""
    return geomesh.mesh_raster(OLINDA, nodes=1200, effort="fast")


class MapPage:
    """A web map in a browser, and the mesh that it shows (on its left side)."""

    def __init__(self, browser: Browser, path: Path, mesh: Mesh) -> None:
        self.browser = browser
        self.mesh = mesh
        self.grid = mesh.grid
        browser.open(path)
        browser.evaluate("geomesh.ready.then(() => true)")

    def idle(self) -> None:
        """Wait until the map shows what it should."""
        self.browser.evaluate("geomesh.idle().then(() => true)")

    def text(self, name: str) -> str:
        """Return the text that a reader sees in an element."""
        found: str = self.browser.evaluate(f"document.getElementById('{name}').innerText")
        return found

    def is_shown(self, name: str) -> bool:
        found: bool = self.browser.evaluate(f"document.getElementById('{name}').checkVisibility()")
        return found

    def attributes(self) -> dict[str, str]:
        """Return names and texts of the attributes that are shown."""
        return dict(self.browser.evaluate(TABLE))

    def choose(self, name: str, value: str | bool) -> None:
        """Choose in a list, or set a check box, as a hand would; the map then shows it."""
        field = "checked" if isinstance(value, bool) else "value"
        self.browser.evaluate(f"""((element) => {{
            element.{field} = {json.dumps(value)};
            element.dispatchEvent(new Event("change", {{ bubbles: true }}));
        }})(document.getElementById("{name}"))""")
        self.idle()

    @property
    def view(self) -> tuple[float, float, float]:
        """Column and row of the middle of the window, and CSS pixels for a unit of the map."""
        found = self.browser.evaluate("geomesh.view")
        return found["x"], found["y"], found["scale"]

    def set_view(self, x: float, y: float, scale: float) -> None:
        state = json.dumps({"x": x, "y": y, "scale": scale})
        self.browser.evaluate(f"geomesh.setView({state}).then(() => true)")

    @property
    def size(self) -> tuple[int, int, float]:
        width, height, ratio = self.browser.evaluate("[innerWidth, innerHeight, devicePixelRatio]")
        return width, height, ratio

    @cached_property
    def narrow(self) -> float:
        """Length of a degree of longitude in the middle of the mesh, divided by one of latitude."""
        crs = self.grid.crs
        if crs is None or not crs.is_geographic:
            return 1.0
        low, high = self.mesh.map_nodes.min(axis=0), self.mesh.map_nodes.max(axis=0)
        lon, lat = (low + high) / 2
        geod, step = crs.get_geod(), 1e-4
        across = geod.inv(lon - step, lat, lon + step, lat)[2]
        return across / geod.inv(lon, lat - step, lon, lat + step)[2]

    def on_screen(self, places: ArrayLike) -> NDArray[np.float64]:
        """Return where places (n, 2) of the raster should be in the window, in CSS pixels."""
        x, y, scale = self.view
        width, height, _ = self.size
        a, b, _, d, e, _ = self.grid.transform[:6]
        across, down = (np.asarray(places, np.float64) - (x, y)).T
        up = -1 if self.grid.crs is not None or self.grid.transform.e < 0 else 1
        east, north = self.narrow * (a * across + b * down), d * across + e * down
        return np.column_stack([width / 2 + scale * east, height / 2 + up * scale * north])

    def to_raster(self, px: float, py: float) -> NDArray[np.float64]:
        """Return the place of the raster that should be at a place of the window."""
        origin, right, below = self.on_screen([(0, 0), (1, 0), (0, 1)])
        turn = np.column_stack([right - origin, below - origin])
        place: NDArray[np.float64] = np.linalg.solve(turn, np.array([px, py]) - origin)
        return place

    def picture(self) -> NDArray[np.uint8]:
        """Return the map alone, without its boxes, (H, W, 3) in device pixels."""
        self.idle()
        self.browser.evaluate(SHOW_BOXES.replace("IS_SHOWN", "false"))
        taken = self.browser.screenshot()
        self.browser.evaluate(SHOW_BOXES.replace("IS_SHOWN", "true"))
        return taken

    def triangles_on_screen(self) -> Shown:
        """Return which triangle should be at the middle of each device pixel."""
        width, height, ratio = self.size
        x, y = self.on_screen(self.mesh.nodes).T
        # Only those in the window, because matplotlib has trouble with places far outside.
        corners = self.mesh.triangles
        near = (x[corners].max(1) > 0) & (x[corners].min(1) < width)
        near &= (y[corners].max(1) > 0) & (y[corners].min(1) < height)
        rows = np.flatnonzero(near)
        find = Triangulation(x, y, corners[rows]).get_trifinder()
        across = (np.arange(round(width * ratio)) + 0.5) / ratio
        down = (np.arange(round(height * ratio)) + 0.5) / ratio
        px, py = np.meshgrid(across, down)
        found = np.asarray(find(px, py))
        # Only near an edge it takes a second look, around the middle of the pixel.
        inner = minimum_filter(found, 3) == maximum_filter(found, 3)
        near_edge = np.nonzero(~inner)
        inner[near_edge] = True
        for dx, dy in np.array([(-1, -1), (-1, 1), (1, -1), (1, 1)]) * SURE / ratio:
            around = find(px[near_edge] + dx, py[near_edge] + dy)
            inner[near_edge] &= around == found[near_edge]
        triangle = np.where(found >= 0, rows[found], -1)
        return Shown(triangle, inner, np.stack([px, py], axis=-1), np.column_stack([x, y]))


class Shown:
    """The triangle (H, W) at each device pixel, -1 for none, and whether it is surely that one."""

    def __init__(
        self,
        triangle: NDArray[np.intp],
        inner: NDArray[np.bool_],
        places: NDArray[np.float64],
        nodes: NDArray[np.float64],
    ) -> None:
        self.triangle = triangle
        self.inner = inner
        self.places = places
        self.nodes = nodes

    def between_nodes(
        self, mesh: Mesh, values: NDArray[Any], shift: ArrayLike = (0, 0)
    ) -> NDArray[np.float64]:
        """Return values (N, k) at nodes, interpolated at the pixels of triangles: (P, k).

        `shift` moves the pixels, in CSS pixels.
        """
        at = (self.triangle >= 0) & self.inner
        corners = mesh.triangles[self.triangle[at]]
        a, b, c = (self.nodes[corners[:, k]] for k in range(3))
        p = self.places[at] + np.asarray(shift)

        def cross(u: NDArray[Any], v: NDArray[Any]) -> NDArray[Any]:
            return u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]

        whole = cross(b - a, c - a)
        shares = [cross(b - p, c - p) / whole, cross(c - p, a - p) / whole]
        shares.append(1 - shares[0] - shares[1])
        result: NDArray[np.float64] = sum(
            share[:, None] * values[corners[:, k]] for k, share in enumerate(shares)
        )
        return result


def assert_flat(
    page: MapPage, colors: NDArray[Any], tolerance: float = 1, part: slice = slice(None)
) -> None:
    """Every pixel of the map has the colour (T, 3) of its triangle, and the rest is empty.

    `part` are the columns of pixels to look at.
    """
    picture, shown = page.picture().astype(int), page.triangles_on_screen()
    looked = np.zeros_like(shown.inner)
    looked[:, part] = shown.inner[:, part]
    inside, outside = (shown.triangle >= 0) & looked, (shown.triangle < 0) & looked
    assert inside.sum() > 1000
    away = np.abs(picture[inside] - colors[shown.triangle[inside]])
    assert away.max() <= tolerance, f"{(away.max(1) > tolerance).sum()} of {len(away)} pixels"
    np.testing.assert_array_equal(
        picture[outside], np.broadcast_to(BACKGROUND, picture[outside].shape)
    )


def assert_smooth(
    page: MapPage, colors: NDArray[Any], factor: float = 1, tolerance: float = 2
) -> None:
    """Every pixel of a triangle has the colour between those of its corners (N, 3), brightened."""
    picture, shown = page.picture().astype(int), page.triangles_on_screen()
    inside = (shown.triangle >= 0) & shown.inner
    assert inside.sum() > 1000
    assert_between(picture[inside], shown, page.mesh, colors, factor, tolerance)


def assert_between(
    found: NDArray[Any],
    shown: Shown,
    mesh: Mesh,
    values: NDArray[Any],
    factor: float = 1,
    tolerance: float = 2,
) -> None:
    """Levels (P, k) are those between the nodes (N, k), to a part of a pixel.

    Programs that draw put corners of triangles on 1/16 of a pixel, which matters where colours
    change quickly.
    """
    around = [
        brighter(shown.between_nodes(mesh, values, (dx, dy)), factor)
        for dx, dy in np.array([(-1, -1), (-1, 1), (1, -1), (1, 1)]) * SNAPPED
    ]
    low, high = np.min(around, axis=0) - tolerance, np.max(around, axis=0) + tolerance
    wrong = (found < low) | (found > high)
    assert not wrong.any(), f"{wrong.any(axis=1).sum()} of {len(found)} pixels"


def flat_colors(mesh: Mesh) -> NDArray[np.float64]:
    """Return the colours (T, 3) in the file, 0 to 255."""
    return np.array([to_rgb(text) for text in mesh.attributes("triangles")["color"]]) * 255


def gain(mesh: Mesh) -> float:
    """Return the factor that brightens a dark mesh: 1 % of its levels become white."""
    return max(255 / max(float(np.percentile(flat_colors(mesh), 99)), 1), 1)


def brighter(colors: NDArray[Any], factor: float) -> NDArray[np.float64]:
    return np.clip(colors * factor, 0, 255)


def band_colors(mesh: Mesh, bands: Sequence[str]) -> NDArray[np.float64]:
    """Return the values of three 8-bit bands at the nodes (N, 3)."""
    return np.stack([np.rint(np.clip(mesh.node_table[name], 0, 255)) for name in bands], axis=1)
