"""Stop when the program that started geomesh has gone: it held the other end of standard input."""

from __future__ import annotations

import _thread
import os
import signal
import sys
import threading


def hold() -> None:
    """Watch standard input from a thread; at its end this process is terminated.

    Closing the pipe is also the one way to ask for a clean stop on every system:
    Windows has no SIGTERM that a process could act upon.
    """
    threading.Thread(target=_watch, name="lifeline", daemon=True).start()


def _watch() -> None:
    # Not through sys.stdin: its lock would be held at the exit of the interpreter.
    try:
        while os.read(sys.__stdin__.fileno() if sys.__stdin__ else 0, 4096):
            pass
    except OSError:
        pass  # closed from the start
    # Runs the handler of the signal in the main thread, on Windows too.
    _thread.interrupt_main(signal.SIGTERM)
