"""Draw the pictures of the README and the documentation from data_samples/.

Run from the top of a checkout: ``.venv/bin/python docs/pictures.py``.
"""

from pathlib import Path

import matplotlib as mpl

import geomesh
from geomesh.figures import draw_stages, run_stages
from geomesh.sources import open_scene

SAMPLES = Path("data_samples")
IMAGES = Path("docs/images")


def silent(_fraction: float, _message: str) -> None:
    pass


def main() -> None:
    mpl.use("agg")
    for preset in ("features", "paper"):
        scene = open_scene(SAMPLES / "olinda_landsat7_rgb_uint8.tif")
        stages = run_stages(scene, geomesh.Recipe.from_preset(preset), silent)
        figure = draw_stages(stages)
        figure.savefig(IMAGES / f"olinda_stages_{preset}.png", dpi=72)
    mesh = geomesh.mesh_raster(SAMPLES / "bahamas_landsat7_rgb_nodata_collar.tif")
    mesh.plot().figure.savefig(IMAGES / "bahamas_mesh.png", dpi=110, bbox_inches="tight")


if __name__ == "__main__":
    main()
