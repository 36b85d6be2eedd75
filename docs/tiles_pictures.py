"""Take the picture of the page about tiles, with Chromium, from data_samples/.

`pictures.py` runs it. Alone, in the root of a checkout: ``.venv/bin/python
docs/tiles_pictures.py``. It needs the browser of the tests, `tests/support/browser.py`.
"""

import shutil
import sys
import tempfile
import warnings
from pathlib import Path

from pictures import IMAGES, SAMPLES
from PIL import Image

import geomesh

WIDTH, HEIGHT = 1000, 620


def main() -> None:
    if shutil.which("chromium") is None:
        print("tiles.png was not drawn: there is no Chromium")
        return
    sys.path.insert(0, str(Path(__file__).parents[1] / "tests"))
    from support.browser import open_browser

    warnings.simplefilter("ignore", geomesh.GeomeshWarning)
    mesh = geomesh.mesh_raster(SAMPLES / "iguacu_landsat8_rgb_uint16.tif")
    with (
        tempfile.TemporaryDirectory() as folder,
        open_browser("chromium", width=WIDTH, height=HEIGHT) as browser,
    ):
        page = Path(folder, "map.html")
        mesh.to_tiles(Path(folder, "Foz do Iguaçu.pmtiles"), page=page)
        browser.open(page)
        browser.wait_for("document.documentElement.dataset.state === 'drawn'")
        browser.click(640, 240)
        browser.evaluate(
            "new Promise((done) => { geomesh.map.once('idle', () => done()); "
            "geomesh.map.triggerRepaint(); })"
        )
        picture = Image.fromarray(browser.screenshot())
        picture.quantize(256, dither=Image.Dither.NONE).save(IMAGES / "tiles.png", optimize=True)


if __name__ == "__main__":
    main()
