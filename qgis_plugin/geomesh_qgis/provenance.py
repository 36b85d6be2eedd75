"""How a mesh was made: read from its GeoPackage, shown in the properties of its layers."""

from __future__ import annotations

import json
import sqlite3
from contextlib import closing
from html import escape
from typing import Any
from xml.etree import ElementTree

from qgis.core import QgsLayerMetadata, QgsMapLayer


def read_document(path: str) -> dict[str, Any]:
    """Return what geomesh has written into a GeoPackage about how its mesh was made."""
    # Not as a URI: those know no network shares.
    with closing(sqlite3.connect(path)) as database:
        rows = database.execute("SELECT metadata FROM gpkg_metadata").fetchall()
    for (text,) in rows:
        document = _find_document(text)
        if document is not None:
            return document
    return {}


def as_metadata(layer: QgsMapLayer, document: dict) -> QgsLayerMetadata:
    """Return what the layer properties show: the recipe and the certificate."""
    metadata = QgsLayerMetadata()
    metadata.setTitle(layer.name())
    metadata.setType("dataset")
    metadata.setLanguage("eng")
    metadata.setCrs(layer.crs())
    metadata.setAbstract(_as_html(document))
    metadata.setKeywords({"gmd:topicCategory": [], "geomesh": ["triangle mesh", "Delaunay"]})
    source = document.get("source", {}).get("name", "")
    recipe = document.get("recipe", {})
    metadata.setHistory(
        [
            f"Made from {escape(source)} by geomesh {escape(document.get('geomesh', ''))}",
            f"Recipe: {escape(json.dumps(recipe))}",
        ]
    )
    return metadata


def _as_html(document: dict) -> str:
    counts = document.get("mesh", {}).get("counts", {})
    checks = document.get("certificate", {}).get("checks", [])
    recipe = document.get("recipe", {})
    rows = "".join(
        f"<tr><td>{escape(name)}</td><td>{_spell(recipe[name])}</td></tr>" for name in recipe
    )
    checked = "".join(
        f"<li>{escape(check['name'])}: {escape(check['detail'])}</li>" for check in checks
    )
    source = escape(document.get("source", {}).get("name", ""))
    return (
        f"<p>A mesh of {counts.get('nodes', 0):,} nodes and {counts.get('triangles', 0):,} "
        f"triangles of {source}.</p>"
        f"<h3>Recipe</h3><table>{rows}</table><h3>Certificate</h3><ul>{checked}</ul>"
    )


def _spell(value: Any) -> str:
    return "not set" if value is None else escape(json.dumps(value, ensure_ascii=False).strip('"'))


def _find_document(text: str) -> dict | None:
    """Find geomesh's JSON in GDAL's XML of metadata, where it is an item."""
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError:
        return None
    for item in root.iter("MDI"):
        if item.get("key") == "geomesh":
            return json.loads(item.text)
    return None
