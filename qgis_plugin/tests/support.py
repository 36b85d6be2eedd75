"""Paths and helper functions for the tests and for the processes that they start."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

PLUGINS = Path(__file__).resolve().parent.parent  # the value for QGIS_PLUGINPATH
ROOT = PLUGINS.parent
SAMPLES = ROOT / "data_samples"


def find_program(name: str) -> str:
    """Find `qgis_process`. In Debian's QGIS 3.22 it always fails, but the .bin file works."""
    found = shutil.which(f"{name}.bin") or shutil.which(name)
    assert found, f"{name} is not installed: apt-get install qgis"
    return found


def build(python: Path, out: Path, script: Path = PLUGINS / "build.py") -> tuple[Path, str]:
    """Build the zip of the plugin in a folder; return its path and the printed text."""
    result = subprocess.run(
        [python, script, "--out", out], capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stdout + result.stderr
    (path,) = out.glob("*.zip")
    return path, result.stdout
