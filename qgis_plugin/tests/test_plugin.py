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


def test_the_menu_opens_every_algorithm(plugin, provider, olinda, monkeypatch):
    import processing

    opened = []
    monkeypatch.setattr(processing, "execAlgorithmDialog", lambda *given: opened.append(given))
    raster = QgsRasterLayer(str(olinda), "raster")
    monkeypatch.setattr(plugin._iface, "activeLayer", lambda: raster)
    entries = [action for action in plugin._menu if not action.isSeparator()]
    for action in entries:
        action.setEnabled(True)
        action.trigger()
    names = [name.partition(":")[2] for name, _ in opened]
    assert sorted(names) == sorted(each.name() for each in provider.algorithms())
    titles = [provider.algorithm(name).displayName() + "…" for name in names]
    assert [action.text() for action in entries] == titles
    values = {name.partition(":")[2]: given for name, given in opened}
    for name in ("rastertomesh", "demtotin", "stages"):
        assert values[name] == {"INPUT": raster.id()}
    assert values["contours"] == {}
    plugin.unload()
    assert plugin._menu == []
