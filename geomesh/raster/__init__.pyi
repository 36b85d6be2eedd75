from .bands import Band as Band
from .grid import Grid as Grid
from .grid import Window as Window
from .open import open_scene as open_scene
from .scene import Scene as Scene
