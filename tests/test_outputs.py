"""The check that no output replaces an input."""

import os
from pathlib import Path

import pytest

from geomesh.cli.outputs import protect_inputs
from geomesh.errors import OutputError


@pytest.mark.parametrize("link", [os.link, os.symlink])
def test_another_name_of_an_input_is_not_an_output(tmp_path, link):
    source, output = tmp_path / "scene.tif", tmp_path / "mesh.gpkg"
    source.write_bytes(b"pixels")
    link(source, output)
    with pytest.raises(OutputError, match=r"mesh\.gpkg is the input .*scene\.tif"):
        protect_inputs([output], [str(source), None])


def test_each_file_of_a_large_batch_is_looked_at_once(tmp_path, monkeypatch):
    looked, stat = [], Path.stat
    monkeypatch.setattr(Path, "stat", lambda path, **how: looked.append(path) or stat(path, **how))
    sources = [str(tmp_path / f"{i}.tif") for i in range(300)]
    outputs = [tmp_path / f"{i}.gpkg" for i in range(300)]
    protect_inputs(outputs, sources)
    assert sorted(looked) == sorted([*outputs, *map(Path, sources)])
