"""The surface that a mesh describes: values fitted to its raster, painted and compared."""
