"""Processes that write layers with GDAL, beside the one that computes.

pyogrio keeps the interpreter's lock while GDAL writes a batch or builds an index: in a thread
of the same process, everything else would wait. This file is also the program that such a
process runs, so at its top it imports nothing but the standard library.

On its standard input a process gets, for each layer, a line of JSON (keywords of
`write_arrow`) and an Arrow stream of the rows; it answers with a line of JSON.
"""

from __future__ import annotations

import json
import signal
import subprocess
import sys
import threading
import warnings
from collections.abc import Callable, Iterator, Mapping
from typing import Any


class WriterPool:
    """Processes that wait for a layer to write, to be used as a context.

    Parameters
    ----------
    count : int
        How many to start in advance.
    """

    def __init__(self, count: int) -> None:
        self.count = count
        self._lock = threading.Lock()
        self._idle: list[_WriterProcess] = []
        self._busy: set[_WriterProcess] = set()

    def __enter__(self) -> WriterPool:
        return self

    def __exit__(self, *_: object) -> None:
        self.dismiss()
        with self._lock:
            while self._idle:
                self._idle.pop().end()

    def warm(self) -> None:
        """Let the processes start now; they are needed soon."""
        with self._lock:
            while len(self._idle) < self.count:
                self._idle.append(_WriterProcess())

    def write(self, schema: Any, batches: Iterator[Any], options: Mapping[str, Any]) -> None:
        """Write a layer.

        Parameters
        ----------
        schema : pyarrow.Schema
        batches : iterator of pyarrow.RecordBatch
        options : mapping
            Keywords of `write_arrow`.

        Raises
        ------
        OSError
            With what the library said.
        """
        with self._lock:
            writer = self._idle.pop() if self._idle else _WriterProcess()
            self._busy.add(writer)
        try:
            writer.write(schema, batches, options)
            with self._lock:
                self._idle.append(writer)
        except BaseException:
            writer.stop()
            writer.end()
            raise
        finally:
            with self._lock:
                self._busy.discard(writer)

    def dismiss(self) -> None:
        """Make an end of those who write; nobody needs it any more."""
        with self._lock:
            for writer in self._busy:
                writer.stop()


class _WriterProcess:
    """One process."""

    def __init__(self) -> None:
        # -P: modules that lie in the user's working folder are none of ours.
        self._process = subprocess.Popen(
            [sys.executable, "-P", __file__],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
        )

    def write(self, schema: Any, batches: Iterator[Any], options: Mapping[str, Any]) -> None:
        """Write a layer, as `WriterPool.write`."""
        import pyarrow as pa

        sink, answers = self._process.stdin, self._process.stdout
        assert sink is not None
        assert answers is not None
        _send(sink.write, json.dumps(dict(options)).encode() + b"\n")
        stream = pa.ipc.new_stream(sink, schema)
        for batch in batches:
            if not _send(stream.write_batch, batch):
                break
        _send(stream.close)
        _send(sink.flush)
        answer = answers.readline()
        if not answer:
            raise OSError(f"the process that writes it ended with code {self._process.wait()}")
        error = json.loads(answer)["error"]
        if error is not None:
            raise OSError(error)

    def stop(self) -> None:
        """Stop the process in whatever it does; another thread may be waiting for it."""
        self._process.kill()

    def end(self) -> None:
        """Let the process end by itself, once it waits for the next layer."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        _send(self._process.stdin.close)
        self._process.wait()
        self._process.stdout.close()


def _send(action: Callable[..., Any], *arguments: Any) -> bool:
    """Return whether there is still someone to listen; if not, the answer tells why."""
    try:
        action(*arguments)
    except OSError:
        return False
    return True


def write_arrow(rows: Any, options: Mapping[str, Any]) -> None:
    """Write rows (pyarrow.RecordBatchReader) with the keywords of pyogrio.write_arrow."""
    import pyogrio

    with warnings.catch_warnings():
        # No CRS is meant: GeoJSON's is understood, and a mesh without one stays so.
        warnings.filterwarnings("ignore", "'crs' was not provided", UserWarning)
        pyogrio.write_arrow(rows, **options)


def main() -> None:
    """Write one layer after the other, until standard input ends or a layer fails."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # whoever started it decides
    # pyogrio takes them along where they are, at half a second; they are not needed.
    sys.modules["pandas"] = sys.modules["geopandas"] = None  # type: ignore[assignment]
    import pyarrow as pa
    import pyogrio  # noqa: F401

    error = None
    while error is None and (line := sys.stdin.buffer.readline()):
        try:
            write_arrow(pa.ipc.open_stream(sys.stdin.buffer), json.loads(line))
        except Exception as failure:
            error = " ".join(str(failure).split()) or type(failure).__name__
        print(json.dumps({"error": error}), flush=True)


if __name__ == "__main__":
    main()
