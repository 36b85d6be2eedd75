"""The pipeline: from a raster to a mesh, and to a mesh file."""
