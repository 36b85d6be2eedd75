"""Names that could be taken for HTML, JavaScript or the ends of blocks: shown as they are."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import html5lib
import numpy as np
import pytest

import geomesh
from geomesh import Mesh
from geomesh.arrays.table import Table
from support.meshes import ORIENTATIONS, frame_mesh, provenance
from support.samples import OLINDA
from support.web_map import MapPage, olinda_mesh

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from support.browser import Browser
    from support.commands import Geomesh

    ShowMap = Callable[..., MapPage]

HACK = "window.hacked = true"
HOSTILE = (
    f"<script>{HACK}</script>",
    f"</script><script>{HACK}</script>",
    f"<img src=x onerror='{HACK}'>",
    f'" onmouseover="{HACK}" x="',
    f"</style></title><svg onload='{HACK}'>",
    "<!--head--><!--script-->",
    "'\"&amp;&lt;\\u003c\\",
    "北京 São Paulo \u202egnp.exe",
    "${window.hacked = 1}`",
)


def hostile_mesh(text: str) -> Mesh:
    """Return a mesh where the raster, a column and its values have a name."""
    mesh = frame_mesh(ORIENTATIONS["north-up"], provenance=provenance(name=f"{text}.tif"))
    count = len(mesh.triangles)
    values = np.where(np.arange(count) % 2, text, "other")
    table = {**mesh.triangle_table, text: values}
    return replace(mesh, triangle_table=Table(table))


@pytest.mark.slow
@pytest.mark.parametrize("text", HOSTILE)
def test_names_are_shown_as_text(show_map: ShowMap, text: str) -> None:
    plain = show_map(hostile_mesh("plain"), title="plain", column="plain")
    elements = "document.querySelectorAll('*').length"
    plain.browser.click(400, 300)
    plain.browser.wait_for("!document.getElementById('info').hidden")
    expected = plain.browser.evaluate(elements)
    page = show_map(hostile_mesh(text), title=text, column=text)
    assert page.browser.evaluate("document.title") == text.strip()
    assert page.browser.evaluate("document.getElementById('title').textContent") == text
    names = page.browser.evaluate("[...column.options].map((option) => option.textContent)")
    assert text in names
    assert page.browser.evaluate("column.value") == text
    listed = page.browser.evaluate(
        "[...document.querySelectorAll('#classes li')].map((row) => row.textContent)"
    )
    assert sorted(listed) == sorted([text, "other"])
    page.browser.move(300, 280)
    page.browser.click(400, 300)
    page.browser.wait_for("!document.getElementById('info').hidden")
    assert page.attributes()[text] in (text, "other")
    assert page.browser.evaluate(elements) == expected
    assert page.browser.evaluate("window.hacked === undefined")


@pytest.mark.slow
def test_names_of_files_on_a_swipe(browser: Browser, command: Geomesh, tmp_path: Path) -> None:
    paths = [tmp_path / f"{text}.gpkg" for text in ("<b>a&amp;b", "北京 'x' \"y\"")]
    for path in paths:
        olinda_mesh().to_file(path)
    out = tmp_path / "map <1>.html"
    made = command("view", *paths, "-o", out)
    assert made.code == 0, made
    page = MapPage(browser, out, olinda_mesh())
    assert page.text("left") == paths[0].name
    assert page.text("right") == paths[1].name
    assert page.text("title") == f"{paths[0].name} | {paths[1].name}"
    assert browser.errors == browser.outside == []


@pytest.mark.parametrize("text", HOSTILE)
def test_a_page_is_valid_html(text: str, tmp_path: Path) -> None:
    path = hostile_mesh(text).to_html(tmp_path / "map.html", title=text)
    assert_valid(path)


def test_a_page_with_two_meshes_or_a_raster_is_valid_html(tmp_path: Path) -> None:
    mesh = geomesh.mesh_raster(OLINDA, nodes=200, effort="fast")
    assert_valid(mesh.to_html(tmp_path / "two.html", other=mesh))
    basemap = "https://tiles.example/{z}/{x}/{y}.png?a=1&b=2"
    assert_valid(mesh.to_html(tmp_path / "raster.html", embed=OLINDA, basemap=basemap))


def assert_valid(path: Path) -> None:
    """A parser of the standard, which raises at errors, and every id once."""
    parser = html5lib.HTMLParser(strict=True, namespaceHTMLElements=False)
    document = parser.parse(path.read_text(encoding="utf-8"))
    ids = [element.get("id") for element in document.iter() if element.get("id")]
    assert len(ids) > 20
    assert len(ids) == len(set(ids))
