"""How a mesh was made: read it from the GeoPackage and show it in the layer properties."""

from __future__ import annotations

import json
import sqlite3
from contextlib import closing
from html import escape
from typing import Any
from xml.etree import ElementTree

from qgis.core import QgsLayerMetadata, QgsMapLayer


def read_document(path: str) -> dict[str, Any]:
    """Return the document that geomesh wrote to a GeoPackage about how the mesh was made."""
    # The path is not a URI, because URIs do not work with network shares.
    with closing(sqlite3.connect(path)) as database:
        rows = database.execute("SELECT metadata FROM gpkg_metadata").fetchall()
    for (text,) in rows:
        document = _find_document(text)
        if document is not None:
            return document
    return {}


def as_metadata(layer: QgsMapLayer, document: dict) -> QgsLayerMetadata:
    """Return the text for the layer properties: the recipe and the certificate."""
    metadata = QgsLayerMetadata()
    metadata.setTitle(layer.name())
    metadata.setType("dataset")
    metadata.setLanguage("eng")
    metadata.setCrs(layer.crs())
    metadata.setAbstract(_as_text(document))
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


def _as_text(document: dict) -> str:
    """Return a document as escaped text. QGIS shows it as HTML and breaks its lines."""
    counts = document.get("mesh", {}).get("counts", {})
    canny = document.get("canny", {})
    lines = [
        f"A mesh of {counts.get('nodes', 0):,} nodes and {counts.get('triangles', 0):,} triangles "
        f"made from {document.get('source', {}).get('name', '')}",
        "",
        "Recipe",
        *(f"{name}: {_spell(value)}" for name, value in document.get("recipe", {}).items()),
        *(f"Canny's {name} threshold that was used: {value:.4g}" for name, value in canny.items()),
        "",
        "Certificate",
        *(
            f"{each['name']}: {each['detail']}"
            for part in ("checks", "facts")
            for each in document.get("certificate", {}).get(part, [])
        ),
    ]
    return escape("\n".join(lines), quote=False)


def _spell(value: Any) -> str:
    return "not set" if value is None else json.dumps(value, ensure_ascii=False).strip('"')


def _find_document(text: str) -> dict | None:
    """Find geomesh's JSON, which is an item in GDAL's XML metadata."""
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError:
        return None
    for item in root.iter("MDI"):
        if item.get("key") == "geomesh":
            return json.loads(item.text)
    return None
