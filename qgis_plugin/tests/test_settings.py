"""The options page, used as by a user: press buttons, type paths, wait for real tasks."""

from __future__ import annotations

import os
import threading
import time
from pathlib import Path

import pytest
from qgis.core import QgsApplication, QgsSettings
from qgis.gui import QgsFileWidget
from qgis.PyQt import sip
from qgis.PyQt.QtWidgets import QLabel, QMessageBox, QPlainTextEdit, QProgressBar, QPushButton

from geomesh_qgis import settings
from geomesh_qgis.engine import installing, managed
from geomesh_qgis.engine.environment import MANAGED, SETTING, EnvironmentProblem, forget_versions
from geomesh_qgis.options import page as options
from geomesh_qgis.options import work
from geomesh_qgis.options.factory import OptionsFactory
from geomesh_qgis.options.page import OptionsPage

PATIENCE = 30.0


def wait_until(condition):
    """Process the events of the window until a condition is true."""
    end = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < end, "waited in vain"
        QgsApplication.processEvents()
        time.sleep(0.01)


# A fake Python for creating environments. It passes meshing on to the real geomesh.
PLAYER = """#!{python}
import os, shutil, sys, time
arguments = sys.argv[1:]
if arguments[:2] == ["-m", "venv"]:
    os.makedirs(arguments[2] + "/bin")
    open(arguments[2] + "/pyvenv.cfg", "w").close()
    shutil.copy(__file__, arguments[2] + "/bin/python")
elif arguments[:2] == ["-m", "pip"]:
    print("Collecting numpy", flush=True)
    exec(os.environ.get("PLAY_PIP", ""))
else:
    os.execv({python!r}, [{python!r}, *arguments])
"""


@pytest.fixture(autouse=True)
def bare_computer(monkeypatch, tmp_path, qgis_app):
    """A computer where only the test's own geomesh exists, with its own profile."""
    forget_versions()
    monkeypatch.delenv("GEOMESH_PYTHON")
    monkeypatch.setenv("PATH", "/usr/bin:/bin")
    monkeypatch.setattr(QgsApplication, "qgisSettingsDirPath", lambda: f"{tmp_path}/profile/")
    QgsSettings().remove("geomesh")
    yield
    QgsSettings().remove("geomesh")


@pytest.fixture
def wheel(monkeypatch, tmp_path):
    """Return a function that adds a wheel of a given version to the plugin."""

    def bring(version="0.1.0"):
        monkeypatch.setattr(managed, "WHEELS", tmp_path / "wheel")
        folder = tmp_path / "wheel"
        folder.mkdir(exist_ok=True)
        (folder / f"geomesh_toolkit-{version}-py3-none-any.whl").touch()

    return bring


@pytest.fixture
def player(monkeypatch, tmp_path, geomesh_python, wheel):
    wheel()
    path = tmp_path / "player"
    path.write_text(PLAYER.format(python=str(geomesh_python)))
    path.chmod(0o755)
    monkeypatch.setattr(installing, "find_base_python", lambda: path)
    return path


class Driver:
    """A page on the screen, with what a user can see and press."""

    def __init__(self, page):
        self.page = page

    def find(self, kind, name):
        found = self.page.findChild(kind, name)
        assert found is not None, name
        return found

    def text(self, name):
        return self.find(QLabel, f"{name}Label").text()

    def can_be_read(self):
        """Return whether every label with text is large enough for it."""
        labels = [
            label
            for label in self.page.findChildren(QLabel)
            if label.isVisible() and label.objectName() and label.text()
        ]
        return len(labels) > 1 and all(
            label.width() > 300 and label.height() >= label.heightForWidth(label.width())
            for label in labels
        )

    def button(self, name):
        return self.find(QPushButton, f"{name}Button")

    def press(self, name):
        button = self.button(name)
        assert button.isEnabled(), name
        assert button.isVisible(), name
        button.click()

    @property
    def bar(self):
        return self.find(QProgressBar, "progressBar")

    @property
    def details(self):
        return self.find(QPlainTextEdit, "detailsText").toPlainText()

    def type(self, path):
        self.find(QgsFileWidget, "pythonFile").lineEdit().setText(str(path))

    def wait(self):
        """Wait until no work is running or about to start."""
        wait_until(lambda: work.running() is None and not self.page._typing.isActive())

    def wait_for_status(self, text):
        wait_until(lambda: text in self.text("status"))


@pytest.fixture
def open_page(qgis_app):
    pages = []

    def open_one():
        page = OptionsFactory().createWidget(None)
        assert isinstance(page, OptionsPage)
        pages.append(page)
        page.resize(700, 600)
        page.show()
        return Driver(page)

    yield open_one
    if work.running() is not None:
        work.running().cancel()
    wait_until(lambda: work.running() is None)
    for page in pages:
        if not sip.isdeleted(page):
            sip.delete(page)


@pytest.fixture
def driver(open_page):
    driver = open_page()
    driver.wait()
    return driver


def own(folder_name="environment"):
    return settings.managed_folder().with_name(folder_name)


def test_without_geomesh_the_page_offers_to_install_it(open_page, wheel):
    wheel()
    driver = open_page()
    driver.wait()
    assert "not installed yet" in driver.text("version")
    assert not driver.find(QLabel, "programLabel").isVisible()
    assert "Not installed" in driver.text("managed")
    assert driver.button("install").text() == "Install geomesh"
    assert driver.button("install").isEnabled()
    assert not driver.button("verify").isEnabled()
    assert not driver.button("remove").isEnabled()
    assert not driver.bar.isVisible()
    assert not driver.button("cancel").isVisible()


def test_a_copy_without_a_wheel_does_not_offer_it(driver):
    assert not driver.button("install").isEnabled()
    assert "does not contain geomesh" in driver.text("managed")


def test_what_is_used_is_shown(open_page, monkeypatch, geomesh_python):
    monkeypatch.setenv("GEOMESH_PYTHON", str(geomesh_python))
    driver = open_page()
    driver.wait()
    assert driver.text("version") == "0.1.0"
    assert driver.text("origin") == "GEOMESH_PYTHON"
    assert driver.text("program") == str(geomesh_python)
    assert driver.button("verify").isEnabled()


def test_a_choice_is_tried_out_at_once_and_kept_by_apply(driver, geomesh_python):
    driver.type(geomesh_python.parent.parent)
    driver.wait()
    assert driver.text("version") == "0.1.0"
    assert driver.text("origin") == SETTING
    assert settings.python_setting() == ""
    driver.page.apply()
    assert settings.python_setting() == str(geomesh_python.parent.parent)
    assert settings.installation().command[0] == str(geomesh_python)
    driver.type("")
    driver.wait()
    driver.page.apply()
    assert not QgsSettings().contains("geomesh/python")


def test_the_choice_is_there_when_the_page_is_opened_again(open_page, geomesh_python):
    settings.set_python_setting(f" {geomesh_python} ")
    driver = open_page()
    driver.wait()
    assert driver.find(QgsFileWidget, "pythonFile").filePath() == str(geomesh_python)
    assert driver.text("origin") == SETTING


def test_a_choice_that_does_not_work_is_told(driver, tmp_path):
    driver.type(tmp_path / "<b>nowhere</b>")
    driver.wait()
    assert "<b>nowhere</b> does not exist" in driver.text("version")
    assert not driver.button("verify").isEnabled()
    driver.page.apply()
    with pytest.raises(EnvironmentProblem, match="nowhere"):
        settings.installation()


def test_long_paths_are_shown_in_full_in_a_small_window(driver, geomesh_python, tmp_path):
    folder = tmp_path / ("a long name " * 12).strip()
    folder.symlink_to(geomesh_python.parent.parent)
    driver.page.resize(500, 250)
    driver.type(folder)
    driver.wait()
    assert driver.text("program") == f"{folder}/bin/python"
    wait_until(driver.can_be_read)
    driver.type(folder / "nowhere")
    driver.wait()
    wait_until(driver.can_be_read)


def test_verifying_meshes_for_real(driver, geomesh_python):
    driver.type(geomesh_python)
    driver.wait()
    driver.press("verify")
    assert driver.bar.isVisible()
    assert not driver.button("verify").isEnabled()
    driver.wait()
    assert driver.text("status") == "geomesh 0.1.0 works."
    assert "test image" in driver.details
    assert "Test image: Refining" in driver.details  # as in the user's first mesh by default
    assert not driver.bar.isVisible()
    assert driver.button("verify").isEnabled()


def test_verifying_tells_what_is_wrong(driver, geomesh_python, tmp_path):
    broken = tmp_path / "python"
    broken.write_text(
        '#!/bin/sh\ncase "$3" in\n--version) echo "geomesh, version 0.1.0";;\n'
        '*) echo "libGL is missing" >&2; exit 1;;\nesac\n'
    )
    broken.chmod(0o755)
    driver.type(broken)
    driver.wait()
    assert driver.text("version") == "0.1.0"
    driver.press("verify")
    driver.wait()
    assert "libGL is missing" in driver.text("status")
    assert driver.details.splitlines()[-1] == "libGL is missing"


def test_installing_upgrading_and_removing(open_page, player, monkeypatch, wheel):
    driver = open_page()
    driver.wait()
    driver.press("install")
    assert driver.button("cancel").isVisible()
    assert not driver.button("install").isEnabled()
    driver.wait()
    assert driver.text("status") == "geomesh 0.1.0 is installed."
    assert "Collecting numpy" in driver.details
    assert driver.bar.value() == 100
    assert driver.text("origin") == MANAGED
    assert driver.text("managed") == f"geomesh 0.1.0 in {own()}"
    assert settings.installation().command == (f"{own()}/bin/python", "-m", "geomesh")
    assert driver.button("install").text() == "Reinstall"

    wheel("0.2.0")
    again = open_page()
    again.wait()
    assert again.button("install").text() == "Upgrade to 0.2.0"

    answers = [QMessageBox.StandardButton.No, QMessageBox.StandardButton.Yes]
    monkeypatch.setattr(QMessageBox, "question", lambda *_: answers.pop(0))
    driver.press("remove")
    assert work.running() is None
    assert own().exists()
    driver.press("remove")
    driver.wait()
    assert not own().exists()
    assert "removed" in driver.text("status")
    assert "not installed yet" in driver.text("version")
    assert driver.button("install").text() == "Install geomesh"
    assert not driver.button("remove").isEnabled()


def test_an_installation_that_is_not_used_says_so(open_page, player, geomesh_python):
    settings.set_python_setting(str(geomesh_python))
    driver = open_page()
    driver.wait()
    driver.press("install")
    driver.wait()
    assert driver.text("status") == (
        "geomesh 0.1.0 is installed, but the plugin uses the one specified by the plugin's setting."
    )


def test_a_failed_installation_tells_why_and_can_be_tried_again(open_page, player, monkeypatch):
    monkeypatch.setenv("PLAY_PIP", "sys.exit('ERROR: [Errno 28] No space left on device')")
    driver = open_page()
    driver.wait()
    driver.press("install")
    driver.wait()
    assert "disk is full" in driver.text("status")
    assert "Errno 28" in driver.details
    assert not own().exists()
    monkeypatch.delenv("PLAY_PIP")
    driver.press("install")
    driver.wait()
    assert driver.text("status") == "geomesh 0.1.0 is installed."


def test_the_window_stays_alive_and_can_cancel(open_page, player, monkeypatch, tmp_path):
    monkeypatch.setenv(
        "PLAY_PIP", f"open({str(tmp_path / 'pid')!r}, 'w').write(str(os.getpid())); time.sleep(60)"
    )
    driver = open_page()
    driver.wait()
    driver.press("install")
    driver.wait_for_status("Collecting numpy")
    assert 0 < driver.bar.value() < 100
    wait_until(lambda: (tmp_path / "pid").exists())
    driver.press("cancel")
    assert driver.text("status") == "Stopping ..."
    assert not driver.button("cancel").isEnabled()
    driver.wait()
    assert driver.text("status") == "Cancelled: nothing has changed."
    with pytest.raises(ProcessLookupError):
        os.kill(int((tmp_path / "pid").read_text()), 0)
    assert list(own().parent.iterdir()) == []
    assert driver.button("install").isEnabled()


def test_work_goes_on_without_its_window_and_shows_in_the_next(
    open_page, player, monkeypatch, tmp_path
):
    go_on = tmp_path / "go on"
    play = f"while not os.path.exists({str(go_on)!r}): time.sleep(0.05)\nprint('Collecting scipy')"
    monkeypatch.setenv("PLAY_PIP", play)
    first = open_page()
    first.wait()
    first.press("install")
    first.wait_for_status("Collecting numpy")
    sip.delete(first.page)
    second = open_page()
    assert second.bar.isVisible()
    assert second.button("cancel").isVisible()
    assert not second.button("install").isEnabled()
    go_on.touch()
    second.wait()
    assert "Collecting scipy" in second.details
    assert second.text("status") == "geomesh 0.1.0 is installed."
    assert second.text("origin") == MANAGED


def test_the_folder_lies_in_the_profile(tmp_path):
    assert settings.managed_folder() == Path(tmp_path, "profile", "geomesh", "environment")


def test_the_page_asks_no_program_in_the_thread_of_the_window(open_page, monkeypatch, qgis_app):
    asked_in = []
    survey = options.survey

    def spy(*values):
        asked_in.append(threading.current_thread() is threading.main_thread())
        return survey(*values)

    monkeypatch.setattr(options, "survey", spy)
    open_page().wait()
    assert asked_in == [False]
