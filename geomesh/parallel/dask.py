"""Use the workers of a Dask cluster."""

from __future__ import annotations

import asyncio
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from geomesh._version import __version__
from geomesh.errors import WorkerError, extra_required, one_line
from geomesh.parallel.workers import Workers, open_workers

if TYPE_CHECKING:
    from collections.abc import Iterator

# Seconds to wait for an answer of the scheduler, and for its first worker.
_TIMEOUT = 6


@contextmanager
def open_dask_workers(address: str) -> Iterator[Workers]:
    """Yield the workers of a running Dask cluster.

    If a worker is lost, Dask gives its tiles to another worker.

    Parameters
    ----------
    address : str
        Address of the scheduler, such as tcp://host:8786.

    Raises
    ------
    WorkerError
        If the scheduler does not answer or has no workers, or if its workers run another
        version of geomesh.
    """
    with extra_required("dask.distributed", "dask"):
        from distributed import Client
    try:
        # Connect first with a time limit. Client has none if a program that is not a scheduler
        # accepts the connection and sends nothing.
        asyncio.run(_check_connection(address))
        client = Client(address, timeout=_TIMEOUT)
    except (OSError, ValueError, TypeError, RuntimeError) as error:
        raise WorkerError(
            f"the scheduler {address} does not answer ({one_line(error)}); check the address and "
            "that the scheduler is running"
        ) from error
    with client:
        size = _count_workers(client, address)
        with open_workers(size, client.get_executor()) as workers:
            yield workers


async def _check_connection(address: str) -> None:
    """Open a connection and close it again."""
    from distributed.comm import connect
    from distributed.security import Security

    keys = Security().get_connection_args("client")
    async with asyncio.timeout(_TIMEOUT + 1):
        comm = await connect(address, timeout=_TIMEOUT, **keys)
    comm.abort()


def _count_workers(client: Any, address: str) -> int:
    """Return how many tiles the workers process at the same time.

    All of them must run this version of geomesh.
    """
    try:
        client.wait_for_workers(1, timeout=_TIMEOUT)
    except TimeoutError as error:
        raise WorkerError(
            f"the scheduler {address} has no workers; start some: dask worker {address}"
        ) from error
    try:
        versions = set(client.run(_version).values())
    except Exception as error:
        raise WorkerError(
            f"the workers of {address} cannot run geomesh ({one_line(error)}); install geomesh "
            f"{__version__} on their machines"
        ) from error
    if versions != {__version__}:
        installed = ", ".join(sorted(versions))
        raise WorkerError(
            f"the workers of {address} run geomesh {installed}, but here it is {__version__}; "
            "install the same version on all"
        )
    return sum(client.nthreads().values())


def _version() -> str:
    return __version__
