"""Long work in the background: a task of QGIS that runs one function."""

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
    """Run a function in a thread. Its signals arrive in the thread of the window.

    Parameters
    ----------
    title : str
        Title in QGIS's list of tasks.
    job : callable
        Receives two callables: one to report progress (0..1, message), and one that returns
        whether to stop.

    Attributes
    ----------
    result : Any
        Return value of the function.
    error : Exception or None
        Exception that it raised. `Cancelled` also if it never started.
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
        """Run the function, in the thread of the task."""
        try:
            self.result = self._job(self._report, self.isCanceled)
            self.error = None
        except Exception as error:
            self.error = error
        return self.error is None

    def finished(self, result: bool) -> None:
        """Report the end of the work, in the thread of the window."""
        _running.remove(self)
        if self.error is not None and not isinstance(self.error, Cancelled):
            # The user may have closed the window, but can read the error in the log.
            QgsMessageLog.logMessage(f"{self.title}: {self.error}", LOG, Qgis.MessageLevel.Warning)
        self.ended.emit()

    def _report(self, fraction: float, message: str) -> None:
        self.setProgress(100 * fraction)
        self.advanced.emit(fraction, message)


# QGIS keeps the C++ object of a task, but not its Python object. This list keeps that one.
_running: list[Work] = []


def start(work: Work) -> None:
    """Start the work. QGIS may run other tasks before it."""
    _running.append(work)
    QgsApplication.taskManager().addTask(work)


def running() -> Work | None:
    """Return the running work. It continues after the window that started it is closed."""
    return _running[-1] if _running else None
