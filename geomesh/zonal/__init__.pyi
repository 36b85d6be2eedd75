from .owners import find_owners as find_owners
from .statistics import Statistics as Statistics
from .statistics import measure_scene as measure_scene
from .tile_statistics import measure_tile as measure_tile
