"""Colours of triangles: convert text to bytes and back, and brighten them for the screen."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

_BRIGHTEST = 99

# The value of each character as a hexadecimal digit.
_NO_DIGIT = 255
_DIGITS = np.full(256, _NO_DIGIT, np.uint8)
for _value, _letters in enumerate([*"0123456789", *("aA", "bB", "cC", "dD", "eE", "fF")]):
    _DIGITS[list(map(ord, _letters))] = _value


def brightened(levels: NDArray[Any]) -> NDArray[np.uint8]:
    """Return 8-bit colours (..., 3), brightened if the image is dark.

    Raw 8-bit satellite bands often use only the lower part of the range. All colours are
    multiplied by one factor, which is 1 if the image is bright enough.
    """
    return np.clip(levels * brightening(levels), 0, 255).astype(np.uint8)


def brightening(levels: NDArray[Any]) -> float:
    """Return the factor of `brightened`."""
    greatest = max(float(np.percentile(levels, _BRIGHTEST)), 1.0)
    return max(255 / greatest, 1.0)


def parse_colors(colors: NDArray[Any]) -> NDArray[np.uint8]:
    """Return the red, green and blue bytes (n, 3) of colours '#rrggbb' (n,).

    Raises
    ------
    ValueError
        If one of them is something else.
    """
    letters = np.ascontiguousarray(colors.astype("<U7")).view("<u4").reshape(-1, 7)
    digits = _DIGITS[np.minimum(letters[:, 1:], len(_DIGITS) - 1)]
    if (letters[:, 0] != ord("#")).any() or (digits == _NO_DIGIT).any():
        raise ValueError("a colour is not written as #rrggbb")
    rgb: NDArray[np.uint8] = digits[:, ::2] << 4 | digits[:, 1::2]
    return rgb


def format_colors(rgb: NDArray[np.uint8]) -> NDArray[np.str_]:
    """Return colours (T, 3) as text '#rrggbb' (T,), dtype '<U7'."""
    digits = np.frombuffer(b"0123456789abcdef", np.uint8).astype("<u4")
    codes = np.empty((len(rgb), 7), "<u4")
    codes[:, 0] = ord("#")
    codes[:, 1::2] = digits[rgb >> 4]
    codes[:, 2::2] = digits[rgb & 15]
    text: NDArray[np.str_] = codes.view("<U7")[:, 0]
    return text
