"""A raster with its valid pixels, and the one scorer of all methods."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from scipy.ndimage import distance_transform_edt

from geomesh.features.gray_image import SceneGray
from geomesh.parallel.progress import silent
from geomesh.parallel.workers import open_workers
from geomesh.pipeline.mesh_scene import scene_tone
from geomesh.raster.open import open_scene
from geomesh.recipe import Recipe
from geomesh.surface.fit import fit_surface

if TYPE_CHECKING:
    from geomesh.arrays.types import Floats, Mask, Points, Triangles
    from geomesh.parameters import Model
    from geomesh.raster.scene import Scene


@dataclass(frozen=True, eq=False)
class Raster:
    """A raster in memory.

    Parameters
    ----------
    name : str
    scene : Scene
        With the bands and the valid pixels that `geomesh.mesh_raster` uses by default.
    bands : float64 (B, H, W)
    valid : bool (H, W)
    peak : float64 (B,)
        Reference values of PSNR: 255 for uint8, else the range of the valid pixels.
    """

    name: str
    scene: Scene
    bands: Floats
    valid: Mask
    peak: Floats

    @classmethod
    def read(cls, path: str | Path) -> Raster:
        """Return all pixels of a raster file."""
        scene = open_scene(path)
        with scene.open():
            bands, valid = scene.read(scene.grid.extent)
        bands = bands.astype(np.float64)
        peak = np.ptp(bands[:, valid], axis=1)
        if scene.dtype == np.uint8:
            peak = np.full(len(bands), 255.0)
        return cls(Path(path).stem, scene, bands, valid, peak)

    @property
    def pixels(self) -> int:
        """Number of valid pixels."""
        return int(np.count_nonzero(self.valid))

    @cached_property
    def guides(self) -> dict[str, Floats]:
        """The single-band images (H, W) that a method for one band can look at.

        "gray" is the 8-bit gray image of the preset `features`. It is stretched, and what is
        darker or brighter than most pixels is clipped. "mean" is the mean of the bands, each
        divided by its peak. Invalid pixels have the value of the nearest valid pixel.
        """
        with open_workers(1) as workers, self.scene.open():
            tone = scene_tone(self.scene, Recipe(), workers, silent)
            gray, _ = SceneGray(self.scene, tone, sobel=False).read(self.scene.grid.extent)
        mean = (self.bands / _or_one(self.peak)).mean(axis=0) * 255
        return {"gray": gray.astype(np.float64), "mean": spread(mean, self.valid)}

    def show(self, points: Points, triangles: Triangles, model: Model) -> Floats:
        """Return the image (B, H, W) of a mesh with the values of the least squares.

        NaN where no triangle is.
        """
        with open_workers(1) as workers, self.scene.open():
            surface = fit_surface(
                points, triangles, self.scene, model=model, workers=workers, progress=silent
            )
        return surface.image(self.scene.grid.extent)

    def score(self, image: Floats) -> tuple[float, int]:
        """Return the PSNR of an image (B, H, W) over all valid pixels and bands, in decibels.

        A valid pixel where the image is NaN gets the value of the nearest pixel that has one;
        the second result is the number of these.
        """
        known: Mask = np.asarray(~np.isnan(image).any(axis=0))
        missing = int(np.count_nonzero(self.valid & ~known))
        if missing:
            image = spread(image, known)
        errors = (image - self.bands)[:, self.valid]
        share = np.square(errors / _or_one(self.peak)[:, 0]).mean()
        return (float(-10 * np.log10(share)) if share > 0 else np.inf), missing


def _or_one(peak: Floats) -> Floats:
    """Return the peaks (B, 1, 1); 1 for a band with only one value, which has no range."""
    return np.where(peak > 0, peak, 1.0)[:, None, None]


def spread(image: Floats, known: Mask) -> Floats:
    """Return an image (..., H, W) in which unknown pixels have the value of the nearest known."""
    if known.all():
        return image
    if not known.any():
        raise ValueError("no pixel is known")
    nearest = distance_transform_edt(~known, return_distances=False, return_indices=True)
    return np.ascontiguousarray(image[(..., *nearest)])
