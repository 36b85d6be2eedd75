"""LandXML 1.2 (http://www.landxml.org/schema/LandXML-1.2): a surface for civil engineering.

Points are northing, easting, height. There is one linear unit for all three. The elements are in
the order of the published schema; the metadata document is a property of the project.
"""

from __future__ import annotations

from datetime import UTC, datetime
from typing import TYPE_CHECKING
from xml.sax.saxutils import quoteattr

from geomesh._version import __version__
from geomesh.errors import GeoreferenceError
from geomesh.formats.format import Format, LayerFile, WriteOptions, WriteRows, layer_with_heights

if TYPE_CHECKING:
    from pathlib import Path
    from typing import BinaryIO

    import numpy as np
    from numpy.typing import NDArray
    from pyproj import CRS

    from geomesh.formats.arrow import Layer
    from geomesh.formats.batch_stream import BatchStream
    from geomesh.formats.tin_lines import TinLines
    from geomesh.formats.tin_units import LinearUnit
    from geomesh.mesh.triangle_mesh import TriangleMesh

_DRIVER = "LandXML"
_NAMESPACE = "http://www.landxml.org/schema/LandXML-1.2"

# Kind, linear unit and area unit of LandXML, and metres.
_UNITS = (
    ("Metric", "meter", "squareMeter", 1.0),
    ("Metric", "millimeter", "squareMillimeter", 0.001),
    ("Metric", "centimeter", "squareCentimeter", 0.01),
    ("Metric", "kilometer", "squareMeter", 1000.0),
    ("Imperial", "foot", "squareFoot", 0.3048),
    ("Imperial", "USSurveyFoot", "squareFoot", 1200 / 3937),
    ("Imperial", "inch", "squareInch", 0.0254),
    ("Imperial", "mile", "squareMiles", 1609.344),
)
# All of these the schema requires, also where nothing has such a unit.
_OTHER_UNITS = {
    "Metric": {
        "volumeUnit": "cubicMeter",
        "temperatureUnit": "celsius",
        "pressureUnit": "milliBars",
    },
    "Imperial": {
        "volumeUnit": "cubicFeet",
        "temperatureUnit": "fahrenheit",
        "pressureUnit": "inchHG",
    },
}
# The unit of their areas is not that of lengths, squared.
_OTHER_AREAS = ("kilometer",)


def _unit(mesh: TriangleMesh) -> LinearUnit:
    """Return the unit of the file, by its name in LandXML."""
    from geomesh.formats.tin_units import LinearUnit, height_unit, horizontal_unit

    wanted = horizontal_unit(mesh.grid.crs) or height_unit(mesh)
    for _, name, _, metres in _UNITS:
        if wanted.equals(metres):
            return LinearUnit(name, metres)
    raise GeoreferenceError(
        f"LandXML has no name for the unit {wanted.name!r}: reproject the raster to a CRS in "
        "metres or feet"
    )


def _notes(mesh: TriangleMesh, options: WriteOptions) -> tuple[str, ...]:  # noqa: ARG001
    from geomesh.formats.tin import notes_on_voids, require_heights, require_lengths
    from geomesh.formats.tin_units import horizontal_unit, note_on_conversion

    require_heights(mesh, _DRIVER)
    require_lengths(mesh, _DRIVER)
    unit = _unit(mesh)
    own = horizontal_unit(mesh.grid.crs)
    notes = note_on_conversion(mesh, _DRIVER, own) + notes_on_voids(mesh)
    if own is not None:
        return notes
    return (
        f"the mesh has no CRS, and LandXML must name a unit: x and y are said to be in {unit.name}",
        *notes,
    )


def _write(layer: Layer, file: LayerFile, stream: BatchStream, by_gdal: WriteRows) -> None:  # noqa: ARG001
    """Write the surface row by row: a tree of a million points would need gigabytes."""
    import numpy as np

    from geomesh.formats.tin import tin_of
    from geomesh.formats.tin_lines import lines_of
    from geomesh.formats.tin_text import name_of, write_rows
    from geomesh.formats.tin_units import converted, height_unit, told_crs

    mesh, tin = file.mesh, tin_of(file.mesh)
    unit = _unit(mesh)
    east, north, heights = tin.points.T
    heights = converted(heights, height_unit(mesh), unit)
    points = np.column_stack([north, east, heights])
    name = name_of(mesh)
    with file.path.open("wb") as out:
        _write_head(out, mesh, unit, name, file.document)
        _open(out, "Surfaces")
        _open(out, "Surface", name=name, desc=told_crs(mesh))
        _write_source(out, points, lines_of(mesh, tin))
        about = _measures(points, tin.triangles, unit)
        _open(out, "Definition", surfType="TIN", **about)
        _open(out, "Pnts")
        ids = np.arange(1, len(points) + 1)
        write_rows(out, '<P id="%d">%r %r %r</P>\n', (ids, *points.T))
        _close(out, "Pnts")
        _open(out, "Faces")
        write_rows(out, "<F>%d %d %d</F>\n", [*(tin.triangles + 1).T], stream.advance)
        _close(out, "Faces", "Definition", "Surface", "Surfaces", "LandXML")


def _open(out: BinaryIO, element: str, end: str = "", **attributes: str) -> None:
    from geomesh.formats.tin_text import one_line_of

    told = "".join(f" {name}={quoteattr(one_line_of(value))}" for name, value in attributes.items())
    out.write(f"<{element}{told}{end}>\n".encode())


def _close(out: BinaryIO, *elements: str) -> None:
    out.write("".join(f"</{element}>\n" for element in elements).encode())


def _write_head(
    out: BinaryIO, mesh: TriangleMesh, unit: LinearUnit, name: str, document: str
) -> None:
    from geomesh.formats.document import KEY

    out.write(b'<?xml version="1.0" encoding="UTF-8"?>\n')
    now = datetime.now(UTC)
    root = {"xmlns": _NAMESPACE, "version": "1.2", "language": "English", "readOnly": "false"}
    _open(out, "LandXML", **root, date=f"{now:%Y-%m-%d}", time=f"{now:%H:%M:%S}")
    kind, area = next((kind, area) for kind, known, area, _ in _UNITS if known == unit.name)
    _open(out, "Units")
    # The defaults would be metres for elevations, and radians.
    told = {"elevationUnit": "feet" if kind == "Imperial" else "meter"}
    told |= dict.fromkeys(("angularUnit", "directionUnit"), "decimal degrees")
    linear = {"areaUnit": area, "linearUnit": unit.name}
    _open(out, kind, "/", **linear, **_OTHER_UNITS[kind], **told)
    _close(out, "Units")
    if mesh.grid.crs is not None:
        _open(out, "CoordinateSystem", "/", **_crs_attributes(mesh.grid.crs))
    _open(out, "Project", name=name)
    _open(out, "Feature", code=KEY, name="how the surface was made")
    _open(out, "Property", "/", label=KEY, value=document)
    _close(out, "Feature", "Project")
    _open(out, "Application", "/", name="geomesh", version=__version__)


def _crs_attributes(crs: CRS) -> dict[str, str]:
    from geomesh.formats.crs_text import wkt1_or_wkt2
    from geomesh.raster.crs import horizontal

    plain = horizontal(crs)
    code = None if crs.is_bound else plain.to_epsg(min_confidence=100)
    attributes = {"name": plain.name, "ogcWktCode": wkt1_or_wkt2(crs)}
    if code is not None:
        attributes["epsgCode"] = str(code)
    if plain.datum is not None:
        attributes["horizontalDatum"] = plain.datum.name
    if crs.is_compound:
        attributes["verticalCoordinateSystemName"] = crs.sub_crs_list[-1].name
    return attributes


def _measures(
    points: NDArray[np.float64], triangles: NDArray[np.int32], unit: LinearUnit
) -> dict[str, str]:
    """Return lowest and highest point, and the areas where their unit is that of lengths."""
    import numpy as np

    told = {"elevMax": points[:, 2].max(), "elevMin": points[:, 2].min()}
    if unit.name not in _OTHER_AREAS:
        a, b, c = (points[triangles[:, k]] for k in range(3))
        double = np.cross(b - a, c - a)
        told["area2DSurf"] = np.abs(double[:, 2]).sum() / 2
        told["area3DSurf"] = np.linalg.norm(double, axis=1).sum() / 2
    return {name: repr(float(value)) for name, value in told.items()}


def _write_source(out: BinaryIO, points: NDArray[np.float64], lines: TinLines) -> None:
    """Write outline and breaklines; the faces lie within the outline already, so none is cut."""
    _open(out, "SourceData")
    _open(out, "Boundaries")
    for kind, rings in (("outer", lines.outer), ("void", lines.holes)):
        for number, ring in enumerate(rings, start=1):
            name = f"{kind} {number}"
            _open(out, "Boundary", bndType=kind, edgeTrim="false", name=name)
            _write_list(out, points[[*ring, ring[0]]])
            _close(out, "Boundary")
    _close(out, "Boundaries")
    if lines.breaklines:
        _open(out, "Breaklines")
        for number, line in enumerate(lines.breaklines, start=1):
            _open(out, "Breakline", brkType="standard", name=f"breakline {number}")
            _write_list(out, points[line])
            _close(out, "Breakline")
        _close(out, "Breaklines")
    _close(out, "SourceData")


def _write_list(out: BinaryIO, places: NDArray[np.float64]) -> None:
    text = " ".join(map(repr, places.ravel().tolist()))
    out.write(f"<PntList3D>{text}</PntList3D>\n".encode())


def _count_rows(path: Path, layer: str) -> int:
    from geomesh.formats.landxml_reading import count_rows

    return count_rows(path, layer)


def _read_document(path: Path) -> str:
    from geomesh.formats.landxml_reading import read_document

    return read_document(path)


FORMAT = Format(
    _DRIVER,
    (".xml", ".landxml"),
    _write,
    _count_rows,
    _read_document,
    layers=("triangles",),
    layer=layer_with_heights,
    leaves_out_voids=True,
    notes=_notes,
)
