"""Each parameter of `geomesh:rastertomesh` is used, with values from the dialog or as text."""

from __future__ import annotations

import json
import math
import shutil
from pathlib import Path

import pytest
from meshing import ALGORITHM, Listener, open_layer, total_area
from qgis.core import (
    QgsProcessingContext,
    QgsProcessingException,
    QgsRasterLayer,
)


def test_progress_rises_to_the_end(run, olinda):
    feedback = Listener()
    run(olinda, feedback=feedback, MESH="TEMPORARY_OUTPUT", NODES=300)
    assert feedback.percents == sorted(feedback.percents)
    assert feedback.percents[-1] == 100
    assert any(text.startswith("Measuring triangles") for text in feedback.texts)


def packed(olinda, folder):
    """Return the path of a raster with an alpha band, scale and offset."""
    from osgeo import gdal

    path = folder / "scene.tif"
    bands = "-b 1 -b 2 -b 3 -b 1 -colorinterp_4 alpha -a_scale 2 -a_offset 1000"
    assert gdal.Translate(str(path), str(olinda), options=bands) is not None
    return path


def test_scale_and_offset(run, olinda, tmp_path):
    path, feedback = packed(olinda, tmp_path), Listener()
    run(path, feedback=feedback, NODES=50)
    told = 'switch on "Apply scale and offset" (advanced) to apply them'
    assert any(told in warning for warning in feedback.warnings)
    made = run(path, BANDS=[4], ALPHA_DATA=True, UNSCALE=True, NODES=50)
    triangles = open_layer(made["OUTPUT"])
    (mean,) = (name for name in triangles.fields().names() if name.endswith("_mean"))
    assert min(feature[mean] for feature in triangles.getFeatures()) > 1000


def test_alpha_band_is_no_data_unless_it_is_said(run, olinda, tmp_path):
    with pytest.raises(QgsProcessingException, match='switch on "Use alpha bands as data"'):
        run(packed(olinda, tmp_path), BANDS=[4])


def test_node_budget_spacing_bands_and_recipe(run, olinda):
    made = run(
        olinda,
        NODES=200,
        MIN_SPACING=4,
        BANDS=[3, 1],
        CANNY_LOW=30,
        CANNY_HIGH=90,
        CANNY_L2=0,
        STRETCH=[1, 99],
        GRAY="band:3",
        SIFT_MAX_OCTAVE=1,
        MIN_HOLE=9,
        STATISTICS=[0, 3],
        DOMAIN=1,
    )
    assert made["NODE_COUNT"] <= 200
    names = open_layer(made["OUTPUT"]).fields().names()
    assert {"blue_mean", "blue_max", "red_mean"} <= set(names)
    assert not {"blue_std", "green_mean"} & set(names)
    from geomesh_qgis.provenance import read_document

    recipe = read_document(made["OUTPUT"].partition("|")[0])["recipe"]
    expected = {
        "nodes": 200,
        "min_spacing": 4,
        "canny_low": 30,
        "canny_high": 90,
        "canny_l2": False,
        "stretch": [1, 99],
        "gray": "band:3",
        "sift_max_octave": 1,
        "min_hole": 9,
        "statistics": ["mean", "max"],
        "domain": "image",
    }
    assert {name: recipe[name] for name in expected} == expected
    columns = [
        (feature["col"], feature["row"])
        for feature in open_layer(made["NODES_LAYER"]).getFeatures()
    ]
    assert len(set(columns)) == made["NODE_COUNT"]


def test_every_parameter_of_a_recipe_can_be_set(run, olinda):
    """Each advanced parameter, with a value from its widget, is in the recipe of the mesh.

    The preset is features, because adaptive meshes cannot be resized.
    """
    from geomesh_qgis.algorithms.recipe_parameters import SETTINGS
    from geomesh_qgis.provenance import read_document

    tried = {"whole": 3, "real": 0.5, "range": [5, 95], "flag": 1, "choice": 0, "some": [0]}
    tried |= {"gray": "mean", "size": "128 x 64"}
    told = {"range": [5, 95], "flag": True, "size": [128, 64]}
    for setting in SETTINGS:
        made = run(olinda, PRESET=0, NODES=100, **{setting.parameter: tried[setting.kind]})
        recipe = read_document(made["OUTPUT"].partition("|")[0])["recipe"]
        expected = told.get(setting.kind, tried[setting.kind])
        if setting.kind in ("choice", "some"):
            expected = setting.choices[0] if setting.kind == "choice" else [setting.choices[0]]
        assert recipe[setting.name] == expected, setting.name


def test_what_the_dialog_says_for_not_set_is_not_set(provider):
    from geomesh_qgis.algorithms.recipe_parameters import (
        find_recipe_fault,
        recipe_options,
        recipe_parameters,
    )

    unset = {parameter.name(): None for parameter in recipe_parameters()}
    unset |= {"STRETCH": [math.nan, math.nan], "GRAY": "", "RESIZE": "", "STATISTICS": []}
    algorithm = provider.algorithm("rastertomesh").create()
    for stretch in ([math.nan, math.nan], "nan,nan", "", []):
        assert (
            recipe_options(algorithm, {**unset, "STRETCH": stretch}, QgsProcessingContext()) == []
        )
    assert find_recipe_fault(algorithm, unset, QgsProcessingContext()) == ""


def test_paper_preset(run, olinda):
    made = run(olinda, PRESET=1)
    triangles = open_layer(made["OUTPUT"])
    raster = QgsRasterLayer(str(olinda), "raster").extent()
    assert 0.8 < total_area(triangles) / (raster.width() * raster.height()) < 1  # convex hull


def test_recipe_file_takes_the_place_of_the_preset(run, olinda, tmp_path):
    file = tmp_path / "recipe.json"
    file.write_text(json.dumps({"nodes": 77, "canny_low": 20.0, "canny_high": 60.0}))
    assert run(olinda, RECIPE=file)["NODE_COUNT"] == 77


@pytest.mark.parametrize("extension", ["geojson", "fgb"])
def test_other_formats_carry_triangles_and_style(run, olinda, tmp_path, extension):
    made = run(olinda, f"mesh.{extension}", NODES=300, MESH=tmp_path / "layer.nc")
    triangles = open_layer(made["OUTPUT"])
    assert triangles.featureCount() == made["TRIANGLE_COUNT"]
    assert triangles.crs().authid() == ("EPSG:4326" if extension == "geojson" else "EPSG:31985")
    assert triangles.renderer().symbol().symbolLayerCount() == 2
    assert "NODES_LAYER" not in made
    assert Path(made["MESH"]).exists()


def test_temporary_output(provider, processing, olinda):
    made = processing.run(ALGORITHM, {"INPUT": str(olinda), "OUTPUT": "TEMPORARY_OUTPUT"})
    assert open_layer(made["OUTPUT"]).featureCount() > 1000


def test_names_that_shells_stumble_over(run, olinda, tmp_path):
    folder = tmp_path / 'Olinda\'s "höhe" & $HOME; 海 (1)'
    folder.mkdir()
    raster = folder / "mapa de São João.tif"
    shutil.copy(olinda, raster)
    made = run(raster, str(folder / "malha é.gpkg"), NODES=200, MESH=folder / "malha é.nc")
    assert open_layer(made["OUTPUT"]).featureCount() > 100
    # QGIS keeps a GeoPackage open for a while after it has read the colours of the mesh layers.
    passing = (".xml", "-wal", "-shm")
    assert {path.name for path in folder.iterdir() if not path.name.endswith(passing)} == {
        raster.name,
        "malha é.gpkg",
        "malha é.nc",
        "malha é.qml",
    }
