"""Arrays: compiled kernels, read-only columns, and the types that every package uses."""
