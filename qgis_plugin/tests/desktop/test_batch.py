"""Batch mode in the real QGIS."""

from __future__ import annotations

import os

from harness import HERE, run_desktop

NAMES = ("olinda_landsat7_rgb_uint8", "rmnp_rgb", "colorado_dem_float32_epsg4269")


def test_a_batch_of_scenes(tmp_path, samples, geomesh_python):
    meshes = tmp_path / "meshes"
    meshes.mkdir()
    seen = run_desktop(
        "drive_batch.py",
        tmp_path,
        timeout=240,
        GEOMESH_PYTHON=geomesh_python,
        GEOMESH_TEST_SCRIPTS=HERE,
        GEOMESH_TEST_RASTERS=os.pathsep.join(str(samples / f"{name}.tif") for name in NAMES),
        GEOMESH_TEST_OUTPUT=meshes,
    )
    assert seen["failure"] is None, seen["failure"]
    assert seen["exceptions"] == []
    assert set(seen["layers"]) == {
        f"{part} · {n}" for n in NAMES for part in ("nodes", "triangles")
    }
    assert all(0 < seen["layers"][f"nodes · {name}"] <= 90 for name in NAMES)
    assert sorted(path.stem for path in meshes.glob("*.gpkg")) == sorted(NAMES)
