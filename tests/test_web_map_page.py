"""The page of a web map: its blocks hold the mesh, and its text is safe and complete."""

from __future__ import annotations

import base64
import hashlib
import html
import json
import re
import zlib
from dataclasses import replace

import cv2
import numpy as np
import pytest
import rasterio
from affine import Affine
from hypothesis import given
from hypothesis import strategies as st
from pyproj import CRS, Transformer
from scipy.interpolate import RegularGridInterpolator

import geomesh
from geomesh.arrays.table import Table
from geomesh.errors import GeomeshWarning, GeoreferenceError, OutputError
from geomesh.mesh.colors import brightening, parse_colors
from geomesh.raster.grid import Grid
from geomesh.view.web_map import page as page_module
from geomesh.view.web_map.codec import below_highest, byte_planes, differences, zigzag
from geomesh.view.web_map.columns import NULL, encode_columns
from geomesh.view.web_map.order import order_along_curve
from support.meshes import ORIENTATIONS, frame_mesh
from support.samples import OLINDA, SAMPLES

COLORADO = SAMPLES / "colorado_dem_float32_epsg4269.tif"


class Page:
    """A page, read with the rules that its program follows."""

    def __init__(self, path):
        self.text = path.read_text(encoding="utf-8")
        blocks = re.findall(r'<script type="text/plain" id="([\w-]+)">([^<]*)</script>', self.text)
        self.blocks = {name: zlib.decompress(base64.b64decode(text)) for name, text in blocks}
        (head,) = re.findall(r'<script type="application/json" id="head">(.*?)</script>', self.text)
        self.head = json.loads(head)

    def planes(self, name, width=4):
        raw = np.frombuffer(self.blocks[name], np.uint8).reshape(width, -1)
        return sum(raw[k].astype(np.int64) << (8 * k) for k in range(width))

    def signed(self, name, parts=1):
        return [unzigzag(part) for part in self.planes_of_parts(name, parts)]

    def planes_of_parts(self, name, parts):
        raw = np.frombuffer(self.blocks[name], np.uint8).reshape(parts, 4, -1).astype(np.int64)
        return (raw << (8 * np.arange(4))[:, None]).sum(axis=1)

    def nodes(self, k=0):
        return np.column_stack([np.cumsum(axis) for axis in self.signed(f"mesh{k}-nodes", 2)])

    def triangles(self, k=0):
        highest, ids = 0, []
        for below in self.planes(f"mesh{k}-triangles").tolist():
            ids.append(highest - below)
            highest += below == 0
        return np.array(ids).reshape(-1, 3)

    def ids(self, k=0):
        nodes, triangles = self.nodes(k), self.triangles(k)
        (of_nodes,), (of_triangles,) = (
            self.signed(f"mesh{k}-{name}") for name in ("nodeIds", "triangleIds")
        )
        by_row = sorted(range(len(nodes)), key=lambda i: (nodes[i, 1], nodes[i, 0]))
        of_nodes[by_row] += np.arange(len(nodes))
        by_node = sorted(range(len(triangles)), key=lambda i: of_nodes[triangles[i, 0]])
        of_triangles[by_node] += np.arange(len(triangles))
        return of_nodes, of_triangles

    def colors(self, name):
        green, red, blue = np.frombuffer(self.blocks[name], np.uint8).reshape(3, -1)
        return np.column_stack([red + green, green, blue + green])

    def column(self, name, k=0):
        for number, about in enumerate(self.head["meshes"][k]["columns"]):
            if about["key"] == name:
                codes = self.planes(f"mesh{k}-column{number}", 2)
                if about["near"]:
                    near, colors = about["near"], self.colors(f"mesh{k}-colors")
                    levels = colors[:, near["channel"]].astype(float)
                    expected = np.floor(near["first"] + levels * near["step"] + 0.5)
                    codes = (unzigzag(codes) + expected.astype(int)) % 65536
                values = 2 * (about["low"] / 2 + about["step"] / 2 * codes)
                return about, np.where(codes == NULL, np.nan, values), codes
        raise KeyError(name)


def unzigzag(codes):
    return (codes >> 1) ^ -(codes & 1)


@pytest.fixture(scope="module")
def olinda_mesh():
    return geomesh.mesh_raster(OLINDA, nodes=400)


def page_of(mesh, tmp_path, **options):
    return Page(mesh.to_html(tmp_path / "map.html", overwrite=True, **options))


@given(st.lists(st.integers(-(2**31), 2**31 - 1), min_size=1))
def test_differences_give_the_numbers_back(numbers):
    values = np.array(numbers, np.int64)
    assert (unzigzag(zigzag(values)) == values).all()
    assert (np.cumsum(unzigzag(differences(values))) == values).all()


@given(st.lists(st.integers(0, 2**32 - 1)), st.sampled_from([2, 4]))
def test_byte_planes_hold_the_numbers(numbers, width):
    codes = np.array(numbers, np.int64) % 256**width
    raw = np.frombuffer(byte_planes(codes, width), np.uint8).reshape(width, -1)
    assert (sum(raw[k].astype(np.int64) << (8 * k) for k in range(width)) == codes).all()


@given(st.lists(st.integers(0, 8), min_size=1))
def test_ids_below_the_highest(numbers):
    # Numbered by first use, as the order along a curve does.
    numbered = {}
    ids = np.array([numbered.setdefault(each, len(numbered)) for each in numbers])
    below = below_highest(ids)
    highest = 0
    for distance, expected in zip(below.tolist(), ids.tolist(), strict=True):
        assert highest - distance == expected
        highest += distance == 0


def test_the_order_along_a_curve_keeps_the_mesh_and_neighbours_together(olinda_mesh):
    order = order_along_curve(olinda_mesh.nodes, olinda_mesh.triangles)
    assert sorted(order.rows.tolist()) == list(range(len(olinda_mesh.triangles)))
    assert (order.nodes[order.triangles] == olinda_mesh.triangles[order.rows]).all()
    middles = olinda_mesh.nodes[olinda_mesh.triangles].mean(axis=1)
    along, before = (np.hypot(*np.diff(m, axis=0).T) for m in (middles[order.rows], middles))
    assert along.mean() < before.mean() / 2


@pytest.mark.parametrize("preset", ["adaptive", "paper"])
def test_the_blocks_hold_the_mesh(preset, tmp_path):
    mesh = geomesh.mesh_raster(OLINDA, preset=preset)
    page = page_of(mesh, tmp_path)
    nodes, triangles = page.nodes(), page.triangles()
    of_nodes, of_triangles = page.ids()
    # The paper's nodes are on the lattice of an image of another size.
    step = 1 / 512 if preset == "paper" else 0
    np.testing.assert_allclose(nodes / 256, mesh.nodes[of_nodes], rtol=0, atol=step)
    assert (of_nodes[triangles] == mesh.triangles[of_triangles]).all()
    assert (np.sort(of_triangles) == np.arange(len(mesh.triangles))).all()
    levels = parse_colors(mesh.triangle_table["color"])
    assert (page.colors("mesh0-colors") == levels[of_triangles]).all()
    about = page.head["meshes"][0]
    assert about["gain"] == brightening(levels)
    assert about["surface"] == (preset == "adaptive")
    table = mesh.attributes("triangles")
    own = {*("id", "n0", "n1", "n2", "ab", "bc", "ca", "ki", "min_angle", "shape", "area", "color")}
    for name in table:
        if name in own:
            continue
        column, values, _ = page.column(name)
        expected = np.asarray(table[name], float)[of_triangles]
        np.testing.assert_allclose(values, expected, rtol=0, atol=column["step"] / 2 * 1.001)
        known = expected[~np.isnan(expected)]
        is_whole = (known == np.rint(known)).all()
        assert not is_whole or (values[~np.isnan(values)] == known).all()
        np.testing.assert_allclose(column["cut"], np.nanpercentile(expected, [2, 98]))
    if preset == "adaptive":
        for band in ("red", "green", "blue"):
            column, values, _ = page.column(band)
            assert column["at"] == "nodes"
            expected = mesh.node_table[band][of_nodes]
            np.testing.assert_allclose(values, expected, rtol=0, atol=column["step"] / 2 * 1.001)
        shown = np.column_stack([mesh.node_table[b] for b in ("red", "green", "blue")])
        expected = np.rint(np.clip(shown, 0, 255))[of_nodes]
        assert (page.colors("mesh0-surface") == expected).all()


def test_the_lines_are_the_outline_and_the_breaklines(tmp_path):
    mesh = geomesh.mesh_raster(OLINDA, nodes=600, breaklines="canny")
    page = page_of(mesh, tmp_path)
    about, (of_nodes, _) = page.head["meshes"][0], page.ids()
    ends = np.column_stack([np.cumsum(part) for part in page.signed("mesh0-lines", 2)])
    pairs = {tuple(sorted(pair)) for pair in of_nodes[ends].tolist()}
    edges = mesh.edges
    outline = {tuple(pair) for pair in edges.nodes[edges.uses == 1].tolist()}
    assert about["breaklines"] > 10
    assert pairs == outline | {tuple(sorted(pair)) for pair in mesh.constraints.tolist()}
    assert len(ends) == about["lines"] == len(pairs)
    first = {tuple(sorted(pair)) for pair in of_nodes[ends[: -about["breaklines"]]].tolist()}
    assert first == outline


def test_colours_of_a_surface_of_16_bits_are_stretched_as_those_of_triangles(tmp_path):
    path = SAMPLES / "iguacu_landsat8_rgb_uint16.tif"
    mesh = geomesh.mesh_raster(path, nodes=900)
    page = page_of(mesh, tmp_path)
    of_nodes, of_triangles = page.ids()
    at_nodes = page.colors("mesh0-surface").astype(float)
    means = at_nodes[page.triangles()].mean(axis=1)
    difference = means - page.colors("mesh0-colors")
    # The mean of a linear surface is that of its corners, but for what was cut at 0 and 255.
    assert np.abs(np.median(difference)) < 1.5
    assert np.percentile(np.abs(difference), 75) < 16
    assert (np.sort(of_triangles) == np.arange(len(mesh.triangles))).all()
    assert len(of_nodes) == len(mesh.nodes)


def test_a_mesh_of_an_older_version_has_flat_colours(olinda_mesh, tmp_path):
    mesh = replace(olinda_mesh, provenance=replace(olinda_mesh.provenance, display=None))
    assert not page_of(mesh, tmp_path).head["meshes"][0]["surface"]


def test_display_is_recorded_and_read_again(olinda_mesh, tmp_path):
    shown = olinda_mesh.provenance.display
    assert shown.bands == ("red", "green", "blue")
    assert shown.ranges == ((0.0, 255.0),) * 3
    again = geomesh.read_mesh(olinda_mesh.to_file(tmp_path / "mesh.gpkg"))
    assert again.provenance.display == shown


def with_column(mesh, **columns):
    return replace(mesh, triangle_table=mesh.triangle_table.with_columns(columns))


def test_values_that_are_missing_infinite_or_text(olinda_mesh, tmp_path):
    count = len(olinda_mesh.triangles)
    rows = np.arange(count)
    texts = np.array(["<script>alert(1)</script>", "北京", "a \"quoted\" 'name'", None], object)[
        rows % 4
    ]
    mesh = with_column(
        olinda_mesh,
        some=np.where(rows % 3, rows / 7.0, np.nan),
        endless=np.where(rows == 5, np.inf, 2.5),
        nothing=np.full(count, np.nan),
        huge=np.where(rows % 2, 1.7e308, -1.7e308),
        truth=rows % 2 == 0,
        day=np.array(["2026-11-29", "NaT"], "datetime64[ms]")[rows % 2],
        name=texts,
        red_majority=np.where(rows % 5, rows % 5 * 10, -1).astype(np.int32),
    )
    page = page_of(mesh, tmp_path)
    _, of_triangles = page.ids()
    for name in ("some", "endless", "nothing", "huge"):
        column, values, _ = page.column(name)
        expected = mesh.triangle_table[name][of_triangles]
        expected = np.where(np.isfinite(expected), expected, np.nan)
        np.testing.assert_allclose(values, expected, rtol=0, atol=column["step"] * 0.5001)
    for name, expected in (
        ("truth", np.where(rows % 2 == 0, "true", "false")),
        ("name", np.where(rows % 4 == 3, "", texts.astype(str))),
        ("day", np.where(rows % 2, "", "2026-11-29T00:00:00.000")),
        ("red_majority", np.where(rows % 5, (rows % 5 * 10).astype(str), "")),
    ):
        column, _, codes = page.column(name)
        assert column["kind"] == "classes"
        found = [column["texts"][code] if code != NULL else "" for code in codes.tolist()]
        assert found == expected[of_triangles].tolist()
    assert "<script>alert" not in page.text


def test_too_many_different_texts_are_left_out_with_a_warning(olinda_mesh, monkeypatch):
    monkeypatch.setattr("geomesh.view.web_map.columns.NULL", 100)
    names = np.array([f"name {k}" for k in range(len(olinda_mesh.triangles))], object)
    with pytest.warns(GeomeshWarning, match="the map leaves out label: more than 100 different"):
        assert encode_columns(with_column(olinda_mesh, label=names), ["label"]) == []


def test_a_mesh_without_colours_is_gray(olinda_mesh, tmp_path):
    bare = replace(olinda_mesh, triangle_table=Table({}), provenance=None)
    page = page_of(bare, tmp_path)
    about = page.head["meshes"][0]
    assert not about["colored"]
    assert not about["columns"]
    assert (page.colors("mesh0-colors") == 128).all()
    odd = with_column(olinda_mesh, color=np.full(len(olinda_mesh.triangles), "red"))
    assert not page_of(odd, tmp_path).head["meshes"][0]["colored"]


def test_columns_are_chosen(olinda_mesh, tmp_path, monkeypatch):
    def names(**options):
        columns = page_of(olinda_mesh, tmp_path, **options).head["meshes"][0]["columns"]
        return [column["key"] for column in columns]

    assert names(columns=[]) == []
    assert names(columns="count") == ["count"]
    assert names(columns=["red_std", "ki", "blue"]) == ["red_std", "blue"]
    assert names(columns=["count"], column="red_max") == ["count", "red_max"]
    everything = names()
    assert {"red_std", "red_max_error", "red"} <= set(everything)
    monkeypatch.setattr("geomesh.view.web_map.columns._MOST_WITH_ALL", 100)
    assert names() == ["count", "red_mean", "green_mean", "blue_mean"]
    with pytest.raises(OutputError, match="the triangles have no column 'nope': choose from id, "):
        page_of(olinda_mesh, tmp_path, columns=["nope"])
    with pytest.raises(OutputError, match="no column 'nope'"):
        page_of(olinda_mesh, tmp_path, column="nope")


PLACES = {
    **ORIENTATIONS,
    "geographic": Grid(40, 30, Affine(0.01, 0, 10, 0, -0.01, 60.15), CRS(4326)),
    "antimeridian": Grid(40, 30, Affine(0.05, 0, 179, 0, -0.05, 10), CRS(4326)),
    "pacific": Grid(40, 30, Affine(50_000, 0, -1e6, 0, -50_000, 1e6), CRS(3832)),
    "large": Grid(
        40, 30, Affine(1e5, 0, -2e6, 0, -1e5, 1.5e6), CRS("+proj=laea +lat_0=52 +lon_0=10")
    ),
    "Mars": Grid(40, 30, Affine(0.1, 0, 0, 0, -0.1, 0), CRS("IAU_2015:49900")),
    "space": Grid(40, 30, Affine(4e5, 0, -8e6, 0, -4e5, 6e6), CRS("+proj=geos +h=35785831")),
    "rotated pole": Grid(
        40,
        30,
        Affine(0.1, 0, -2, 0, -0.1, 1.5),
        CRS("+proj=ob_tran +o_proj=longlat +o_lat_p=39 +lon_0=18"),
    ),
}


@pytest.mark.parametrize("place", PLACES)
def test_places_are_where_they_are(place, tmp_path):
    mesh = frame_mesh(PLACES[place])
    frame = page_of(geomesh.Mesh.of(mesh), tmp_path).head["frame"]
    a, b, c, d, e, f = frame["affine"]
    lattice = mesh.nodes * 256
    placed = lattice @ [[a, d], [b, e]] + (c, f)
    np.testing.assert_allclose(placed, mesh.map_nodes, rtol=1e-12, atol=1e-9)
    crs = mesh.grid.crs
    if place in ("no georeference", "space"):
        assert frame["lonlat"] is None
        return
    lonlat = frame["lonlat"]
    left, top, right, bottom = frame["box"]
    target = crs.geodetic_crs if place == "Mars" else CRS("OGC:CRS84")
    transformer = Transformer.from_crs(crs, target, always_xy=True)
    lon, lat = transformer.transform(*mesh.map_nodes.T)
    side = lonlat["side"]
    axes = np.linspace(top, bottom, side), np.linspace(left, right, side)
    found = [
        RegularGridInterpolator(axes, np.array(lonlat[axis]).reshape(side, side))(lattice[:, ::-1])
        for axis in ("lon", "lat")
    ]
    away = (found[0] - lon + 180) % 360 - 180
    shown = 10.0 ** -lonlat["decimals"]
    assert max(np.abs(away).max(), np.abs(found[1] - lat).max()) < shown


def test_a_dem_with_heights_is_shown_by_height(tmp_path):
    mesh = geomesh.mesh_raster(COLORADO, nodes=200, z=1, z_factor=2)
    page = page_of(mesh, tmp_path, columns=[])
    (about,) = page.head["meshes"]
    assert about["height"] == {"key": "b1", "metres": 2.0}
    assert page.head["column"] == "b1"
    of_nodes, _ = page.ids()
    column, values, _ = page.column("b1")
    expected = mesh.node_table["b1"][of_nodes]
    np.testing.assert_allclose(values, expected, rtol=0, atol=column["step"] / 2 * 1.001)
    assert page_of(mesh, tmp_path, column="color").head["column"] == ""
    feet = geomesh.mesh_raster(COLORADO, nodes=200, preset="features", z=1)
    column, _, _ = page_of(feet, tmp_path).column("b1")
    assert column["at"] == "nodes"
    assert column["unit"] == "m"


def test_two_meshes_lie_on_one_lattice(olinda_mesh, tmp_path):
    part = geomesh.mesh_raster(OLINDA, nodes=200, bounds=(290000, 9112000, 294000, 9116000))
    page = page_of(olinda_mesh, tmp_path, other=part)
    a, b, c, d, e, f = page.head["frame"]["affine"]
    of_nodes, _ = page.ids(1)
    placed = page.nodes(1) @ [[a, d], [b, e]] + (c, f)
    pixel = olinda_mesh.grid.transform.a
    np.testing.assert_allclose(placed, part.map_nodes[of_nodes], rtol=0, atol=pixel / 512 * 1.01)
    x0, y0, x1, y1 = page.head["frame"]["box"]
    assert (x0, y0) == (0, 0)
    assert (x1, y1) == (349 * 256, 352 * 256)
    assert [about["name"] for about in page.head["meshes"]] == [OLINDA.name, OLINDA.name]


def test_meshes_in_two_crs_are_refused(olinda_mesh, tmp_path):
    other = geomesh.mesh_raster(COLORADO, nodes=100)
    with pytest.raises(GeoreferenceError, match="first mesh is in EPSG:31985 and the second in EP"):
        olinda_mesh.to_html(tmp_path / "map.html", other=other)
    assert not list(tmp_path.iterdir())


def test_the_raster_beside_the_mesh(olinda_mesh, tmp_path):
    page = page_of(olinda_mesh, tmp_path, embed=OLINDA)
    about = page.head["image"]
    assert about["name"] == OLINDA.name
    a, b, c, d, e, f = about["affine"]
    assert (a, e) == pytest.approx((349 * 256, 352 * 256))
    assert (b, c, d, f) == pytest.approx((0, 0, 0, 0), abs=1e-6)
    shown = cv2.imdecode(np.frombuffer(page.blocks["image"], np.uint8), cv2.IMREAD_UNCHANGED)
    with rasterio.open(OLINDA) as dataset:
        pixels = np.moveaxis(dataset.read(), 0, -1)
    assert shown.shape[:2] == pixels.shape[:2]
    assert np.abs(shown[..., 2::-1].astype(int) - pixels).mean() < 4  # it is compressed


def test_a_raster_in_another_crs_is_brought_to_the_mesh(olinda_mesh, tmp_path):
    with rasterio.open(OLINDA) as dataset:
        from rasterio.vrt import WarpedVRT

        with WarpedVRT(dataset, crs="EPSG:4326") as warped:
            profile = warped.profile | {"driver": "GTiff", "photometric": "RGB"}
            pixels = warped.read()
            transform = warped.transform
    profile = {key: profile[key] for key in ("driver", "width", "height", "count", "dtype", "crs")}
    with rasterio.open(tmp_path / "degrees.tif", "w", transform=transform, **profile) as dataset:
        dataset.write(pixels)
    page = page_of(olinda_mesh, tmp_path, embed=tmp_path / "degrees.tif")
    shown = cv2.imdecode(np.frombuffer(page.blocks["image"], np.uint8), cv2.IMREAD_UNCHANGED)
    with rasterio.open(OLINDA) as dataset:
        expected = np.moveaxis(dataset.read(), 0, -1).astype(np.uint8)
    small = cv2.resize(shown[..., 2::-1], expected.shape[1::-1], interpolation=cv2.INTER_AREA)
    inner = np.s_[10:-10, 10:-10]
    correlation = np.corrcoef(small[inner].ravel(), expected[inner].ravel())[0, 1]
    assert correlation > 0.95


def test_a_raster_elsewhere_is_refused(olinda_mesh, tmp_path):
    with pytest.raises(geomesh.errors.GeomeshError, match="no pixels where the mesh is"):
        page_of(olinda_mesh, tmp_path, embed=COLORADO)
    plain = geomesh.mesh_raster(
        (np.eye(30, dtype=np.uint8) * 200, Affine.identity(), None), nodes=40
    )
    with pytest.raises(GeoreferenceError, match="use the raster from which"):
        page_of(plain, tmp_path, embed=OLINDA)
    with pytest.raises(OutputError, match="two meshes and a raster do not fit"):
        page_of(olinda_mesh, tmp_path, embed=OLINDA, other=olinda_mesh)


def test_the_policy_allows_the_program_of_the_page_and_nothing_else(olinda_mesh, tmp_path):
    page = page_of(olinda_mesh, tmp_path)
    (policy,) = re.findall(r'http-equiv="Content-Security-Policy" content="([^"]*)"', page.text)
    rules = dict(rule.strip().split(" ", 1) for rule in policy.split(";"))
    assert rules["default-src"] == "'none'"
    assert rules["img-src"] == "data:"
    for kind, pattern in (
        ("script", r"<script>(.*?)</script>"),
        ("style", r"<style>(.*?)</style>"),
    ):
        (text,) = re.findall(pattern, page.text, re.DOTALL)
        digest = base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
        assert rules[f"{kind}-src"] == f"'sha256-{digest}'"
    assert not re.search(r"https?://", page.text)
    page = page_of(olinda_mesh, tmp_path, basemap="https://tiles.example.org/{z}/{x}/{y}.png")
    assert "img-src data: https://tiles.example.org" in page.text
    assert page.head["frame"]["mercator"]["side"] == 33


@pytest.mark.parametrize(
    "address",
    [
        "tiles",
        "file:///{z}/{x}/{y}",
        "https://a/{z}/{x}.png",
        "https://a'; x/{z}/{x}/{y}",
        "https:///{z}{x}{y}",
    ],
)
def test_a_base_map_that_is_none_is_refused(address, olinda_mesh, tmp_path):
    with pytest.raises(OutputError, match=r"is not an address of web tiles: write it as https://h"):
        page_of(olinda_mesh, tmp_path, basemap=address)


def test_a_title_is_text(olinda_mesh, tmp_path):
    title = '<script>alert("1")</script> <!--head--> & 北京'
    page = page_of(olinda_mesh, tmp_path, title=title)
    assert f"<title>{html.escape(title)}</title>" in page.text
    assert "<script>alert" not in page.text


def test_the_same_mesh_gives_the_same_bytes(olinda_mesh, tmp_path):
    first, second = (
        olinda_mesh.to_html(tmp_path / f"{k}.html").read_bytes() for k in ("one", "two")
    )
    assert first == second


def test_too_many_triangles_are_refused(olinda_mesh, tmp_path, monkeypatch):
    monkeypatch.setattr(page_module, "MOST_TRIANGLES", 100)
    with pytest.raises(OutputError, match=r"triangles are too many for one page \(at most 100\)"):
        olinda_mesh.to_html(tmp_path / "map.html")
    with pytest.raises(OutputError, match="too many"):
        olinda_mesh.explore()
    assert not list(tmp_path.iterdir())


def test_an_output_that_cannot_be_written(olinda_mesh, tmp_path):
    with pytest.raises(OutputError, match=r"map\.png is not named as a page: name it \.html"):
        olinda_mesh.to_html(tmp_path / "map.png")
    old = tmp_path / "map.html"
    old.write_text("old")
    with pytest.raises(OutputError, match="exists"):
        olinda_mesh.to_html(old)
    with pytest.raises(OutputError, match="folder"):
        olinda_mesh.to_html(tmp_path / "missing" / "map.html")
    with pytest.raises(OutputError, match="no column"):
        olinda_mesh.to_html(old, overwrite=True, columns=["nope"])
    assert old.read_text() == "old"
    assert olinda_mesh.to_html(old, overwrite=True) == old


def test_one_triangle(tmp_path):
    grid = Grid(4, 4, Affine(10, 0, 500_000, 0, -10, 4_000_000), CRS(32631))
    mesh = frame_mesh(grid)
    one = replace(mesh, triangles=mesh.triangles[:1], triangle_table=Table({}))
    page = page_of(geomesh.Mesh.of(one), tmp_path)
    assert len(page.nodes()) == 3
    assert page.triangles().tolist() == [[0, 1, 2]]


def test_a_notebook_shows_the_page_in_a_frame(olinda_mesh):
    shown = olinda_mesh.explore("red_mean", height=300)
    frame = shown._repr_html_()
    (source,) = re.findall(r'srcdoc="([^"]*)"', frame)
    assert html.unescape(source) == shown.page
    assert 'sandbox="allow-scripts"' in frame
    assert "height:300px" in frame
    assert '"column":"red_mean"' in shown.page
    assert len(repr(shown)) < 60
