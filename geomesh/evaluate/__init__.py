"""The presets compared with other ways to choose nodes, as in the paper's Table 1."""
