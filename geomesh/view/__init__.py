"""Show a mesh: plots, the stages of the pipeline, notebooks."""
