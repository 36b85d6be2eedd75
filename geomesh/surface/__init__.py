"""Mesh surfaces: fit values to a raster, paint them on pixels and compare with the raster."""
