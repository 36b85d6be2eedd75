"""Ctrl-C and requests to terminate, as exceptions in the main thread, but never in an import.

An exception that is raised while Python imports a module can get lost there and leave the import
lock locked. Then every thread that imports something waits forever. So a signal that arrives
during an import is sent again a moment later.
"""

from __future__ import annotations

import _thread
import signal
import threading
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable
    from types import FrameType

# Seconds until a signal is sent again.
_RETRY = 0.05


def on_signal(number: int, stop: Callable[[], object]) -> None:
    """Call `stop`, which raises, in the main thread when a signal arrives."""

    def handle(number: int, frame: FrameType | None) -> None:
        if not _is_importing(frame):
            stop()
            return
        again = threading.Timer(_RETRY, send_to_main_thread, [number])
        again.daemon = True
        again.start()

    signal.signal(number, handle)


def send_to_main_thread(number: int) -> None:
    """Have the main thread handle a signal, even if it waits for another thread."""
    main = threading.main_thread().ident
    if hasattr(signal, "pthread_kill") and main is not None:
        signal.pthread_kill(main, number)
    else:
        _thread.interrupt_main(signal.Signals(number))  # Windows


def _is_importing(frame: FrameType | None) -> bool:
    while frame is not None:
        if frame.f_code.co_filename.startswith("<frozen importlib"):
            return True
        frame = frame.f_back
    return False
