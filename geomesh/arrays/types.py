"""The arrays that every package speaks of, by name."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Coordinates (N, 2): x, then y.
Points = NDArray[np.float64]
# Node ids (T, 3).
Triangles = NDArray[np.int32]
# Any other numbers, counts, and ids of nodes or triangles.
Floats = NDArray[np.float64]
Counts = NDArray[np.int64]
Ids = NDArray[np.int32]
# An image (H, W) of 256 gray levels, and which of its pixels are chosen.
Gray = NDArray[np.uint8]
Mask = NDArray[np.bool_]
