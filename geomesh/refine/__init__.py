"""Adaptive refinement: move, add and remove the nodes of a mesh until it reaches a goal."""
