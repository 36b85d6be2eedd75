"""Web tiles under a web map: asked for only when switched on, and each where it belongs."""

from __future__ import annotations

import re
import threading
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from io import BytesIO
from typing import TYPE_CHECKING

import numpy as np
import pytest
from PIL import Image
from pyproj import Transformer

from support.web_map import MapPage, olinda_mesh

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from support.browser import Browser

pytestmark = pytest.mark.slow


def color_of(zoom: int, col: np.ndarray, row: np.ndarray) -> np.ndarray:
    """Return a colour for each tile; those of neighbours differ."""
    red, green = 40 + (53 * col) % 200, 40 + (91 * row) % 200
    return np.stack([red, green, np.broadcast_to(12 * zoom, red.shape)], axis=-1)


class Tiles(BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        found = re.fullmatch(r"/(\d+)/(\d+)/(\d+)\.png", self.path)
        assert found
        zoom, col, row = map(int, found.groups())
        color = tuple(color_of(zoom, np.array(col), np.array(row)).tolist())
        file = BytesIO()
        Image.new("RGB", (256, 256), color).save(file, "png")
        self.send_response(200)
        self.send_header("Content-Type", "image/png")
        self.send_header("Access-Control-Allow-Origin", "*")
        self.end_headers()
        self.wfile.write(file.getvalue())

    def log_message(self, *args: object) -> None:
        pass


@pytest.fixture
def tiles() -> Iterator[str]:
    """The address of a server of tiles on this computer."""
    with ThreadingHTTPServer(("127.0.0.1", 0), Tiles) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_address[1]}/"
        server.shutdown()
        thread.join()


def test_tiles_are_bent_to_the_map_when_switched_on(
    browser: Browser, tiles: str, tmp_path: Path
) -> None:
    mesh = olinda_mesh()
    path = mesh.to_html(tmp_path / "map.html", basemap=f"{tiles}{{z}}/{{x}}/{{y}}.png")
    page = MapPage(browser, path, mesh)
    page.idle()
    assert [url for url in browser.requests if url.startswith("http")] == []
    assert not page.is_shown("credit")
    page.choose("basemap", True)
    assert page.text("credit") == "Basemap: 127.0.0.1"
    asked = set(asked_for(browser, tiles))
    zoom = max(zoom for zoom, _, _ in asked)
    expected, sure = tiles_on_screen(page, zoom)
    around = (page.triangles_on_screen().triangle < 0) & sure
    assert around.sum() > 20_000
    picture = picture_with(page, expected[around], around)
    assert np.abs(picture[around].astype(int) - expected[around]).max() <= 1
    # Only what is seen was asked for, each once, and from nowhere else.
    urls = [url for url in browser.requests if not url.startswith(("file:", "data:"))]
    assert len(urls) == len(set(urls))
    assert all(url.startswith(tiles) for url in urls)
    assert browser.errors == browser.console == browser.outside == []


def asked_for(browser: Browser, tiles: str) -> list[tuple[int, int, int]]:
    """Wait until the page has asked for tiles; return zoom, column and row of each."""
    for _ in range(100):
        browser.evaluate("geomesh.idle().then(() => true)")
        asked = [url.removeprefix(tiles) for url in browser.requests if url.startswith(tiles)]
        numbers = [re.findall(r"\d+", address) for address in asked]
        if numbers:
            return [(int(zoom), int(col), int(row)) for zoom, col, row in numbers]
    raise AssertionError("no tiles were asked for")


def tiles_on_screen(page: MapPage, zoom: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the colour (H, W, 3) of the tile at each pixel, and whether it is surely that one."""
    width, height, _ = page.size
    px, py = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    origin, right, below = page.on_screen([(0, 0), (1, 0), (0, 1)])
    turn = np.linalg.inv(np.column_stack([right - origin, below - origin]))
    to_lonlat = Transformer.from_crs(page.grid.crs, 4326, always_xy=True)

    def tile(dx: float, dy: float) -> tuple[np.ndarray, np.ndarray]:
        screen = np.stack([px.ravel() + dx, py.ravel() + dy]) - origin[:, None]
        x, y = page.grid.to_map((turn @ screen).T).T
        lon, lat = np.deg2rad(to_lonlat.transform(x, y))
        col = (lon / np.pi + 1) / 2 * 2**zoom
        row = (1 - np.arcsinh(np.tan(lat)) / np.pi) / 2 * 2**zoom
        return np.floor(col).astype(int), np.floor(row).astype(int)

    col, row = tile(0, 0)
    sure = np.ones(col.shape, bool)
    for dx, dy in ((-1, -1), (1, -1), (-1, 1), (1, 1)):
        other_col, other_row = tile(dx, dy)
        sure &= (other_col == col) & (other_row == row)
    color = color_of(zoom, col, row).reshape(height, width, 3)
    return color, sure.reshape(height, width)


def picture_with(page: MapPage, colors: np.ndarray, around: np.ndarray) -> np.ndarray:
    """Return the picture, as soon as all tiles have arrived in it."""
    for _ in range(50):
        picture = page.picture()
        if np.abs(picture[around].astype(int) - colors).max() <= 1:
            break
    return picture
