"""The mesh does not depend on which workers make it, and errors name their cause."""

from __future__ import annotations

import multiprocessing
import os
import random
import re
import signal
import subprocess
import threading
import time
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import cv2
import geopandas as gpd
import numpy as np
import pytest
import rasterio
import shapely
from rasterio.env import get_gdal_config, set_gdal_config

import geomesh
from geomesh.errors import SourceError, WorkerError
from geomesh.parallel import workers
from geomesh.parallel.workers import Workers, open_workers
from geomesh.raster.gdal import CACHE_BYTES
from geomesh.raster.scene import Scene
from support.commands import OLD, PROGRAM, Geomesh, snapshot
from support.files import contents
from support.rasters import picture, write_raster
from support.samples import NODATA_EDGE, fingerprint, write_mirrored

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

pytestmark = pytest.mark.filterwarnings("ignore::geomesh.errors.GeomeshWarning")


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A raster of 3 x 3 tiles; half of its pixels are nodata."""
    folder = tmp_path_factory.mktemp("scene")
    return write_mirrored(folder / "scene.tif", NODATA_EDGE, 2300, 2100)


@pytest.fixture(scope="module")
def small(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A raster of 2 x 2 tiles."""
    folder = tmp_path_factory.mktemp("small")
    return write_mirrored(folder / "small.tif", NODATA_EDGE, 1300, 1200)


def processes() -> ProcessPoolExecutor:
    return ProcessPoolExecutor(2, mp_context=multiprocessing.get_context("spawn"))


@pytest.fixture(scope="module")
def pool() -> Iterator[ProcessPoolExecutor]:
    with processes() as executor:
        yield executor


def box_of(path: Path, left: float, top: float, right: float, bottom: float) -> tuple[float, ...]:
    """Return the map bounds of a box in pixels."""
    with rasterio.open(path) as dataset:
        (west, north), (east, south) = (
            dataset.transform @ (left, top),
            dataset.transform
            @ (
                right,
                bottom,
            ),
        )
    return west, south, east, north


def await_no_threads() -> None:
    """Wait until all threads have ended. Running tasks may finish."""
    deadline = time.monotonic() + 20
    while any(thread.name.startswith("geomesh") for thread in threading.enumerate()):
        assert time.monotonic() < deadline
        time.sleep(0.05)


# ---------------------------------------------------------------- the same result


@pytest.mark.slow
@pytest.mark.parametrize("preset", ["features", "paper"])
def test_mesh_is_the_same_whoever_works(
    scene: Path, pool: ProcessPoolExecutor, preset: str
) -> None:
    expected = fingerprint(geomesh.mesh_raster(scene, preset=preset, workers=1))
    for count in (2, 4):
        assert fingerprint(geomesh.mesh_raster(scene, preset=preset, workers=count)) == expected
    with ThreadPoolExecutor(3) as threads:
        for executor in (threads, pool):
            mesh = geomesh.mesh_raster(scene, preset=preset, executor=executor)
            assert fingerprint(mesh) == expected


@pytest.mark.slow
@pytest.mark.parametrize("preset", ["features", "paper"])
@pytest.mark.parametrize("masked", [False, True], ids=["plain", "masked"])
def test_mesh_of_an_array_is_the_same_whoever_works(
    small: Path, pool: ProcessPoolExecutor, masked: bool, preset: str
) -> None:
    with rasterio.open(small) as dataset:
        source = (dataset.read(masked=masked), dataset.transform, dataset.crs)
    one, two, apart = (
        fingerprint(geomesh.mesh_raster(source, preset=preset, **options))
        for options in ({"workers": 1}, {"workers": 2}, {"executor": pool})
    )
    assert one == two == apart
    if masked:
        by_path = fingerprint(geomesh.mesh_raster(small, preset=preset))
        assert [one[name] for name in ("nodes", "triangles")] == [
            by_path[name] for name in ("nodes", "triangles")
        ]


@pytest.mark.slow
def test_mesh_of_a_part_is_the_same_whoever_works(scene: Path, pool: ProcessPoolExecutor) -> None:
    bounds = box_of(scene, 700, 600.5, 2100, 1900)
    center = np.array(box_of(scene, 1250, 1100, 1250, 1100)[:2])
    circle = gpd.GeoSeries([shapely.Point(center).buffer(18_000)], crs="EPSG:32621")
    for options in ({"bounds": bounds}, {"mask": circle}, {"bounds": bounds, "mask": circle}):
        one, two, apart = (
            fingerprint(geomesh.mesh_raster(scene, **options, **who))
            for who in ({"workers": 1}, {"workers": 2}, {"executor": pool})
        )
        assert one == two == apart


@pytest.mark.slow
def test_open_dataset_is_read_by_threads_and_stays_open(small: Path) -> None:
    expected = fingerprint(geomesh.mesh_raster(small, workers=1))
    with rasterio.open(small) as dataset:
        for count in (1, 3):
            assert fingerprint(geomesh.mesh_raster(dataset, workers=count)) == expected
        assert not dataset.closed
        assert dataset.read(1).any()


@pytest.mark.slow
def test_order_in_which_tiles_are_done_does_not_matter(scene: Path) -> None:
    """Tasks start in any order and end in any order."""

    class Shuffled(Executor):
        """Runs the submitted tasks one by one, in a random order."""

        _max_workers = 4

        def __init__(self) -> None:
            self.waiting: list[tuple[Future[Any], Callable[[], Any]]] = []
            self.order = random.Random(7)
            self.begun: list[int] = []
            self.numbers: dict[Future[Any], int] = {}

        def submit(self, function: Any, /, *given: Any, **_: Any) -> Future[Any]:
            executor = self

            class Lazy(Future[Any]):
                def result(self, timeout: float | None = None) -> Any:
                    while not self.done():
                        pick = executor.order.randrange(len(executor.waiting))
                        future, work = executor.waiting.pop(pick)
                        executor.begun.append(executor.numbers[future])
                        future.set_result(work())
                    return super().result(timeout)

            future = Lazy()
            self.numbers[future] = len(self.numbers)
            self.waiting.append((future, partial(function, *given)))
            return future

    executor = Shuffled()
    mesh = geomesh.mesh_raster(scene, executor=executor)
    assert executor.begun != sorted(executor.begun)
    assert fingerprint(mesh) == fingerprint(geomesh.mesh_raster(scene, workers=2))


@pytest.mark.slow
def test_written_file_holds_the_same_whatever_the_workers(
    tmp_path: Path, small: Path, command: Geomesh
) -> None:
    for count in (1, 2, 5):
        run = command("mesh", small, "-o", tmp_path / f"{count}.gpkg", f"--workers={count}")
        assert (run.code, run.err) == (0, "")
    first = contents(tmp_path / "1.gpkg")
    assert contents(tmp_path / "2.gpkg") == first
    assert contents(tmp_path / "5.gpkg") == first


@pytest.mark.slow
def test_meshes_made_at_the_same_time_are_right(small: Path, olinda: Path) -> None:
    alone = [fingerprint(geomesh.mesh_raster(path)) for path in (small, olinda)]
    with ThreadPoolExecutor(4) as users:
        made = list(users.map(geomesh.mesh_raster, [small, olinda, small, olinda, small, olinda]))
    assert [fingerprint(mesh) for mesh in made] == alone * 3


def test_one_dataset_may_be_meshed_twice_at_the_same_time(olinda: Path) -> None:
    alone = fingerprint(geomesh.mesh_raster(olinda))
    with rasterio.open(olinda) as dataset, ThreadPoolExecutor(2) as users:
        for mesh in users.map(geomesh.mesh_raster, [dataset] * 4):
            assert fingerprint(mesh) == alone


# ------------------------------------------------------------------ order of the work


class Counting(Executor):
    """Threads with a count of the open tasks: submitted, but their result is not taken yet."""

    def __init__(self, size: int) -> None:
        self._max_workers = size
        self.threads = ThreadPoolExecutor(size)
        self.under_way = self.most = self.all = 0

    def submit(self, function: Any, /, *given: Any, **_: Any) -> Future[Any]:
        self.under_way += 1
        self.all += 1
        self.most = max(self.most, self.under_way)
        future = self.threads.submit(function, *given)
        take = future.result

        def result(timeout: float | None = None) -> Any:
            self.under_way -= 1
            return take(timeout)

        future.result = result  # type: ignore[method-assign]
        return future


@pytest.mark.slow
@pytest.mark.parametrize("size", [1, 2])
def test_few_tasks_are_under_way_at_a_time(scene: Path, size: int) -> None:
    executor = Counting(size)
    geomesh.mesh_raster(scene, executor=executor, nodes=500)
    executor.threads.shutdown()
    assert executor.all > 18
    assert executor.most == 2 * size


def test_tasks_are_made_when_they_are_wanted(small: Path) -> None:
    """Their arguments contain parts of arrays, so all of them at once would be too many."""
    made = 0

    def tasks() -> Iterator[int]:
        nonlocal made
        for number in range(100):
            made += 1
            yield number

    with open_workers(2) as workers:
        for done, result in enumerate(workers.map(abs, tasks())):
            assert result == done
            assert made <= done + 5


def test_progress_rises_and_tells_of_tiles(scene: Path) -> None:
    told: list[tuple[float, str]] = []
    options = {"effort": "fast", "workers": 2}
    geomesh.mesh_raster(scene, **options, progress=lambda *news: told.append(news))
    fractions = [fraction for fraction, _ in told]
    assert fractions == sorted(fractions)
    assert (fractions[0], fractions[-1]) == (0, 1)
    for stage in ("Detecting edges and keypoints", "Measuring triangles"):
        tiles = [
            message.removeprefix(f"{stage}: ") for _, message in told if message.startswith(stage)
        ]
        assert tiles == ["9 tiles", *(f"tile {k} of 9" for k in range(1, 10))]


@pytest.mark.slow
@pytest.mark.parametrize("stage", ["Looking", "Detecting", "Measuring"])
@pytest.mark.parametrize("kind", ["path", "dataset", "process pool"])
def test_exception_in_progress_ends_the_work(
    small: Path, monkeypatch: pytest.MonkeyPatch, stage: str, kind: str
) -> None:
    class StopError(Exception):
        pass

    def stop(_fraction: float, message: str) -> None:
        if message.startswith(stage) and "tile 1 of" in message:
            raise StopError

    if kind == "process pool":
        with processes() as executor:
            with pytest.raises(StopError):
                geomesh.mesh_raster(small, executor=executor, progress=stop)
            assert executor.submit(abs, -1).result() == 1
    elif kind == "path":
        with pytest.raises(StopError):
            geomesh.mesh_raster(small, workers=2, progress=stop)
    else:
        with rasterio.open(small) as dataset, pytest.raises(StopError):
            geomesh.mesh_raster(dataset, workers=2, progress=stop)
    await_no_threads()


def test_dataset_is_not_read_once_the_call_has_failed(
    small: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its owner may then close the dataset, and GDAL must not read a closed dataset."""
    read, late = Scene._read_dataset, []
    detecting, ended = threading.Event(), threading.Event()

    def slow(self: Scene, dataset: Any, window: Any, shape: Any) -> Any:
        late.append(ended.is_set())
        if detecting.is_set():
            if (window.col, window.row) == (0, 0):
                raise SourceError("the first tile cannot be read")
            time.sleep(0.5)
        late.append(ended.is_set())
        return read(self, dataset, window, shape)

    monkeypatch.setattr(Scene, "_read_dataset", slow)

    def watch(_fraction: float, message: str) -> None:
        if message.startswith("Detecting"):
            detecting.set()

    with rasterio.open(small) as dataset:
        with pytest.raises(SourceError, match="the first tile"):
            # The thresholds are given, because finding them would read in the caller's thread.
            geomesh.mesh_raster(dataset, workers=4, canny_low=50, canny_high=100, progress=watch)
        ended.set()
        await_no_threads()
    assert late
    assert not any(late)


# ------------------------------------------------------------------ shared data


@pytest.mark.slow
def test_result_does_not_depend_on_opencv_threads_which_are_restored(small: Path) -> None:
    before = cv2.getNumThreads()
    try:
        found = []
        for count in (1, 3):
            cv2.setNumThreads(count)
            found.append(fingerprint(geomesh.mesh_raster(small)))
            assert cv2.getNumThreads() == count
        assert found[0] == found[1]
    finally:
        cv2.setNumThreads(before)


def test_settings_of_the_process_are_restored_when_the_last_mesh_is_done(olinda: Path) -> None:
    cache, threads = get_gdal_config("GDAL_CACHEMAX"), cv2.getNumThreads()
    inside: list[tuple[int, Any]] = []
    try:
        cv2.setNumThreads(3)
        set_gdal_config("GDAL_CACHEMAX", 77_000_000)
        first, second = open_workers(1), open_workers(1)
        for workers in (first, second):
            list(workers.__enter__().map(abs, [1]))
        first.__exit__(None, None, None)
        inside.append((cv2.getNumThreads(), get_gdal_config("GDAL_CACHEMAX")))
        second.__exit__(None, None, None)
        assert inside == [(1, CACHE_BYTES)]
        assert (cv2.getNumThreads(), get_gdal_config("GDAL_CACHEMAX")) == (3, 77_000_000)
        with pytest.raises(SourceError):
            geomesh.mesh_raster("missing.tif")
        assert (cv2.getNumThreads(), get_gdal_config("GDAL_CACHEMAX")) == (3, 77_000_000)
    finally:
        cv2.setNumThreads(threads)
        set_gdal_config("GDAL_CACHEMAX", cache)


def option_of(name: str) -> Any:
    return get_gdal_config(name)


@pytest.mark.parametrize("apart", [False, True], ids=["threads", "processes"])
def test_settings_of_the_caller_reach_the_workers(pool: ProcessPoolExecutor, apart: bool) -> None:
    ask = partial(map, option_of)
    options = ["GDAL_DISABLE_READDIR_ON_OPEN", "AWS_SECRET_ACCESS_KEY", "GDAL_CACHEMAX"]
    with open_workers(None if apart else 2, pool if apart else None) as workers:
        with rasterio.Env(GDAL_DISABLE_READDIR_ON_OPEN="EMPTY_DIR", GDAL_CACHEMAX=64_000_000):
            rasterio.env.setenv(AWS_SECRET_ACCESS_KEY="xyz")
            assert list(workers.map(option_of, options)) == ["EMPTY_DIR", "xyz", 64_000_000]
        assert list(workers.map(option_of, options)) == [None, None, CACHE_BYTES]
    assert list(ask(options[:2])) == [None, None]


def test_setting_of_the_caller_has_its_effect(tmp_path: Path) -> None:
    """Without the setting, a worker would read the mask file beside the raster."""
    path = Path(write_raster(tmp_path, data=picture(1, 300, 300)))
    hidden = np.full((300, 300), 255, np.uint8)
    hidden[:, 150:] = 0
    with rasterio.Env(GDAL_TIFF_INTERNAL_MASK=False), rasterio.open(path, "r+") as dataset:
        dataset.write_mask(hidden)
    assert geomesh.mesh_raster(path).domain.valid_pixels == 300 * 150
    with rasterio.Env(GDAL_DISABLE_READDIR_ON_OPEN="EMPTY_DIR"):
        assert geomesh.mesh_raster(path, workers=2).domain.valid_pixels == 300 * 300


# -------------------------------------------------------------------------- failures


@pytest.mark.parametrize("count", [0, -1, 1.5, "two"])
def test_number_of_workers_that_is_none_is_refused(olinda: Path, count: Any) -> None:
    with pytest.raises(WorkerError, match=r"workers is .*: expected a whole number, 1 or more"):
        geomesh.mesh_raster(olinda, workers=count)


def die(_task: int) -> None:
    os._exit(3)


def test_worker_that_dies_is_told_of(small: Path) -> None:
    with (
        processes() as executor,
        open_workers(executor=executor) as workers,
        pytest.raises(WorkerError) as lost,
    ):
        list(workers.map(die, [1, 2, 3]))
    assert re.match("a worker was lost .*use fewer workers, or give them more", str(lost.value))
    assert "\n" not in str(lost.value)


@pytest.mark.slow
def test_worker_that_is_killed_in_mid_run_is_told_of(small: Path) -> None:
    with processes() as executor:

        def kill(_fraction: float, message: str) -> None:
            if "Detecting" in message and "tile 1 of" in message:
                for process in list(executor._processes.values()):
                    os.kill(process.pid, signal.SIGKILL)

        with pytest.raises(WorkerError, match="a worker was lost"):
            geomesh.mesh_raster(small, executor=executor, progress=kill)
    await_no_threads()


def test_open_dataset_cannot_go_to_other_processes(small: Path, pool: ProcessPoolExecutor) -> None:
    with rasterio.open(small) as dataset:
        with pytest.raises(WorkerError, match="give its path instead of the open dataset"):
            geomesh.mesh_raster(dataset, executor=pool)
        assert not dataset.closed


def test_source_that_a_worker_cannot_read_is_named(small: Path, pool: ProcessPoolExecutor) -> None:
    """A file in memory exists only in this process."""
    with rasterio.MemoryFile(small.read_bytes(), filename="held.tif") as memory:
        assert len(geomesh.mesh_raster(memory.name, nodes=500).nodes) == 500
        with pytest.raises(SourceError, match=r"held\.tif.* each worker needs it") as error:
            geomesh.mesh_raster(memory.name, executor=pool)
    assert "\n" not in str(error.value)


@pytest.mark.slow
def test_relative_path_is_found_by_workers_in_another_folder(
    small: Path, pool: ProcessPoolExecutor, monkeypatch: pytest.MonkeyPatch
) -> None:
    pool.submit(os.getpid).result()
    monkeypatch.chdir(small.parent)
    mesh = geomesh.mesh_raster(small.name, executor=pool)
    assert mesh.metadata["source"]["name"] == small.name
    np.testing.assert_array_equal(mesh.nodes, geomesh.mesh_raster(small).nodes)


@pytest.mark.parametrize("apart", [False, True], ids=["threads", "processes"])
def test_truncated_raster_names_the_window(
    tmp_path: Path, scene: Path, pool: ProcessPoolExecutor, apart: bool
) -> None:
    broken = tmp_path / "broken.tif"
    whole = scene.read_bytes()
    broken.write_bytes(whole[: len(whole) * 6 // 10])
    who: dict[str, Any] = {"executor": pool} if apart else {"workers": 2}
    with pytest.raises(SourceError) as error:
        geomesh.mesh_raster(broken, **who)
    text = str(error.value)
    assert re.search(r"broken.tif: cannot read columns \d+ to \d+, rows \d+ to \d+: ", text)
    assert "\n" not in text


@pytest.mark.parametrize(
    ("shape", "told"),
    [
        ((3, 1200, 1000), "it had 1300 x 1200 pixels and now has 1000 x 1200"),
        ((1, 1200, 1300), "changed while it was read .*band"),
    ],
    ids=["other size", "fewer bands"],
)
def test_raster_that_is_replaced_by_another_is_noticed(
    tmp_path: Path, small: Path, shape: tuple[int, int, int], told: str
) -> None:
    path = tmp_path / "scene.tif"
    path.write_bytes(small.read_bytes())

    def replace(_fraction: float, message: str) -> None:
        if message.startswith("Looking") and "tile" in message:
            path.unlink(missing_ok=True)
            write_raster(tmp_path, data=picture(*shape).astype(np.uint16))

    with pytest.raises(SourceError, match=told) as error:
        geomesh.mesh_raster(path, progress=replace)
    assert "scene.tif" in str(error.value)


# ---------------------------------------------------------------------------- batches


@pytest.mark.slow
def test_one_crew_works_on_all_sources(
    tmp_path: Path, small: Path, olinda: Path, command: Geomesh, monkeypatch: pytest.MonkeyPatch
) -> None:
    crews: list[Workers] = []

    class Recorded(Workers):
        def __init__(self, *given: Any) -> None:
            super().__init__(*given)
            crews.append(self)

    monkeypatch.setattr(workers, "Workers", Recorded)
    bad = tmp_path / "bad.tif"
    bad.write_bytes(small.read_bytes()[: small.stat().st_size // 2])
    output = tmp_path / "out"
    run = command("mesh", small, bad, olinda, "-o", f"{output}/", "--workers=2")
    assert run.code == 1
    assert sorted(path.name for path in output.iterdir()) == [f"{olinda.stem}.gpkg", "small.gpkg"]
    assert [line for line in run.err.splitlines() if line.startswith("Error")] == [
        next(line for line in run.err.splitlines() if f"{bad}: cannot read columns" in line)
    ]
    assert len(crews) == 1
    await_no_threads()


@pytest.mark.parametrize("preset", ["adaptive", "features"])
def test_only_tiles_that_meet_the_part_are_read(
    scene: Path, monkeypatch: pytest.MonkeyPatch, preset: str
) -> None:
    read, seen = Scene._read_dataset, []

    def noted(self: Scene, dataset: Any, window: Any, shape: Any) -> Any:
        seen.append(window)
        return read(self, dataset, window, shape)

    monkeypatch.setattr(Scene, "_read_dataset", noted)
    box = (1100, 1150, 1700, 1600)
    area = gpd.GeoSeries([shapely.box(*box_of(scene, *box))], crs="EPSG:32621")
    for options in ({"bounds": box_of(scene, *box)}, {"mask": area}):
        seen.clear()
        geomesh.mesh_raster(scene, preset=preset, **options)
        assert 3 <= len(seen) <= (4 if preset == "features" else 100)
        left, top, right, bottom = box
        for window in seen:
            assert left <= window.col < window.stop_col <= right
            assert top <= window.row < window.stop_row <= bottom


# -------------------------------------------------------------------------- interrupts


@pytest.mark.slow
@pytest.mark.parametrize("message", ["Detecting", "Measuring", "Writing"])
def test_interrupt_ends_work_on_a_large_scene(tmp_path: Path, scene: Path, message: str) -> None:
    output = tmp_path / "mesh.gpkg"
    output.write_bytes(OLD)
    arguments = ["mesh", str(scene), "-o", str(output), "--overwrite", "--progress=jsonl"]
    process = subprocess.Popen(
        [*PROGRAM, *arguments, "--workers=2"],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    with process:
        assert process.stdout is not None
        line = next(line for line in process.stdout if f'"message": "{message}' in line)
        assert line
        process.send_signal(signal.SIGINT)
        sent = time.monotonic()
        _, err = process.communicate(timeout=60)
    assert time.monotonic() - sent < 5
    assert process.returncode == 130
    assert "Traceback" not in err
    assert snapshot(tmp_path) == {"mesh.gpkg": OLD}
