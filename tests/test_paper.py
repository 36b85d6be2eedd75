"""The paper preset, compared with ten lines of cv2 and scipy that implement the paper."""

import cv2
import numpy as np
import pytest
import rasterio
from scipy.spatial import Delaunay

import geomesh
from geomesh.mesh.quality import ki
from support.samples import SAMPLES

pytestmark = pytest.mark.filterwarnings("ignore:the array has no georeference")

RGB_8BIT = [
    "olinda_landsat7_rgb_uint8.tif",  # 349 x 352
    "olinda_landsat7_rgb_rotated_gt.tif",  # 240 x 240: enlarged by the preset
]


def by_the_letter(rgb):
    """Return the points, in OpenCV's coordinates, and triangles of the published pipeline."""
    gray = cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY)
    gx = cv2.convertScaleAbs(cv2.Sobel(gray, cv2.CV_16S, 1, 0, ksize=3))
    gy = cv2.convertScaleAbs(cv2.Sobel(gray, cv2.CV_16S, 0, 1, ksize=3))
    sobel = cv2.addWeighted(gx, 0.5, gy, 0.5, 0)
    edges = cv2.Canny(cv2.resize(sobel, (256, 256), interpolation=cv2.INTER_AREA), 100, 200)
    sift = cv2.SIFT_create(enable_precise_upscale=True)
    points = np.unique([k.pt for k in sift.detect(edges, None)], axis=0)
    return points, Delaunay(points).simplices


def as_sets_of_places(points, triangles):
    """Return triangles as a set of triples of rounded points, so numbering does not matter."""
    keys = [tuple(point) for point in points.round(5)]
    return {frozenset(keys[i] for i in triangle) for triangle in triangles}


def read_rgb(name):
    with rasterio.open(SAMPLES / name) as dataset:
        return np.moveaxis(dataset.read(), 0, -1).copy()


def assert_same_mesh(rgb, mesh):
    points, triangles = by_the_letter(rgb)
    ours = mesh.plane_nodes - 0.5
    assert len(ours) == len(points)
    order = np.lexsort((ours[:, 1], ours[:, 0]))
    np.testing.assert_allclose(ours[order], points, atol=1e-9)
    assert as_sets_of_places(ours, mesh.triangles) == as_sets_of_places(points, triangles)


@pytest.mark.parametrize("name", RGB_8BIT)
def test_equals_the_letter_on_samples(name):
    mesh = geomesh.mesh_raster(SAMPLES / name, preset="paper")
    assert mesh.plane_size == (256, 256)
    assert_same_mesh(read_rgb(name), mesh)


@pytest.mark.parametrize("shape", [(256, 256), (256, 200), (100, 300), (349, 40), (300, 352)])
def test_equals_the_letter_on_any_size(shape):
    height, width = shape
    rgb = read_rgb(RGB_8BIT[0])[:height, :width]
    mesh = geomesh.mesh_raster((np.moveaxis(rgb, -1, 0), None, None), preset="paper")
    assert_same_mesh(rgb, mesh)


def test_nodes_are_carried_back_to_where_they_came_from():
    """A non-square image is resized by different factors in x and y."""
    with rasterio.open(SAMPLES / RGB_8BIT[0]) as dataset:
        a, b, c, d, e, f = dataset.transform[:6]
    mesh = geomesh.mesh_raster(SAMPLES / RGB_8BIT[0], preset="paper")
    points, _ = by_the_letter(read_rgb(RGB_8BIT[0]))
    x, y = ((points + 0.5) * (349 / 256, 352 / 256)).T
    there = np.column_stack([a * x + b * y + c, d * x + e * y + f])
    ours = mesh.map_nodes[np.lexsort((mesh.nodes[:, 1], mesh.nodes[:, 0]))]
    np.testing.assert_allclose(ours, there, atol=1e-4)


def test_lengths_are_those_of_the_resized_image():
    mesh = geomesh.mesh_raster(SAMPLES / RGB_8BIT[0], preset="paper")
    points, triangles = by_the_letter(read_rgb(RGB_8BIT[0]))
    corners = points[triangles]
    sides = np.sort(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2), axis=1)
    summary = mesh.quality().summary()
    expected = ki(sides[:, 0], sides[:, 2], sides[:, 1]).mean()
    assert summary["size"] == [256, 256]
    assert summary["measures"]["ki"]["mean"] == pytest.approx(expected, rel=1e-9)


def test_table_1_is_the_formula_applied_to_its_own_sides():
    assert round(float(ki(101, 213, 99)), 2) == 102.12
    assert round(float(ki(97, 160, 85)), 2) == 79.53
