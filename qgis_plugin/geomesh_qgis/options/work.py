"""Long work beside the window: one function in a background task of QGIS."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from qgis.core import Qgis, QgsApplication, QgsMessageLog, QgsTask
from qgis.PyQt.QtCore import pyqtSignal

from ..engine.child import Cancelled

Report = Callable[[float, str], None]
Cancel = Callable[[], bool]
Job = Callable[[Report, Cancel], Any]

LOG = "geomesh"


class Work(QgsTask):
    """Run a function in a thread; its signals arrive in the thread of the window.

    Parameters
    ----------
    title : str
        What QGIS shows in its list of tasks.
    job : callable
        Gets a callable to report progress to (0..1, message), and one that tells whether to stop.

    Attributes
    ----------
    result : Any
        What the function returned.
    error : Exception or None
        What it raised; `Cancelled` also if it never began.
    """

    advanced = pyqtSignal(float, str)
    ended = pyqtSignal()

    def __init__(self, title: str, job: Job) -> None:
        super().__init__(title, QgsTask.Flag.CanCancel)
        self.title = title
        self.result: Any = None
        self.error: Exception | None = Cancelled()
        self._job = job

    def run(self) -> bool:
        """Do the work, in the thread."""
        try:
            self.result = self._job(self._report, self.isCanceled)
            self.error = None
        except Exception as error:
            self.error = error
        return self.error is None

    def finished(self, result: bool) -> None:
        """Tell that it is over, in the thread of the window."""
        _running.remove(self)
        if self.error is not None and not isinstance(self.error, Cancelled):
            # Whoever has closed the window meanwhile finds it here.
            QgsMessageLog.logMessage(f"{self.title}: {self.error}", LOG, Qgis.MessageLevel.Warning)
        self.ended.emit()

    def _report(self, fraction: float, message: str) -> None:
        self.setProgress(100 * fraction)
        self.advanced.emit(fraction, message)


# QGIS owns a task, but does not keep the Python half of it alive.
_running: list[Work] = []


def start(work: Work) -> None:
    """Begin, unless QGIS has other tasks to do first."""
    _running.append(work)
    QgsApplication.taskManager().addTask(work)


def running() -> Work | None:
    """Return the work that is under way, which outlives the window that began it."""
    return _running[-1] if _running else None
