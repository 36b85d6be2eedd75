"""Measure the contents of a mesh file: a digest of its rows, and the bytes of its arrays."""

from __future__ import annotations

import hashlib
import json
import marshal
import sqlite3
import sys
from contextlib import closing
from pathlib import Path

from geomesh import read_mesh
from geomesh.parameters import LAYERS


def digest(path: Path) -> str:
    """Return the SHA-256 of all rows of all layers of a GeoPackage, in the order of their ids."""
    found = hashlib.sha256()
    with closing(sqlite3.connect(path)) as database:
        for layer in LAYERS:
            for row in database.execute(f'SELECT * FROM "{layer}" ORDER BY id'):
                found.update(marshal.dumps(row, 2))  # version 2 does not mark shared objects
    return found.hexdigest()


def array_bytes(path: Path) -> int:
    """Return the bytes in memory of the columns of all layers."""
    mesh = read_mesh(path)
    return sum(column.nbytes for layer in LAYERS for column in mesh.attributes(layer).values())


if __name__ == "__main__":
    print(json.dumps({"digest": digest, "bytes": array_bytes}[sys.argv[1]](Path(sys.argv[2]))))
