"""The 8-bit gray image, the input of Canny and SIFT, read window by window."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

from geomesh.features.filters import sobel_enhance
from geomesh.raster.grid import Window

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from geomesh.arrays.types import Gray
    from geomesh.features.gray import Tone
    from geomesh.raster.scene import Scene


class GrayImage(Protocol):
    """An 8-bit image that can be read in windows."""

    @property
    def extent(self) -> Window:
        """The window of all pixels."""

    def read(self, window: Window) -> tuple[Gray, NDArray[np.bool_]]:
        """Return the gray levels (h, w) and the valid pixels (h, w) of a window."""

    def excerpt(self, window: Window) -> GrayImage:
        """Return an image for a worker that reads only `window`. An array is cut to it."""


@dataclass(frozen=True)
class SceneGray:
    """The gray image of a scene, computed window by window."""

    scene: Scene
    tone: Tone
    sobel: bool

    @property
    def extent(self) -> Window:
        """The window of all pixels."""
        return self.scene.grid.extent

    def read(self, window: Window) -> tuple[Gray, NDArray[np.bool_]]:
        """Return the gray levels (h, w) and the valid pixels (h, w) of a window."""
        bands, valid = self.scene.read(window)
        gray = self.tone.gray(bands, valid)
        return (sobel_enhance(gray) if self.sobel else gray), valid

    def excerpt(self, window: Window) -> SceneGray:
        """Return an image for a worker that reads only `window`. An array is cut to it."""
        return replace(self, scene=self.scene.excerpt(window))


@dataclass(frozen=True)
class ArrayGray:
    """A gray image, or a part of one, in memory.

    Parameters
    ----------
    gray : uint8 (h, w)
    valid : bool (h, w)
    extent : Window
        The window of the whole image.
    held : Window
        The window of `gray` and `valid`.
    """

    gray: Gray
    valid: NDArray[np.bool_]
    extent: Window
    held: Window

    @classmethod
    def whole(cls, gray: Gray, valid: NDArray[np.bool_]) -> ArrayGray:
        """Return the image with the gray levels `gray` and the valid pixels `valid` (h, w)."""
        extent = Window(0, 0, gray.shape[1], gray.shape[0])
        return cls(gray, valid, extent, extent)

    def read(self, window: Window) -> tuple[Gray, NDArray[np.bool_]]:
        """Return the gray levels (h, w) and the valid pixels (h, w) of a window."""
        part = window.slices(self.held)
        return self.gray[part], self.valid[part]

    def excerpt(self, window: Window) -> ArrayGray:
        """Return an image for a worker that reads only `window`, cut to it."""
        return ArrayGray(*self.read(window), self.extent, window)
