"""Domains that touch themselves at a corner, and tiny rasters, are refined like others."""

from __future__ import annotations

import numpy as np
import pytest

import geomesh
from geomesh.mesh.topology import boundary_edges


@pytest.fixture(scope="module")
def touching():
    """A raster whose valid pixels are random squares of 16 pixels; many touch at a corner only."""
    lots = np.random.default_rng(3)
    squares = lots.random((40, 64)) < 0.6
    valid = np.kron(squares, np.ones((16, 16))).astype(bool)
    x, y = np.meshgrid(np.arange(valid.shape[1]), np.arange(valid.shape[0]))
    values = 100 + 60 * np.sin(x / 23) * np.cos(y / 17) + lots.normal(0, 4, valid.shape)
    return np.ma.array(values.astype(np.float32), mask=~valid), None, None


def pinched(mesh):
    ends = np.bincount(boundary_edges(mesh.triangles).ravel(), minlength=len(mesh.nodes))
    return set(map(tuple, mesh.nodes[ends > 2]))


@pytest.mark.filterwarnings("ignore::geomesh.GeomeshWarning")
@pytest.mark.parametrize("nodes", [500, 20_000])
def test_nodes_where_the_domain_touches_itself_stay(touching, nodes):
    start = pinched(geomesh.mesh_raster(touching, preset="features"))
    assert len(start) > 100
    mesh = geomesh.mesh_raster(touching, preset="adaptive", nodes=nodes, effort="fast")
    assert mesh.certify().passed
    assert pinched(mesh) == start
    assert len(mesh.nodes) == nodes or nodes == 500


@pytest.mark.filterwarnings("ignore::geomesh.GeomeshWarning")
@pytest.mark.parametrize("nodes", [None, 4, 20])
@pytest.mark.parametrize("shape", [(1, 1), (40, 1), (2, 2), (3, 3), (5, 8)])
def test_tiny_rasters_are_refined(shape, nodes):
    values = np.random.default_rng(1).integers(0, 255, shape, np.uint8)
    mesh = geomesh.mesh_raster((values, None, None), preset="adaptive", nodes=nodes)
    assert mesh.certify().passed


@pytest.mark.filterwarnings("ignore::geomesh.GeomeshWarning")
def test_blocks_of_which_few_nodes_are_their_own_get_exactly_as_many_as_they_should():
    """Almost all of the error is in one corner, so the other blocks get hardly any nodes."""
    lots = np.random.default_rng(0)
    values = np.zeros((700, 700), np.float32)
    values[:120, :120] = lots.normal(0, 50, (120, 120))
    values[120:, 120:] += lots.normal(0, 0.01, (580, 580)).astype(np.float32)
    for nodes in (1000, 1500):
        mesh = geomesh.mesh_raster((values, None, None), preset="adaptive", nodes=nodes)
        assert len(mesh.nodes) == nodes
