"""Take the pictures of the page about web maps, with Chromium, from data_samples/.

`pictures.py` runs it. Alone, in the root of a checkout: ``PYTHONPATH=tests .venv/bin/python
docs/web_map_pictures.py``.
"""

import shutil
import sys
import tempfile
import warnings
from pathlib import Path

from pictures import IMAGES, SAMPLES
from PIL import Image

import geomesh
from geomesh.view.web_map.page import MapOptions
from geomesh.view.web_map.write import write_map

sys.path.append("tests")  # the browser that the tests use
from support.browser import Browser, open_browser

OLINDA = SAMPLES / "olinda_landsat7_rgb_uint8.tif"
DEM = SAMPLES / "rmnp_dem.tif"

# Windows in CSS pixels.
DESK, PHONE = (1000, 640), (390, 720)


def main() -> None:
    if not (shutil.which("chromium") and shutil.which("chromedriver")):
        print("The web maps were not drawn: there is no Chromium, or no chromedriver")
        return
    warnings.simplefilter("ignore", geomesh.GeomeshWarning)
    with tempfile.TemporaryDirectory() as name, open_browser("chromium") as browser:
        folder = Path(name)
        image = geomesh.mesh_raster(OLINDA)
        page = folder / "olinda.html"
        write_map([image], page, MapOptions(title="Olinda"), names=["mesh.gpkg"], embed=OLINDA)
        show(browser, page, DESK)
        browser.drag((500, 320), (620, 320))
        keep(browser, "web_map", DESK)

        terrain = geomesh.mesh_raster(DEM, nodes=6000, z=1)
        page = terrain.to_html(folder / "slope.html", column="slope", title="Rocky Mountains")
        x, y = terrain.nodes.mean(axis=0)
        show(browser, page, DESK, dark=True)
        near(browser, x, y, pixel=abs(terrain.grid.transform.a) / 16)
        browser.key("e")
        browser.click(520, 330)
        browser.wait_for("!document.getElementById('info').hidden")
        keep(browser, "web_map_attributes", DESK)

        page = terrain.to_html(folder / "height.html", title="Rocky Mountains")
        show(browser, page, PHONE, ratio=2)
        browser.touch([(200, 250), (200, 250)])
        browser.wait_for("!document.getElementById('info').hidden")
        keep(browser, "web_map_phone", PHONE)


def show(
    browser: Browser, page: Path, size: tuple[int, int], *, dark: bool = False, ratio: float = 1
) -> None:
    """Open a page in a window of a size."""
    browser.new_page(*size, ratio)
    if dark:
        browser.darken()
    browser.open(page)
    browser.evaluate("geomesh.ready.then(() => true)")


def near(browser: Browser, x: float, y: float, pixel: float) -> None:
    """Show a place of the raster, at `pixel` map units for a pixel of the window."""
    browser.evaluate(f"geomesh.setView({{ x: {x}, y: {y}, scale: {1 / pixel} }}).then(() => true)")


def keep(browser: Browser, name: str, size: tuple[int, int]) -> None:
    """Keep what the browser shows as a small picture."""
    browser.evaluate("geomesh.idle().then(() => true)")
    picture = Image.fromarray(browser.screenshot()).resize(size, Image.Resampling.LANCZOS)
    # The mark of a small triangle would lose its colour among 256.
    kept = picture if size == PHONE else picture.quantize(256)
    kept.save(IMAGES / f"{name}.png", optimize=True)


if __name__ == "__main__":
    main()
