"""Mutated rasters: each gives a certified mesh or one line, and never ends or stops the process.

The list is always the same. `python -m support.fuzz` tries others.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rasterio

from support.fuzz import run
from support.fuzz.originals import Original, write_originals
from support.fuzz.tiff import Tiff

pytest.importorskip("resource", reason="limits of memory need Linux or macOS")

SEED, COUNT = 11, 1000


@pytest.fixture(scope="module")
def originals(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Original]:
    return write_originals(tmp_path_factory.mktemp("originals"))


@pytest.mark.slow
def test_mutants_are_meshed_or_refused_in_one_line() -> None:
    # Not in tmp_path: the mutants that show a fault stay until the next run.
    folder = Path("build/fuzz").absolute()
    report = run.fuzz(SEED, range(COUNT), folder)
    print(report)
    assert not report.faults, f"{report}\nThese mutants are kept in {folder}"
    assert report.outcomes.total() == COUNT
    # Else the mutants would say little about an original. Complex numbers are always refused.
    meshed = {name: found["mesh"] for name, found in report.by_original.items()}
    del meshed["complex"]
    assert min(meshed.values()) > 5


def test_a_mutant_is_always_the_same(tmp_path: Path, originals: dict[str, Original]) -> None:
    for number in range(0, 100, 7):
        contents = []
        for folder in (tmp_path / "one", tmp_path / "other"):
            _, path = run.make_mutant(originals, SEED, number, folder)
            contents.append([file.read_bytes() for file in sorted(path.parent.iterdir())])
        assert contents[0] == contents[1]


def test_a_rebuilt_tiff_has_the_same_pixels(tmp_path: Path, originals: dict[str, Original]) -> None:
    for original in originals.values():
        if original.kind != "tiff":
            continue
        rebuilt = tmp_path / "rebuilt.tif"
        rebuilt.write_bytes(Tiff.parse(original.opened.read_bytes()).build())
        with rasterio.open(original.opened) as one, rasterio.open(rebuilt) as other:
            assert (one.profile, one.tags()) == (other.profile, other.tags())
            assert str(one.gcps) == str(other.gcps)
            np.testing.assert_array_equal(one.read(), other.read())
            np.testing.assert_array_equal(one.dataset_mask(), other.dataset_mask())


@pytest.mark.slow
def test_crashes_and_hangs_are_found(
    originals: dict[str, Original], monkeypatch: pytest.MonkeyPatch
) -> None:
    child = run.Child()
    path = originals["strips"].opened
    assert child.check(path, 2) == {"outcome": "mesh"}
    child.kill()
    assert child.check(path, 2)["outcome"] == "crash"
    monkeypatch.setattr(run, "SECONDS", 0.01)
    assert child.check(path, 2)["outcome"] == "hang"
    monkeypatch.undo()
    assert child.check(path, 2) == {"outcome": "mesh"}
    child.close()
