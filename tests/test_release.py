"""The files for a release: the CI workflows and the citation agree with the project."""

from __future__ import annotations

import os
import re
import subprocess
import tomllib

import pytest
import yaml

import geomesh
from support.samples import ROOT

WORKFLOWS = ROOT / ".github" / "workflows"
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))


def workflow(name):
    """Return a workflow. YAML 1.1 reads its key `on` as True."""
    document = yaml.safe_load((WORKFLOWS / name).read_text(encoding="utf-8"))
    return {"on": document.pop(True), **document}


CI, RELEASE = workflow("ci.yml"), workflow("release.yml")
JOBS = CI["jobs"] | RELEASE["jobs"]
STEPS = [step for job in JOBS.values() for step in job.get("steps", [])]
COMMANDS = "\n".join(step.get("run", "") for step in STEPS)


def test_every_python_that_is_promised_is_tested_on_every_system():
    matrix = CI["jobs"]["test"]["strategy"]["matrix"]
    promised = re.findall(
        r"Python :: (3\.\d+)$", "\n".join(PROJECT["project"]["classifiers"]), re.MULTILINE
    )
    assert matrix["python"] == promised
    assert PROJECT["project"]["requires-python"] == f">={promised[0]}"
    assert [name.partition("-")[0] for name in matrix["os"]] == ["ubuntu", "macos", "windows"]


@pytest.mark.parametrize("target", sorted(set(re.findall(r"\bmake ([\w-]+)", COMMANDS))))
def test_what_the_workflows_make_is_in_the_makefile(target):
    rules = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert re.search(rf"^{target}:", rules, re.MULTILINE)


def test_the_tests_start_as_make_starts_them():
    """Windows has no make, so the workflow must contain the same command as the Makefile."""
    (started,) = re.findall(r"^python -m pytest.*", COMMANDS, re.MULTILINE)
    rules = (ROOT / "Makefile").read_text(encoding="utf-8")
    assert started.replace("python", "$(BIN)/python", 1) in rules
    assert "make" not in "".join(step.get("run", "") for step in CI["jobs"]["test"]["steps"])
    for group in re.findall(r"--group (\w+)", COMMANDS):
        assert group in PROJECT["dependency-groups"]
    for file in re.findall(r"--constraint (\S+)", COMMANDS):
        assert (ROOT / file).exists()


def test_actions_are_official_and_held_to_a_major_version():
    used = [step["uses"] for step in STEPS if "uses" in step]
    assert used
    for action in used:
        assert re.fullmatch(r"actions/[\w-]+@v\d+|pypa/[\w-]+@release/v\d+", action), action
    assert RELEASE["jobs"]["ci"]["uses"] == "./.github/workflows/ci.yml"
    assert "workflow_call" in CI["on"]


def test_nothing_may_write_but_the_job_that_publishes():
    for document in (CI, RELEASE):
        assert document["permissions"] == {"contents": "read"}
    allowed = {name: job["permissions"] for name, job in JOBS.items() if "permissions" in job}
    assert allowed == {"publish": {"id-token": "write"}}
    assert "secrets" not in (WORKFLOWS / "release.yml").read_text(encoding="utf-8")


def test_a_tag_is_published_only_if_it_is_the_version_and_is_tested():
    assert RELEASE["on"] == {"push": {"tags": ["v*"]}}
    jobs = RELEASE["jobs"]
    assert (jobs["publish"]["needs"], jobs["build"]["needs"]) == ("build", "ci")
    assert "run" not in str(jobs["publish"]["steps"])
    check = next(step["run"] for step in jobs["build"]["steps"] if "GITHUB_REF_NAME" in str(step))
    for tag, code in ((f"v{geomesh.__version__}", 0), ("v0.0.0", 1)):
        done = subprocess.run(
            ["bash", "-e", "-c", check],
            cwd=ROOT,
            env={**os.environ, "GITHUB_REF_NAME": tag},
            check=False,
        )
        assert done.returncode == code


def test_the_citation_is_that_of_this_version():
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["cff-version"] == "1.2.0"
    assert citation["type"] == "software"
    assert citation["title"] == "geomesh"
    assert citation["version"] == geomesh.__version__
    assert citation["license"] == PROJECT["project"]["license"]
    assert citation["authors"] == PROJECT["project"]["authors"]
    assert {"message", "abstract", "keywords"} <= set(citation)
    (paper,) = citation["references"]
    assert paper["title"].startswith("Proposed System for Convert Satellite Surface Image")
    # Only fields that the text of the paper contains.
    assert set(paper) == {"type", "title", "authors", "notes"}


def test_contributors_are_told_that_the_workflows_have_not_run():
    assert "have not run yet" in (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
