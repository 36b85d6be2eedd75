"""A GLB in a page in Chromium, drawn by three.js: what it finds, and that a terrain is seen."""

from __future__ import annotations

import base64
import json
import os
import re
import shutil
import subprocess
from html import unescape
from io import BytesIO
from pathlib import Path
from zipfile import ZipFile

import numpy as np
import pytest
import trimesh
from PIL import Image

import geomesh
from geomesh.formats.tin import LocalFrame
from support.samples import SAMPLES

SCRIPT = Path(__file__).parent / "data" / "glb_viewer.js"
BROWSERS = ("chromium", "chromium-browser", "google-chrome")

# Set to a folder to keep the picture.
PICTURES = os.environ.get("GEOMESH_SCREENSHOTS")


def page(glb: Path) -> str:
    """Return a page without links: trimesh brings three.js for a viewer of its own."""
    archive = Path(trimesh.__file__).parent / "resources" / "templates" / "viewer.zip"
    with ZipFile(archive) as files:
        template = files.read("viewer.html.template").decode()
    library, _, _ = template[template.index("<script>") + 8 :].partition("var camera,controls,")
    script = SCRIPT.read_text().replace("$GLB", base64.b64encode(glb.read_bytes()).decode())
    return (
        "<!doctype html><meta charset=utf-8><body></body>"
        f"<script>{library}</script><script>{script}</script>"
    )


def browse(browser: str, document: Path, profile: Path) -> dict:
    """Return what the page reports; WebGL runs without a graphics card."""
    done = subprocess.run(
        [
            *(browser, "--headless=new", "--no-sandbox", "--disable-gpu-sandbox"),
            *("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
            *("--no-first-run", "--disable-extensions", f"--user-data-dir={profile}"),
            *("--virtual-time-budget=20000", "--dump-dom", document.as_uri()),
        ],
        capture_output=True,
        text=True,
        check=False,
        timeout=180,
    )
    found = re.search("<pre>(.*?)</pre>", done.stdout, re.DOTALL)
    assert found, done.stdout[-2000:] + done.stderr[-2000:]
    return json.loads(unescape(found[1]))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::geomesh.errors.GeomeshWarning")
def test_chromium_shows_the_terrain(tmp_path):
    browser = next(filter(None, map(shutil.which, BROWSERS)), None)
    if browser is None:
        pytest.skip("no Chromium on this computer: apt-get install chromium")
    source = SAMPLES / "colorado_dem_float32_epsg4269.tif"
    mesh = geomesh.mesh_raster(source, nodes=1500, effort="fast", z=1)
    mesh.to_file(tmp_path / "mesh.glb")
    document = tmp_path / "page.html"
    document.write_text(page(tmp_path / "mesh.glb"), encoding="utf-8")
    found = browse(browser, document, tmp_path / "profile")
    assert "error" not in found, found
    assert found["meshes"] == 1
    assert found["vertices"] == len(mesh.nodes)
    assert found["triangles"] == found["drawn"] == len(mesh.triangles)
    assert found["attributes"] == ["color", "normal", "position"]
    low, high = np.array(found["box"])
    assert np.allclose([low[1], high[1]], [mesh.heights.min(), mesh.heights.max()], atol=1e-3)
    assert found["extras"]["origin"] == [*LocalFrame.of(mesh).origin, 0.0]
    picture = Image.open(BytesIO(base64.b64decode(found["picture"].partition(",")[2])))
    if PICTURES:
        picture.save(Path(PICTURES) / "terrain_glb.png")
    levels = np.asarray(picture.convert("L")).astype(int)
    shown = levels < 250
    assert 0.1 < shown.mean() < 0.9
    # The relief has light and shade.
    assert np.ptp(np.percentile(levels[shown], [5, 95])) > 40
