"""What the plugin adds to the desktop and removes again."""

from __future__ import annotations

import pytest
from qgis.core import QgsApplication, QgsRasterLayer, QgsVectorLayer


@pytest.fixture
def plugin(qgis_iface, processing, monkeypatch):
    """The plugin with another provider id, because other tests use the session's provider."""
    from geomesh_qgis import classFactory, plugin

    class OtherProvider(plugin.GeomeshProvider):
        ID = "othergeomesh"

    monkeypatch.setattr(plugin, "GeomeshProvider", OtherProvider)
    made = classFactory(qgis_iface)
    made.initGui()
    yield made
    made.unload()


def test_provider_comes_and_goes_once(plugin):
    registry = QgsApplication.processingRegistry()
    provider = registry.providerById("othergeomesh")
    assert provider is not None
    plugin.initProcessing()  # QGIS may call this twice
    assert registry.providerById("othergeomesh") is provider
    plugin.unload()
    assert registry.providerById("othergeomesh") is None
    plugin.unload()


def test_action_is_for_raster_layers(plugin, olinda):
    action = plugin._action
    assert not action.isEnabled()
    raster = QgsRasterLayer(str(olinda), "raster")
    plugin._enable_action(raster)
    assert action.isEnabled()
    vector = QgsVectorLayer("Point", "points", "memory")
    for other in (vector, None, QgsRasterLayer("/nowhere.tif", "broken")):
        plugin._enable_action(raster)
        plugin._enable_action(other)
        assert not action.isEnabled()
