"""Read and compare mesh files, and list what is in their folder."""

from __future__ import annotations

import subprocess
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

import geopandas as gpd
import numpy as np
import pyogrio

from geomesh.mesh.topology import edge_keys

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from geomesh.mesh.triangle_mesh import TriangleMesh


def read_layer(path: Path, layer: str = "triangles") -> gpd.GeoDataFrame:
    if path.suffix == ".parquet":
        frame = gpd.read_parquet(path)
    else:
        frame = gpd.read_file(path, layer=layer)
    return frame.sort_values("id", ignore_index=True)


def hidden(folder: Path) -> list[str]:
    return [entry.name for entry in folder.iterdir() if entry.name.startswith(".")]


def contents(path: Path) -> dict[str, Any]:
    """Return the rows and the metadata of each layer of a file."""
    found: dict[str, Any] = {}
    for name in ("triangles", "edges", "nodes"):
        meta, table = pyogrio.read_arrow(path, layer=name)
        found[name] = table.to_pydict()
        found[f"{name}, about"] = pyogrio.read_info(path, layer=name)["layer_metadata"]
        assert table.num_rows > 100, meta
    return found


def assert_same(found: TriangleMesh, expected: TriangleMesh) -> None:
    np.testing.assert_array_equal(found.nodes, expected.nodes)
    np.testing.assert_array_equal(found.triangles, expected.triangles)
    keys = edge_keys(found.constraints)
    np.testing.assert_array_equal(keys, np.unique(edge_keys(expected.constraints)))
    assert found.grid == expected.grid
    assert found.domain == expected.domain
    assert found.plane_size == expected.plane_size
    assert found.metadata == expected.metadata
    for table, other in (
        (found.node_table, expected.node_table),
        (found.triangle_table, expected.triangle_table),
    ):
        assert list(table) == list(other)
        for name in other:
            assert table[name].dtype == other[name].dtype, name
            np.testing.assert_array_equal(table[name], other[name], err_msg=name)


@contextmanager
def mounted(folder: Path, size: str) -> Iterator[bool]:
    """Mount a disk of a size, such as "200k", on a folder. Yield False if that is not allowed."""
    mount = ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", str(folder)]
    try:
        done = subprocess.run(mount, capture_output=True, check=False).returncode == 0
    except OSError:
        done = False
    yield done
    if done:
        subprocess.run(["umount", str(folder)], check=True)
