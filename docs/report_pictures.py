"""Take the picture of the page about reports, with Chromium, from data_samples/.

`pictures.py` runs it. Alone, in the root of a checkout: ``.venv/bin/python
docs/report_pictures.py``.
"""

import shutil
import subprocess
import tempfile
import warnings
from pathlib import Path

from pictures import IMAGES, SAMPLES
from PIL import Image

import geomesh

# Width of the window, and height of the part that is shown.
WIDTH, HEIGHT = 1000, 1130


def main() -> None:
    browser = shutil.which("chromium") or shutil.which("google-chrome")
    if browser is None:
        print("report.png was not drawn: there is no Chromium")
        return
    warnings.simplefilter("ignore", geomesh.GeomeshWarning)
    mesh = geomesh.mesh_raster(SAMPLES / "colorado_dem_float32_epsg4269.tif", z=1, max_error=5)
    with tempfile.TemporaryDirectory() as folder:
        page, shot = Path(folder, "report.html"), Path(folder, "shot.png")
        mesh.to_report(page, title="Colorado, within 5 m")
        subprocess.run(
            [
                *(browser, "--headless", "--no-sandbox", "--disable-gpu", "--hide-scrollbars"),
                *(f"--window-size={WIDTH},{HEIGHT}", f"--screenshot={shot}", page.as_uri()),
            ],
            check=True,
            capture_output=True,
        )
        picture = Image.open(shot).convert("RGB")
        small = picture.resize((WIDTH * 4 // 5, HEIGHT * 4 // 5), Image.Resampling.LANCZOS)
        small.quantize(256, dither=Image.Dither.NONE).save(IMAGES / "report.png", optimize=True)


if __name__ == "__main__":
    main()
