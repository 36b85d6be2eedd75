"""UGRID 1.0 (https://ugrid-conventions.github.io) in NetCDF, written by scipy.

UGRID stores the mesh with its topology. QGIS opens it as a mesh layer through MDAL, which
reads the data on faces and the CRS. ParaView and xugrid read it too.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from geomesh._version import __version__
from geomesh.formats.format import Format, LayerFile, WriteRows
from geomesh.formats.names import legal_name

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path

    import numpy as np
    from numpy.typing import NDArray
    from pyproj import CRS

    from geomesh.formats.arrow import Layer
    from geomesh.formats.batch_stream import BatchStream
    from geomesh.mesh.triangle_mesh import TriangleMesh

_FACES = "mesh_face_nodes"

# The name of the variable in which MDAL looks for the CRS.
_CRS = "projected_coordinate_system"

# Attributes that are already in the topology.
_TOPOLOGY = ("id", "n0", "n1", "n2")

_COLOR = "color"

_UNITS = {
    **dict.fromkeys(("ab", "bc", "ca", "ki", "count"), "pixel"),
    **dict.fromkeys(("min_angle", "max_angle", "slope", "aspect"), "degree"),
}

# The size of a variable is stored in 32 bits with a sign; the largest has three corners a face.
_MOST_FACES = (2**31 - 1) // (3 * 4)

# Few enough for a renderer to list all colours of a mesh.
_MOST_COLORS = 4096


def _write(layer: Layer, file: LayerFile, stream: BatchStream, write_rows: WriteRows) -> None:  # noqa: ARG001
    """Write the triangles of a mesh; the document is stored as a global attribute.

    Attributes become data on faces, as float64. The values of a linear surface become data on
    nodes, so that a program can draw it. `color` becomes 65536 red + 256 green + blue,
    rounded to fewer levels until there are at most 4096 colours. Other text and dates are left
    out, because data on faces must be numbers. A name that is not legal in NetCDF becomes the
    `long_name` of its variable.
    """
    import numpy as np
    from scipy.io import netcdf_file

    from geomesh.formats.document import KEY

    crs = file.mesh.grid.crs
    corners = layer.vertices[:, :3]
    # 64-bit offsets: the file may be larger than 2 GB.
    with netcdf_file(file.path, "w", version=2) as dataset:
        dataset.Conventions = "CF-1.8 UGRID-1.0"
        dataset.source = f"geomesh {__version__}"
        setattr(dataset, KEY, file.document.encode())
        dataset.createDimension("mesh_node", len(layer.points))
        dataset.createDimension("mesh_face", len(corners))
        dataset.createDimension("three", 3)
        topology = {
            "cf_role": "mesh_topology",
            "topology_dimension": np.int32(2),
            "node_coordinates": "mesh_node_x mesh_node_y",
            "face_node_connectivity": _FACES,
            "face_dimension": "mesh_face",
        }
        _add(dataset, "mesh", (), np.array(0, np.int32), topology | _placed(crs))
        if crs is not None:
            _add(dataset, _CRS, (), np.array(0, np.int32), _crs_attributes(crs))
        for axis, values in zip("xy", layer.points.T, strict=True):
            _add(dataset, f"mesh_node_{axis}", ("mesh_node",), values, _axis(axis, crs))
        height = file.mesh.height
        if layer.heights is not None and height is not None:
            # MDAL looks for the heights of the nodes by this standard name.
            about = {"standard_name": "altitude", "units": height.unit.replace(" ", "_")}
            places = {"mesh": "mesh", "location": "node"} | _placed(crs)
            _add(dataset, "mesh_node_z", ("mesh_node",), layer.heights, about | places)
        numbering = {"cf_role": "face_node_connectivity", "start_index": np.int32(0)}
        _add(dataset, _FACES, ("mesh_face", "three"), corners, numbering)
        on_nodes = {"mesh": "mesh", "location": "node"} | _placed(crs)
        for name, values in _surface(file.mesh).items():
            _add_data(dataset, name, ("mesh_node",), values.astype(np.float64), on_nodes)
        units = _UNITS | dict.fromkeys(("area", "area_3d"), "pixel2" if crs is None else "m2")
        on_faces = {"mesh": "mesh", "location": "face"} | _placed(crs)
        for name, values in layer.columns.items():
            is_color = name == _COLOR and values.dtype.kind == "U"
            if name in _TOPOLOGY or not (is_color or values.dtype.kind in "biuf"):
                continue
            data = _packed(values) if is_color else values.astype(np.float64)
            unit = {"units": units[name]} if name in units else {}
            _add_data(dataset, name, ("mesh_face",), data, on_faces | unit)
    stream.rows += len(layer)


def _surface(mesh: TriangleMesh) -> dict[str, NDArray[Any]]:
    """Return the values at the nodes, band by band, if the mesh has a linear surface."""
    refinement = None if mesh.provenance is None else mesh.provenance.refinement
    if refinement is None or refinement.model != "linear":
        return {}
    nodes = mesh.attributes("nodes")
    return {band.name: nodes[band.name] for band in refinement.bands}


def _add_data(
    dataset: Any,
    name: str,
    dimensions: tuple[str, ...],
    values: NDArray[Any],
    attributes: Mapping[str, Any],
) -> None:
    legal = legal_name(name, dataset.variables)
    full = {} if legal == name else {"long_name": name.encode()}
    _add(dataset, legal, dimensions, values, {**attributes, **full})


def _add(
    dataset: Any,
    name: str,
    dimensions: tuple[str, ...],
    values: NDArray[Any],
    attributes: Mapping[str, Any],
) -> None:
    variable = dataset.createVariable(name, values.dtype, dimensions)
    variable.data[...] = values
    for attribute, value in attributes.items():
        setattr(variable, attribute, value)


def _packed(colors: NDArray[np.str_]) -> NDArray[np.float64]:
    """Return colours '#rrggbb' as numbers, 65536 red + 256 green + blue."""
    import numpy as np

    codes = np.array([int(color[1:], 16) for color in colors.tolist()], np.int64)
    channels = codes[:, None] >> np.array([16, 8, 0]) & 255
    packed = codes.astype(np.float64)
    for levels in (128, 64, 32, 16):
        if len(np.unique(packed)) <= _MOST_COLORS:
            break
        step = 255 / (levels - 1)
        packed = np.rint(np.rint(channels / step) * step) @ np.array([65536.0, 256.0, 1.0])
    return packed


def _placed(crs: CRS | None) -> dict[str, str]:
    # A grid mapping leads to the Earth, so a local CRS is none: xugrid refuses it.
    return {} if crs is None or crs.is_engineering else {"grid_mapping": _CRS}


def _crs_attributes(crs: CRS) -> dict[str, Any]:
    """Return the CRS as CF has it, and as MDAL reads it: an EPSG code, or else WKT."""
    import numpy as np

    from geomesh.formats.crs_text import cf_attributes, wkt1_or_wkt2

    attributes = cf_attributes(crs)
    code = None if crs.is_bound else crs.to_epsg(min_confidence=100)
    if code is None:
        attributes["wkt"] = wkt1_or_wkt2(crs)
    else:
        attributes |= {"epsg": np.int32(code), "EPSG_code": f"EPSG:{code}"}
    return {
        name: value.encode() if isinstance(value, str) else value
        for name, value in attributes.items()
    }


def _axis(axis: str, crs: CRS | None) -> dict[str, str]:
    from geomesh.raster.crs import has_angles, is_rotated

    if crs is None or not has_angles(crs):
        unit = crs.axis_info[0].unit_name.replace(" ", "_") if crs is not None else "unknown"
        units = {} if unit == "unknown" else {"units": unit}
        return {"standard_name": f"projection_{axis}_coordinate", **units}
    name = "longitude" if axis == "x" else "latitude"
    unit = crs.axis_info[0].unit_name
    if is_rotated(crs):
        return {"standard_name": f"grid_{name}", "units": f"{unit}s"}
    if unit != "degree":
        return {"standard_name": name, "units": unit}
    return {"standard_name": name, "units": f"degrees_{'east' if axis == 'x' else 'north'}"}


def _count_rows(path: Path, layer: str) -> int:  # noqa: ARG001
    from scipy.io import netcdf_file

    try:
        # Without memory mapping every value is read, so a truncated file is detected.
        with netcdf_file(path, mmap=False) as dataset:
            return len(dataset.variables[_FACES].data)
    except (IndexError, KeyError, TypeError, ValueError) as error:
        raise OSError(f"the NetCDF file is damaged: {error}") from error


def _read_document(path: Path) -> str:
    from scipy.io import netcdf_file

    from geomesh.formats.document import KEY

    with netcdf_file(path, mmap=False) as dataset:
        document: bytes = getattr(dataset, KEY, b"")
        return document.decode()


FORMAT = Format(
    "UGRID",
    (".nc",),
    _write,
    _count_rows,
    _read_document,
    layers=("triangles",),
    most_rows=_MOST_FACES,
)
