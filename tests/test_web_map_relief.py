"""Terrain on web maps: light from the north-west, as numpy works it out from the heights."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import pytest
from pyproj import Transformer

import geomesh
from support.samples import SAMPLES
from support.web_map import MapPage, brighter

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

    from geomesh import Mesh

    ShowMap = Callable[..., MapPage]

pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::geomesh.errors.GeomeshWarning"),
]
DEM = SAMPLES / "colorado_dem_float32_epsg4269.tif"


def light(mesh: Mesh) -> NDArray[np.float64]:
    """Return the light at the nodes (N,); 1 on flat ground. The sun is 45 degrees high.

    In metres on a plane that touches the Earth in the middle.
    """
    lon, lat = mesh.map_nodes.T
    plane = f"+proj=laea +lat_0={lat.mean()} +lon_0={lon.mean()} +datum=NAD83"
    x, y = Transformer.from_crs(mesh.grid.crs, plane, always_xy=True).transform(lon, lat)
    nodes = np.column_stack([x, y, mesh.heights])
    a, b, c = (nodes[mesh.triangles[:, k]] for k in range(3))
    of_triangles = np.cross(b - a, c - a)
    assert (of_triangles[:, 2] > 0).all()
    normals = np.zeros_like(nodes)
    for k in range(3):
        np.add.at(normals, mesh.triangles[:, k], of_triangles)
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    sun = np.array([-0.5, 0.5, np.sqrt(0.5)])
    return normals @ sun / sun[2]


def test_slopes_to_the_north_west_are_light(show_map: ShowMap) -> None:
    mesh = geomesh.mesh_raster(DEM, nodes=800, effort="fast", z=1)
    page = show_map(mesh)
    # First by height, then in the colours of the raster.
    assert page.browser.evaluate("column.value") == mesh.height.band
    page.choose("column", "")
    page.choose("relief", False)
    plain = page.picture().astype(float)
    page.choose("relief", True)
    lit = page.picture().astype(float)
    shown = page.triangles_on_screen()
    inside = (shown.triangle >= 0) & shown.inner
    # The page keeps the darkest slopes visible, and the lightest are white.
    kept = np.clip(light(mesh), 40 / 170, 255 / 170)
    expected = brighter(plain[inside] * shown.between_nodes(mesh, kept[:, None]), 1)
    assert np.abs(lit[inside] - expected).max() <= 4
    assert kept.min() < 0.8
    assert kept.max() > 1.2


def test_no_relief_on_other_attributes(show_map: ShowMap) -> None:
    mesh = geomesh.mesh_raster(DEM, nodes=800, effort="fast", z=1)
    page = show_map(mesh, column="slope")
    with_relief = page.picture()
    page.choose("relief", False)
    np.testing.assert_array_equal(page.picture(), with_relief)
