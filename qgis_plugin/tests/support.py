"""Where things are, and how they are found and built, for the tests and what they start."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

PLUGINS = Path(__file__).resolve().parent.parent  # what QGIS_PLUGINPATH has to be
ROOT = PLUGINS.parent
SAMPLES = ROOT / "data_samples"


def find_program(name: str) -> str:
    """Debian's `qgis_process` of QGIS 3.22 is a wrapper that always fails; the .bin works."""
    found = shutil.which(f"{name}.bin") or shutil.which(name)
    assert found, f"{name} is not installed: apt-get install qgis"
    return found


def build(python: Path, out: Path, script: Path = PLUGINS / "build.py") -> tuple[Path, str]:
    """Build the zip of the plugin into a folder; return its path and what was printed."""
    result = subprocess.run(
        [python, script, "--out", out], capture_output=True, text=True, check=False
    )
    assert result.returncode == 0, result.stdout + result.stderr
    (path,) = out.glob("*.zip")
    return path, result.stdout
