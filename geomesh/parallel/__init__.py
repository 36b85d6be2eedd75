"""Parallel work: the tile plan, the workers that process the tiles, and progress."""
