"""Stop when standard input is closed: the program that started geomesh has exited."""

from __future__ import annotations

import os
import signal
import sys
import threading

from geomesh.cli.signals import send_to_main_thread


def watch_stdin() -> None:
    """Watch standard input in a thread, and terminate this process when it is closed.

    Closing the pipe is also the only clean way to stop this process on every system: on
    Windows a process cannot handle SIGTERM.
    """
    threading.Thread(target=_watch, name="lifeline", daemon=True).start()


def _watch() -> None:
    # Do not read sys.stdin: its lock would block the exit of the interpreter.
    try:
        while os.read(sys.__stdin__.fileno() if sys.__stdin__ else 0, 4096):
            pass
    except OSError:
        pass  # standard input was already closed
    send_to_main_thread(signal.SIGTERM)
