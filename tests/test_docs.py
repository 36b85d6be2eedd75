"""The documents are correct: examples run, and every column is listed."""

import doctest
import importlib
import inspect
import json
import pkgutil
import re
import runpy
import shlex
import shutil
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import click
import pyogrio
import pytest
from click.testing import CliRunner

import geomesh
from geomesh.cli import cli
from geomesh.parameters import MODELS
from support.samples import OLINDA, ROOT, SAMPLES

DOCUMENTS = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(ROOT.glob("docs/*.md"))]


def test_the_readme_example_runs(tmp_path, monkeypatch):
    (code,) = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    shutil.copy(OLINDA, tmp_path / "scene.tif")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("MPLBACKEND", "agg")
    names = {}
    exec(code, names)
    assert (names["again"].nodes == names["mesh"].nodes).all()
    assert names["graph"].shape == (len(names["mesh"].nodes),) * 2


@pytest.mark.slow
def test_the_cluster_example_runs(tmp_path):
    (code,) = re.findall(
        r"```python\n(.*?)```", (ROOT / "docs" / "large-rasters.md").read_text(), re.DOTALL
    )
    scene = shutil.copy(OLINDA, tmp_path / "scene.tif")
    # The code is in a file, because the processes of the workers import it.
    (tmp_path / "example.py").write_text(code)
    subprocess.run([sys.executable, "example.py"], cwd=tmp_path, check=True, timeout=300)
    made = geomesh.read_mesh(tmp_path / "mesh.gpkg")
    assert (made.triangles == geomesh.mesh_raster(scene).triangles).all()


def test_links_between_documents_lead_somewhere():
    for document in DOCUMENTS:
        for target in re.findall(r"\]\(([^)#:]+)\)", document.read_text()):
            assert (document.parent / target).exists(), f"{document.name}: {target}"


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::geomesh.GeomeshWarning")
@pytest.mark.parametrize(
    "page",
    [
        *("getting-started", "choose-bands", "nodata", "breaklines", "contours", "batch", "web"),
        *("presets", "terrain", "report", "tiles"),
    ],
)
def test_the_commands_of_a_page_run_one_after_the_other(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("data_samples").symlink_to(SAMPLES)
    text = (ROOT / "docs" / f"{page}.md").read_text()
    blocks = re.findall(r"^```(sh|python)\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    assert blocks
    for language, code in blocks:
        if language == "python":
            exec(code, {})
            continue
        for line in code.replace("\\\n", "").splitlines():
            run_line(line)


def test_pydelatin_does_what_is_said_of_it(monkeypatch, capsys):
    pytest.importorskip("pydelatin")
    monkeypatch.chdir(ROOT)
    text = (ROOT / "docs" / "neighbours.md").read_text()
    code = re.findall(r"```python\n(.*?)```", text, re.DOTALL)[0]
    assert "from pydelatin" in code
    exec(code, {})
    assert capsys.readouterr().out.strip() == code.split("#")[-1].strip()


def run_line(line: str) -> None:
    """Run a line as a shell would. geomesh runs in this process, where it is already loaded."""
    if not line.startswith("geomesh "):
        subprocess.run(["bash", "-euc", line], check=True, capture_output=True)
        return
    command, _, target = line.partition(" > ")
    words = [
        found
        for word in shlex.split(command)[1:]
        for found in sorted(map(str, Path().glob(word))) or [word]
    ]
    outcome = CliRunner().invoke(cli, words)
    assert outcome.exit_code == 0, f"{line}\n{outcome.output}"
    if target:
        Path(target).write_text(outcome.stdout)


def test_every_command_in_the_documents_is_one_that_geomesh_takes():
    found = 0
    for document in DOCUMENTS:
        text = document.read_text().replace("\\\n", "")
        for line in re.findall(r"^(?: {4})?(geomesh [a-z].*)$", text, re.MULTILINE):
            words = shlex.split(re.split(r" [>|] ", line)[0], comments=True)
            if words[1] not in cli.commands:
                continue  # this is text, not a command
            try:
                cli.commands[words[1]].make_context(words[1], words[2:])
            except click.UsageError as error:
                pytest.fail(f"{document.name}: {line}: {error.format_message()}")
            found += 1
    assert found > 30


def test_the_check_of_the_site_finds_what_needs_a_network_or_leads_nowhere(tmp_path):
    check = runpy.run_path(str(ROOT / "docs" / "check.py"))
    (tmp_path / "style.css").write_text('@import "https://fonts.example/a.css"; a {color: red}')
    (tmp_path / "other.html").write_text("<p id=here></p>")
    (tmp_path / "index.html").write_text(
        """<script src="https://cdn.example/a.js"></script> <img src="//cdn.example/a.png">
        <link rel="stylesheet" href="style.css"> <a href="https://example.org">fine</a>
        <a href="other.html#here">fine</a> <a href="other.html#gone">no such place</a>
        <a href="gone.html">not there</a> <a href="#gone">no such place</a>"""
    )
    pages = check["read"](tmp_path)
    assert len(list(check["outside"](pages))) == 2
    assert len(list(check["styles"](tmp_path))) == 1
    assert len(list(check["dangling"](pages))) == 3
    assert len(list(check["missing"](pages, tmp_path))) == len(cli.commands)


def test_every_test_that_the_documents_name_exists():
    tests = "".join(path.read_text() for path in ROOT.glob("tests/test_*.py"))
    for document in DOCUMENTS:
        for name in re.findall(r"`(test_\w+)`", document.read_text()):
            assert f"def {name}(" in tests, f"{document.name}: {name}"
        for name in re.findall(r"`(tests/\w+\.py)`", document.read_text()):
            assert (ROOT / name).exists(), f"{document.name}: {name}"


def public_names() -> set[str]:
    """Return the names of geomesh and of its public packages, without "geomesh."."""
    names = set()
    for name in geomesh.__all__:
        found = getattr(geomesh, name)
        if isinstance(found, ModuleType):
            names |= {f"{name}.{inner}" for inner in found.__all__}
        else:
            names.add(name)
    return names


def test_every_public_name_is_in_the_reference():
    text = (ROOT / "docs" / "api.rst").read_text()
    told = re.findall(r"auto(?:class|function):: geomesh\.([\w.]+)$", text, re.MULTILINE)
    errors = {"GeomeshError", "GeomeshWarning"}  # documented by `automodule:: geomesh.errors`
    assert "automodule:: geomesh.errors" in text
    assert len(told) == len(set(told))
    # A class that is also public in its package is documented only once.
    expected = public_names() - errors - {"__version__", "raster.Grid"}
    assert {name for name in told if name.count(".") < 2} == expected


def test_the_reference_tells_of_what_there_is():
    text = (ROOT / "docs" / "api.rst").read_text()
    for path in re.findall(r"auto(?:class|function):: ([\w.]+)$", text, re.MULTILINE):
        assert inspect.getdoc(pkgutil.resolve_name(path)), path


def test_docstring_examples_run(monkeypatch):
    monkeypatch.chdir(ROOT)
    attempted = 0
    for found in pkgutil.walk_packages(geomesh.__path__, "geomesh."):
        outcome = doctest.testmod(importlib.import_module(found.name))
        assert outcome.failed == 0
        attempted += outcome.attempted
    assert attempted > 0


def documented(section: str) -> list[str]:
    """Return the first column of the table in a section of docs/formats.md."""
    text = (ROOT / "docs" / "formats.md").read_text()
    table = text.split(f"\n## {section}\n")[1].split("\n## ")[0]
    told = re.findall(r"^\| (`.*?) \|", table, re.MULTILINE)
    return [name for cell in told for name in re.findall(r"`([^`]+)`", cell)]


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    """A GeoPackage from a raster with one band."""
    path = tmp_path_factory.mktemp("written") / "mesh.gpkg"
    return geomesh.mesh_raster(SAMPLES / "colorado_dem_float32_epsg4269.tif").to_file(path)


@pytest.mark.parametrize("layer", ["triangles", "nodes", "edges"])
def test_every_column_of_a_file_is_documented_in_order(layer, written):
    names = documented(layer)
    expected = list(pyogrio.read_info(written, layer=layer)["fields"])
    if layer == "triangles":
        names[names.index("_std") : names.index("_max") + 1] = [
            "<band>_std",
            "<band>_min",
            "<band>_max",
        ]
    assert names == [re.sub(r"^b1", "<band>", name) for name in expected]


def test_every_measure_is_documented():
    mesh = geomesh.mesh_raster(SAMPLES / "colorado_dem_float32_epsg4269.tif")
    added = mesh.with_measures().triangle_table.keys() - mesh.triangle_table.keys()
    assert set(documented("Measures of quality")) == added
    in_map_units = mesh.with_measures("map").triangle_table.keys() - mesh.triangle_table.keys()
    assert in_map_units == {f"map_{name}" for name in mesh.quality().table}


def test_every_entry_of_the_metadata_is_documented(written):
    document = json.loads(
        pyogrio.read_info(written, layer="triangles")["layer_metadata"]["geomesh"]
    )
    assert set(documented("Metadata")) == set(document)


def test_models_and_entries_of_a_refined_mesh_are_documented(written):
    assert documented("Refined meshes") == list(MODELS)
    text = (ROOT / "docs" / "formats.md").read_text().split("\n## Metadata\n")[1]
    (row,) = re.findall(r"^\| `refinement` .*$", text, re.MULTILINE)
    entries = geomesh.read_mesh(written).metadata["refinement"]
    for name in (*entries, *entries["bands"][0]):
        assert f"`{name}`" in row, name


def test_what_only_refined_meshes_have_is_said_to_be_so(written):
    refined = geomesh.read_mesh(written)
    source = SAMPLES / "colorado_dem_float32_epsg4269.tif"
    plain = geomesh.mesh_raster(source, preset="features")
    only = {re.sub(r"^b1", "<band>", name) for name in refined.triangle_table}
    only -= {re.sub(r"^b1", "<band>", name) for name in plain.triangle_table}
    only |= refined.metadata.keys() - plain.metadata.keys()
    text = (ROOT / "docs" / "formats.md").read_text()
    said = re.findall(r"^\| `([^`]+)` .*(?:in|of) a \[?refined mesh", text, re.MULTILINE)
    assert only == set(said) - {"<band>", "certificate"}
