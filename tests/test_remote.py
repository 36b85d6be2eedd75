"""A raster at a URL: only the necessary bytes are read, and errors are reported in one line."""

from __future__ import annotations

import os
import re
import subprocess
import sys
import threading
from contextlib import suppress
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from itertools import product
from typing import TYPE_CHECKING, Any

import pytest
import rasterio
from rasterio.enums import Resampling
from rasterio.shutil import copy

import geomesh
from geomesh.errors import SourceError
from support.commands import OLD, snapshot
from support.samples import fingerprint, write_mirrored

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

# GDAL recommends this setting for reading from the web: it does not list the folder.
AS_USERS_DO = {"GDAL_DISABLE_READDIR_ON_OPEN": "EMPTY_DIR"}

SIDE, TILE, BLOCK = 4096, 1024, 256


@dataclass
class Served:
    """A folder that is available over HTTP, with a log of the requests.

    Parameters
    ----------
    folder : Path
    url : str
    log : list of (method, path, first byte, last byte)
        -1 if the request had no range.
    ends : int, optional
        Position at which the connection breaks. The header promises more bytes.
    """

    folder: Path
    url: str = ""
    log: list[tuple[str, str, int, int]] = field(default_factory=list)
    ends: int | None = None


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with scene.tif: 4 x 4 tiles with overviews, and its header first as in a COG."""
    folder = tmp_path_factory.mktemp("web")
    plain = write_mirrored(folder / "plain.tif", "olinda_landsat7_rgb_uint8.tif", SIDE, SIDE)
    with rasterio.open(plain, "r+") as dataset:
        dataset.build_overviews([2, 4], Resampling.nearest)
    options = {"tiled": True, "blockxsize": BLOCK, "blockysize": BLOCK, "compress": "deflate"}
    copy(plain, folder / "scene.tif", driver="GTiff", copy_src_overviews=True, **options)
    plain.unlink()
    return folder


@pytest.fixture
def served(folder: Path) -> Iterator[Served]:
    served = Served(folder)

    class Handler(BaseHTTPRequestHandler):
        protocol_version = "HTTP/1.1"

        def do_HEAD(self) -> None:
            self.answer("HEAD")

        def do_GET(self) -> None:
            self.answer("GET")

        def answer(self, method: str) -> None:
            asked = re.fullmatch(r"bytes=(\d+)-(\d*)", self.headers.get("Range", ""))
            path = folder / self.path.strip("/")
            size = path.stat().st_size if path.is_file() else 0
            first = int(asked[1]) if asked else -1
            last = min(int(asked[2] or size - 1), size - 1) if asked else -1
            served.log.append((method, self.path, first, last))
            if not size:
                self.send_error(404)
                return
            start, stop = (first, last + 1) if asked else (0, size)
            self.send_response(206 if asked else 200)
            self.send_header("Accept-Ranges", "bytes")
            self.send_header("Content-Length", str(stop - start))
            if asked:
                self.send_header("Content-Range", f"bytes {start}-{stop - 1}/{size}")
            self.end_headers()
            if method == "HEAD":
                return
            content = path.read_bytes()[start:stop]
            if served.ends is not None and stop > served.ends:
                self.wfile.write(content[: max(served.ends - start, 0)])
                self.close_connection = True
            else:
                self.wfile.write(content)

        def log_message(self, *_: Any) -> None:
            pass

        def handle(self) -> None:
            with suppress(ConnectionError):  # the client has closed the connection
                super().handle()

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    server.daemon_threads = True
    threading.Thread(target=server.serve_forever, daemon=True).start()
    served.url = f"http://127.0.0.1:{server.server_port}"
    yield served
    server.shutdown()
    server.server_close()


def box(path: Path, left: int, top: int, right: int, bottom: int) -> tuple[float, ...]:
    """Return the map bounds of a box in pixels."""
    with rasterio.open(path) as dataset:
        west, north = dataset.transform @ (left, top)
        east, south = dataset.transform @ (right, bottom)
    return west, south, east, north


def blocks(path: Path) -> dict[tuple[int, int], tuple[int, int]]:
    """Return the first and last byte of each block (column, row), without the overviews."""
    found = {}
    with rasterio.open(path) as dataset:
        for col, row in product(range(SIDE // BLOCK), repeat=2):
            first, size = (
                int(dataset.get_tag_item(f"BLOCK_{name}_{col}_{row}", "TIFF", bidx=1))
                for name in ("OFFSET", "SIZE")
            )
            found[col, row] = first, first + size - 1
    return found


@pytest.mark.slow
@pytest.mark.parametrize("prefix", ["", "/vsicurl/"], ids=["url", "vsicurl"])
def test_only_the_part_asked_for_is_fetched(folder: Path, served: Served, prefix: str) -> None:
    path = folder / "scene.tif"
    bounds = box(path, TILE, TILE, 2 * TILE, 2 * TILE)
    with rasterio.Env(**AS_USERS_DO):
        mesh = geomesh.mesh_raster(f"{prefix}{served.url}/scene.tif", bounds=bounds, workers=2)
    local = geomesh.mesh_raster(path, bounds=bounds)
    same, other = fingerprint(mesh), fingerprint(local)
    assert {name for name in same if same[name] != other[name]} == {"metadata"}  # names differ

    assert {name for _, name, _, _ in served.log} == {"/scene.tif"}
    ranges = [(first, last) for method, _, first, last in served.log if method == "GET"]
    assert min(first for first, _ in ranges) == 0
    assert all(last >= 0 for _, last in ranges)
    total = path.stat().st_size
    assert sum(last - first + 1 for first, last in ranges) < 0.15 * total

    first, last = TILE // BLOCK, 2 * TILE // BLOCK - 1
    for (col, row), (start, end) in blocks(path).items():
        read = any(a <= start and end <= b for a, b in ranges) or all(
            any(a <= byte <= b for a, b in ranges) for byte in (start, end)
        )
        if first <= col <= last and first <= row <= last:
            assert read
        elif not first - 1 <= row <= last + 1:
            assert not any(a <= end and start <= b for a, b in ranges), (col, row)


@pytest.mark.slow
def test_first_look_at_a_scene_reads_each_block_once(folder: Path, served: Served) -> None:
    """Overviews could hold anything, so it reads the blocks of the scene itself."""
    path = folder / "scene.tif"
    far = {spot: where for spot, where in blocks(path).items() if spot != (0, 0)}
    seen: list[int] = []

    def stop(_fraction: float, message: str) -> None:
        if message.startswith("Detecting"):
            raise KeyboardInterrupt

    with rasterio.Env(**AS_USERS_DO), pytest.raises(KeyboardInterrupt):
        geomesh.mesh_raster(f"{served.url}/scene.tif", workers=1, progress=stop)
    for _, _, first, last in served.log:
        seen += [spot for spot, (a, b) in far.items() if first <= a and b <= last]
    assert sorted(seen) == sorted(far)


def run(*arguments: str | Path) -> tuple[int, str, str]:
    """Run the command line as a separate program, with the settings that users have."""
    done = subprocess.run(
        [sys.executable, "-m", "geomesh", "mesh", *map(str, arguments)],
        capture_output=True,
        text=True,
        check=False,
        timeout=120,
        env=os.environ | AS_USERS_DO,
    )
    return done.returncode, done.stdout, done.stderr


def test_missing_remote_file_is_told_in_one_line(tmp_path: Path, served: Served) -> None:
    url = f"{served.url}/gone.tif"
    code, out, err = run(url, "-o", tmp_path / "mesh.gpkg")
    assert (code, out) == (1, "")
    assert re.fullmatch(f"Error: {re.escape(url)}: .*404.*\n", err), err
    assert snapshot(tmp_path) == {}


@pytest.mark.slow
def test_server_that_breaks_off_is_told_in_one_line(
    tmp_path: Path, folder: Path, served: Served
) -> None:
    served.ends = (folder / "scene.tif").stat().st_size // 2
    url, output = f"{served.url}/scene.tif", tmp_path / "mesh.gpkg"
    output.write_bytes(OLD)
    code, out, err = run(url, "-o", output, "--overwrite", "--workers=2")
    assert (code, out) == (1, "")
    lines = [line for line in err.splitlines() if not line.startswith("Warning")]
    assert len(lines) == 1, err
    pattern = r": cannot read columns \d+ to \d+, rows \d+ to \d+: .*(again|server)"
    assert re.match(f"Error: {re.escape(url)}{pattern}", lines[0]), err
    assert snapshot(tmp_path) == {"mesh.gpkg": OLD}


@pytest.mark.slow
def test_command_line_meshes_a_part_of_a_url(tmp_path: Path, folder: Path, served: Served) -> None:
    west, south, east, north = box(folder / "scene.tif", 3000, 3000, 3300, 3200)
    options = ["--bounds", *map(repr, (west, south, east, north))]
    code, out, err = run(f"{served.url}/scene.tif", "-o", tmp_path / "mesh.gpkg", *options)
    assert (code, err) == (0, "")
    assert "certified" in out
    assert geomesh.read_mesh(tmp_path / "mesh.gpkg").certify().passed


def test_server_that_does_not_run_is_told_of(served: Served) -> None:
    with pytest.raises(SourceError, match=r"127\.0\.0\.1:1/scene\.tif") as error:
        geomesh.mesh_raster("http://127.0.0.1:1/scene.tif")
    assert "\n" not in str(error.value)
