"""The report of a mesh: what its page says, that it is valid, safe and whole, and how it fails."""

from __future__ import annotations

import itertools
import json
import re
import shlex
import shutil
import subprocess
import time
import tracemalloc
import warnings
from base64 import b64decode
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from unicodedata import normalize

import cv2
import html5lib
import numpy as np
import pypdf
import pytest
import rasterio
from affine import Affine
from pyproj import Transformer

import geomesh
from geomesh import Mesh
from geomesh.arrays.table import Table
from geomesh.cli import cli
from geomesh.errors import GeomeshWarning, GeoreferenceError, OutputError
from geomesh.features.gray import Tone
from geomesh.mesh.certificate import DomainFacts
from geomesh.mesh.provenance import PixelCounts
from geomesh.view.report.beside import busiest
from geomesh.view.report.charts import log_ticks, nice_ticks
from geomesh.view.report.histograms import count
from geomesh.view.report.relief import find_scale, shaded
from geomesh.view.report.statements import in_words
from geomesh.view.report.write import write_report
from support.browser_process import need
from support.commands import OLD, Geomesh, run_program, snapshot
from support.meshes import GEOREFERENCES, frame_mesh, lattice_mesh, provenance, two_triangles
from support.rasters import picture, write_raster
from support.samples import OLINDA, ROTATED, SAMPLES, fingerprint

DEM = SAMPLES / "colorado_dem_float32_epsg4269.tif"
HOSTILE = "<script>alert(1)</script> \"'&amp; 北京 --> ]]> \x00\x1b\ud800\ufffe\u202e.tif"
VOID = ("meta", "img", "br", "hr", "link", "input")


class Page(HTMLParser):
    """The elements of a page, in order, as (tag, attributes, text inside)."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.elements: list[tuple[str, dict[str, str | None], list[str]]] = []
        self._open: list[int] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs), []))
        if tag not in VOID:
            self._open.append(len(self.elements) - 1)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs), []))

    def handle_endtag(self, tag: str) -> None:
        assert self.elements[self._open.pop()][0] == tag

    def handle_data(self, data: str) -> None:
        for k in self._open:
            self.elements[k][2].append(data)

    def texts(self, tag: str, class_: str | None = None) -> list[str]:
        return [
            "".join(text).strip()
            for name, attributes, text in self.elements
            if name == tag and (class_ is None or class_ in (attributes.get("class") or "").split())
        ]

    def all(self, tag: str) -> list[dict[str, str | None]]:
        return [attributes for name, attributes, _ in self.elements if name == tag]

    @property
    def text(self) -> str:
        return "".join(self.elements[0][2])

    def table(self, heading: str) -> list[list[str]]:
        """Return the rows of the first table after a heading."""
        names = [(tag, "".join(text).strip()) for tag, _, text in self.elements]
        start = next(
            k for k, (tag, text) in enumerate(names) if tag in ("h2", "h3") and text == heading
        )
        table = next(k for k in range(start, len(names)) if names[k][0] == "table")
        rows: list[list[str]] = []
        for tag, text in names[table + 1 :]:
            if tag in ("table", "h2", "h3"):
                break
            if tag == "tr":
                rows.append([])
            elif tag in ("td", "th"):
                rows[-1].append(text)
        return rows

    def facts(self) -> dict[str, str]:
        found = [(tag, "".join(text)) for tag, _, text in self.elements if tag in ("dt", "dd")]
        pairs = itertools.pairwise(found)
        return {one[1]: other[1] for one, other in pairs if (one[0], other[0]) == ("dt", "dd")}


def valid(text: str) -> Page:
    """Return the page, after a strict parser has read it, without any request in it."""
    # It takes seconds to read what pictures consist of.
    html5lib.HTMLParser(strict=True).parse(re.sub(r";base64,[\w+/=]+", ";base64,", text))
    page = Page(text)
    (policy,) = (
        m["content"] for m in page.all("meta") if m.get("http-equiv") == "Content-Security-Policy"
    )
    assert policy == "default-src 'none'; img-src data:; style-src 'unsafe-inline'"
    for tag, attributes, _ in page.elements:
        assert tag not in ("script", "link", "iframe", "object", "embed", "base", "form", "a")
        for name, value in attributes.items():
            assert not name.startswith("on")
            if name in ("src", "href", "xlink:href", "srcset", "action", "poster"):
                assert value is not None
                assert value.startswith("data:image/png;base64,")
    (style,) = page.texts("style")
    assert "url(" not in style
    assert "@import" not in style
    return page


def report_of(mesh: Mesh, folder: Path, **options: Any) -> Page:
    path = mesh.to_report(folder / "report.html", overwrite=True, **options)
    return valid(path.read_text(encoding="utf-8"))


def mesh_of(source: Any, **options: Any) -> Mesh:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", GeomeshWarning)
        return geomesh.mesh_raster(source, **options)


@pytest.fixture(scope="module")
def bounded() -> Mesh:
    return mesh_of(DEM, max_error=10, z=1)


@pytest.fixture(scope="module")
def colored() -> Mesh:
    return mesh_of(OLINDA, nodes=600)


@pytest.fixture(scope="module")
def features() -> Mesh:
    return mesh_of(OLINDA, preset="features", nodes=500)


def number(text: str) -> float:
    return float(text.replace("−", "-").replace(",", "").replace("°", ""))


# ---------------------------------------------------------------- what the page says


def test_the_figures_of_the_page_are_those_of_the_mesh(bounded: Mesh, tmp_path: Path) -> None:
    page = report_of(bounded, tmp_path)
    assert page.texts("h1") == [f"Mesh of {DEM.name}"]
    assert page.texts("title")[:1] == page.texts("h1")
    facts = page.facts()
    assert facts["Nodes"] == f"{len(bounded.nodes):,}"
    assert facts["Triangles"] == f"{len(bounded.triangles):,}"
    assert bounded.provenance is not None
    refinement = bounded.provenance.refinement
    assert refinement is not None
    (band,) = refinement.bands
    assert number(facts["Greatest error"]) == pytest.approx(band.max_error, rel=1e-5)
    assert facts["PSNR"] == f"{band.psnr:.2f} dB"
    certificate = bounded.certify()
    assert facts["Smallest angle"] == f"{certificate.min_angle:.2f}°"
    assert f"all {len(certificate.checks)} checks hold" in page.texts("p", "badge")[0]
    assert (
        f"No valid pixel of band b1 differs by more than 10 from the surface; the greatest "
        f"difference is {band.max_error:.6g}." in page.text
    )
    assert "They are those that the mesh records." in page.text
    assert f"{refinement.pixels:,} valid pixels, measured for this report" in page.text
    assert page.texts("ul", "warnings")


def test_the_quality_is_that_of_the_command(
    bounded: Mesh, tmp_path: Path, command: Geomesh
) -> None:
    path = bounded.to_file(tmp_path / "mesh.gpkg")
    printed = json.loads(command("quality", "--json", path).out)
    done = command("report", path, "-o", tmp_path / "report.html")
    assert done.code == 0, done
    page = valid((tmp_path / "report.html").read_text(encoding="utf-8"))
    head, *rows = page.table("Quality")
    assert head == ["measure", "mean", "median", "p5", "p95", "min", "max"]
    assert [row[0] for row in rows] == list(printed["measures"])
    for name, *values in rows:
        expected = [f"{printed['measures'][name][figure]:.4g}" for figure in head[1:]]
        assert values == expected


@pytest.mark.slow
def test_each_check_is_a_sentence_with_its_result(
    bounded: Mesh, colored: Mesh, features: Mesh, tmp_path: Path
) -> None:
    paper = mesh_of(OLINDA, preset="paper")
    rmse = mesh_of(OLINDA, rmse=12)
    missing = replace(two_triangles(), triangles=np.array([[0, 3, 9]], np.int32))
    known = set()
    for mesh in (bounded, colored, features, paper, rmse, missing):
        certificate = mesh.certify()
        for check, statement in zip(certificate.checks, in_words(certificate), strict=False):
            # Every check has a sentence of its own: its name alone is none.
            assert statement.text != f"{check.name[:1].upper()}{check.name[1:]}.", check.name
            assert statement.text.endswith(".")
            assert "\\" not in statement.text
            assert statement.detail == check.detail
            known.add(statement.text)
    assert len(known) == 16
    page = report_of(bounded, tmp_path)
    held = page.texts("li", "held")
    assert len(held) == len(bounded.certify().checks)
    assert any("No angle of a triangle is smaller than 10 degrees." in line for line in held)


def test_a_mesh_that_fails_is_not_called_certified(
    bounded: Mesh, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    values = bounded.node_table["b1"].copy()
    values[7] += 3
    wrong = replace(bounded, node_table=bounded.node_table.with_columns({"b1": values}))
    failed = [check for check in wrong.certify().checks if not check.passed]
    assert failed
    page = report_of(wrong, tmp_path)
    assert "✗ Not certified" in page.texts("p", "badge")[0]
    assert len(page.texts("li", "failed")) == len(failed)
    # The recorded raster shows other errors than the mesh says: it is not taken for its own.
    assert "recorded when the mesh was made" in page.text
    given = report_of(wrong, tmp_path, source=DEM)
    assert "They are not those that the mesh records" in given.text


def test_a_bound_that_was_not_reached_is_not_said_to_hold(tmp_path: Path) -> None:
    mesh = mesh_of(DEM, max_error=2, nodes=150)
    assert mesh.provenance is not None
    assert mesh.provenance.refinement is not None
    (band,) = mesh.provenance.refinement.bands
    assert band.max_error > 2
    page = report_of(mesh, tmp_path)
    assert "No valid pixel of band" not in page.text
    assert f"by up to {band.max_error:.6g}, which is more than the bound of 2" in page.text
    assert "The goal was not reached: an error of 2 needs about" in page.text
    assert page.texts("dd", "note")[1] == "bound 2, not reached"
    assert any("The bound was not reached." in line for line in page.texts("li", "fact"))


def test_the_worst_triangles_are_the_worst(bounded: Mesh, tmp_path: Path) -> None:
    page = report_of(bounded, tmp_path)
    angles = bounded.quality().table["min_angle"]
    errors = bounded.triangle_table["b1_max_error"]
    to_lonlat = Transformer.from_crs(bounded.grid.crs, "OGC:CRS84", always_xy=True)
    for heading, values, order in (
        ("The smallest angles", angles, np.argsort(angles, kind="stable")[:5]),
        ("The largest errors", errors, np.argsort(-errors, kind="stable")[:5]),
    ):
        _, *rows = page.table(heading)
        assert [int(row[1]) for row in rows] == order.tolist()
        for row, t in zip(rows, order, strict=True):
            centre = bounded.map_nodes[bounded.triangles[t]].mean(axis=0)
            np.testing.assert_allclose([number(cell) for cell in row[2:4]], centre, atol=6e-6)
            lonlat = to_lonlat.transform(*centre)
            np.testing.assert_allclose([number(cell) for cell in row[4:6]], lonlat, atol=6e-6)
            assert number(row[6]) == pytest.approx(values[t], abs=6e-5)
    marks = [row[0] for row in page.table("The smallest angles")[1:]]
    assert marks == ["A1", "A2", "A3", "A4", "A5"]


def test_the_marks_are_at_their_triangles(colored: Mesh, tmp_path: Path) -> None:
    shown = write_report(colored, tmp_path / "report.html")
    west, south, east, north = colored.grid.bounds()
    size = np.array([shown.map.picture.width, shown.map.picture.height])
    ids = {each.mark: each.id for listed in shown.worst for each in listed.triangles}
    assert len(shown.map.markers) == len(ids) == 10
    for marker in shown.map.markers:
        x, y = colored.map_nodes[colored.triangles[ids[marker.mark]]].mean(axis=0)
        place = np.array([(x - west) / (east - west), (north - y) / (north - south)]) * size
        np.testing.assert_allclose(marker.place, place, atol=1e-6)
        assert (np.array(marker.label) >= 0).all()
        assert (np.array(marker.label) <= size).all()
    labels = np.array([marker.label for marker in shown.map.markers])
    apart = np.linalg.norm(labels[:, None] - labels, axis=-1) + 1e3 * np.eye(len(labels))
    assert apart.min() > 30
    assert shown.map.scale is not None
    length, text = shown.map.scale
    assert text == "2 km"
    assert length == pytest.approx(2000 / (east - west) * size[0])


def test_the_worst_errors_of_several_bands_are_compared(colored: Mesh, tmp_path: Path) -> None:
    shown = write_report(colored, tmp_path / "report.html")
    names = ("red", "green", "blue")
    errors = np.array([colored.triangle_table[f"{name}_max_error"] for name in names])
    highest = np.nanmax(errors, axis=0)  # all have the peak 255
    order = np.argsort(-np.nan_to_num(highest, nan=-1), kind="stable")[:5]
    by_error = shown.worst[1].triangles
    assert [each.id for each in by_error] == order.tolist()
    band = names[int(np.nanargmax(errors[:, order[0]]))]
    assert by_error[0].value == f"{highest[order[0]]:.6g} in band {band}"


def test_the_histograms_count_every_triangle(colored: Mesh, tmp_path: Path) -> None:
    shown = write_report(colored, tmp_path / "report.html")
    page = valid((tmp_path / "report.html").read_text(encoding="utf-8"))
    attributes = colored.attributes("triangles")
    columns = ("min_angle", "area", "ki", "red_rmse", "green_rmse", "blue_rmse")
    assert len(shown.histograms) == len(columns)
    for histogram, column in zip(shown.histograms, columns, strict=True):
        values = attributes[column][np.isfinite(attributes[column])]
        edges = np.array(histogram.edges)
        expected = [
            np.count_nonzero((values >= low) & ((values < high) | (k == len(edges) - 2)))
            for k, (low, high) in enumerate(itertools.pairwise(edges))
        ]
        assert list(histogram.counts) == expected
        assert sum(expected) + histogram.left_out == len(colored.triangles)
        assert histogram.median == np.median(values)
    # The bars of the first: their tooltips have the same numbers.
    bars = [title for title in page.texts("title")[1:] if "degrees: " in title]
    found = [int(title.rpartition(": ")[2].split()[0].replace(",", "")) for title in bars]
    assert found == [number for number in shown.histograms[0].counts if number]


@pytest.mark.parametrize(
    "values",
    [[], [np.nan, np.inf], [3.0], [0.0, 0.0], [-5.0, -5.0], [1e-300, 1e300], [1.0, 1.0 + 1e-15]],
)
def test_histograms_of_odd_values(values: list[float]) -> None:
    for wide in (False, True):
        histogram = count("x", "", np.array(values), wide=wide)
        assert (np.diff(histogram.edges) > 0).all()
        assert sum(histogram.counts) + histogram.left_out == len(values)


def test_ticks_are_round_and_inside() -> None:
    assert nice_ticks(0, 60, 5) == [0, 20, 40, 60]
    assert nice_ticks(-0.3, 0.3, 5) == [-0.2, 0, 0.2]
    assert nice_ticks(2, 2, 5) == [2]
    assert log_ticks(0.5, 2000) == [1, 10, 100, 1000]
    assert log_ticks(3, 60) == [5, 10, 20, 50]


def test_only_what_differs_from_the_preset_is_marked(tmp_path: Path, colored: Mesh) -> None:
    shown = write_report(colored, tmp_path / "report.html")
    assert colored.provenance is not None
    recipe = colored.provenance.recipe
    usual = geomesh.Recipe.from_preset("adaptive")
    marked = {setting.name for setting in shown.settings if setting.usual is not None}
    assert (
        marked == {k for k, v in recipe.to_dict().items() if v != usual.to_dict()[k]} == {"nodes"}
    )
    assert len(shown.settings) == len(recipe.to_dict()) - 1
    page = valid((tmp_path / "report.html").read_text(encoding="utf-8"))
    assert list(page.texts("div", "changed")) == ["nodes600preset: none"]


# ---------------------------------------------------------------- pictures


def pictures(page: Page) -> list[np.ndarray]:
    found = []
    for image in page.all("img"):
        data = np.frombuffer(b64decode(str(image["src"]).partition(",")[2]), np.uint8)
        decoded = cv2.imdecode(data, cv2.IMREAD_UNCHANGED)
        assert decoded.shape[:2] == (int(str(image["height"])), int(str(image["width"])))
        found.append(decoded)
    return found


def test_image_and_mesh_have_the_same_colours(colored: Mesh, tmp_path: Path) -> None:
    shown, image, mesh, detail, meshed = pictures(report_of(colored, tmp_path, source=OLINDA))
    assert image.shape == mesh.shape
    assert detail.shape == meshed.shape
    with rasterio.open(OLINDA) as dataset:
        bands = dataset.read()
    # OpenCV has blue, green, red.
    raster = np.moveaxis(bands[::-1], 0, -1)
    row, col = (
        np.arange(side) * there // side
        for side, there in zip(image.shape, raster.shape[:2], strict=False)
    )
    expected = raster[row[:, None], col] * (255 / np.percentile(raster, 99))
    np.testing.assert_allclose(image, np.minimum(expected, 255), atol=3)
    assert np.abs(image[..., :3].astype(float) - mesh[..., :3]).mean() < 25
    assert shown.shape[0] == 1000


def test_the_detail_shows_pixels_of_the_raster_where_most_nodes_are(
    colored: Mesh, tmp_path: Path
) -> None:
    window = busiest(colored)
    *_, detail, _ = pictures(report_of(colored, tmp_path, source=OLINDA))
    zoom = detail.shape[1] // window.width
    assert detail.shape[:2] == (zoom * window.height, zoom * window.width)
    blocks = detail.reshape(window.height, zoom, window.width, zoom, -1)
    assert (blocks == blocks[:, :1, :, :1]).all()
    x, y = colored.nodes.T
    inside = (x >= window.col) & (x < window.stop_col) & (y >= window.row) & (y < window.stop_row)
    share = inside.sum() / len(x)
    assert share > window.width * window.height / (349 * 352)


def test_without_the_raster_the_mesh_is_shown_alone(colored: Mesh, tmp_path: Path) -> None:
    assert colored.provenance is not None
    source = replace(colored.provenance.source, name="not-here.tif")
    moved = replace(colored, provenance=replace(colored.provenance, source=source))
    page = report_of(moved, tmp_path)
    assert len(page.all("img")) == 3
    assert "no image beside it" in page.text
    assert "recorded when the mesh was made" in page.text
    assert "Give its path if it is elsewhere" in page.text


@pytest.mark.slow
def test_another_raster_at_the_recorded_place_is_not_used(tmp_path: Path) -> None:
    source = Path(shutil.copy(OLINDA, tmp_path / "scene.tif"))
    mesh = mesh_of(source, nodes=300)
    assert "found where the mesh records it" in report_of(mesh, tmp_path).text
    with rasterio.open(source, "r+") as dataset:
        dataset.write(255 - dataset.read())
    assert "no image beside it" in report_of(mesh, tmp_path).text
    source.write_bytes(b"no raster")
    assert "no image beside it" in report_of(mesh, tmp_path).text
    source.unlink()
    source.mkdir()
    assert "no image beside it" in report_of(mesh, tmp_path).text


def test_the_errors_of_a_mesh_without_refinement_are_measured(
    features: Mesh, tmp_path: Path
) -> None:
    page = report_of(features, tmp_path, source=OLINDA)
    fidelity = features.psnr(OLINDA)
    assert page.facts()["PSNR, green"] == f"{fidelity.psnr[1]:.2f} dB"
    assert page.table("The largest errors, compared with the range of each band")
    assert "smallest squared error" in page.text


def test_heights_are_lit_from_the_upper_left() -> None:
    y, x = np.mgrid[-20:21, -20:21].astype(float)
    cone = 30 - np.hypot(x, y)
    cone[:3] = np.nan
    image = shaded(cone, find_scale(cone))
    assert (image[:3, :, 3] == 0).all()
    assert (image[3:, :, 3] == 255).all()
    bright = image[..., :3].sum(axis=-1)
    assert bright[12, 12] > 1.5 * bright[28, 28]
    assert bright[12, 28] == pytest.approx(bright[28, 12], rel=0.05)
    flat = np.full((5, 5), 7.0)
    assert (shaded(flat, find_scale(flat)) == shaded(flat, find_scale(flat))[0, 0]).all()
    nothing = np.full((2, 3), np.nan)
    assert (shaded(nothing, find_scale(nothing))[..., 3] == 0).all()


# ---------------------------------------------------------------- how to make it again


def again(shown: Any, folder: Path, command: Geomesh) -> Mesh:
    """Run the command of a report in a folder, and return the mesh that it makes."""
    words = shlex.split(shown.again.command.replace("\\\n", ""))
    assert words[:2] == ["geomesh", "mesh"]
    output = folder / "again.gpkg"
    words[words.index("mesh.gpkg")] = str(output)
    assert command(*words[1:]).code == 0, words
    return geomesh.read_mesh(output)


NODATA = "bahamas_landsat7_rgb_nodata_collar.tif"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "options", "known"),
    [
        ("olinda_landsat7_rgb_uint8.tif", {}, False),
        ("olinda_landsat7_rgb_uint8.tif", {"preset": "paper"}, True),
        (
            "olinda_landsat7_6band_uint8.tif",
            {"preset": "features", "bidx": [4, 3, 2], "nodes": "2%", "canny_low": 50.0},
            True,
        ),
        ("olinda_landsat7_6band_uint8.tif", {"bidx": [4, 3, 2], "nodes": 200}, False),
        (
            "colorado_dem_float32_epsg4269.tif",
            {"max_error": 12.5, "z": 1, "z_factor": 0.3048, "min_angle": 15.0},
            False,
        ),
        (
            "iguacu_landsat8_rgb_uint16.tif",
            {"nodes": 300, "model": "constant", "sift_upsample": False, "domain": "image"},
            True,
        ),
        (NODATA, {"nodes": 900, "statistics": ("mean", "median")}, False),
        ("olinda_landsat7_rgb_rotated_gt.tif", {"nodes": 300, "keep_features": True}, False),
        ("spyndex_sentinel2_4band_uint16_NOGEOREF.tif", {"nodes": 300, "crs": "EPSG:32633"}, True),
        (
            "rmnp_dem.tif",
            {"rmse": 20.0, "gray": "band:1", "nodata": -9999, "breaklines": "canny"},
            True,
        ),
    ],
)
def test_the_command_makes_the_same_mesh(
    name: str, options: dict[str, Any], known: bool, tmp_path: Path, command: Geomesh
) -> None:
    source = Path(shutil.copy(SAMPLES / name, tmp_path / "a 'scene' of mine.tif"))
    mesh = mesh_of(source, **options)
    away = source.rename(tmp_path / "away.tif") if not known else source
    shown = write_report(mesh, tmp_path / "report.html")
    assert known == ("Give its path" not in " ".join(shown.again.notes))
    away.rename(source)
    made = again(shown, tmp_path, command)
    stored = geomesh.read_mesh(mesh.to_file(tmp_path / "mesh.gpkg"))
    assert fingerprint(made) == fingerprint(stored)


@pytest.mark.slow
@pytest.mark.parametrize("source", [OLINDA, SAMPLES / "colorado_dem_float32_epsg4269.tif"])
def test_the_command_has_the_bounds(source: Path, tmp_path: Path, command: Geomesh) -> None:
    with rasterio.open(source) as dataset:
        left, bottom, right, top = dataset.bounds
    width, height = right - left, top - bottom
    bounds = (left + 0.2 * width, bottom + 0.3 * height, left + 0.7 * width, top)
    mesh = mesh_of(source, nodes=300, bounds=bounds)
    shown = write_report(mesh, tmp_path / "report.html")
    assert "--bounds" in shown.again.command
    made = again(shown, tmp_path, command)
    assert made.metadata == mesh.metadata
    np.testing.assert_array_equal(made.nodes, mesh.nodes)


@pytest.mark.slow
def test_what_the_command_cannot_say_is_told(tmp_path: Path) -> None:
    west, south, east, north = mesh_of(OLINDA, nodes=100).grid.bounds()
    triangle = f"POLYGON (({west} {south}, {east} {south}, {west} {north}, {west} {south}))"
    mesh = mesh_of(OLINDA, nodes=300, mask=triangle)
    page = report_of(mesh, tmp_path)
    assert "Add --mask or --bounds" in page.text
    assert "inside an area of interest" in page.facts()["Pixels"]
    refined = mesh_of(OLINDA, preset="features", nodes=200).refine(OLINDA, nodes=200)
    assert "refined from another mesh" in report_of(refined, tmp_path).text


# ---------------------------------------------------------------- odd meshes, hostile names


def test_hostile_names_are_shown_as_text(tmp_path: Path) -> None:
    mesh = frame_mesh(GEOREFERENCES["north-up"])
    made = provenance(
        name=HOSTILE, warnings=(HOSTILE,), versions={"geomesh": HOSTILE, HOSTILE: "1"}
    )
    mesh = replace(mesh, provenance=replace(made, pixels=PixelCounts(2000, 2000)))
    page = report_of(mesh, tmp_path)
    shown = HOSTILE.translate({0: "\ufffd", 0x1B: "\ufffd", 0xD800: "\ufffd", 0xFFFE: "\ufffd"})
    assert shown in page.texts("ul", "warnings")[0]
    assert page.facts()["Raster"] == shown
    titled = report_of(mesh, tmp_path, title="</title><img src=x onerror=alert(1)> & 'q' \"d\"")
    assert titled.texts("h1") == ["</title><img src=x onerror=alert(1)> & 'q' \"d\""]
    assert titled.texts("title")[0] == titled.texts("h1")[0]


@pytest.mark.parametrize("georeference", GEOREFERENCES)
def test_every_georeference_has_a_report(georeference: str, tmp_path: Path) -> None:
    mesh = frame_mesh(GEOREFERENCES[georeference])
    page = report_of(mesh, tmp_path)
    assert page.facts()["Triangles"] == str(len(mesh.triangles))
    head, *rows = page.table("The smallest angles")
    has_lonlat = georeference not in ("no CRS", "Mars")
    assert ("longitude" in head) == has_lonlat
    assert len(rows) == 5
    assert len(page.all("img")) == 3


def test_a_mesh_without_provenance_colours_or_values(tmp_path: Path) -> None:
    page = report_of(two_triangles(), tmp_path)
    assert page.texts("h1") == ["Mesh"]
    assert "does not record how it was made" in page.text
    assert "has no colours" in page.text
    assert "not recorded in this mesh" in page.text
    assert len(page.table("The smallest angles")) == 3
    assert "Recipe" not in page.texts("h2")
    # The check of the pixels could not be made: it is neither passed nor failed.
    assert len(page.texts("li", "fact")) == 1
    assert page.texts("p", "badge") == ["✓ Certified: all 8 checks hold"]


def test_one_triangle(tmp_path: Path) -> None:
    grid = GEOREFERENCES["geographic"]
    mesh = Mesh(
        np.array([[0.0, 0], [0, 4], [4, 0]]),
        np.array([[0, 1, 2]], np.int32),
        grid,
        DomainFacts("hull", 8.0, 1, 0, 8),
    )
    page = report_of(mesh, tmp_path)
    assert page.facts()["Triangles"] == "1"
    assert len(page.table("The smallest angles")) == 2


def test_a_mesh_without_triangles(tmp_path: Path) -> None:
    grid = GEOREFERENCES["no CRS"]
    empty = Mesh(
        np.zeros((0, 2)), np.zeros((0, 3), np.int32), grid, DomainFacts("hull", 0.0, 0, 0, 8)
    )
    page = report_of(empty, tmp_path)
    assert page.texts("p", "badge")[0].startswith("✗ Not certified")


@pytest.mark.slow
def test_values_that_are_not_numbers(bounded: Mesh, tmp_path: Path) -> None:
    columns = {}
    for name in ("b1_max_error", "b1_rmse"):
        columns[name] = bounded.triangle_table[name].copy()
        columns[name][::2] = np.nan
        columns[name][1] = np.inf
    heights = bounded.node_table["b1"].copy()
    heights[:40] = np.nan
    odd = replace(
        bounded,
        triangle_table=bounded.triangle_table.with_columns(columns),
        node_table=bounded.node_table.with_columns({"b1": heights}),
    )
    page = report_of(odd, tmp_path)
    assert page.texts("p", "badge")[0].startswith("✗ Not certified")
    every = replace(
        odd,
        triangle_table=odd.triangle_table.with_columns(
            {name: np.full(len(odd.triangles), np.nan) for name in columns}
        ),
        node_table=odd.node_table.with_columns({"b1": np.full(len(odd.nodes), np.nan)}),
    )
    page = report_of(every, tmp_path)
    assert "No triangle has a value." in page.text
    dropped = replace(bounded, triangle_table=Table({}))
    assert "No triangle has a value" not in report_of(dropped, tmp_path).text


def test_a_column_named_color_that_has_none(tmp_path: Path) -> None:
    mesh = frame_mesh(GEOREFERENCES["north-up"])
    for column in (np.full(len(mesh.triangles), "red"), np.arange(len(mesh.triangles))):
        odd = replace(mesh, triangle_table=mesh.triangle_table.with_columns({"color": column}))
        assert "has no colours" in report_of(odd, tmp_path).text


@pytest.mark.slow
def test_depths_are_shaded_as_the_surface_they_are(tmp_path: Path) -> None:
    _, image, *_ = pictures(report_of(mesh_of(DEM, nodes=300, z=1), tmp_path))
    _, turned, *_ = pictures(report_of(mesh_of(DEM, nodes=300, z=1, z_factor=-1.0), tmp_path))
    # What is lit in one is in the shade in the other.
    one, other = (picture_[..., :3].mean(axis=-1).ravel() for picture_ in (image, turned))
    assert np.corrcoef(one, other)[0, 1] < -0.5


def test_only_the_bands_that_are_shown_are_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    mesh = mesh_of(SAMPLES / "olinda_landsat7_6band_uint8.tif", nodes=200)
    wanted = geomesh.raster.open_scene(SAMPLES / "olinda_landsat7_6band_uint8.tif").display
    shown = []
    displayed = Tone.display

    def display(self: Tone, values: np.ndarray) -> np.ndarray:
        shown.append(len(values))
        return displayed(self, values)

    monkeypatch.setattr(Tone, "display", display)
    report_of(mesh, tmp_path)
    assert shown == [len(set(wanted))] * 4


def test_a_raster_with_nodata_is_transparent_where_there_is_none(tmp_path: Path) -> None:
    mesh = mesh_of(SAMPLES / "bahamas_landsat7_rgb_nodata_collar.tif", nodes=900)
    shown, image, painted, *_ = pictures(report_of(mesh, tmp_path))
    for picture_ in (shown, image, painted):
        assert picture_.shape[2] == 4
        assert 0.1 < (picture_[..., 3] == 0).mean() < 0.9
    # The image, which is smaller than its raster, has the same places as the mesh beside it.
    assert np.abs(image[..., 3].astype(float) - painted[..., 3]).mean() < 255 * 0.02


@pytest.mark.slow
def test_a_large_image_is_decimated_as_a_whole(tmp_path: Path) -> None:
    """Its sides are no multiples of the step: nothing may be cut off or moved."""
    height, width = 1999, 3001
    ramp = np.add.outer(np.arange(height), np.arange(width)).astype(np.float32)
    source = write_raster(tmp_path, data=ramp[None])
    _, image, *_ = pictures(report_of(mesh_of(source, preset="features", nodes=50), tmp_path))
    expected = cv2.resize(ramp, image.shape[1::-1], interpolation=cv2.INTER_AREA)
    low, high = np.percentile(ramp, (2, 98))
    levels = np.clip((expected - low) / (high - low) * 255, 0, 255)
    assert image.shape == (426, 640, 3)
    np.testing.assert_allclose(image[..., 0], levels, atol=3)


@pytest.mark.slow
def test_many_triangles_need_little_memory(tmp_path: Path) -> None:
    side = 400
    mesh = lattice_mesh("EPSG:32722", Affine(30, 0, 5e5, 0, -30, 8e6), side, side)
    assert len(mesh.triangles) == 320_000
    mesh.quality()
    tracemalloc.start()
    started = time.perf_counter()
    page = report_of(mesh, tmp_path)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    print(f"{time.perf_counter() - started:.1f} s, {peak / 1e6:.0f} MB")
    # Pictures are painted pixel by pixel: no shapes of triangles are kept.
    assert peak < 450e6
    assert page.facts()["Triangles"] == "320,000"
    assert (tmp_path / "report.html").stat().st_size < 3_000_000


# ---------------------------------------------------------------- the file


def test_the_same_mesh_gives_the_same_bytes(colored: Mesh, tmp_path: Path) -> None:
    stored = colored.to_file(tmp_path / "mesh.gpkg")
    one = colored.to_report(tmp_path / "one.html").read_bytes()
    other = geomesh.read_mesh(stored).to_report(tmp_path / "other.htm").read_bytes()
    assert one == other
    assert not re.search(rb"20\d\d-\d\d-\d\d", one)


@pytest.mark.slow
def test_the_command_prints_what_it_wrote(colored: Mesh, tmp_path: Path, command: Geomesh) -> None:
    path, page = colored.to_file(tmp_path / "mesh.gpkg"), tmp_path / "report.html"
    done = command("report", path, "-o", page, "--title", "Olinda & sea", "--json")
    assert done.code == 0
    (outcome,) = json.loads(done.out)["results"]
    assert outcome["output"] == str(page)
    assert outcome["nodes"] == 600
    assert outcome["certified"] is True
    assert valid(page.read_text(encoding="utf-8")).texts("h1") == ["Olinda & sea"]
    again_ = command("report", path, "-o", page, "--like", OLINDA, "--overwrite")
    assert again_.out == f"{page}: the report of {path}\n"
    lines = command("report", path, "-o", page, "--overwrite", "--progress", "jsonl").out
    events = [json.loads(line) for line in lines.splitlines()]
    assert events[0]["command"] == "report"
    assert events[-1]["event"] == "result"
    assert events[-1]["outputs"] == [str(page)]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("mesh.gpkg", "-o", "report.txt"), "name it .html"),
        (("mesh.gpkg", "-o", "old.html"), "use --overwrite to replace it"),
        (("mesh.gpkg", "-o", "gone/report.html"), "the folder of gone/report.html does not exist"),
        (("gone.gpkg", "-o", "report.html"), "gone.gpkg"),
        (("scene.tif", "-o", "report.html"), "scene.tif"),
        (("mesh.gpkg", "-o", "report.html", "--like", "gone.tif"), "gone.tif"),
        (("mesh.gpkg", "-o", "report.html", "--like", "other.tif"), "pixels of the mesh"),
        (("mesh.gpkg", "-o", "mesh.html"), "mesh.html is the input"),
    ],
)
def test_what_cannot_be_done_is_said_in_one_line(
    colored: Mesh,
    arguments: tuple[str, ...],
    words: str,
    tmp_path: Path,
    command: Geomesh,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    colored.to_file("mesh.gpkg")
    Path("mesh.html").symlink_to("mesh.gpkg")
    shutil.copy(OLINDA, "scene.tif")
    write_raster(tmp_path, "other.tif", picture(3, 20, 30))
    Path("old.html").write_bytes(OLD)
    before = snapshot(tmp_path)
    assert words in command("report", *arguments).error()
    assert snapshot(tmp_path) == before


def test_an_old_report_stays_if_the_disk_is_full(
    colored: Mesh, tmp_path: Path, small_disk: Any
) -> None:
    folder, options = small_disk
    mesh, page = colored.to_file(tmp_path / "mesh.gpkg"), folder / "report.html"
    page.write_bytes(OLD)
    done = run_program("report", mesh, "-o", page, "--overwrite", **options)
    assert "free some space" in done.error()
    assert snapshot(folder) == {"report.html": OLD}


def test_the_library_says_what_is_wrong(colored: Mesh, tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"name it \.html"):
        colored.to_report(tmp_path / "report.pdf")
    with pytest.raises(GeoreferenceError, match="not among those of"):
        colored.to_report(tmp_path / "report.html", source=ROTATED)
    assert list(tmp_path.iterdir()) == []


def test_help_needs_no_slow_library() -> None:
    assert cli.commands["report"].get_short_help_str(200).startswith("Write a page about MESH")


# ---------------------------------------------------------------- in a browser


@pytest.mark.slow
def test_the_printed_page_has_all_of_it(bounded: Mesh, tmp_path: Path) -> None:
    chromium = need("chromium")["chromium"]
    page = report_of(bounded, tmp_path)
    printed = tmp_path / "report.pdf"
    subprocess.run(
        [
            *(chromium, "--headless", "--no-sandbox", "--disable-gpu", "--no-pdf-header-footer"),
            *(f"--print-to-pdf={printed}", (tmp_path / "report.html").as_uri()),
        ],
        check=True,
        capture_output=True,
        timeout=120,
    )
    pdf = pypdf.PdfReader(printed)
    assert 5 <= len(pdf.pages) <= 9
    for sheet in pdf.pages:
        assert [round(float(side)) for side in sheet.mediabox[2:]] == [595, 842]
    # Without ligatures, which fonts have for "fi" and others.
    text = normalize("NFKC", " ".join(sheet.extract_text() for sheet in pdf.pages))
    text = " ".join(text.split())
    for word in ("A1", "E5", "relative_size_squared", "sift_contrast_threshold", "--max-error 10"):
        assert word in text
    for heading in page.texts("h2"):
        assert heading in text
    # Every number of the widest table is there: nothing is cut at the margin.
    for row in page.table("Quality")[1:]:
        assert " ".join(row) in text
