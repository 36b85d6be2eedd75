"""The page Settings > Options > geomesh: choose the geomesh that is used, or install one."""

from __future__ import annotations

from typing import TYPE_CHECKING

from qgis.gui import QgsOptionsPageWidget, QgsScrollArea
from qgis.PyQt.QtCore import QTimer
from qgis.PyQt.QtWidgets import QFrame, QMessageBox, QVBoxLayout, QWidget

from ..engine.child import Cancelled
from ..engine.environment import MANAGED, EnvironmentProblem, find, forget_versions
from ..engine.installing import install
from ..engine.managed import Survey, bundled_wheel, remove, survey
from ..engine.trial import self_test
from ..settings import PAGE, managed_folder, python_setting, set_python_setting
from . import work
from .form import OptionsForm

if TYPE_CHECKING:
    from pathlib import Path

LOOKING = "Looking for geomesh"

# The delay before a path is checked, so that the user can finish typing.
_TYPING_MS = 600


class OptionsPage(QgsOptionsPageWidget):
    """Shows what is installed. The user can choose, install, verify and remove geomesh.

    Only one task runs at a time. It continues if the window is closed. If the page is opened
    again meanwhile, it shows this task.
    """

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.setObjectName(PAGE)
        self._work: work.Work | None = None
        self._survey: Survey | None = None
        self._looked_for = ""
        self._form = form = OptionsForm()
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        # The texts are as high as necessary. If the page does not fit, the user can scroll.
        area = QgsScrollArea()
        area.setFrameShape(QFrame.Shape.NoFrame)
        area.setWidgetResizable(True)
        area.setWidget(form)
        layout.addWidget(area)
        form.file.setFilePath(python_setting())
        self._typing = QTimer(self)
        self._typing.setSingleShot(True)
        self._typing.setInterval(_TYPING_MS)
        self._typing.timeout.connect(self._look)
        form.file.fileChanged.connect(self._restart_typing)
        form.verify.clicked.connect(self._verify)
        form.install.clicked.connect(self._install)
        form.remove.clicked.connect(self._remove)
        form.cancel.clicked.connect(self._stop)
        under_way = work.running()
        if under_way is None:
            self._look()
        else:
            self._follow(under_way)

    def apply(self) -> None:
        """Save the choice of the user."""
        set_python_setting(self._form.file.filePath())

    def _restart_typing(self, _path: str) -> None:
        self._typing.start()

    def _look(self) -> None:
        """Find out what is installed. If work is running, this happens when it ends."""
        if self._work is None:
            chosen, managed = self._form.file.filePath(), managed_folder()
            self._looked_for = chosen
            self._begin(work.Work(LOOKING, lambda _report, _cancelled: survey(chosen, managed)))

    def _verify(self) -> None:
        chosen, managed = self._form.file.filePath(), managed_folder()

        def verify(report: work.Report, cancelled: work.Cancel) -> str:
            report(0.0, "Looking for geomesh ...")
            forget_versions()
            here = find(chosen, managed)
            return f"geomesh {self_test(here, progress=report, cancelled=cancelled)} works."

        self._begin(work.Work("Verifying geomesh", verify))

    def _install(self) -> None:
        chosen, managed = self._form.file.filePath(), managed_folder()

        def make(report: work.Report, cancelled: work.Cancel) -> str:
            made = install(managed, bundled_wheel(), progress=report, cancelled=cancelled)
            return f"geomesh {made.version} is installed{_overruled(chosen, managed)}."

        self._begin(work.Work("Installing geomesh", make))

    def _remove(self) -> None:
        managed = managed_folder()
        question = f"Remove the plugin's own environment?\n\n{managed}"
        if QMessageBox.question(self, "geomesh", question) != QMessageBox.StandardButton.Yes:
            return

        def take_away(report: work.Report, _cancelled: work.Cancel) -> str:
            report(0.1, f"Removing {managed} ...")
            remove(managed)
            return "The plugin's own environment was removed."

        self._begin(work.Work("Removing geomesh", take_away))

    def _begin(self, begun: work.Work) -> None:
        if begun.title != LOOKING:
            self._form.details.clear()
            self._form.status.clear()
            self._form.bar.setValue(0)
        self._follow(begun)
        work.start(begun)

    def _follow(self, begun: work.Work) -> None:
        """Show the progress of this work."""
        self._work = begun
        begun.advanced.connect(self._advance)
        begun.ended.connect(self._end)
        self._form.cancel.setEnabled(True)
        self._refresh()

    def _advance(self, fraction: float, message: str) -> None:
        self._form.bar.setValue(round(100 * fraction))
        self._form.status.setText(message)
        self._form.details.appendPlainText(message)

    def _stop(self) -> None:
        if self._work is not None:
            self._form.status.setText("Stopping ...")
            self._form.cancel.setEnabled(False)
            self._work.cancel()

    def _end(self) -> None:
        ended, self._work = self._work, None
        if ended is None:
            return
        if ended.title == LOOKING:
            self._survey = ended.result
            if self._survey is not None:
                self._form.show_survey(self._survey, managed_folder())
            if self._form.file.filePath() != self._looked_for:
                self._look()  # the user typed another path meanwhile
        else:
            self._form.status.setText(_outcome(ended))
            for line in getattr(ended.error, "details", ()):
                self._form.details.appendPlainText(line)
            self._look()
        self._refresh()

    def _refresh(self) -> None:
        busy = self._work is not None
        self._form.show_work(self._survey, busy=busy, long=busy and self._work.title != LOOKING)


def _overruled(chosen: str, managed: Path) -> str:
    """Return a text that says if something other than the plugin's own environment is used."""
    try:
        used = find(chosen, managed)
    except EnvironmentProblem as problem:
        return f", but {problem.message}"
    if used.origin == MANAGED:
        return ""
    return f", but the plugin uses the one specified by {used.origin}"


def _outcome(ended: work.Work) -> str:
    if ended.error is None:
        return str(ended.result)
    if isinstance(ended.error, Cancelled):
        return "Cancelled: nothing has changed."
    return str(ended.error)
