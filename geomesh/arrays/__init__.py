"""Arrays: compiled kernels, read-only columns, and the array types that all packages use."""
