"""Kernels: one signature each, compiled once, cached on disk, and never outdated."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import textwrap
import warnings
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np
import pytest

from geomesh import GeomeshWarning
from geomesh.arrays import kernel_cache
from geomesh.arrays.jit import float64, int64, kernel, reads, void, writes
from geomesh.arrays.kernel_cache import NoCache, digest_of, open_cache
from support.commands import PROGRAM
from support.files import mounted
from support.samples import OLINDA

if TYPE_CHECKING:
    from pathlib import Path

Run = Callable[..., list[str]]

# Two modules: a kernel, and the function and the value that it uses.
PARTS = """
from geomesh.arrays.jit import inner

STEP = 1

@inner
def one(value):
    return value + 1
"""
USER = """
import numpy as np
from geomesh.arrays.jit import float64, kernel, reads, void, writes
from parts import STEP, one

@kernel(void(reads(float64, 1), writes(float64, 1)))
def add(values, sums):
    for i in range(len(values)):
        sums[i] = one(values[i]) + STEP

def run():
    sums = np.empty(2)
    add(np.array([1.0, 2.0]), sums)
    return sums.tolist()
"""


@pytest.fixture
def project(tmp_path: Path) -> tuple[Path, Run]:
    """A folder with both modules, and a function that runs them with a separate cache."""
    folder = tmp_path / "project"
    folder.mkdir()
    (folder / "parts.py").write_text(PARTS)
    (folder / "user.py").write_text(USER)

    def run(*before: str) -> list[str]:
        """Return the result, and how many functions numba compiled."""
        code = textwrap.dedent("""
            import json
            from numba.core import event
            compiled = event.RecordingListener()
            event.register("numba:compile", compiled)
            {before}
            import user
            print(json.dumps([user.run(), len(compiled.buffer) // 2]))
        """).format(before="\n".join(before))
        environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")}
        environment["PYTHONPATH"] = os.pathsep.join([str(folder), *filter(None, sys.path)])
        done = subprocess.run(
            [sys.executable, "-c", code],
            capture_output=True,
            text=True,
            check=True,
            env=environment,
            timeout=120,
        )
        found: list[str] = json.loads(done.stdout)
        return found

    return folder, run


def test_a_second_process_compiles_nothing(project: tuple[Path, Run]) -> None:
    _, run = project
    assert run() == [[3.0, 4.0], 2]
    assert run() == [[3.0, 4.0], 0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("old", "new", "sums"),
    [
        ("value + 1", "value + 5", [7.0, 8.0]),
        ("STEP = 1", "STEP = 9", [11.0, 12.0]),
        ("return value + 1", "return value - 1", [1.0, 2.0]),
    ],
)
def test_an_edit_in_what_a_kernel_calls_or_uses_is_seen(
    project: tuple[Path, Run], old: str, new: str, sums: list[float]
) -> None:
    folder, run = project
    parts = folder / "parts.py"
    stamp = parts.stat()
    run()
    parts.write_text(PARTS.replace(old, new))
    # Size and time are the same, so only the code itself is different.
    os.utime(parts, ns=(stamp.st_atime_ns, stamp.st_mtime_ns))
    assert parts.stat().st_size == stamp.st_size
    for cached in folder.glob("__pycache__/*"):
        cached.unlink()  # Python's own cache compares size and time
    assert run()[0] == sums


@pytest.mark.slow
def test_older_machine_code_of_a_kernel_is_removed(
    project: tuple[Path, Run], tmp_path: Path
) -> None:
    folder, run = project
    run()
    before = {path.name for path in (tmp_path / "cache").rglob("*.nb?")}
    (folder / "parts.py").write_text(PARTS.replace("STEP = 1", "STEP = 12"))
    run()
    after = {path.name for path in (tmp_path / "cache").rglob("*.nb?")}
    assert len(before) == len(after) == 2
    assert not before & after


@pytest.mark.slow
def test_damaged_machine_code_is_compiled_anew(project: tuple[Path, Run], tmp_path: Path) -> None:
    _, run = project
    run()
    for path in (tmp_path / "cache").rglob("*.nb?"):
        path.write_bytes(path.read_bytes()[:100])
    assert run() == [[3.0, 4.0], 2]
    assert run() == [[3.0, 4.0], 0]


@pytest.mark.slow
def test_lines_and_files_may_move(project: tuple[Path, Run]) -> None:
    folder, run = project
    run()
    (folder / "parts.py").write_text("# A line more.\n" + PARTS)
    assert run() == [[3.0, 4.0], 0]


def double(values, sums):
    for i in range(len(values)):
        sums[i] = 2 * values[i]


def test_a_kernel_takes_what_its_signature_says_and_nothing_else() -> None:
    compiled = kernel(void(reads(float64, 1), writes(float64, 1)))(double)
    values, sums = np.arange(3.0), np.empty(3)
    values.flags.writeable = False
    compiled(values, sums)
    assert sums.tolist() == [0, 2, 4]
    compiled(np.arange(3.0), sums)  # a writable array is accepted as input
    with pytest.raises(TypeError, match="No matching definition"):
        compiled(np.arange(3), sums)
    with pytest.raises(TypeError, match="No matching definition"):
        compiled(values, np.empty((3, 2))[:, 0])
    with pytest.raises(TypeError, match="No matching definition"):
        compiled(values, values)


def test_the_digest_depends_on_the_signature() -> None:
    one = digest_of(double, void(reads(float64, 1), writes(float64, 1)))
    assert one == digest_of(double, void(reads(float64, 1), writes(float64, 1)))
    assert one != digest_of(double, void(reads(int64, 1), writes(float64, 1)))


def test_without_a_folder_to_write_to_kernels_compile_and_that_is_said_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(kernel_cache, "_warned", [])

    def no_folder(*_: object) -> None:
        raise RuntimeError("cannot cache function: no locator available")

    monkeypatch.setattr(kernel_cache.FunctionCache, "__init__", no_folder)
    signature = void(reads(float64, 1), writes(float64, 1))
    assert isinstance(open_cache(double, signature), NoCache)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        for _ in range(3):
            sums = np.empty(2)
            kernel(signature)(double)(np.ones(2), sums)
            assert sums.tolist() == [2, 2]
    (told,) = [each for each in caught if each.category is GeomeshWarning]
    assert "every run compiles it again" in str(told.message)
    assert "NUMBA_CACHE_DIR" in str(told.message)


def mesh(cache: Path, output: Path, **environment: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [*PROGRAM, "mesh", str(OLINDA), "-o", str(output), "--progress", "jsonl"],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "NUMBA_CACHE_DIR": str(cache), **environment},
    )


def events(process: subprocess.Popen[str]) -> list[dict[str, object]]:
    out, _ = process.communicate(timeout=180)
    assert process.returncode == 0
    return [json.loads(line) for line in out.splitlines()]


def is_compiling(told: list[dict[str, object]]) -> bool:
    return any("Compiling, once" in str(event.get("message")) for event in told)


@pytest.mark.slow
def test_two_first_runs_at_the_same_time_and_a_quick_second_one(tmp_path: Path) -> None:
    cache, outputs = tmp_path / "cache", [tmp_path / f"{k}.gpkg" for k in range(3)]
    first = [mesh(cache, output) for output in outputs[:2]]
    told = [events(process) for process in first]
    assert any(map(is_compiling, told))
    last = events(mesh(cache, outputs[2]))
    assert not is_compiling(last)
    results = [found[-1] for found in (*told, last)]
    assert len({json.dumps(result["figures"]) for result in results}) == 1


@pytest.mark.slow
def test_a_full_folder_is_said_once_and_the_mesh_is_made(tmp_path: Path) -> None:
    full = tmp_path / "full"
    full.mkdir()
    with mounted(full, "16k") as allowed:
        if not allowed:
            pytest.skip("file systems cannot be mounted here")
        (full / "filling").write_bytes(b"x" * 8192)
        told = events(mesh(full, tmp_path / "mesh.gpkg"))
    warned = [event["message"] for event in told if event["event"] == "log"]
    assert len(warned) == 1
    assert "compiled code cannot be stored (" in str(warned[0])
    assert told[-1]["event"] == "result"
