"""Separate processes that write layers with GDAL while the main process computes.

pyogrio holds the interpreter lock while GDAL writes a batch or builds an index. With a thread
instead of a process, everything else would wait. `main` is the program of such a process, so
this module imports only a few modules at its top.

For each layer, a process reads from standard input a line of JSON (keywords of `write_arrow`)
and an Arrow stream of the rows. It answers with a line of JSON.
"""

from __future__ import annotations

import json
import signal
import sys
import warnings
from typing import TYPE_CHECKING, Any

from geomesh.parallel.processes import Process, ProcessPool, send

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

# Files are written under temporary names and flushed when they are complete. So SQLite need not
# wait for the disk after each of its dozens of transactions.
_CONFIG = {"OGR_SQLITE_SYNCHRONOUS": "OFF"}


class WriterPool(ProcessPool):
    """A pool of processes that wait for layers to write.

    Parameters
    ----------
    count : int
        Number of processes to start in advance.
    """

    def __init__(self, count: int) -> None:
        super().__init__(__name__, count, quiet=True)

    def write(self, schema: Any, batches: Iterator[Any], options: Mapping[str, Any]) -> None:
        """Write a layer in one of the processes.

        Parameters
        ----------
        schema : pyarrow.Schema
        batches : iterator of pyarrow.RecordBatch
        options : mapping
            Keywords of `write_arrow`.

        Raises
        ------
        OSError
            With the message of the library, if writing failed.
        """
        with self.borrow() as process:
            _write(process, schema, batches, options)


def _write(
    process: Process, schema: Any, batches: Iterator[Any], options: Mapping[str, Any]
) -> None:
    import pyarrow as pa

    send(process.requests.write, json.dumps(dict(options)).encode() + b"\n")
    stream = pa.ipc.new_stream(process.requests, schema)
    for batch in batches:
        if not send(stream.write_batch, batch):
            break
    send(stream.close)
    send(process.requests.flush)
    answer = process.answers.readline()
    if not answer:
        raise OSError(f"the process that writes it ended with code {process.wait()}")
    error = json.loads(answer)["error"]
    if error is not None:
        raise OSError(error)


def load_pyogrio() -> None:
    """Import pyogrio without pandas and geopandas, whose import takes half a second.

    Only for processes of geomesh itself that need neither: afterwards pyogrio.read_dataframe
    does not work, and GeoPackages are not flushed by GDAL. If pyogrio has been imported already,
    it can still read data frames.
    """
    unneeded = [name for name in ("pandas", "geopandas") if name not in sys.modules]
    for name in unneeded:
        sys.modules[name] = None  # type: ignore[assignment]
    try:
        import pyogrio
    finally:
        for name in unneeded:
            del sys.modules[name]
    pyogrio.set_gdal_config_options(_CONFIG)


def write_arrow(rows: Any, options: Mapping[str, Any]) -> None:
    """Write rows (pyarrow.RecordBatchReader) with the keywords of pyogrio.write_arrow."""
    import pyogrio

    with warnings.catch_warnings():
        # No CRS on purpose: that of GeoJSON is implied, and some meshes have none.
        warnings.filterwarnings("ignore", "'crs' was not provided", UserWarning)
        pyogrio.write_arrow(rows, **options)


def main() -> None:
    """Write layers one after the other, until standard input ends or a layer fails."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is handled by the parent process
    load_pyogrio()
    import pyarrow as pa

    error = None
    while error is None and (line := sys.stdin.buffer.readline()):
        try:
            write_arrow(pa.ipc.open_stream(sys.stdin.buffer), json.loads(line))
        except Exception as failure:
            error = " ".join(str(failure).split()) or type(failure).__name__
        print(json.dumps({"error": error}), flush=True)
