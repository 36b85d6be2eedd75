"""Pack the QGIS plugin, with the wheel of geomesh inside, into dist/geomesh_qgis-<version>.zip."""

from __future__ import annotations

import argparse
import configparser
import re
import subprocess
import sys
import tempfile
import zipfile
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
PLUGIN = HERE / "geomesh_qgis"

# The types of the plugin's files. A file of another type stops the build: either it is there by
# mistake, or its type is missing in this list.
WANTED = {".py", ".txt", ".svg", ".png", ".ui", ".qml", ".md", ".html", ".json", ".qm", ".ipynb"}

# The time of every entry. It is constant: the zip depends only on the content of its files.
TIMESTAMP = (2020, 2, 2, 0, 0, 0)


def versions() -> tuple[str, str]:
    """Return the versions of the plugin and of the library."""
    metadata = configparser.ConfigParser(interpolation=None)
    metadata.read(PLUGIN / "metadata.txt", encoding="utf-8")
    library = re.search(r'"(.+)"', (ROOT / "geomesh/_version.py").read_text().split("=")[1])
    return metadata.get("general", "version", fallback="none"), library[1] if library else "none"


def plugin_files() -> list[Path]:
    """Return the files of the plugin, sorted."""
    files = []
    for path in sorted(PLUGIN.rglob("*")):
        inside = path.relative_to(PLUGIN)
        if path.is_dir() or inside.parts[0] in {"wheel", "tests"} or "__pycache__" in inside.parts:
            continue
        if path.suffix not in WANTED and path.name != "LICENSE":
            sys.exit(f"Not a file of a plugin: {path.relative_to(ROOT)}. Remove it, or see WANTED.")
        files.append(path)
    return files


def build_wheel(folder: str) -> Path:
    """Build the wheel of geomesh only, without its dependencies."""
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--wheel-dir", folder]
    subprocess.run([*command, str(ROOT)], check=True)
    (wheel,) = Path(folder).glob("geomesh_toolkit-*.whl")
    return wheel


def pack(target: Path, wheel: Path) -> None:
    """Write the zip. The same content always gives the same bytes."""
    content = {path.relative_to(PLUGIN).as_posix(): path for path in plugin_files()}
    content[f"wheel/{wheel.name}"] = wheel
    if not (PLUGIN / "LICENSE").exists():
        sys.exit("The plugin has no LICENSE; QGIS plugins are refused without one.")
    target.parent.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as archive:
        for name in sorted(content):
            entry = zipfile.ZipInfo(f"{PLUGIN.name}/{name}", TIMESTAMP)
            entry.compress_type = zipfile.ZIP_DEFLATED
            entry.external_attr = 0o644 << 16
            archive.writestr(entry, content[name].read_bytes())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, default=ROOT / "dist", help="folder of the zip")
    out = parser.parse_args().out
    plugin, library = versions()
    if plugin != library:
        sys.exit(
            f"metadata.txt has version {plugin}, geomesh/_version.py {library}: make them one."
        )
    target = out / f"{PLUGIN.name}-{plugin}.zip"
    with tempfile.TemporaryDirectory() as folder:
        pack(target, build_wheel(folder))
    size = target.stat().st_size / 1e6
    print(f"Made {target} ({size:.1f} MB).")
    print("QGIS: Plugins > Manage and Install Plugins > Install from ZIP")


if __name__ == "__main__":
    main()
