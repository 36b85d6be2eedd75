"""A GLB in a page in real browsers, drawn by three.js: what it finds, and that it is seen."""

from __future__ import annotations

import base64
import os
from pathlib import Path
from typing import TYPE_CHECKING
from zipfile import ZipFile

import numpy as np
import pytest
import trimesh
from PIL import Image

import geomesh
from geomesh.formats.tin import LocalFrame
from support.samples import SAMPLES

if TYPE_CHECKING:
    from support.browser import Browser

SCRIPT = Path(__file__).parent / "data" / "glb_viewer.js"

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
        "<!doctype html><meta charset=utf-8><body style='margin: 0'></body>"
        f"<script>{library}</script><script>{script}</script>"
    )


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::geomesh.errors.GeomeshWarning")
def test_browsers_show_the_terrain(tmp_path: Path, browser: Browser) -> None:
    source = SAMPLES / "colorado_dem_float32_epsg4269.tif"
    mesh = geomesh.mesh_raster(source, nodes=1500, effort="fast", z=1)
    mesh.to_file(tmp_path / "mesh.glb")
    document = tmp_path / "page.html"
    document.write_text(page(tmp_path / "mesh.glb"), encoding="utf-8")
    browser.resize(900, 600)
    browser.open(document)
    found = browser.evaluate("found")
    assert "error" not in found, found
    assert found["meshes"] == 1
    assert found["vertices"] == len(mesh.nodes)
    assert found["triangles"] == found["drawn"] == len(mesh.triangles)
    assert found["attributes"] == ["color", "normal", "position"]
    low, high = np.array(found["box"])
    assert np.allclose([low[1], high[1]], [mesh.heights.min(), mesh.heights.max()], atol=1e-3)
    assert found["extras"]["origin"] == [*LocalFrame.of(mesh).origin, 0.0]
    assert browser.errors == browser.outside == []
    picture = Image.fromarray(browser.screenshot())
    if PICTURES:
        picture.save(Path(PICTURES) / f"terrain_glb_{browser.name}.png")
    levels = np.asarray(picture.convert("L")).astype(int)
    shown = levels < 250
    assert 0.1 < shown.mean() < 0.9
    # The relief has light and shade.
    assert np.ptp(np.percentile(levels[shown], [5, 95])) > 40
