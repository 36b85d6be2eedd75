"""The page of a map of tiles, in real browsers: what it shows, and that it is safe."""

from __future__ import annotations

import base64
import hashlib
import json
import re
import threading
from contextlib import contextmanager
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from typing import TYPE_CHECKING

import numpy as np
import pytest
from affine import Affine

import geomesh
from geomesh.arrays.table import Table
from geomesh.errors import OutputError
from geomesh.view.tiles_page.page import write_page
from support.meshes import GEOREFERENCES, frame_mesh, lattice_mesh
from support.samples import OLINDA

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from support.browser import Browser

pytestmark = pytest.mark.filterwarnings("ignore::geomesh.errors.GeomeshWarning")

VENDOR = files("geomesh.view.tiles_page").joinpath("vendor")
DRAWN = "document.documentElement.dataset.state === 'drawn'"
PAPER = (238, 241, 242)
# Every eighth of matplotlib's colour map of that name.
VIRIDIS = np.array(
    [
        *((68, 1, 84), (71, 45, 123), (59, 82, 139), (44, 114, 142), (33, 145, 140)),
        *((40, 174, 128), (94, 201, 98), (173, 220, 48), (253, 231, 37)),
    ]
)
HOSTILE = "<script>window.hacked=1</script>\"'&@tiles@</title>"


@pytest.fixture(scope="module")
def landsat(tmp_path_factory) -> tuple[geomesh.Mesh, Path]:
    mesh = geomesh.mesh_raster(OLINDA, nodes=2500, effort="fast")
    folder = tmp_path_factory.mktemp("map")
    mesh.to_tiles(folder / "olinda.pmtiles", page=folder / "olinda.html")
    return mesh, folder


def show(browser: Browser, page: Path | str) -> None:
    browser.open(page)
    browser.wait_for(DRAWN)


def text(browser: Browser, selector: str) -> str:
    return browser.evaluate(f"document.querySelector({json.dumps(selector)}).innerText")


def texts(browser: Browser, selector: str) -> list[str]:
    return browser.evaluate(f"[...document.querySelectorAll('{selector}')].map(e => e.innerText)")


def at(browser: Browser, lon: float, lat: float) -> tuple[int, int]:
    """Return where a place is on the screen."""
    place = browser.evaluate(f"geomesh.map.project([{lon}, {lat}])")
    return round(place["x"]), round(place["y"])


def middles(mesh: geomesh.Mesh) -> np.ndarray:
    """Return longitude and latitude of points in the triangles."""
    points = mesh.to_geodataframe().to_crs(4326).geometry.representative_point()
    return np.column_stack([points.x, points.y])


def go(browser: Browser, lon: float, lat: float, zoom: float) -> None:
    """Move the map, and wait until it is drawn."""
    browser.evaluate(
        "new Promise((done) => { const { map } = geomesh; map.once('idle', () => done()); "
        f"map.jumpTo({{ center: [{lon}, {lat}], zoom: {zoom} }}); map.triggerRepaint(); }})"
    )


def color_at(browser: Browser, x: int, y: int) -> tuple[int, ...]:
    return tuple(browser.screenshot()[y, x].tolist())


def assert_quiet(browser: Browser) -> None:
    assert browser.errors == []
    assert [told for told in browser.console if told[0] in ("warn", "error")] == []
    assert browser.outside == []


def test_each_triangle_has_its_colour_and_a_click_tells_its_values(browser, landsat):
    mesh, folder = landsat
    show(browser, folder / "olinda.html")
    assert text(browser, "h1") == "olinda"
    assert re.fullmatch(r"Zoom 1\d: a smaller mesh, [\d,]+ triangles", text(browser, "#level"))
    assert text(browser, "#made").startswith(f"Made from {OLINDA.name} by geomesh ")
    table, places = mesh.attributes("triangles"), middles(mesh)
    large = np.argsort(table["area"])[-400::40]
    for number in large.tolist():
        go(browser, *places[number], 14)
        x, y = at(browser, *places[number])
        expected = tuple(bytes.fromhex(table["color"][number][1:]))
        assert np.abs(np.subtract(color_at(browser, x, y), expected)).max() <= 1
        browser.click(x, y)
        values = dict(
            zip(
                *(
                    browser.evaluate(
                        f"[...document.querySelectorAll('{kind}')].map(e => e.innerText)"
                    )
                    for kind in ("dt", "dd")
                ),
                strict=True,
            )
        )
        assert values["id"] == f"{number:,}"
        assert values["color"] == table["color"][number]
        assert float(values["red_mean"].replace(",", "")) == pytest.approx(
            table["red_mean"][number], rel=1e-5
        )
    assert text(browser, "#level") == f"Zoom 12: the mesh itself, {len(mesh.triangles):,} triangles"
    assert_quiet(browser)


def test_no_gap_is_seen_at_any_zoom(browser, landsat):
    """In the middle of the mesh, no pixel has anything of the paper, which is magenta here."""
    mesh, folder = landsat
    show(browser, folder / "olinda.html")
    browser.evaluate("void geomesh.map.setPaintProperty('paper', 'background-color', '#f0f')")
    lon, lat = middles(mesh).mean(axis=0)
    for zoom in (10.5, 11, 11.7, 12, 13.4, 16):
        go(browser, lon, lat, zoom)
        picture = browser.screenshot().astype(int)
        x, y = at(browser, lon, lat)
        reach = int(90 * 2 ** (min(zoom, 11.5) - 10.5))
        part = picture[y - reach : y + reach, max(x - reach, 300) : x + reach]
        # No colour of the image has so little green for its red and blue.
        assert (part[..., [0, 2]].min(axis=-1) - part[..., 1]).max() < 40, zoom
    go(browser, lon + 0.3, lat, 11)
    assert color_at(browser, 600, 300) == (255, 0, 255)
    assert_quiet(browser)


def test_another_attribute_has_a_ramp_of_colours(browser, landsat):
    mesh, folder = landsat
    show(browser, folder / "olinda.html")
    options = browser.evaluate("[...document.querySelectorAll('option')].map(e => e.value)")
    assert options == ["area", "count", "red_mean", "green_mean", "blue_mean", "color"]
    assert browser.evaluate("document.querySelector('select').value") == "color"
    assert browser.evaluate("document.querySelector('#legend').hidden")
    browser.evaluate(
        "(() => { const s = document.querySelector('select'); s.value = 'red_mean'; "
        "s.dispatchEvent(new Event('change')); })()"
    )
    table, places = mesh.attributes("triangles"), middles(mesh)
    large = np.argsort(table["area"])[-300:]
    low, high = np.nanpercentile(table["red_mean"], (2, 98))
    for number in large[np.argsort(table["red_mean"][large])][[0, 100, 200, -1]].tolist():
        go(browser, *places[number], 14)
        place = (table["red_mean"][number] - low) / (high - low)
        expected = np.array([np.interp(place, np.linspace(0, 1, 9), c) for c in VIRIDIS.T])
        found = color_at(browser, *at(browser, *places[number]))
        assert np.abs(found - expected).max() <= 2
    ends = [float(part) for part in text(browser, "#ends").split()]
    assert ends == pytest.approx([low, high], rel=1e-3)
    assert_quiet(browser)


def test_edges_are_drawn_when_asked_for(browser, landsat):
    mesh, folder = landsat
    show(browser, folder / "olinda.html")
    lon, lat = middles(mesh).mean(axis=0)
    go(browser, lon, lat, 13)
    before = browser.screenshot().astype(int)
    browser.evaluate(
        "new Promise((done) => { geomesh.map.once('idle', () => done()); "
        "document.querySelector('#edges').click(); })"
    )
    after = browser.screenshot().astype(int)
    assert (after[100:500, 350:750] < before[100:500, 350:750] - 3).any(axis=-1).mean() > 0.02
    assert_quiet(browser)


def test_names_are_text(browser, tmp_path):
    mesh = frame_mesh(GEOREFERENCES["north-up"])
    source = replace(mesh.provenance.source, name=f"/secret/folder/{HOSTILE.replace('/', '|')}")
    values = np.full(len(mesh.triangles), HOSTILE)
    table = Table({**mesh.triangle_table, HOSTILE: values, "b & <b>_mean": np.ones(len(values))})
    mesh = replace(mesh, triangle_table=table, provenance=replace(mesh.provenance, source=source))
    path = tmp_path / "<b>&@about@'.pmtiles"
    mesh.to_tiles(path, page=tmp_path / "map.html", columns=[HOSTILE, "b & <b>_mean", "color"])
    show(browser, tmp_path / "map.html")
    assert browser.evaluate("document.title") == "<b>&@about@'"
    assert text(browser, "h1") == "<b>&@about@'"
    assert "secret" not in (tmp_path / "map.html").read_text(encoding="utf-8")
    assert HOSTILE.replace("/", "|") in text(browser, "#made")
    lon, lat = middles(mesh)[0]
    go(browser, lon, lat, 14)
    browser.click(*at(browser, lon, lat))
    assert text(browser, "dl").count(HOSTILE) == 2
    assert browser.evaluate("window.hacked ?? 0") == 0
    assert_quiet(browser)


def test_a_mesh_over_the_antimeridian_is_shown_in_one_piece(browser, tmp_path):
    mesh = lattice_mesh("EPSG:4326", Affine(0.5, 0, 175, 0, -0.5, -10))
    mesh.to_tiles(tmp_path / "map.pmtiles", page=tmp_path / "map.html")
    show(browser, tmp_path / "map.html")
    west, east = (browser.evaluate(f"geomesh.map.project([{lon}, -15]).x") for lon in (176, 184))
    assert 0 < west < east < 800
    picture = browser.screenshot().astype(int)
    _, y = at(browser, 180, -15)
    covered = np.abs(picture[y, max(int(west), 300) : int(east)] - PAPER).max(axis=-1)
    assert covered.min() > 6
    assert_quiet(browser)


@pytest.mark.parametrize("width", [390, 1000])
def test_the_panel_leaves_room_for_the_mesh(browser, landsat, width):
    mesh, folder = landsat
    browser.new_page(width, 760)
    show(browser, folder / "olinda.html")
    west, south, east, north = mesh.to_geodataframe().to_crs(4326).total_bounds
    left, bottom = at(browser, west, south)
    right, top = at(browser, east, north)
    panel = browser.evaluate(
        "(({ left, right, top, bottom }) => ({ left, right, top, bottom }))"
        "(document.querySelector('#panel').getBoundingClientRect())"
    )
    assert 0 <= left < right <= width
    assert 0 <= top < bottom <= 760
    assert bottom <= panel["top"] or left >= panel["right"]
    assert_quiet(browser)


class _Ranges(BaseHTTPRequestHandler):
    """A static web server that knows byte ranges."""

    folder: Path

    def do_GET(self) -> None:
        data = (self.folder / self.path.lstrip("/")).read_bytes()
        asked = re.fullmatch(r"bytes=(\d+)-(\d+)", self.headers.get("Range", ""))
        if asked:
            start, stop = int(asked[1]), min(int(asked[2]) + 1, len(data))
            self.send_response(206)
            self.send_header("Content-Range", f"bytes {start}-{stop - 1}/{len(data)}")
            data = data[start:stop]
        else:
            self.send_response(200)
        self.send_header("Content-Type", "text/html" if self.path.endswith(".html") else "x/y")
        self.send_header("Content-Length", str(len(data)))
        self.end_headers()
        self.wfile.write(data)

    def log_message(self, *_: object) -> None:
        pass


@contextmanager
def served(folder: Path) -> Iterator[str]:
    handler = type("Handler", (_Ranges,), {"folder": folder})
    with ThreadingHTTPServer(("127.0.0.1", 0), handler) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield f"http://127.0.0.1:{server.server_port}"
        finally:
            server.shutdown()
            thread.join()


def test_large_tiles_come_from_a_web_server(browser, landsat, tmp_path):
    mesh, folder = landsat
    data = (folder / "olinda.pmtiles").read_bytes()
    (tmp_path / "olinda.pmtiles").write_bytes(data)
    assert not write_page(tmp_path / "map.html", tmp_path / "olinda.pmtiles", embedded=1000)
    assert (tmp_path / "map.html").stat().st_size < 1_000_000
    with served(tmp_path) as address:
        show(browser, f"{address}/map.html")
        assert text(browser, "#level").startswith("Zoom ")
        asked = {url.rpartition("/")[2] for url in browser.requests if url.startswith(address)}
        assert asked == {"map.html", "olinda.pmtiles"}
        lon, lat = middles(mesh)[0]
        go(browser, lon, lat, 14)
        assert color_at(browser, *at(browser, lon, lat)) != PAPER
        assert_quiet(browser)


def test_large_tiles_can_be_chosen_from_disk(browser, landsat, tmp_path):
    _, folder = landsat
    write_page(tmp_path / "map.html", folder / "olinda.pmtiles", embedded=1000)
    browser.open(tmp_path / "map.html")
    browser.wait_for("!document.querySelector('#chooser').hidden")
    assert "olinda.pmtiles" in text(browser, "#chooser")
    data = base64.b64encode((folder / "olinda.pmtiles").read_bytes()).decode()
    browser.evaluate(
        "(() => { const files = new DataTransfer(); const bytes = Uint8Array.from("
        f"atob('{data}'), (c) => c.charCodeAt(0)); files.items.add(new File([bytes], 'x.pmtiles'));"
        " const input = document.querySelector('#file'); input.files = files.files; "
        "input.dispatchEvent(new Event('change')); })()"
    )
    browser.wait_for(DRAWN)
    assert browser.evaluate("document.querySelector('#chooser').hidden")
    assert_quiet(browser)


def test_a_file_that_holds_no_tiles_is_told(browser, landsat, tmp_path):
    _, folder = landsat
    write_page(tmp_path / "map.html", folder / "olinda.pmtiles", embedded=1000)
    browser.open(tmp_path / "map.html")
    browser.wait_for("!document.querySelector('#chooser').hidden")
    browser.evaluate(
        "(() => { const files = new DataTransfer(); files.items.add(new File(['no'], 'x')); "
        "const input = document.querySelector('#file'); input.files = files.files; "
        "input.dispatchEvent(new Event('change')); })()"
    )
    browser.wait_for("document.querySelector('#level').innerText.includes('cannot be read')")


def test_the_page_asks_for_nothing_outside(landsat):
    page = (landsat[1] / "olinda.html").read_text(encoding="utf-8")
    (policy,) = re.findall('Content-Security-Policy" content="([^"]*)"', page)
    assert "default-src 'none'" in policy
    assert "unsafe-eval" not in policy
    assert "http" not in policy
    scripts = re.findall("<script>(.*?)</script>", page, re.DOTALL)
    for script in scripts:
        digest = base64.b64encode(hashlib.sha256(script.encode()).digest()).decode()
        assert f"'sha256-{digest}'" in policy
    assert "sourceMappingURL" not in page
    assert not re.search(r"<(?:link|script|img)[^>]*(?:src|href)=[\"']https?:", page)


def test_vendored_files_are_those_that_were_published():
    manifest = json.loads(VENDOR.joinpath("manifest.json").read_text())
    names = {each.name for each in VENDOR.iterdir()}
    assert names == {*manifest["files"], "manifest.json", "LICENSES.txt"}
    for name, about in manifest["files"].items():
        data = VENDOR.joinpath(name).read_bytes()
        assert hashlib.sha256(data).hexdigest() == about["sha256"], name
        assert re.fullmatch(r"[a-z-]+@\d+\.\d+\.\d+", about["package"])
    licenses = VENDOR.joinpath("LICENSES.txt").read_text()
    for owner in ("MapLibre contributors", "Protomaps LLC", "Arjun Barrett"):
        assert owner in licenses


def test_a_page_is_refused_before_the_work(landsat, tmp_path):
    mesh, folder = landsat
    (tmp_path / "map.html").write_text("older")
    for page, message in (
        (tmp_path / "map.html", "exists; use `overwrite=True`"),
        (tmp_path / "map.txt", "not named as a page"),
        (tmp_path / "none" / "map.html", "the folder of .* does not exist"),
    ):
        with pytest.raises(OutputError, match=message):
            mesh.to_tiles(tmp_path / "map.pmtiles", page=page)
    assert [each.name for each in tmp_path.iterdir()] == ["map.html"]
    write_page(tmp_path / "map.html", folder / "olinda.pmtiles", overwrite=True)
    assert (tmp_path / "map.html").read_text(encoding="utf-8").startswith("<!doctype html>")
