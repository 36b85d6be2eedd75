"""geomesh against other ways to the same result: ``python -m benchmarks``."""
