"""The domain of a mesh: trace the outline of the valid data and simplify it to loops."""
