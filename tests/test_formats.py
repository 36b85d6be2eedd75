"""A new file format needs one module and one line: a copy of the package gets a toy format."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from support.commands import PROGRAM, Run
from support.samples import OLINDA

DIFF = Path(__file__).parent / "data" / "toy_format.diff"
PACKAGE = Path(__file__).parent.parent / "geomesh"


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the package with one more format."""
    folder = tmp_path_factory.mktemp("toy")
    shutil.copytree(PACKAGE, folder / "geomesh", ignore=shutil.ignore_patterns("__pycache__"))
    subprocess.run(["git", "apply", str(DIFF)], cwd=folder, check=True)
    return folder


def run(toy: Path, *arguments: str | Path) -> Run:
    done = subprocess.run(
        [*PROGRAM, *map(str, arguments)],
        cwd=toy,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([str(toy), *filter(None, sys.path)])},
        capture_output=True,
        text=True,
        check=False,
        timeout=180,
    )
    return Run(done.returncode, done.stdout, done.stderr)


def test_a_new_format_is_a_new_file_and_a_line_in_the_registry() -> None:
    changed: dict[str, list[str]] = {}
    for line in DIFF.read_text().splitlines():
        if line.startswith("+++ "):
            changed[line.removeprefix("+++ b/")] = []
        elif line.startswith(("+", "-")) and not line.startswith("--- "):
            changed[list(changed)[-1]].append(line)
    assert list(changed) == ["geomesh/formats/lines.py", "geomesh/formats/registry.py"]
    assert changed["geomesh/formats/registry.py"] == ['+    "lines",']
    assert all(line.startswith("+") for line in changed["geomesh/formats/lines.py"])


def test_help_and_messages_name_it(toy: Path) -> None:
    assert "UGRID, Lines" in " ".join(run(toy, "mesh", "--help").out.split())
    refused = run(toy, "mesh", OLINDA, "-o", toy / "a.txt")
    assert ".nc, .lines" in refused.error()
    assert "Lines can store triangles, not edges" in (
        run(toy, "mesh", OLINDA, "-o", toy / "a.lines", "--layers", "edges").error()
    )


@pytest.mark.slow
def test_meshes_are_written_converted_described_and_found_again(toy: Path) -> None:
    made = run(toy, "mesh", OLINDA, "-o", toy / "a.lines", "--nodes", "200")
    assert made.code == 0, made.err
    lines = (toy / "a.lines").read_text().splitlines()
    triangles = [json.loads(line) for line in lines[1:]]
    assert all(len(corners) == 3 for corners in triangles)
    assert f"{len(triangles)} triangles, certified" in made.out
    again = run(toy, "mesh", OLINDA, "-o", toy / "a.lines", "--nodes", "200", "--skip-existing")
    assert "triangles, skipped" in again.out
    assert run(toy, "mesh", OLINDA, "-o", toy / "a.gpkg", "--nodes", "200").code == 0
    assert run(toy, "convert", toy / "a.gpkg", "-o", toy / "b.lines").code == 0
    assert (toy / "b.lines").read_text().splitlines()[1:] == lines[1:]
    folder = run(toy, "mesh", OLINDA, "-o", f"{toy}/many/", "-f", "lines", "--nodes", "200")
    assert folder.code == 0, folder.err
    assert (toy / "many" / f"{OLINDA.stem}.lines").read_text().splitlines()[1:] == lines[1:]
