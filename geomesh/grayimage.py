"""The 8-bit image that the detectors look at, read window by window."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from geomesh.grid import Window
from geomesh.preprocess import Gray, Tone, sobel_enhance
from geomesh.raster import Reader


class GrayImage(Protocol):
    """An 8-bit image that can be read by windows."""

    @property
    def extent(self) -> Window:
        """The window of all pixels."""

    def read(self, window: Window) -> tuple[Gray, NDArray[np.bool_]]:
        """Return gray levels and validity (h, w) of a window."""


@dataclass(frozen=True)
class SceneGray:
    """The scene's gray image, made window by window."""

    reader: Reader
    tone: Tone
    sobel: bool
    extent: Window

    def read(self, window: Window) -> tuple[Gray, NDArray[np.bool_]]:
        """Return gray levels and validity (h, w) of a window."""
        bands, valid = self.reader.read(window)
        gray = self.tone.gray(bands, valid)
        return (sobel_enhance(gray) if self.sobel else gray), valid


@dataclass(frozen=True)
class ArrayGray:
    """A gray image in memory."""

    gray: Gray
    valid: NDArray[np.bool_]

    @property
    def extent(self) -> Window:
        """The window of all pixels."""
        return Window(0, 0, self.gray.shape[1], self.gray.shape[0])

    def read(self, window: Window) -> tuple[Gray, NDArray[np.bool_]]:
        """Return gray levels and validity (h, w) of a window."""
        return self.gray[window.slices()], self.valid[window.slices()]
