"""Stage 4: exact Delaunay and constrained Delaunay triangulation."""
