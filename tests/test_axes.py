"""Arrays whose bands come last, and coordinates of corners: understood, or refused in one line."""

from __future__ import annotations

import datetime
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd
import pytest
import rasterio
import rioxarray
import xarray as xr
from affine import Affine

import geomesh
from geomesh.errors import GeomeshError, GeoreferenceError, SourceError
from geomesh.raster.open import open_scene
from support.rasters import NORTH_UP, UTM, picture, write_raster

if TYPE_CHECKING:
    from pathlib import Path

pytestmark = pytest.mark.filterwarnings("ignore::PendingDeprecationWarning")

# Shapes of numpy arrays, and whether the last axis can only be the bands.
SHAPES = {
    (48, 64, 3): True,
    (64, 48, 4): True,
    (100, 90, 12): True,
    (145, 145, 200): True,
    (145, 145, 103): True,
    (64, 64, 1): True,
    (20, 30, 16): True,
    (3, 48, 64): False,
    (3, 2, 2): False,
    (4, 64, 3): False,
    (12, 30, 40): False,
    (200, 145, 145): False,
    (40, 20, 30): False,
    (50, 50, 50): False,
    (6, 6, 40): False,
}


@pytest.mark.parametrize(("shape", "refused"), SHAPES.items(), ids=str)
def test_bands_on_the_last_axis_are_refused(shape: tuple[int, ...], refused: bool) -> None:
    array = np.random.default_rng(1).random(shape, np.float32)
    source = (array, NORTH_UP, UTM)
    if not refused:
        assert len(open_scene(source).bands) == shape[0]
        return
    with pytest.raises(SourceError, match=r"np\.moveaxis\(array, -1, 0\)") as caught:
        open_scene(source)
    assert "\n" not in str(caught.value)
    # Both ways out that it names:
    scene = open_scene((np.moveaxis(array, -1, 0), NORTH_UP, UTM))
    assert (len(scene.bands), *scene.grid.extent.shape) == (shape[2], *shape[:2])
    named = xr.DataArray(array, dims=("band", "y", "x")).rio.write_crs(UTM)
    scene = open_scene(named.rio.write_transform(NORTH_UP))
    assert (len(scene.bands), *scene.grid.extent.shape) == shape


@pytest.mark.slow
def test_the_mesh_of_an_image_is_that_of_its_bands() -> None:
    bands = picture(3)
    mesh = geomesh.mesh_raster((np.moveaxis(np.moveaxis(bands, 0, -1), -1, 0), NORTH_UP, UTM))
    assert (mesh.nodes == geomesh.mesh_raster((bands, NORTH_UP, UTM)).nodes).all()


@pytest.mark.parametrize(
    ("array", "told"),
    [
        ([[1, 2, 3], [4, 5]], "give rows of equal length"),
        ([np.zeros((2, 2)), np.zeros((3, 2))], "give rows of equal length"),
        (None, r"shape \(\) is not a raster"),
        (np.zeros((4, 4), "datetime64[s]"), "only real numbers can be meshed; convert them"),
        (np.zeros((4, 4), "timedelta64[s]"), "only real numbers can be meshed; convert them"),
        (np.full((4, 4), datetime.date.min), "type object: only real numbers .* convert them"),
        (pd.DataFrame({"a": ["x", "y"], "b": ["z", "w"]}), "only real numbers"),
        (pd.Series([1.0, 2.0]), r"shape \(2,\) is not a raster"),
        (np.zeros((2, 2), [("a", "f4")]), "only real numbers"),
    ],
    ids=repr,
)
def test_what_is_no_array_of_numbers_is_refused(array: Any, told: str) -> None:
    with pytest.raises(GeomeshError, match=told) as caught:
        open_scene((array, NORTH_UP, UTM))
    assert len(str(caught.value).splitlines()) == 1


def test_a_table_of_numbers_and_masked_bands_are_rasters(tmp_path: Path) -> None:
    table = pd.DataFrame(picture()[0].astype(float))
    assert (open_scene((table, NORTH_UP, UTM)).read(open_scene((table, NORTH_UP, UTM)).window)[0]
            == picture()).all()  # fmt: skip
    data = picture(2).copy()
    data[1, :5] = 0
    with rasterio.open(write_raster(tmp_path, data=data, nodata=0)) as dataset:
        masked = dataset.read(masked=True)
        scene, file = open_scene((masked, dataset.transform, dataset.crs)), open_scene(dataset)
        assert (scene.read(scene.window)[1] == file.read(file.window)[1]).all()


@pytest.mark.parametrize(
    "transform", [tuple(NORTH_UP), list(NORTH_UP)[:6], NORTH_UP.to_gdal(), np.eye(3), "north"]
)
def test_a_transform_of_plain_numbers_is_refused_with_both_ways_to_make_one(transform: Any) -> None:
    if isinstance(transform, Affine):
        transform = tuple(transform)
    with pytest.raises(GeoreferenceError, match=r"give affine\.Affine") as caught:
        open_scene((picture(), transform, UTM))
    told = str(caught.value)
    assert "Affine(*numbers)" in told
    assert Affine(*list(NORTH_UP)[:6]) == Affine.from_gdal(*NORTH_UP.to_gdal()) == NORTH_UP


# ------------------------------------------------------------- coordinates of corners


def coordinates(transform: Affine, at: float, rows: int = 48, cols: int = 64) -> dict[str, Any]:
    """Return the coordinates of the points at (at, at) in each pixel."""
    return {
        "x": ("x", transform.c + transform.a * (np.arange(cols) + at)),
        "y": ("y", transform.f + transform.e * (np.arange(rows) + at)),
    }


def stackstac_array(at: float = 0.0, **attributes: Any) -> xr.DataArray:
    """Return an array as stackstac makes it: by default with coordinates of upper left corners."""
    attrs = {"crs": UTM.lower(), "transform": NORTH_UP, "resolution": 30, **attributes}
    if "spec" in attrs:
        del attrs["transform"]
    return xr.DataArray(
        picture()[0], dims=("y", "x"), coords=coordinates(NORTH_UP, at), attrs=attrs
    )


def geotransform_array(at: float, transform: Affine = NORTH_UP) -> xr.DataArray:
    array = xr.DataArray(picture()[0], dims=("y", "x"), coords=coordinates(transform, at))
    return array.rio.write_crs(UTM).rio.write_transform(transform)


MAKERS = {
    "attribute": stackstac_array,
    "tuple": lambda at: stackstac_array(at, transform=tuple(NORTH_UP)[:6]),
    "specification": lambda at: stackstac_array(at, spec=SimpleNamespace(transform=NORTH_UP)),
    "GeoTransform": geotransform_array,
}


@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
@pytest.mark.parametrize("part", [slice(None), slice(7, 40), slice(30, 31)], ids=str)
def test_coordinates_of_corners_are_understood_and_told(make: Any, part: slice) -> None:
    centres, corners = make(0.5), make(0.0)
    for cut in ({}, {"y": part}, {"x": part}, {"y": part, "x": part}):
        expected, found = (open_scene(array.isel(cut)) for array in (centres, corners))
        assert expected.notes == ()
        assert found.grid == expected.grid
        assert len(found.notes) == 1
        assert "upper left corners of its pixels" in found.notes[0]
    flipped = corners.isel(y=slice(None, None, -1))
    assert open_scene(flipped).grid.bounds() == pytest.approx(open_scene(centres).grid.bounds())


@pytest.mark.parametrize("make", MAKERS.values(), ids=MAKERS)
@pytest.mark.parametrize("at", [0.25, 0.75, 0.4])
def test_another_shift_is_refused_and_the_way_out_works(make: Any, at: float) -> None:
    array = make(at)
    with pytest.raises(GeoreferenceError, match="pixels beside its stored transform") as caught:
        open_scene(array)
    assert ".rio.write_transform(array.rio.transform(recalc=True))" in str(caught.value)
    mended = array.rio.write_transform(array.rio.transform(recalc=True))
    scene = open_scene(mended)
    assert scene.notes == ()
    x, y = scene.grid.transform @ (0.5, 0.5)
    assert (x, y) == pytest.approx((float(array.x[0]), float(array.y[0])))


def test_a_shift_on_one_axis_is_refused() -> None:
    array = stackstac_array(0.5)
    with pytest.raises(GeoreferenceError, match=r"lie 0\.5 and 0 pixels beside"):
        open_scene(array.assign_coords(x=array.x - 15))


def test_the_note_on_corners_names_a_way_to_have_centres() -> None:
    array = stackstac_array(0.0)
    mended = open_scene(array.rio.write_transform(array.rio.transform(recalc=True)))
    assert mended.notes == ()
    assert mended.grid.transform.c == NORTH_UP.c - 15


def test_pixels_of_another_size_lie_where_their_coordinates_say() -> None:
    """A stored transform of the pixels before they were made larger says nothing."""
    array = geotransform_array(0.5)
    larger = array.coarsen(x=2, y=2).mean()
    scene = open_scene(larger)
    assert scene.notes == ()
    assert scene.grid.bounds() == pytest.approx(open_scene(array).grid.bounds())


def test_stored_transforms_that_are_no_transform_are_ignored() -> None:
    for odd in ("none", (1, 2), ("a",) * 6, 5):
        scene = open_scene(stackstac_array(0.5, transform=odd))
        assert scene.grid.transform.almost_equals(NORTH_UP)


def test_a_file_and_its_dataarray_still_agree(tmp_path: Path) -> None:
    path = write_raster(tmp_path)
    with rioxarray.open_rasterio(path) as array:
        assert open_scene(array).grid == open_scene(path).grid
