"""Filters for 8-bit images: fill nodata, Sobel magnitude, resize."""

from __future__ import annotations

from typing import TYPE_CHECKING

import cv2
import numpy as np

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from geomesh.arrays.types import Gray


def fill_invalid(image: Gray, valid: NDArray[np.bool_]) -> Gray:
    """Return `image` (H, W) where each invalid pixel has the value of a nearest valid pixel.

    Otherwise the border of the nodata area would be the strongest edge of the image.
    """
    if valid.all() or not valid.any():
        return image
    _, labels = cv2.distanceTransformWithLabels(
        (~valid).view(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL
    )
    value_of = np.zeros(int(labels.max()) + 1, np.uint8)
    value_of[labels[valid]] = image[valid]
    filled: Gray = value_of[labels]
    return filled


def sobel_enhance(gray: Gray) -> Gray:
    """Return the Sobel magnitude of an 8-bit image (H, W).

    It is ``0.5 abs(gx) + 0.5 abs(gy)``, at most 255.
    """
    gx = cv2.convertScaleAbs(cv2.Sobel(gray, cv2.CV_16S, 1, 0, ksize=3))
    gy = cv2.convertScaleAbs(cv2.Sobel(gray, cv2.CV_16S, 0, 1, ksize=3))
    return cv2.addWeighted(gx, 0.5, gy, 0.5, 0).astype(np.uint8, copy=False)


def resize(image: Gray, size: tuple[int, int]) -> Gray:
    """Return an 8-bit image resized to (width, height) by pixel area, separately in x and y."""
    return cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.uint8, copy=False)
