"""Processes that wait for work, for what threads of one process cannot do side by side.

A process is a Python program that reads its work from standard input and answers on standard
output. It ends by itself when its input does, so none outlives the one that started it.
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

# Seconds for a process to clean up after it was asked to end.
_GRACE = 3.0


# Where geomesh is, wherever that was imported from.
_PACKAGES = str(Path(__file__).parents[2])


class Process:
    """One process.

    Parameters
    ----------
    module : str
        Whose `main` it runs.
    quiet : bool
        Whether its standard error is thrown away.
    """

    def __init__(self, module: str, *, quiet: bool) -> None:
        code = f"import sys; sys.path.append({_PACKAGES!r}); from {module} import main; main()"
        # -P: modules in the user's working folder do not belong to geomesh.
        self._process = subprocess.Popen(
            [sys.executable, "-P", "-c", code],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL if quiet else None,
        )

    @property
    def pid(self) -> int:
        """Its process number."""
        return self._process.pid

    @property
    def requests(self) -> IO[bytes]:
        """What it reads."""
        assert self._process.stdin is not None
        return self._process.stdin

    @property
    def answers(self) -> IO[bytes]:
        """What it writes."""
        assert self._process.stdout is not None
        return self._process.stdout

    def wait(self) -> int:
        """Return its exit code, once it has ended."""
        return self._process.wait()

    def kill(self) -> None:
        """Stop it in whatever it does; another thread may be waiting for it."""
        self._process.kill()

    def terminate(self) -> None:
        """Let it clean up and end; stop it if that takes too long."""
        self._process.terminate()
        try:
            self._process.wait(_GRACE)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

    def end(self) -> None:
        """Let it end by itself, once it waits for more work."""
        send(self.requests.close)
        self.wait()
        self.answers.close()


class ProcessPool:
    """Processes that run the same program, to be used as a context.

    Parameters
    ----------
    module : str
        Whose `main` they run.
    count : int
        How many to start in advance.
    quiet : bool
        Whether their standard error is thrown away.
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
        """Start the processes now; they are needed soon."""
        with self._lock:
            while len(self._idle) + len(self._busy) < self.count:
                self._idle.append(self._start())

    @contextmanager
    def borrow(self) -> Iterator[Process]:
        """Yield a process that nobody else uses; after an error in the block it is stopped."""
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
        """Stop the processes that still work, and return their numbers."""
        with self._lock:
            busy = list(self._busy)
        for process in busy:
            how(process)
        return [process.pid for process in busy]

    def _start(self) -> Process:
        return Process(self._module, quiet=self._quiet)


def send(action: Callable[..., Any], *arguments: Any) -> bool:
    """Return whether the process still listened; if not, its answer or its end tells why."""
    try:
        action(*arguments)
    except OSError:
        return False
    return True
