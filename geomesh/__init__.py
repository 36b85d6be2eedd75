"""geomesh: from a georeferenced raster to a certified triangle mesh.

>>> import geomesh
>>> mesh = geomesh.mesh_raster("scene.tif")  # doctest: +SKIP
>>> mesh.to_file("mesh.gpkg")  # doctest: +SKIP
"""

import lazy_loader

# OpenCV, GDAL and numba take a second to import: each name of __init__.pyi loads its module
# when it is first used, so that `geomesh --help` and `import geomesh` answer at once.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
