"""Rasters: any source as a Scene that is read by windows, on a Grid."""
