"""How an adaptive mesh looks: a linear surface is smooth, a constant one has flat triangles."""

from __future__ import annotations

import os
from pathlib import Path

from meshing import Listener, open_layer
from painting import beside, difference, paint
from qgis.core import (
    QgsColorRampShader,
    QgsMeshDatasetIndex,
    QgsMeshLayer,
    QgsProject,
    QgsRasterLayer,
    QgsRectangle,
)
from qgis.PyQt.QtGui import QPainter

ADAPTIVE = 2
FAST = 0
CONSTANT = 1

# Fine enough to tell a surface from flat triangles.
FINE = 75


def in_legend(project):
    """Return the loaded layers by the first part of their names, from top to bottom."""
    layers = [node.layer() for node in project.layerTreeRoot().findLayers()]
    return {layer.name().partition(" · ")[0]: layer for layer in layers}


def shown_group(layer):
    settings = layer.rendererSettings()
    group = settings.activeScalarDatasetGroup()
    about = layer.datasetGroupMetadata(QgsMeshDatasetIndex(group, 0))
    return about, settings.scalarSettings(group)


def test_an_image_is_three_mesh_layers_whose_light_adds_up(loaded, olinda, tmp_path, project):
    loaded(PRESET=ADAPTIVE, NODES=1500, EFFORT=FAST, MESH=str(tmp_path / "mesh.nc"))
    layers = in_legend(project)
    assert list(layers) == ["nodes", "mesh blue", "mesh green", "mesh red", "triangles"]
    plus = QPainter.CompositionMode.CompositionMode_Plus
    for color, adds in (("red", False), ("green", True), ("blue", True)):
        layer = layers[f"mesh {color}"]
        about, scalar = shown_group(layer)
        assert about.name() == color
        assert about.dataType() == about.DataType.DataOnVertices
        assert (layer.blendMode() == plus) == adds
        shader = scalar.colorRampShader()
        assert shader.colorRampType() == QgsColorRampShader.Type.Interpolated
        assert (shader.minimumValue(), shader.maximumValue()) == (0, 255)
    raster = QgsRasterLayer(str(olinda), "raster")
    extent = raster.extent()
    surface = [layers[f"mesh {color}"] for color in ("blue", "green", "red")]
    expected = paint([raster], extent)
    smooth = paint(surface, extent)
    flat = paint([layers["triangles"]], extent)
    error = difference(expected, smooth, FINE)
    assert error < 6
    assert error < 0.8 * difference(expected, flat, FINE)
    # The lowest of the three hides what is below, so the colours are the same over anything.
    extent.scale(0.9)  # there is no background then
    over = paint([*surface, layers["triangles"]], extent)
    assert difference(paint(surface, extent), over, FINE) == 0


def test_a_project_keeps_the_colours(loaded, olinda, tmp_path, project):
    loaded(PRESET=ADAPTIVE, NODES=200, EFFORT=FAST, MESH=str(tmp_path / "mesh.nc"))
    extent = QgsRasterLayer(str(olinda), "raster").extent()
    names = ("mesh blue", "mesh green", "mesh red")
    before = paint([in_legend(project)[name] for name in names], extent)
    assert project.write(str(tmp_path / "project.qgz"))
    project.clear()
    assert QgsProject.instance().read(str(tmp_path / "project.qgz"))
    after = paint([in_legend(project)[name] for name in names], extent)
    assert difference(before, after, FINE) == 0


def test_stretched_bands_have_the_colours_of_the_triangles(loaded, samples, tmp_path, project):
    """The bands have 16 bits. The plugin finds how their values become colours."""
    raster = samples / "parana_landsat8_rgb_uint16_nodata_edge.tif"
    loaded(
        INPUT=str(raster),
        PRESET=ADAPTIVE,
        NODES=600,
        EFFORT=FAST,
        MESH=str(tmp_path / "mesh.nc"),
    )
    layers = in_legend(project)
    surface = [layer for name, layer in layers.items() if name.startswith("mesh")]
    assert len(surface) == 3
    for layer in surface:
        shader = shown_group(layer)[1].colorRampShader()
        assert shader.maximumValue() - shader.minimumValue() > 255
    whole = layers["triangles"].extent()
    left, below = whole.xMinimum() + 0.1 * whole.width(), whole.yMinimum() + 0.02 * whole.width()
    side = 0.36 * whole.width()
    extent = QgsRectangle(left, below, left + side, below + side)  # islands, and no nodata
    flat, smooth = paint([layers["triangles"]], extent, 500), paint(surface, extent, 500)
    assert difference(flat, smooth) < 12  # edges are drawn over the triangles
    if "GEOMESH_SCREENSHOTS" in os.environ:
        beside(flat, smooth).save(str(Path(os.environ["GEOMESH_SCREENSHOTS"], "qgis_surface.png")))


def test_one_band_is_one_mesh_layer_in_gray(loaded, samples, tmp_path, project):
    raster = samples / "rmnp_dem.tif"
    loaded(
        INPUT=str(raster),
        OUTPUT=str(tmp_path / "dem.fgb"),  # the triangles alone, which tell the stretch too
        PRESET=ADAPTIVE,
        NODES=400,
        EFFORT=FAST,
        MESH=str(tmp_path / "mesh.nc"),
    )
    layers = in_legend(project)
    assert list(layers) == ["mesh", "triangles"]
    about, scalar = shown_group(layers["mesh"])
    assert about.dataType() == about.DataType.DataOnVertices
    colors = [item.color.name() for item in scalar.colorRampShader().colorRampItemList()]
    assert colors == ["#000000", "#ffffff"]
    extent = layers["triangles"].extent()
    extent.scale(0.9)
    flat = paint([layers["triangles"]], extent)
    assert difference(flat, paint([layers["mesh"]], extent)) < 12
    # The style beside the file shows the surface too.
    again = QgsMeshLayer(str(tmp_path / "mesh.nc"), "again", "mdal")
    assert again.loadDefaultStyle()[1]
    assert shown_group(again)[0].name() == about.name()


def test_a_constant_surface_is_flat_triangles(loaded, tmp_path, project):
    loaded(PRESET=ADAPTIVE, NODES=300, MODEL=CONSTANT, EFFORT=FAST, MESH=str(tmp_path / "mesh.nc"))
    layers = in_legend(project)
    assert list(layers) == ["nodes", "triangles", "mesh"]
    about, scalar = shown_group(layers["mesh"])
    assert about.name() == "color"
    assert about.dataType() == about.DataType.DataOnFaces
    assert scalar.colorRampShader().colorRampType() == QgsColorRampShader.Type.Exact
    categories = [found.value() for found in layers["nodes"].renderer().categories()]
    assert categories == ["refined", "border"]


def test_without_means_the_range_of_the_surface_is_used(run, samples, tmp_path):
    from geomesh_qgis.provenance import read_document
    from geomesh_qgis.styling import style_surface
    from geomesh_qgis.surface import Channel, find_channels

    made = run(
        samples / "rmnp_dem.tif",
        PRESET=ADAPTIVE,
        NODES=100,
        EFFORT=FAST,
        STATISTICS=[2],
        MESH=str(tmp_path / "mesh.nc"),
        feedback=Listener(),
    )
    document = read_document(made["OUTPUT"].partition("|")[0])
    channels = find_channels(open_layer(made["OUTPUT"]), document)
    assert channels == (Channel("", "b1", None, None),)
    layer = QgsMeshLayer(made["MESH"], "mesh", "mdal")
    style_surface(layer, channels[0], adds=False)
    about, scalar = shown_group(layer)
    shader = scalar.colorRampShader()
    assert (shader.minimumValue(), shader.maximumValue()) == (about.minimum(), about.maximum())
    assert find_channels(open_layer(made["OUTPUT"]), {}) == ()
