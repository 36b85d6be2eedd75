"""Stages 1 to 3: gray image and Sobel, Canny edges, SIFT keypoints."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
