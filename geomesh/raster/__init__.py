"""Rasters: open any source as a Scene, which is read in windows and lies on a Grid."""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
