"""Files: write meshes, images and figures, and read meshes back."""
