from .triangulate import Triangulation as Triangulation
from .triangulate import constrained_delaunay as constrained_delaunay
from .triangulate import delaunay as delaunay
