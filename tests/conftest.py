"""Fixtures that several test files share, and settings for all tests."""

from __future__ import annotations

import signal
import sys
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np
import pytest
import rasterio
from hypothesis import HealthCheck, settings

from geomesh.cli import main
from support.browser import Browser, open_browser
from support.browser_process import NAMES
from support.commands import Geomesh, Run
from support.files import mounted
from support.samples import OLINDA, SAMPLES
from support.web_map import MapPage

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping
    from pathlib import Path

    from geomesh import Mesh

# No deadline: shared machines have no reliable timing, and the first call of a kernel compiles it.
settings.register_profile(
    "geomesh", deadline=None, suppress_health_check=[HealthCheck.too_slow], max_examples=60
)
settings.load_profile("geomesh")


def pytest_report_header() -> str:
    import cv2
    import pyogrio
    import shapely

    return (
        f"rasterio {rasterio.__version__} (GDAL {rasterio.__gdal_version__}), "
        f"pyogrio {pyogrio.__version__} (GDAL {pyogrio.__gdal_version_string__}), "
        f"OpenCV {cv2.__version__}, GEOS {shapely.geos_version_string}, numpy {np.__version__}"
    )


@pytest.fixture(params=sorted(path.name for path in SAMPLES.glob("*.tif")))
def sample(request: pytest.FixtureRequest) -> Path:
    """Each raster of data_samples."""
    return SAMPLES / request.param


@pytest.fixture(scope="session")
def olinda() -> Path:
    return OLINDA


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Geomesh:
    """Runs the command line in this process. It also captures what C libraries print."""
    handlers = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)}
    monkeypatch.setattr(sys, "argv", sys.argv)

    def run(*arguments: str | Path) -> Run:
        sys.argv = ["geomesh", *map(str, arguments)]
        capfd.readouterr()
        try:
            with pytest.raises(SystemExit) as stop:
                main()
        finally:
            for number, handler in handlers.items():
                signal.signal(number, handler)
        return Run(int(stop.value.code or 0), *capfd.readouterr())

    return run


@pytest.fixture(
    scope="session",
    params=[pytest.param(name, marks=pytest.mark.xdist_group(name)) for name in NAMES],
)
def started_browser(request: pytest.FixtureRequest) -> Iterator[Browser]:
    with open_browser(request.param) as browser:
        yield browser


@pytest.fixture
def browser(started_browser: Browser) -> Browser:
    """Chromium, then Firefox, with an empty page of 800 x 600 pixels. Starting takes seconds."""
    started_browser.new_page(800, 600)
    return started_browser


@pytest.fixture
def show_map(browser: Browser, tmp_path: Path) -> Iterator[Callable[..., MapPage]]:
    """Writes a mesh as a web map and opens it: takes the options of `Mesh.to_html`.

    At the end of the test, the page must have asked for nothing and had no error.
    """

    def show(mesh: Mesh, **options: Any) -> MapPage:
        path = mesh.to_html(tmp_path / "map.html", overwrite=True, **options)
        return MapPage(browser, path, mesh)

    yield show
    assert browser.errors == browser.console == browser.outside == []
    assert [url for url in browser.requests if not url.startswith(("file:", "data:"))] == []


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[tuple[Path, Mapping[str, Any]]]:
    """A folder with room for 200 kB, and the options to run a program with it.

    If it is allowed, a disk of that size is mounted. Otherwise the size of files is limited.
    """
    import resource  # not available on Windows

    folder = tmp_path / "disk"
    folder.mkdir()
    limit = partial(resource.setrlimit, resource.RLIMIT_FSIZE, (200_000, 200_000))
    with mounted(folder, "200k") as done:
        yield folder, {} if done else {"preexec_fn": limit}
