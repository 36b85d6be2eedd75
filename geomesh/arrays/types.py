"""Names for the array types that all packages use."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

# Coordinates (N, 2): x, then y.
Points = NDArray[np.float64]
# Node ids (T, 3).
Triangles = NDArray[np.int32]
# Other numbers, counts, and ids of nodes or triangles.
Floats = NDArray[np.float64]
Counts = NDArray[np.int64]
Ids = NDArray[np.int32]
# An image (H, W) of 256 gray levels, and a mask: True for chosen pixels or items.
Gray = NDArray[np.uint8]
Mask = NDArray[np.bool_]
