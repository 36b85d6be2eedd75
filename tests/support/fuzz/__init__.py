"""Mutated rasters through geomesh, in processes of their own.

By hand, from the root of the project::

    PYTHONPATH=tests .venv/bin/python -m support.fuzz --seed 7 --count 5000

`originals` writes small real rasters, `tiff` and `mutate` change them, `check` puts one of them
through geomesh, and `run` distributes them over processes.
"""
