"""The workers of a Dask cluster."""

from __future__ import annotations

import asyncio
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from geomesh._version import __version__
from geomesh.errors import WorkerError, extra_required, one_line
from geomesh.parallel.workers import Workers, open_workers

if TYPE_CHECKING:
    from collections.abc import Iterator

# Seconds until a scheduler, or its workers, count as not answering.
_PATIENCE = 6


@contextmanager
def open_dask_workers(address: str) -> Iterator[Workers]:
    """Yield the workers of a running Dask cluster.

    A worker that is lost does not matter: Dask gives its tiles to another.

    Parameters
    ----------
    address : str
        Of the scheduler, such as tcp://host:8786.

    Raises
    ------
    WorkerError
        If the scheduler does not answer, has no workers, or they run another version.
    """
    with extra_required("dask.distributed", "dask"):
        from distributed import Client
    try:
        # Client has no limit on the wait for what is at the address to say that it is a scheduler.
        asyncio.run(_greet(address))
        client = Client(address, timeout=_PATIENCE)
    except (OSError, ValueError, TypeError, RuntimeError) as error:
        raise WorkerError(
            f"the scheduler {address} does not answer ({one_line(error)}); check the address, and "
            "that it runs"
        ) from error
    with client:
        size = _count_workers(client, address)
        with open_workers(size, client.get_executor()) as workers:
            yield workers


async def _greet(address: str) -> None:
    """Open a connection, and close it."""
    from distributed.comm import connect
    from distributed.security import Security

    keys = Security().get_connection_args("client")
    async with asyncio.timeout(_PATIENCE + 1):
        comm = await connect(address, timeout=_PATIENCE, **keys)
    comm.abort()


def _count_workers(client: Any, address: str) -> int:
    """Return how many tiles the workers do at a time, if all run this version of geomesh."""
    try:
        client.wait_for_workers(1, timeout=_PATIENCE)
    except TimeoutError as error:
        raise WorkerError(
            f"the scheduler {address} has no workers; start some: dask worker {address}"
        ) from error
    try:
        versions = set(client.run(_version).values())
    except Exception as error:
        raise WorkerError(
            f"the workers of {address} cannot run geomesh ({one_line(error)}); install geomesh "
            f"{__version__} where they run"
        ) from error
    if versions != {__version__}:
        found = ", ".join(sorted(versions))
        raise WorkerError(
            f"the workers of {address} run geomesh {found}, but here it is {__version__}; install "
            "the same version on all"
        )
    return sum(client.nthreads().values())


def _version() -> str:
    return __version__
