"""A child process that ends when its reader ends. Its output is read line by line. No Qt."""

from __future__ import annotations

import os
import queue
import signal
import subprocess
import sys
import threading
import time
from collections import deque
from contextlib import suppress
from typing import IO, TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from types import TracebackType

# Variables of another Python, PROJ or GDAL. QGIS sets them for itself. With them, the child
# would load the wrong libraries or, worse, use the wrong CRS database without an error.
_FOREIGN = ("PYTHON", "PROJ_", "GDAL_", "DYLD_", "QGIS_")
_FOREIGN_NAMES = ("VIRTUAL_ENV", "LD_LIBRARY_PATH", "LD_PRELOAD", "QT_PLUGIN_PATH")

_POLL = 0.1
_PATIENCE = 3.0
_LAST_CHANCE = 1.0
_KEPT_LINES = 40
_LONGEST_LINE = 1 << 20

# Without this flag, a console window would appear for a moment on Windows.
_NO_WINDOW: int = getattr(subprocess, "CREATE_NO_WINDOW", 0)


class Cancelled(Exception):  # noqa: N818
    """The user cancelled the work."""


def clean_environment(environ: Mapping[str, str]) -> dict[str, str]:
    """Return the environment variables for a child process that runs another Python.

    Parameters
    ----------
    environ : mapping of str to str
        Usually `os.environ`. The result leaves out the variables that make Python, PROJ, GDAL
        or the dynamic linker use the files of QGIS.
    """
    kept = {
        name: value
        for name, value in environ.items()
        if not name.startswith(_FOREIGN) and name not in _FOREIGN_NAMES
    }
    # The working folder of QGIS may be a user's folder that contains a numpy.py.
    return {**kept, "PYTHONUTF8": "1", "PYTHONSAFEPATH": "1"}


def ask(command: Sequence[str], timeout: float) -> subprocess.CompletedProcess[bytes]:
    """Run a program that ends after a short time, and return its output.

    Raises
    ------
    OSError, ValueError
        If the program cannot be started.
    subprocess.TimeoutExpired
        If it took longer than `timeout` seconds. It is then killed.
    """
    return subprocess.run(
        list(command),
        stdin=subprocess.DEVNULL,
        capture_output=True,
        env=clean_environment(os.environ),
        timeout=timeout,
        creationflags=_NO_WINDOW,
        check=False,
    )


class Child:
    """A child process for use in a `with` statement. A pipe to its standard input stays open.

    When the `with` statement ends, for any reason, the process has ended too.

    Parameters
    ----------
    command : sequence of str
        Program and arguments. No shell is used.
    environ : mapping of str to str
    merge : bool
        Whether `lines` includes the standard error of the process.
    patience : float
        Time in seconds that the process has to end by itself after its standard input is closed.

    Raises
    ------
    OSError, ValueError
        If the process cannot be started.
    """

    def __init__(
        self,
        command: Sequence[str],
        environ: Mapping[str, str],
        *,
        merge: bool = False,
        patience: float = _PATIENCE,
    ) -> None:
        self.errors: deque[str] = deque(maxlen=_KEPT_LINES)
        self._patience = patience
        self._lines: queue.Queue[str | None] = queue.Queue()
        self._process: subprocess.Popen[bytes] = subprocess.Popen(
            list(command),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT if merge else subprocess.PIPE,
            env=dict(environ),
            creationflags=_NO_WINDOW,
            # A new process group: its own child processes can be ended together with it.
            start_new_session=True,
        )
        self._readers = [self._read(self._process.stdout, self._lines.put, last=True)]
        if not merge:
            self._readers.append(self._read(self._process.stderr, self._keep_error, last=False))

    def __enter__(self) -> Child:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        traceback: TracebackType | None,
    ) -> None:
        self.stop()

    @property
    def exit_code(self) -> int | None:
        """Exit code as in `subprocess`: None while it runs, negative for a signal."""
        return self._process.poll()

    def lines(self, cancelled: Callable[[], bool]) -> Iterator[str]:
        """Yield the output line by line, until the process has ended.

        Raises
        ------
        Cancelled
            When `cancelled()` returns True. It is called every 0.1 s.
        """
        asked = float("-inf")
        open_ = True
        ended_since: float | None = None
        while open_ or self.exit_code is None:
            now = time.monotonic()
            if now - asked >= _POLL:
                asked = now
                if cancelled():
                    raise Cancelled
            try:
                line = self._lines.get(timeout=_POLL)
            except queue.Empty:
                if self.exit_code is not None:
                    # A process that the child started and did not end may keep the pipe open.
                    ended_since = ended_since or now
                    open_ = open_ and now - ended_since < _LAST_CHANCE
                continue
            if line is None:
                open_ = False
            else:
                yield line

    def rest(self) -> Iterator[str]:
        """Yield the lines that were received but not read yet, without waiting."""
        with suppress(queue.Empty):
            while True:
                line = self._lines.get_nowait()
                if line is not None:
                    yield line

    def stop(self) -> None:
        """End the process: close its standard input, then terminate it, then kill it."""
        with suppress(OSError):
            if self._process.stdin:
                self._process.stdin.close()
        if not self._ends_within(self._patience):
            self._signal("SIGTERM")
            if not self._ends_within(_LAST_CHANCE):
                self._signal("SIGKILL")
                self._ends_within(_PATIENCE)
        for reader in self._readers:
            reader.join(timeout=_LAST_CHANCE)
            if reader.is_alive():
                # A process that the child started still writes to the pipe.
                self._signal("SIGKILL")
                reader.join(timeout=_LAST_CHANCE)
        if not any(reader.is_alive() for reader in self._readers):
            for stream in (self._process.stdout, self._process.stderr):
                if stream:
                    stream.close()

    def _ends_within(self, seconds: float) -> bool:
        try:
            self._process.wait(timeout=seconds)
        except subprocess.TimeoutExpired:
            return False
        return True

    def _signal(self, name: str) -> None:
        with suppress(OSError):
            if sys.platform != "win32":
                os.killpg(self._process.pid, getattr(signal, name))
            else:
                self._process.kill()

    def _keep_error(self, line: str | None) -> None:
        if line and line.strip():
            self.errors.append(line)

    @staticmethod
    def _read(
        stream: IO[bytes] | None, take: Callable[[str | None], Any], *, last: bool
    ) -> threading.Thread:
        def read() -> None:
            with suppress(OSError, ValueError):
                while stream:
                    line = stream.readline(_LONGEST_LINE)
                    if not line:
                        break
                    take(line.decode("utf-8", "replace").rstrip("\r\n"))
            if last:
                take(None)

        thread = threading.Thread(target=read, name="geomesh-reader", daemon=True)
        thread.start()
        return thread
