"""The pipeline: turn a raster into a mesh, and write mesh files."""
