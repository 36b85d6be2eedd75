"""A pool of processes, for work that the threads of one process cannot do at the same time.

Each process is a Python program that reads its tasks from standard input and writes answers to
standard output. It exits when its standard input is closed, so it ends with its parent.
"""

from __future__ import annotations

import subprocess
import sys
import threading
from contextlib import contextmanager
from pathlib import Path
from typing import IO, TYPE_CHECKING, Any, Self

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

# Seconds that a process has to clean up after `terminate`.
_GRACE = 3.0


# The folder that geomesh was imported from.
_PACKAGES = str(Path(__file__).parents[2])


class Process:
    """One process of the pool.

    Parameters
    ----------
    module : str
        Name of a module. The process calls its function `main`.
    quiet : bool
        Discard the standard error of the process.
    """

    def __init__(self, module: str, *, quiet: bool) -> None:
        code = f"import sys; sys.path.append({_PACKAGES!r}); from {module} import main; main()"
        # -P: do not import modules from the user's working folder.
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-c", code],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL if quiet else None,
        )

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    @property
    def requests(self) -> IO[bytes]:
        """The standard input of the process."""
        assert self._process.stdin is not None
        return self._process.stdin

    @property
    def answers(self) -> IO[bytes]:
        """The standard output of the process."""
        assert self._process.stdout is not None
        return self._process.stdout

    def wait(self) -> int:
        """Wait until the process ends, and return its exit code."""
        return self._process.wait()

    def kill(self) -> None:
        """Stop the process at once. Another thread may be waiting for its answer."""
        self._process.kill()

    def terminate(self) -> None:
        """Ask the process to clean up and exit. Kill it if that takes too long."""
        self._process.terminate()
        try:
            self._process.wait(_GRACE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def end(self) -> None:
        """Close its standard input, so that it exits after its current task; then wait for it."""
        send(self.requests.close)
        self.wait()
        self.answers.close()


class ProcessPool:
    """Processes that run the same program. Use it as a context manager.

    Parameters
    ----------
    module : str
        Name of a module. The processes call its function `main`.
    count : int
        Number of processes that `warm` starts.
    quiet : bool
        Discard the standard error of the processes.
    """

    def __init__(self, module: str, count: int, *, quiet: bool = False) -> None:
        self.count = count
        self._module = module
        self._quiet = quiet
        self._lock = threading.Lock()
        self._idle: list[Process] = []
        self._busy: set[Process] = set()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop(Process.kill)
        with self._lock:
            while self._idle:
                idle = self._idle.pop()
                idle.kill()
                idle.end()

    def warm(self) -> None:
        """Start the processes now, before they are needed."""
        with self._lock:
            while len(self._idle) + len(self._busy) < self.count:
                self._idle.append(self._start())

    @contextmanager
    def borrow(self) -> Iterator[Process]:
        """Yield a process that no other thread uses. An error in the block kills it."""
        with self._lock:
            process = self._idle.pop(0) if self._idle else self._start()
            self._busy.add(process)
        try:
            yield process
            with self._lock:
                self._idle.append(process)
        except BaseException:
            process.kill()
            process.end()
            raise
        finally:
            with self._lock:
                self._busy.discard(process)

    def stop(self, how: Callable[[Process], Any]) -> list[int]:
        """Call `how` (a method of Process) for each busy process, and return their ids."""
        with self._lock:
            busy = list(self._busy)
        for process in busy:
            how(process)
        return [process.pid for process in busy]

    def _start(self) -> Process:
        return Process(self._module, quiet=self._quiet)


def send(action: Callable[..., Any], *arguments: Any) -> bool:
    """Call `action`, which writes to a process. Return False if the process has closed its input.

    The answer or the exit code of the process then gives the reason.
    """
    try:
        action(*arguments)
    except OSError:
        return False
    return True
