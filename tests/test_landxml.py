"""LandXML files: read with lxml, and checked against the rules of the published schema.

No package has the schema itself. What is tested of it: the order and number of the elements, their
required attributes, and the words that units and kinds may be.
"""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pytest
from affine import Affine
from lxml import etree
from pyproj import CRS

from geomesh.errors import GeoreferenceError, OutputError
from geomesh.formats.document import build_document
from geomesh.formats.landxml import FORMAT as LANDXML
from geomesh.raster.grid import Grid
from support.meshes import GEOREFERENCES, frame_mesh, provenance
from support.terrain import (
    HOSTILE,
    edges_of,
    expected,
    is_counter_clockwise,
    small_tin,
    utm_tin,
    with_voids,
    write,
)

SPACE = "{http://www.landxml.org/schema/LandXML-1.2}"
# Children in their order: names with ? may be missing, with + there are several.
CHILDREN = {
    "LandXML": "Units CoordinateSystem? Project Application Surfaces",
    "Units": "Metric? Imperial?",
    "Project": "Feature",
    "Feature": "Property",
    "Surfaces": "Surface",
    "Surface": "SourceData Definition",
    "SourceData": "Boundaries Breaklines?",
    "Boundaries": "Boundary+",
    "Boundary": "PntList3D",
    "Breaklines": "Breakline+",
    "Breakline": "PntList3D",
    "Definition": "Pnts Faces",
    "Pnts": "P+",
    "Faces": "F+",
}
_UNITS = "areaUnit linearUnit volumeUnit temperatureUnit pressureUnit"
REQUIRED = {
    "LandXML": "date time version",
    "Metric": _UNITS,
    "Imperial": _UNITS,
    "Project": "name",
    "Application": "name",
    "Property": "label value",
    "Surface": "name",
    "Boundary": "bndType edgeTrim",
    "Definition": "surfType",
    "P": "id",
}
WORDS = {
    ("Metric", "linearUnit"): "millimeter centimeter meter kilometer",
    ("Metric", "areaUnit"): "hectare squareMeter squareMillimeter squareCentimeter",
    ("Metric", "volumeUnit"): "cubicMeter liter hectareMeter",
    ("Metric", "temperatureUnit"): "celsius kelvin",
    ("Metric", "pressureUnit"): "HPA milliBars mmHG millimeterHG",
    ("Metric", "elevationUnit"): "meter kilometer feet miles",
    ("Imperial", "linearUnit"): "foot USSurveyFoot inch mile",
    ("Imperial", "areaUnit"): "acre squareFoot squareInch squareMiles",
    ("Imperial", "volumeUnit"): "US_gallon IMP_gallon cubicInch cubicFeet cubicYard acreFeet",
    ("Imperial", "temperatureUnit"): "fahrenheit kelvin",
    ("Imperial", "pressureUnit"): "inchHG inHG",
    ("Imperial", "elevationUnit"): "meter kilometer feet miles",
    ("Boundary", "bndType"): "outer void island",
    ("Boundary", "edgeTrim"): "true false",
    ("Breakline", "brkType"): "standard wall proximity nondestructive",
    ("Definition", "surfType"): "TIN grid",
}


def check_rules(root: etree._Element) -> None:
    assert re.fullmatch(r"\d{4}-\d\d-\d\d", root.get("date"))
    assert re.fullmatch(r"\d\d:\d\d:\d\d", root.get("time"))
    assert root.get("version") == "1.2"
    for element in root.iter():
        name = element.tag.removeprefix(SPACE)
        children = "".join(f"{child.tag.removeprefix(SPACE)} " for child in element)
        allowed = CHILDREN.get(name, "").split()
        pattern = "".join(
            f"({each.rstrip('?+')} ){each[-1:] * (each[-1] in '?+')}" for each in allowed
        )
        assert re.fullmatch(pattern, children), (name, children[:80])
        assert set(REQUIRED.get(name, "").split()) <= set(element.attrib), name
        for attribute, value in element.attrib.items():
            known = WORDS.get((name, attribute))
            assert known is None or value in known.split(), (name, attribute, value)
    ids = [int(point.get("id")) for point in root.iter(f"{SPACE}P")]
    assert ids == list(range(1, len(ids) + 1))


class Read:
    """What lxml finds in a file; points are given back as x, y, height."""

    def __init__(self, path):
        self.root = etree.parse(path, etree.XMLParser(huge_tree=True)).getroot()
        check_rules(self.root)
        texts = [point.text.split() for point in self.find("P")]
        self.points = np.array(texts, float)[:, [1, 0, 2]]
        self.faces = np.array([face.text.split() for face in self.find("F")], int)
        self.unit = self.find("Units")[0][0]
        self.definition = self.find("Definition")[0]

    def find(self, name):
        return list(self.root.iter(f"{SPACE}{name}"))

    def lines(self, name):
        found = [each[0].text.split() for each in self.find(name)]
        return [np.array(text, float).reshape(-1, 3)[:, [1, 0, 2]] for text in found]


def test_the_surface_of_a_dem_is_read_back_to_the_last_bit(tmp_path):
    mesh = utm_tin()
    path, told = write(mesh, tmp_path / "mesh.xml")
    read, wanted = Read(path), expected(mesh)
    assert np.array_equal(read.points[read.faces - 1], wanted.corners)
    assert is_counter_clockwise(read.points[read.faces - 1])
    assert len(np.unique(read.points, axis=0)) == len(read.points)
    assert len(read.find("Breakline")) == 1
    assert wanted.breaklines
    assert set(edges_of(read.lines("Breakline"))) == wanted.breaklines
    rings = read.lines("Boundary")
    assert all(np.array_equal(ring[0], ring[-1]) for ring in rings)
    assert set(edges_of(rings)) == wanted.outline
    assert [each.get("bndType") for each in read.find("Boundary")] == ["outer"]
    assert told == []
    (system,) = read.find("CoordinateSystem")
    assert system.get("epsgCode") == "26913"
    assert CRS.from_wkt(system.get("ogcWktCode")).equals(mesh.grid.crs, ignore_axis_order=True)
    assert read.unit.get("linearUnit") == "meter"
    assert LANDXML.count_rows(path, "triangles") == len(wanted.corners)
    assert LANDXML.read_document(path) == build_document(mesh, mesh.certify())


def test_areas_and_lowest_and_highest_point(tmp_path):
    read = Read(write(small_tin(), tmp_path / "mesh.landxml")[0])
    about = {
        name: float(value) for name, value in read.definition.attrib.items() if name[0] in "ae"
    }
    assert about["area2DSurf"] == pytest.approx(40 * 30 * 30.1**2, rel=1e-12)
    a, b, c = np.moveaxis(read.points[read.faces - 1], 1, 0)
    sides = [np.linalg.norm(side, axis=1) for side in (b - a, c - b, a - c)]
    half = sum(sides) / 2
    heron = np.sqrt(half * np.prod([half - side for side in sides], axis=0))
    assert about["area3DSurf"] == pytest.approx(heron.sum(), rel=1e-9)
    assert (about["elevMin"], about["elevMax"]) == (
        read.points[:, 2].min(),
        read.points[:, 2].max(),
    )


@pytest.mark.parametrize(
    ("crs", "unit", "name", "factor"),
    [
        ("EPSG:2232", "US survey foot", "USSurveyFoot", None),
        ("EPSG:2232", "metre", "USSurveyFoot", 3937 / 1200),
        ("EPSG:2223", "US survey foot", "foot", 1200 / 3937 / 0.3048),
        ("EPSG:32613", "foot", "meter", 0.3048),
        ("EPSG:32613+5703", "metre", "meter", None),
    ],
)
def test_heights_are_in_the_unit_of_x_and_y(tmp_path, crs, unit, name, factor):
    mesh = small_tin(crs, unit)
    path, told = write(mesh, tmp_path / "mesh.xml")
    read = Read(path)
    kind = "Metric" if name == "meter" else "Imperial"
    assert (read.unit.tag, read.unit.get("linearUnit")) == (f"{SPACE}{kind}", name)
    heights = mesh.heights if factor is None else mesh.heights * factor
    if factor is None:
        assert told == []
        assert np.array_equal(read.points[:, 2], heights)
    else:
        assert len(told) == 1
        assert re.match(
            f"the heights are converted from {unit} to .*, because LandXML has", told[0]
        )
        assert read.points[:, 2] == pytest.approx(heights, rel=1e-14)
    (system,) = read.find("CoordinateSystem")
    assert system.get("epsgCode") == crs.partition(":")[2].partition("+")[0]
    vertical = system.get("verticalCoordinateSystemName")
    assert vertical == ("NAVD88 height" if "+" in crs else None)


def test_voids_are_left_out_and_become_boundaries(tmp_path):
    mesh = with_voids(small_tin(), [0, 7])
    path, told = write(mesh, tmp_path / "mesh.xml")
    read, wanted = Read(path), expected(mesh)
    assert np.array_equal(read.points[read.faces - 1], wanted.corners)
    kinds = [each.get("bndType") for each in read.find("Boundary")]
    assert kinds[0] == "outer"
    assert "void" in kinds
    assert sorted(map(sorted, edges_of(read.lines("Boundary")))) == sorted(
        map(sorted, wanted.outline)
    )
    assert told[-1].endswith("triangles have no heights and are left out")


def test_without_a_crs_the_unit_is_said_to_be_that_of_the_heights(tmp_path):
    path, told = write(small_tin(None, "foot"), tmp_path / "mesh.xml")
    read = Read(path)
    assert read.find("CoordinateSystem") == []
    assert read.unit.get("linearUnit") == "foot"
    assert told == [
        "the mesh has no CRS, and LandXML must name a unit: x and y are said to be in foot"
    ]


def test_angles_are_refused_with_the_zone_that_fits(tmp_path):
    geographic = small_tin(None)
    for crs, origin, zone in (
        ("EPSG:4269", (-105.3, 40.1), "EPSG:26913"),
        ("EPSG:4326", (151.1, -33.9), "EPSG:32756"),
        ("EPSG:4326", (-181.9, -17.9), "EPSG:32760"),
    ):
        mesh = replace(geographic, grid=degrees(crs, *origin))
        with pytest.raises(GeoreferenceError, match=f"are angles: .*gdalwarp -t_srs {zone}$"):
            write(mesh, tmp_path / "mesh.xml")
    mars = replace(geographic, grid=replace(GEOREFERENCES["Mars"], width=40, height=30))
    with pytest.raises(GeoreferenceError, match=r"gdalwarp to a projected CRS$"):
        write(mars, tmp_path / "mesh.xml")
    with pytest.raises(GeoreferenceError, match="no name for the unit 'British yard"):
        write(small_tin("EPSG:27291"), tmp_path / "mesh.xml")
    assert list(tmp_path.iterdir()) == []


def degrees(crs, x, y):
    return Grid(40, 30, Affine(0.01, 0, x, 0, -0.01, y), CRS(crs))


def test_a_mesh_without_heights_is_refused(tmp_path):
    with pytest.raises(OutputError, match=r"LandXML needs heights, and the mesh has none: .*`z=1`"):
        write(frame_mesh(GEOREFERENCES["north-up"]), tmp_path / "mesh.xml")
    nothing = with_voids(small_tin(), list(range(29)))
    with pytest.raises(OutputError, match="no triangle of the mesh has any"):
        write(nothing, tmp_path / "mesh.xml")
    assert list(tmp_path.iterdir()) == []


def test_any_name_is_written_as_xml(tmp_path):
    mesh = small_tin(provenance=provenance(name=f"a/{HOSTILE}", warnings=(HOSTILE, "\udc80")))
    path, _ = write(mesh, tmp_path / "mesh.xml")
    (surface,) = Read(path).find("Surface")
    assert surface.get("name") == "<&>\"'北京__--.tif"
    assert LANDXML.read_document(path) == build_document(mesh, mesh.certify())


def test_damage_is_noticed(tmp_path):
    path, _ = write(small_tin(), tmp_path / "mesh.xml")
    whole = path.read_bytes()
    for kept in (0.0, 0.3, 0.7, 0.99):
        path.write_bytes(whole[: int(kept * len(whole))])
        with pytest.raises(OSError, match="damaged"):
            LANDXML.count_rows(path, "triangles")
    for old, new in ((b"<F>", b"<F>9"), (b"<F>", b"<F>0 "), (b'<P id="2">', b'<P id="2">x')):
        path.write_bytes(whole.replace(old, new, 1).replace(b"<F>9", b"<F>99"))
        with pytest.raises(OSError, match="damaged"):
            LANDXML.count_rows(path, "triangles")
    path.write_bytes(b"<LandXML></LandXML>")
    with pytest.raises(KeyError):
        LANDXML.read_document(path)
