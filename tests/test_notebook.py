"""A mesh in a notebook: its picture and its description."""

from __future__ import annotations

import base64
import subprocess
import sys
from dataclasses import replace
from xml.etree import ElementTree

import cv2
import nbclient
import nbformat
import numpy as np
import pytest
from affine import Affine
from matplotlib.tri import Triangulation
from pyproj import CRS

import geomesh
from geomesh.arrays.table import Table
from geomesh.mesh.colors import brightened, parse_colors
from geomesh.raster.grid import Grid
from geomesh.recipe import Recipe
from geomesh.view.thumbnail import thumbnail
from support.meshes import ORIENTATIONS, frame_mesh, provenance
from support.samples import OLINDA

GEOGRAPHIC = Grid(40, 30, Affine(0.01, 0, 10, 0, -0.01, 60.15), CRS(4326))
PLACES = {**ORIENTATIONS, "geographic": GEOGRAPHIC}


@pytest.fixture(params=PLACES, ids=str)
def placed(request):
    """A mesh on each kind of grid. Each triangle has a different colour."""
    mesh = frame_mesh(PLACES[request.param])
    count = len(mesh.triangles)
    colors = np.array([f"#{number:02x}80ff" for number in np.arange(count) * 4])
    return replace(mesh, triangle_table=mesh.triangle_table.with_columns({"color": colors}))


def test_a_thumbnail_shows_the_map_as_matplotlib_finds_triangles_on_it(placed):
    picture = thumbnail(placed)
    height, width = picture.shape[:2]
    west, south, east, north = placed.grid.bounds()
    x = west + (np.arange(width) + 0.5) / width * (east - west)
    y = north - (np.arange(height) + 0.5) / height * (north - south)
    if placed.grid.crs is None:
        y = y[::-1]  # rows are counted downwards
    places = Triangulation(*placed.map_nodes.T, placed.triangles)
    found = places.get_trifinder()(*np.meshgrid(x, y))
    assert (picture[..., 3] == np.where(found >= 0, 255, 0)).all()
    # Edges are drawn lighter. Away from them, each pixel has the colour of its triangle.
    same = np.pad(found, 1, mode="edge")
    inner = (found >= 0) & (found == same[:-2, 1:-1]) & (found == same[1:-1, :-2])
    colors = brightened(parse_colors(placed.triangle_table["color"][found[found >= 0]]))
    expected = np.zeros((height, width, 3), np.uint8)
    expected[found >= 0] = colors
    assert inner.sum() > 0.7 * (found >= 0).sum()
    assert (picture[inner, :3] == expected[inner]).all()
    assert (picture[(found >= 0) & ~inner, :3] > expected[(found >= 0) & ~inner]).any()


def test_a_thumbnail_is_in_proportion():
    # At 60 degrees north, a degree of longitude is half as long as a degree of latitude.
    assert thumbnail(frame_mesh(GEOGRAPHIC)).shape == (256, 171, 4)
    wide = Grid(4000, 10, Affine(30, 0, 600_000, 0, -30, 4_900_000), CRS(32618))
    assert thumbnail(frame_mesh(wide)).shape == (8, 256, 4)


def test_a_mesh_without_colours_is_gray_and_shows_its_sides():
    mesh = replace(frame_mesh(ORIENTATIONS["north-up"]), triangle_table=Table({}))
    picture = thumbnail(mesh)
    assert {tuple(pixel) for pixel in picture.reshape(-1, 4)} == {
        (128, 128, 128, 255),
        (172, 172, 172, 255),
    }


def test_a_mesh_of_many_triangles_shows_no_sides(olinda):
    mesh = geomesh.mesh_raster(olinda)
    colors = np.where(np.arange(len(mesh.triangles)) % 2, "#ff0000", "#0000ff")
    mesh = replace(mesh, triangle_table=mesh.triangle_table.with_columns({"color": colors}))
    shown = {tuple(pixel) for pixel in thumbnail(mesh).reshape(-1, 4)}
    assert shown == {(255, 0, 0, 255), (0, 0, 255, 255)}


def told_by(html: str) -> tuple[ElementTree.Element, str]:
    """Return the parsed HTML, which must be well-formed, and its text."""
    tree = ElementTree.fromstring(html)
    return tree, " ".join(" ".join(tree.itertext()).split())


def test_a_mesh_tells_what_it_is(olinda):
    mesh = geomesh.mesh_raster(olinda, nodes=300)
    tree, text = told_by(mesh._repr_html_())
    assert f"geomesh.Mesh : 300 nodes, {len(mesh.triangles)} triangles" in text
    assert f"Source {olinda}, 349 × 352 pixels" in text
    assert "CRS EPSG:31985, SIRGAS 2000 / UTM zone 25S" in text
    assert "Bounds x 288776.25 to 298722.75, y 9110728.75 to 9120760.75" in text
    assert "Preset adaptive" in text
    count = len(mesh.certify().checks)
    assert count >= 9
    assert f"✓ {count} of {count} checks hold" in text
    assert all(check.name in text for check in mesh.certify().checks)
    assert "open" not in tree.find(".//details").attrib
    assert "Warnings" not in text
    (image,) = tree.iter("img")
    scheme, data = image.get("src").split(",")
    assert scheme == "data:image/png;base64"
    shown = cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_UNCHANGED)
    assert (cv2.cvtColor(shown, cv2.COLOR_BGRA2RGBA) == thumbnail(mesh)).all()


def test_a_mesh_needs_nothing_from_elsewhere_and_no_colours_of_its_own(olinda):
    """So it is visible offline, in an exported page, and on light and dark pages."""
    html = geomesh.mesh_raster(olinda, nodes=300)._repr_html_()
    tree, _ = told_by(html)
    assert {element.tag for element in tree.iter()}.isdisjoint({"script", "link", "style", "a"})
    assert "http" not in html.replace(tree.find(".//img").get("src"), "")
    styles = " ".join(element.get("style", "") for element in tree.iter())
    assert "color" not in styles
    assert "background" not in styles


def test_checks_that_fail_are_shown_at_once():
    mesh = frame_mesh(ORIENTATIONS["north-up"])
    wrong = replace(mesh, triangles=mesh.triangles[:, ::-1])
    tree, text = told_by(wrong._repr_html_())
    assert "open" in tree.find(".//details").attrib
    failed = [check for check in wrong.certify().checks if not check.passed]
    assert failed
    assert text.count("✗") == len(failed) + 1
    assert all(f"✗ {check.name} ({check.detail})" in text for check in failed)


def test_names_and_warnings_cannot_become_html():
    said = '<script>alert("1")</script> & <b>'
    mesh = replace(
        frame_mesh(ORIENTATIONS["north-up"]),
        provenance=provenance(recipe=Recipe(preset=said), name=said, warnings=(said,)),
    )
    html = mesh._repr_html_()
    _, text = told_by(html)
    assert text.count(said) == 3
    assert "<script" not in html


def test_a_mesh_of_a_file_tells_the_same(olinda, tmp_path):
    mesh = geomesh.mesh_raster(olinda, nodes=100)
    again = geomesh.read_mesh(mesh.to_file(tmp_path / "mesh.gpkg"))
    assert again._repr_html_() == mesh._repr_html_()


def test_a_mesh_with_little_to_tell_tells_it():
    mesh = frame_mesh(ORIENTATIONS["no georeference"])
    _, text = told_by(replace(mesh, provenance=None)._repr_html_())
    assert "Source 40 × 30 pixels CRS none Bounds" in text
    empty = replace(mesh, triangles=mesh.triangles[:0], triangle_table=Table({}))
    _, text = told_by(empty._repr_html_())
    assert "0 triangles" in text


def test_no_matplotlib_is_needed():
    code = (
        "import sys; sys.modules['matplotlib'] = None; import geomesh; "
        "print(geomesh.mesh_raster(sys.argv[1], nodes=50)._repr_html_()[:4])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code, str(OLINDA)], capture_output=True, text=True, check=True
    )
    assert done.stdout == "<div\n"


@pytest.mark.slow
def test_jupyter_shows_the_mesh_its_plot_once_and_its_map(tmp_path):
    cells = (
        f"import geomesh\nmesh = geomesh.mesh_raster({str(OLINDA)!r}, nodes=300)\nmesh",
        "mesh.plot()",
        "mesh.explore()",
    )
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in cells])
    done = nbclient.NotebookClient(notebook, timeout=120, kernel_name="python3").execute(
        cwd=str(tmp_path)
    )
    shown, plotted, explored = (cell["outputs"] for cell in done["cells"])
    (result,) = shown
    assert result["data"]["text/plain"] == repr(geomesh.mesh_raster(OLINDA, nodes=300))
    assert told_by(result["data"]["text/html"])[1].startswith("geomesh.Mesh : 300 nodes")
    assert ["image/png" in output["data"] for output in plotted] == [False, True]
    assert explored[0]["data"]["text/html"].startswith("<iframe srcdoc=")
