"""Helpers for scripts inside QGIS: steps that wait without blocking, a report, a timeout."""

from __future__ import annotations

import json
import os
import sys
import time
import traceback
from pathlib import Path
from typing import TYPE_CHECKING, Callable

from qgis.core import QgsProject
from qgis.gui import QgsProcessingAlgorithmDialogBase
from qgis.PyQt.QtCore import QTimer
from qgis.PyQt.QtWidgets import QApplication, QMessageBox, QWidget
from qgis.utils import iface

if TYPE_CHECKING:
    from collections.abc import Generator

POLL = 100  # ms


class Driver:
    """Runs a generator of steps from QGIS's event loop.

    The generator yields functions. The driver calls a function until it returns a true value.
    It then sends that value to the generator. A dialog may run its own event loop: the timer
    works there too.
    """

    def __init__(self, steps: Callable[[Driver], Generator], timeout: float = 90) -> None:
        self.report: dict = {"boxes": [], "exceptions": [], "failure": None}
        self._timeout = timeout
        self._steps = steps(self)
        self._awaited: Callable[[], object] | None = None
        self._since = time.monotonic()
        self._busy = False
        sys.excepthook = self._note_exception  # without this, QGIS shows a window
        self._timer = QTimer()
        self._timer.timeout.connect(self._tick)
        self._timer.start(POLL)

    def picture(self, path: Path, widget: QWidget | None = None) -> None:
        """Save a screenshot of the screen or of one window."""
        image = widget.grab() if widget else QApplication.primaryScreen().grabWindow(0)
        path.parent.mkdir(parents=True, exist_ok=True)
        image.save(str(path))

    def _note_exception(self, kind, error, trace) -> None:
        self.report["exceptions"].append("".join(traceback.format_exception(kind, error, trace)))

    def _tick(self) -> None:
        if self._busy:  # a step has opened a dialog, whose event loop calls this
            return
        self._busy = True
        try:
            self._refuse_boxes()
            value = self._awaited() if self._awaited else None
            if value or not self._awaited:
                self._awaited = self._steps.send(value)
                self._since = time.monotonic()
            elif time.monotonic() - self._since > self._timeout:
                line = self._steps.gi_frame.f_lineno
                raise TimeoutError(f"line {line} waited {self._timeout} s")
        except StopIteration:
            self._end()
        except Exception:
            self.report["failure"] = traceback.format_exc()
            self._end()
        finally:
            self._busy = False

    def _refuse_boxes(self) -> None:
        """Report a message box and stop: nobody can close it."""
        for window in QApplication.topLevelWidgets():
            if isinstance(window, QMessageBox) and window.isVisible():
                self.report["boxes"].append(window.text())
        if self.report["boxes"]:
            raise RuntimeError(f"message box: {self.report['boxes'][0]}")

    def _end(self) -> None:
        self._timer.stop()
        path = Path(os.environ["GEOMESH_TEST_REPORT"])
        if self.report["failure"]:
            self.picture(path.with_name("failure.png"))
        path.write_text(json.dumps(self.report, indent=1, default=str))
        if self.report["failure"]:
            os._exit(1)  # the event loop of an open dialog would block a normal exit
        QgsProject.instance().clear()  # without this, QGIS asks about unsaved changes
        QTimer.singleShot(0, iface.actionExit().trigger)


def processing_dialog() -> QgsProcessingAlgorithmDialogBase | None:
    """Return the open dialog of an algorithm."""
    for window in QApplication.topLevelWidgets():
        if isinstance(window, QgsProcessingAlgorithmDialogBase) and window.isVisible():
            return window
    return None


def press_run(dialog: QgsProcessingAlgorithmDialogBase) -> Generator:
    """Press Run and wait for the end. These steps return (successful, results)."""
    ended = []
    dialog.algorithmFinished.connect(
        lambda successful, results: ended.append((successful, results))
    )
    QTimer.singleShot(0, dialog.runButton().click)
    yield lambda: ended
    return ended[0]


def options_page() -> QWidget | None:
    """Return the options page of the plugin, if it is open."""
    pages = (
        window.findChild(QWidget, "geomeshOptions") for window in QApplication.topLevelWidgets()
    )
    return next((page for page in pages if page is not None and page.isVisible()), None)


def canvas_is_still() -> Callable[[], bool]:
    """Return a function that tells whether the map has not been drawing for half a second."""
    canvas = iface.mapCanvas()
    canvas.refresh()
    busy = time.monotonic()

    def still() -> bool:
        nonlocal busy
        if canvas.isDrawing():
            busy = time.monotonic()
        return time.monotonic() - busy > 0.5

    return still
