"""A Dask cluster of processes: the same mesh even if a worker dies, or a helpful error line."""

from __future__ import annotations

import os
import signal
import socket
import sys
import time
from typing import TYPE_CHECKING, Any

import pytest
import rasterio

import geomesh
from geomesh.errors import SourceError, WorkerError
from geomesh.parallel.workers import open_workers
from geomesh.zonal import statistics as zonal
from support.commands import Geomesh, snapshot
from support.files import contents
from support.samples import NODATA_EDGE, fingerprint, write_mirrored

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

dask = pytest.importorskip("dask")
distributed = pytest.importorskip("distributed")


pytestmark = [
    pytest.mark.slow,
    pytest.mark.filterwarnings("ignore::geomesh.errors.GeomeshWarning"),
    # Warnings about arrays that are sent, and about the port of the dashboard, which is not used.
    pytest.mark.filterwarnings("ignore:(Sending large graph|Port 8787)"),
]

# Number of workers that may die on one task. After that, Dask stops the task.
ALLOWED = 1


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    with (
        dask.config.set({"distributed.scheduler.allowed-failures": ALLOWED}),
        distributed.LocalCluster(
            n_workers=2,
            threads_per_worker=1,
            processes=True,
            dashboard_address=None,
            silence_logs=50,
        ) as cluster,
    ):
        yield cluster


@pytest.fixture
def client(cluster: Any) -> Iterator[Any]:
    with distributed.Client(cluster) as client:
        client.wait_for_workers(2, timeout=60)
        yield client


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A raster of 2 x 2 tiles."""
    folder = tmp_path_factory.mktemp("scene")
    return write_mirrored(folder / "scene.tif", NODATA_EDGE, 1300, 1200)


@pytest.mark.parametrize(
    "options",
    [
        {"preset": "features"},
        {"preset": "paper"},
        {"preset": "adaptive", "effort": "fast"},
        {"preset": "adaptive", "max_error": 3000, "effort": "fast"},
    ],
    ids=lambda options: " ".join(map(str, options.values())),
)
def test_mesh_of_a_cluster_is_that_of_threads(
    scene: Path, client: Any, options: dict[str, Any]
) -> None:
    mesh = geomesh.mesh_raster(scene, executor=client.get_executor(), **options)
    assert fingerprint(mesh) == fingerprint(geomesh.mesh_raster(scene, workers=2, **options))


def test_array_is_sent_to_the_cluster_in_parts(scene: Path, client: Any) -> None:
    with rasterio.open(scene) as dataset:
        source = (dataset.read(masked=True), dataset.transform, dataset.crs)
    mesh = geomesh.mesh_raster(source, executor=client.get_executor())
    assert fingerprint(mesh) == fingerprint(geomesh.mesh_raster(source))


def test_command_on_a_cluster_writes_the_same_file(
    tmp_path: Path, scene: Path, client: Any, command: Geomesh, monkeypatch: pytest.MonkeyPatch
) -> None:
    """This also works for a relative path, wherever the workers were started."""
    monkeypatch.chdir(scene.parent)
    address = client.scheduler.address
    for name, options in (("here", []), ("there", ["--scheduler", address])):
        run = command("mesh", scene.name, "-o", tmp_path / f"{name}.gpkg", *options)
        assert (run.code, run.err) == (0, "")
    assert contents(tmp_path / "there.gpkg") == contents(tmp_path / "here.gpkg")


@pytest.mark.parametrize("stage", ["Detecting", "Measuring"])
def test_worker_that_is_killed_is_made_up_for(scene: Path, client: Any, stage: str) -> None:
    killed = []

    def kill(_fraction: float, message: str) -> None:
        if not killed and message.startswith(stage) and "tile 1 of" in message:
            killed.append(next(iter(client.run(os.getpid).values())))
            os.kill(killed[0], signal.SIGKILL)

    mesh = geomesh.mesh_raster(scene, executor=client.get_executor(), progress=kill)
    assert len(killed) == 1
    assert fingerprint(mesh) == fingerprint(geomesh.mesh_raster(scene))


def kill_worker(_task: Any, **_options: Any) -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def test_tile_that_kills_its_workers_is_told_of(
    scene: Path, client: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(zonal, "_read_and_measure", kill_worker)
    with pytest.raises(WorkerError, match=r"a worker was lost .* fewer workers, or .* memory") as e:
        geomesh.mesh_raster(scene, executor=client.get_executor())
    assert "\n" not in str(e.value)


def test_source_that_workers_cannot_read_is_named(scene: Path, client: Any) -> None:
    """A file in memory exists only in this process."""
    with (
        rasterio.MemoryFile(scene.read_bytes(), filename="held.tif") as memory,
        pytest.raises(SourceError, match=r"held\.tif") as error,
    ):
        geomesh.mesh_raster(memory.name, executor=client.get_executor())
    assert "\n" not in str(error.value)


def test_open_dataset_cannot_go_to_a_cluster(scene: Path, client: Any) -> None:
    with rasterio.open(scene) as dataset, pytest.raises(WorkerError, match="give its path"):
        geomesh.mesh_raster(dataset, executor=client.get_executor())


def test_settings_of_the_caller_reach_the_cluster(client: Any) -> None:
    name = "GDAL_DISABLE_READDIR_ON_OPEN"
    with (
        rasterio.Env(**{name: "EMPTY_DIR"}),
        open_workers(executor=client.get_executor()) as workers,
    ):
        found = list(workers.map(rasterio.env.get_gdal_config, [name]))
    assert found == ["EMPTY_DIR"]


def test_names_of_tasks_hold_no_credentials(client: Any) -> None:
    """Dask shows these names on its dashboard and in its logs."""
    with rasterio.Env(), open_workers(executor=client.get_executor()) as workers:
        rasterio.env.setenv(AWS_SECRET_ACCESS_KEY="very-secret")
        results = workers.map(rasterio.env.get_gdal_config, ["AWS_SECRET_ACCESS_KEY"] * 4)
        assert next(results) == "very-secret"
        keys = [str(key) for key in client.futures]
        assert list(results) == ["very-secret"] * 3
    assert keys
    assert not any("secret" in key for key in keys)


# ----------------------------------------------------------------- invalid clusters


def refused(command: Geomesh, scene: Path, folder: Path, address: str) -> str:
    started = time.monotonic()
    run = command("mesh", scene, "-o", folder / "mesh.gpkg", "--scheduler", address)
    assert time.monotonic() - started < 20
    assert snapshot(folder) == {}
    return run.error()


@pytest.mark.parametrize("listens", [False, True], ids=["closed port", "silent port"])
def test_scheduler_that_does_not_answer_is_told_of(
    tmp_path: Path, scene: Path, command: Geomesh, listens: bool
) -> None:
    with socket.socket() as port:
        port.bind(("127.0.0.1", 0))
        if listens:
            port.listen()
        address = "tcp://{}:{}".format(*port.getsockname())
        error = refused(command, scene, tmp_path, address)
    assert error.startswith(f"the scheduler {address} does not answer (")
    assert error.endswith("check the address and that the scheduler is running")


@pytest.mark.parametrize("address", ["localhost", "http://localhost:1", "tcp://localhost:x", ""])
def test_address_that_is_none_is_told_of(
    tmp_path: Path, scene: Path, command: Geomesh, address: str
) -> None:
    assert f"the scheduler {address} does" in refused(command, scene, tmp_path, address)


def test_scheduler_without_workers_is_told_of(
    tmp_path: Path, scene: Path, command: Geomesh
) -> None:
    with (
        dask.config.set({"distributed.scheduler.http.routes": []}),
        distributed.LocalCluster(
            n_workers=0, processes=True, dashboard_address=None, silence_logs=50
        ) as empty,
    ):
        address = empty.scheduler_address
        error = refused(command, scene, tmp_path, address)
    expected = f"the scheduler {address} has no workers; start some: dask worker {address}"
    assert error == expected


def test_workers_of_another_version_are_refused(
    tmp_path: Path, scene: Path, client: Any, command: Geomesh, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("geomesh.parallel.dask.__version__", "9.9")
    error = refused(command, scene, tmp_path, client.scheduler.address)
    assert f"run geomesh {geomesh.__version__}, but here it is 9.9; install the same" in error


def test_workers_that_cannot_run_geomesh_are_refused(
    tmp_path: Path, scene: Path, client: Any, command: Geomesh, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("geomesh.parallel.dask._version", no_geomesh)
    error = refused(command, scene, tmp_path, client.scheduler.address)
    assert "cannot run geomesh (No module named 'geomesh')" in error
    assert f"install geomesh {geomesh.__version__} on their machines" in error


def no_geomesh() -> str:
    raise ModuleNotFoundError("No module named 'geomesh'")


def test_dask_that_is_not_installed_is_told_of(
    tmp_path: Path, scene: Path, command: Geomesh, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    error = refused(command, scene, tmp_path, "tcp://127.0.0.1:8786")
    assert error.endswith("pip install 'geomesh-toolkit[dask]'")


def test_workers_and_scheduler_exclude_each_other(
    tmp_path: Path, scene: Path, command: Geomesh
) -> None:
    output = tmp_path / "mesh.gpkg"
    run = command("mesh", scene, "-o", output, "--workers=2", "--scheduler=tcp://127.0.0.1:1")
    assert run.code == 2
    assert "--workers and --scheduler cannot be used together" in run.err
    assert not output.exists()
