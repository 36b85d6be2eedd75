"""Read a source as a mesh reads it, and collect the warnings that a mesh gives."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING, Any

import geomesh
from geomesh.errors import GeomeshWarning
from geomesh.raster.open import open_scene

if TYPE_CHECKING:
    import numpy as np


def read(source: Any, **options: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return the bands and the valid pixels of a source."""
    scene = open_scene(source, **options)
    with scene.open():
        return scene.read(scene.grid.extent)


def notes(source: Any, **options: Any) -> list[str]:
    """Return the warnings of a mesh, which are also in its provenance; not those on its image."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", GeomeshWarning)
        mesh = geomesh.mesh_raster(source, **options)
    told = [str(each.message) for each in caught if each.category is GeomeshWarning]
    assert mesh.provenance is not None
    assert list(mesh.provenance.warnings) == told
    return [text for text in told if "keypoints" not in text and "holes" not in text]
