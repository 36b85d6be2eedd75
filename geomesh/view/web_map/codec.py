"""Numbers as short texts: differences, byte planes, zlib and base64. The page reads them back."""

from __future__ import annotations

import base64
import zlib
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

# Higher levels take much longer, and save one percent.
_LEVEL = 6


def pack(data: bytes) -> str:
    """Return bytes, compressed, as text."""
    return base64.b64encode(zlib.compress(data, _LEVEL)).decode("ascii")


def byte_planes(codes: NDArray[Any], width: int) -> bytes:
    """Return whole numbers (n,) of `width` bytes: all lowest bytes, then all next ones, and so on.

    The bytes of a plane are alike, so they compress better than whole numbers.
    """
    raw = np.ascontiguousarray(codes.astype(f"<u{width}")).view(np.uint8)
    return raw.reshape(-1, width).T.tobytes()


def zigzag(values: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return numbers (n,) as numbers of 0 or more: 2 v, or -2 v - 1 if v is negative."""
    codes: NDArray[np.int64] = (values << 1) ^ (values >> 63)
    return codes


def differences(values: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the difference of each number (n,) to the one before it, as in `zigzag`."""
    return zigzag(np.diff(values, prepend=0))


def below_highest(ids: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return ids (n,) as distances below the next new id. A new id itself becomes 0.

    The ids must be numbered in the order in which they first appear.
    """
    highest = np.maximum.accumulate(np.concatenate([[-1], ids[:-1]])) + 1
    distances: NDArray[np.int64] = highest - ids
    return distances
