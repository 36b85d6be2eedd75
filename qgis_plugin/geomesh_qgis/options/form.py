"""The widgets of the options page. What they do is in `page.py`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from qgis.gui import QgsCollapsibleGroupBox, QgsFileWidget
from qgis.PyQt.QtCore import Qt
from qgis.PyQt.QtGui import QFontDatabase
from qgis.PyQt.QtWidgets import (
    QFormLayout,
    QGroupBox,
    QHBoxLayout,
    QLabel,
    QPlainTextEdit,
    QProgressBar,
    QPushButton,
    QSizePolicy,
    QVBoxLayout,
    QWidget,
)

from ..engine import OPTIONS
from ..engine.environment import order

if TYPE_CHECKING:
    from pathlib import Path

    from ..engine.managed import Survey


class OptionsForm(QWidget):
    """The widgets of the page, from top to bottom."""

    def __init__(self, parent: QWidget | None = None) -> None:
        super().__init__(parent)
        self.version = _label("versionLabel")
        self.origin = _label("originLabel")
        self.program = _label("programLabel")
        self.verify = _button("verifyButton", "Verify", "Mesh a small image to test this geomesh")
        self.file = _file_widget()
        self.managed = _label("managedLabel")
        self.install = _button("installButton", "Install geomesh")
        self.remove = _button("removeButton", "Remove", "Delete this environment")
        self.bar = QProgressBar()
        self.bar.setObjectName("progressBar")
        self.bar.setRange(0, 100)
        self.cancel = _button("cancelButton", "Cancel", "Stop; nothing is changed")
        self.status = _label("statusLabel")
        self.details = QPlainTextEdit()
        self.details.setObjectName("detailsText")
        self.details.setReadOnly(True)
        self.details.setFont(QFontDatabase.systemFont(QFontDatabase.SystemFont.FixedFont))
        self.details.setMinimumHeight(120)
        self.details_box = QgsCollapsibleGroupBox("Details")
        self.details_box.setObjectName("detailsBox")
        QVBoxLayout(self.details_box).addWidget(self.details)
        self.details_box.setCollapsed(True)
        layout = QVBoxLayout(self)
        layout.setContentsMargins(0, 0, 0, 0)
        layout.addWidget(self._used_box())
        layout.addWidget(self._managed_box())
        layout.addLayout(_row(self.bar, self.cancel, stretch=False))
        layout.addWidget(self.status)
        layout.addWidget(self.details_box)
        layout.addStretch()
        self.show_work(None, busy=True)

    def _used_box(self) -> QGroupBox:
        box = QGroupBox("geomesh in use")
        self._rows = form = QFormLayout(box)
        form.setFieldGrowthPolicy(QFormLayout.FieldGrowthPolicy.AllNonFixedFieldsGrow)
        form.addRow("Version:", self.version)
        form.addRow("Found in:", self.origin)
        form.addRow("Program:", self.program)
        form.addRow("Use another:", self.file)
        form.addRow(_row(self.verify))
        return box

    def _managed_box(self) -> QGroupBox:
        box = QGroupBox("The plugin's own environment")
        layout = QVBoxLayout(box)
        layout.addWidget(self.managed)
        layout.addLayout(_row(self.install, self.remove))
        return box

    def show_survey(self, survey: Survey, folder: Path) -> None:
        """Show what is installed.

        Parameters
        ----------
        survey : Survey
        folder : Path
            Folder of the plugin's own environment.
        """
        used = survey.used
        self.version.setText(used.version if used else survey.problem.replace(f" in {OPTIONS}", ""))
        self.origin.setText(used.origin if used else "")
        self.program.setText(used.command[0] if used else "")
        self.program.setToolTip(self.program.text())
        for widget in (self.origin, self.program):
            widget.setVisible(used is not None)
            self._rows.labelForField(widget).setVisible(used is not None)
        self.managed.setText(managed_text(survey, folder))
        self.managed.setToolTip(str(folder))
        self.install.setText(install_text(survey))
        self.install.setToolTip(
            f"Install geomesh {survey.offered}, which is included in the plugin"
        )

    def show_work(self, survey: Survey | None, *, busy: bool, long: bool = False) -> None:
        """Enable the buttons that can be used now.

        Parameters
        ----------
        survey : Survey or None
            None if it is not known yet what is installed.
        busy : bool
            Whether work is running.
        long : bool
            Whether the work is long enough for a progress bar.
        """
        idle = survey is not None and not busy
        self.verify.setEnabled(idle and survey.used is not None)
        self.install.setEnabled(idle and bool(survey.offered))
        self.remove.setEnabled(idle and survey.managed)
        self.file.setEnabled(not long)
        self.bar.setVisible(busy and long)
        self.cancel.setVisible(busy and long)
        self.details_box.setVisible(long or not self.details.document().isEmpty())
        self.status.setVisible(long or bool(self.status.text()))


def managed_text(survey: Survey, folder: Path) -> str:
    """Return the text about the plugin's own environment."""
    if survey.managed_version:
        return f"geomesh {survey.managed_version} in {folder}"
    if survey.managed:
        return f"This environment does not work: {folder}"
    if not survey.offered:
        return (
            "This copy of the plugin does not contain geomesh: install the plugin from its zip "
            "file."
        )
    return (
        "Not installed. The installation needs Python 3.11 or newer, about 1.5 GB of disk, a "
        "network connection and a few minutes."
    )


def install_text(survey: Survey) -> str:
    """Return the text of the install button."""
    if not survey.managed:
        return "Install geomesh"
    if survey.managed_version and order(survey.managed_version) < order(survey.offered):
        return f"Upgrade to {survey.offered}"
    return "Reinstall"


def _label(name: str) -> QLabel:
    label = QLabel()
    label.setObjectName(name)
    label.setWordWrap(True)
    # Plain text, because paths and messages of pip are not HTML.
    label.setTextFormat(Qt.TextFormat.PlainText)
    label.setTextInteractionFlags(Qt.TextInteractionFlag.TextSelectableByMouse)
    # Without this, a long path would make the whole window as wide as the path.
    policy = label.sizePolicy()
    policy.setHorizontalPolicy(QSizePolicy.Policy.Ignored)
    label.setSizePolicy(policy)
    return label


def _button(name: str, text: str, tip: str = "") -> QPushButton:
    button = QPushButton(text)
    button.setObjectName(name)
    button.setToolTip(tip)
    return button


def _file_widget() -> QgsFileWidget:
    widget = QgsFileWidget()
    widget.setObjectName("pythonFile")
    widget.setStorageMode(QgsFileWidget.StorageMode.GetFile)
    widget.setDialogTitle("A Python that has geomesh, or a geomesh command")
    widget.lineEdit().setPlaceholderText("Python, geomesh command or folder of an environment")
    widget.setToolTip(
        "A Python that has geomesh, a geomesh command, or the folder of an environment.<br>"
        "If empty, the plugin looks for geomesh in GEOMESH_PYTHON, then on PATH, then in its own "
        "environment."
    )
    return widget


def _row(*widgets: QWidget, stretch: bool = True) -> QHBoxLayout:
    layout = QHBoxLayout()
    for widget in widgets:
        layout.addWidget(widget)
    if stretch:
        layout.addStretch()
    return layout
