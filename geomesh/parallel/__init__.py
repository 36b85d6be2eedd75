"""Work on tiles: the tile plan, the workers that share it, and its progress."""
