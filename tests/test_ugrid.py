"""UGRID files: read with xugrid, and directly."""

import re
from dataclasses import replace

import numpy as np
import pytest
import xugrid
from pyproj import CRS
from rasterio.transform import from_origin
from scipy.io import netcdf_file

import geomesh
from geomesh.arrays.table import Table
from geomesh.errors import OutputError
from geomesh.formats.ugrid import FORMAT as UGRID
from geomesh.io.write import write_mesh
from support.meshes import GEOREFERENCES, random_mesh, two_triangles


@pytest.mark.parametrize("grid", GEOREFERENCES.values(), ids=list(GEOREFERENCES))
def test_xugrid_finds_the_same_mesh(tmp_path, grid):
    mesh = random_mesh(grid)
    path = write_mesh(mesh, tmp_path / "mesh.nc")
    dataset = xugrid.open_dataset(path, engine="scipy")
    found = dataset.ugrid.grid
    assert np.array_equal(found.node_coordinates, mesh.map_nodes)
    assert np.array_equal(found.face_node_connectivity, mesh.triangles)
    for name in ("b1_mean", "ki", "count", "area"):
        expected = np.asarray(mesh.attributes("triangles")[name], np.float64)
        assert dataset[name].dims == (found.face_dimension,)
        assert np.array_equal(dataset[name].to_numpy(), expected, equal_nan=True)
    assert "name" not in dataset


@pytest.mark.parametrize("model", ["linear", "constant"])
def test_a_linear_surface_is_data_on_nodes(tmp_path, model):
    x, y = np.meshgrid(np.arange(24.0), np.arange(20.0))
    pixels = np.stack([x * y, 10 * np.sin(x)]).astype(np.float32)
    source = (pixels, from_origin(300000, 7000000, 30, 30), "EPSG:32723")
    mesh = geomesh.mesh_raster(source, preset="adaptive", nodes=40, model=model)
    mesh.to_file(tmp_path / "mesh.nc")
    with netcdf_file(tmp_path / "mesh.nc", mmap=False) as dataset:
        on_nodes = {
            name: variable.data.copy()
            for name, variable in dataset.variables.items()
            if getattr(variable, "location", b"") == b"node"
        }
    if model == "constant":
        assert on_nodes == {}
        return
    assert list(on_nodes) == ["b1", "b2"]
    for name, values in on_nodes.items():
        assert np.array_equal(values, mesh.node_table[name], equal_nan=True)


def read_attributes(path, variable):
    with netcdf_file(path, mmap=False) as dataset:
        if variable not in dataset.variables:
            return None
        return dict(dataset.variables[variable]._attributes)


def test_the_crs_is_told_by_its_code_or_in_words(tmp_path):
    coded = write_mesh(two_triangles(), tmp_path / "coded.nc")
    told = read_attributes(coded, "projected_coordinate_system")
    assert told["EPSG_code"] == b"EPSG:32723"
    assert told["epsg"] == 32723
    custom = write_mesh(two_triangles(GEOREFERENCES["custom CRS"]), tmp_path / "custom.nc")
    told = read_attributes(custom, "projected_coordinate_system")
    assert CRS.from_wkt(told["crs_wkt"].decode()) == GEOREFERENCES["custom CRS"].crs
    assert "epsg" not in told
    placeless = write_mesh(two_triangles(GEOREFERENCES["no CRS"]), tmp_path / "none.nc")
    assert read_attributes(placeless, "projected_coordinate_system") is None


def colored(mesh, colors):
    return replace(mesh, triangle_table=Table({"color": np.array(colors)}))


def test_few_colours_are_exact(tmp_path):
    mesh = colored(two_triangles(), ["#0b6e8f", "#fedcba"])
    path = write_mesh(mesh, tmp_path / "mesh.nc")
    with netcdf_file(path, mmap=False) as dataset:
        assert dataset.variables["color"].data.tolist() == [0x0B6E8F, 0xFEDCBA]


def test_many_colours_are_rounded_alike_in_each_channel(tmp_path):
    mesh = random_mesh(count=5000)
    exact = np.array([int(color[1:], 16) for color in mesh.triangle_table["color"].tolist()])
    path = write_mesh(mesh, tmp_path / "mesh.nc")
    with netcdf_file(path, mmap=False) as dataset:
        rounded = dataset.variables["color"].data.astype(np.int64)
    assert 500 < len(np.unique(rounded)) <= 4096 < len(np.unique(exact))
    for shift in (0, 8, 16):
        assert np.abs((rounded >> shift & 255) - (exact >> shift & 255)).max() <= 9


def test_it_holds_triangles_only(tmp_path):
    with pytest.raises(OutputError, match="UGRID can store triangles, not nodes"):
        write_mesh(two_triangles(), tmp_path / "mesh.nc", layers=["nodes"])


def test_names_of_any_script_are_legal_and_kept_as_long_names(tmp_path):
    names = ["近红外_mean", "红_mean", "Größe", "GROSSE", "Grosse", "1 a", "1_a", "x" * 300]
    table = Table({name: np.array([k, -k], float) for k, name in enumerate(names, start=1)})
    path = write_mesh(replace(two_triangles(), triangle_table=table), tmp_path / "mesh.nc")
    dataset = xugrid.open_dataset(path, engine="scipy")
    found = {
        variable.attrs.get("long_name", name): variable.to_numpy().tolist()
        for name, variable in dataset.data_vars.items()
    }
    for name, values in table.items():
        assert found[name] == values.tolist()
    assert all(re.fullmatch("[A-Za-z][A-Za-z0-9_]{,254}", name) for name in dataset.data_vars)
    assert {"u8fd1u7ea2u5916_mean", "Grosse", "b_1_a"} <= set(dataset.data_vars)


def test_more_faces_than_a_variable_can_have_are_refused():
    UGRID.require_room("triangles", columns=10**6, rows=178_956_970)
    with pytest.raises(OutputError, match=r"at most 178956970 rows .* write \.parquet"):
        UGRID.require_room("triangles", rows=178_956_971)


def test_a_file_cut_short_is_noticed(tmp_path):
    path = write_mesh(random_mesh(), tmp_path / "mesh.nc")
    assert UGRID.count_rows(path, "triangles") == len(random_mesh().triangles)
    whole = path.read_bytes()
    for kept in (0.999, 0.5, 0.01):
        path.write_bytes(whole[: int(kept * len(whole))])
        with pytest.raises(OSError, match="damaged"):
            UGRID.count_rows(path, "triangles")
