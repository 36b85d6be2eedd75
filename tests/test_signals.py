"""Signals interrupt the work, wherever the main thread is, but never an import."""

from __future__ import annotations

import importlib
import signal
import sys
import threading
import time
from typing import TYPE_CHECKING

import pytest

from geomesh.cli.signals import on_signal, send_to_main_thread

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path


class StoppedError(Exception):
    pass


@pytest.fixture(autouse=True)
def stopping() -> Iterator[None]:
    """During the test, SIGTERM raises StoppedError."""
    before = signal.getsignal(signal.SIGTERM)

    def stop() -> None:
        raise StoppedError

    on_signal(signal.SIGTERM, stop)
    yield
    signal.signal(signal.SIGTERM, before)


def send_after(seconds: float) -> None:
    threading.Timer(seconds, send_to_main_thread, [signal.SIGTERM]).start()


def test_an_import_is_finished_first(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "slow_module.py").write_text("import time; time.sleep(0.4); done = True")
    monkeypatch.syspath_prepend(tmp_path)
    send_after(0.1)
    begun = time.monotonic()
    with pytest.raises(StoppedError):  # noqa: PT012
        importlib.import_module("slow_module")
        time.sleep(5)
    assert 0.4 < time.monotonic() - begun < 3
    assert sys.modules.pop("slow_module").done


@pytest.mark.skipif(not hasattr(signal, "pthread_kill"), reason="POSIX wakes a waiting thread")
def test_a_main_thread_that_waits_for_another_is_woken() -> None:
    send_after(0.1)
    begun = time.monotonic()
    with pytest.raises(StoppedError):
        threading.Event().wait(20)
    assert time.monotonic() - begun < 5
