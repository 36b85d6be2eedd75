"""The benchmark of web maps: its large mesh is one, and frames are counted right."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import pytest

from benchmarks import web_browser, web_pages
from geomesh.mesh.certify import certify
from support.meshes import GEOREFERENCES, frame_mesh, random_mesh

if TYPE_CHECKING:
    from pathlib import Path


@pytest.mark.parametrize("times", [1, 2, 3])
def test_a_mirrored_mesh_covers_its_raster_once(times: int) -> None:
    mesh = frame_mesh(GEOREFERENCES["rotated"])
    found = web_pages.mirrored(mesh, times)
    assert len(found.triangles) == times**2 * len(mesh.triangles)
    area = float(mesh.grid.width * mesh.grid.height * times**2)
    domain = replace(mesh.domain, area=area)
    certificate = certify(
        found.nodes,
        found.triangles,
        constraints=found.constraints,
        plane_scale=found.plane_scale,
        counter_clockwise=not found.grid.flips,
        domain=domain,
        pixels=None,
        delaunay=False,
    )
    failed = [check for check in certificate.to_dict()["checks"] if not check["passed"]]
    assert failed == []
    assert len(np.unique(found.nodes, axis=0)) == len(found.nodes)
    # Each triangle has the attributes of the one that it mirrors.
    areas = found.attributes("triangles")["area"]
    once = mesh.with_measures().attributes("triangles")["area"]
    marked = web_pages.mirrored(
        replace(mesh, triangle_table=mesh.triangle_table.with_columns({"own": once})), times
    )
    np.testing.assert_allclose(marked.triangle_table["own"], areas)


def test_frames_of_the_pan_and_of_the_rest_are_told_apart() -> None:
    seen = {"frames": [0, 10, 30, 130, 140, 640, 650], "moves": [12, 35, 120], "end": 645}
    pan, redraw, longest = web_browser.frames_of(seen)
    assert pan == 100
    assert redraw == pytest.approx(0.525)
    assert longest == 500


def test_the_page_of_deck_gl_has_the_mesh(tmp_path: Path) -> None:
    mesh = random_mesh()
    path = web_pages.write_deck(mesh, tmp_path / "deck.html", "simpleMesh", "window.deck = 1;")
    text = path.read_text()
    head = json.loads(re.findall(r'id="head">(.*?)</script>', text)[0])
    assert head["triangles"] == len(mesh.triangles)
    assert head["layer"] == "simpleMesh"
    for name in ("nodes", "triangles", "colors"):
        assert re.search(f'id="{name}">[A-Za-z0-9+/=]+</script>', text), name
    assert "window.deck = 1;" in text
