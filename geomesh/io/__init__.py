"""Files: writing meshes and reading them back."""
