"""What a mesh with heights says of the ground: volumes and contours."""
