"""PixelMask: which pixels of a raster belong to an area of interest, one bit for each."""

from __future__ import annotations

import base64
import zlib
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geomesh.raster.grid import Window

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geomesh.arrays.types import Mask


@dataclass(frozen=True, eq=False)
class PixelMask:
    """The pixels of an area of interest.

    It is burnt once for a scene. Tiles cut their part out of it, so all of them agree.

    Parameters
    ----------
    window : Window
        In pixels of the file. Pixels outside do not belong to the area.
    bits : uint8 (height, ceil(width / 8))
        The pixels of `window`: eight in a byte, the first in the highest bit.
    """

    window: Window
    bits: NDArray[np.uint8]

    @classmethod
    def pack(cls, window: Window, pixels: Mask) -> PixelMask:
        """Return the mask of bool (height, width)."""
        return cls(window, np.packbits(pixels, axis=1))

    def read(self, window: Window, shape: tuple[int, int] | None = None) -> Mask:
        """Return bool (h, w) for `window`; `shape` (rows, columns) picks the middle of each block.

        These are the pixels that a decimated read of the raster returns.
        """
        rows, cols = (
            first + np.arange(count) if shape is None else first + _middles(count, shape[axis])
            for axis, (first, count) in enumerate(
                ((window.row, window.height), (window.col, window.width))
            )
        )
        rows, cols = rows - self.window.row, cols - self.window.col
        known_rows = (rows >= 0) & (rows < self.window.height)
        known_cols = (cols >= 0) & (cols < self.window.width)
        found = np.zeros((len(rows), len(cols)), np.bool_)
        if known_rows.any() and known_cols.any():
            inside = cols[known_cols]
            first, stop = inside[0] // 8, inside[-1] // 8 + 1
            pixels = np.unpackbits(self.bits[rows[known_rows], first:stop], axis=1)
            found[np.ix_(known_rows, known_cols)] = pixels[:, inside - 8 * first]
        return found

    def cut(self, window: Window) -> PixelMask:
        """Return the part in `window`, or a little more: whole bytes are kept."""
        inside = self.window.clip(window)
        row, col = inside.row - self.window.row, inside.col - self.window.col
        first, stop = col // 8, -(-(col + inside.width) // 8)
        width = min(8 * stop, self.window.width) - 8 * first
        kept = Window(self.window.col + 8 * first, inside.row, width, inside.height)
        return PixelMask(kept, self.bits[row : row + inside.height, first:stop].copy())

    def move(self, cols: int, rows: int) -> PixelMask:
        """Return the same pixels for a file in which they lie `cols` and `rows` farther."""
        w = self.window
        return PixelMask(Window(w.col + cols, w.row + rows, w.width, w.height), self.bits)

    def to_text(self) -> str:
        """Return the mask as text: column, row, width, height, and the packed bits.

        The bits are compressed with zlib and written in base64.
        """
        w, bits = self.window, zlib.compress(self.bits.tobytes(), 9)
        return f"{w.col} {w.row} {w.width} {w.height} {base64.b64encode(bits).decode('ascii')}"

    @classmethod
    def from_text(cls, text: str) -> PixelMask:
        """Return the mask that `to_text` wrote.

        Raises
        ------
        ValueError
            If the text is not such a mask.
        """
        try:
            col, row, width, height, encoded = text.split(" ")
            window = Window(int(col), int(row), int(width), int(height))
            bits = np.frombuffer(zlib.decompress(base64.b64decode(encoded)), np.uint8)
            return cls(window, bits.reshape(window.height, -(-window.width // 8)))
        except (ValueError, zlib.error) as error:
            raise ValueError(f"not a mask of pixels: {error}") from error


def _middles(count: int, steps: int) -> NDArray[np.intp]:
    """Return the middle of each of `steps` equal blocks of `count` pixels."""
    middles: NDArray[np.intp] = ((np.arange(steps) + 0.5) * (count / steps)).astype(np.intp)
    return middles
