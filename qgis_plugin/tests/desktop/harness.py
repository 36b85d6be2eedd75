"""Start the real QGIS, with its windows, on a virtual screen."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from support import PLUGINS, find_program

if TYPE_CHECKING:
    from collections.abc import Iterator

HERE = Path(__file__).resolve().parent
WIDTH, HEIGHT = 1280, 800

# A profile that is not new: QGIS shows no welcome, no tip of the day and no news from the network.
PROFILE = """
[PythonPlugins]
geomesh_qgis=true
processing=true

[app]
checkVersion=false
news-feed\\disabled=true
plugin_installer\\checkOnStart=false

[qgis]
checkVersion=false
newProjectDefault=false
projOpenAtLaunch=1
style=Fusion
stylesheet\\fontFamily=DejaVu Sans
stylesheet\\fontPointSize=9

[locale]
userLocale=en_US
overrideFlag=true

[core]
NewsFeed\\disabled=true

[migration]
fileVersion=2
settings=true
"""


@contextlib.contextmanager
def screen(width: int = WIDTH, height: int = HEIGHT) -> Iterator[str]:
    """Start Xvfb on a free display; yield the value of DISPLAY."""
    reading, writing = os.pipe()
    geometry = f"{width}x{height}x24"
    try:
        server = subprocess.Popen(
            ["Xvfb", "-displayfd", str(writing), "-screen", "0", geometry, "-nolisten", "tcp"],
            pass_fds=[writing],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
    except FileNotFoundError:
        raise AssertionError("Xvfb is not installed: apt-get install xvfb") from None
    finally:
        os.close(writing)
    try:
        # Xvfb writes its number when it is ready. If it fails, it only closes the pipe.
        with os.fdopen(reading) as pipe:
            number = pipe.readline().strip()
        assert number, "Xvfb did not start"
        yield f":{number}"
    finally:
        server.terminate()
        server.wait(timeout=20)


def make_profile(folder: Path) -> Path:
    """Write the settings of a profile; return the value for --profiles-path."""
    # QGIS 4 uses another name for the same file.
    for name in ("QGIS3.ini", "QGIS4.ini"):
        settings = folder / "profiles/default/QGIS" / name
        settings.parent.mkdir(parents=True, exist_ok=True)
        settings.write_text(PROFILE.lstrip())
    return folder


@contextlib.contextmanager
def desktop(script: str, folder: Path, plugins: Path = PLUGINS, **variables: object):
    """Start QGIS on a screen with a script of this folder, and yield the process.

    At the end, QGIS and its screen are always ended, even after an error.

    Parameters
    ----------
    script
        Name of a file beside this one. It runs inside QGIS.
    folder
        Folder for the profile, the log `qgis.log` and the files that the script writes.
    variables
        Environment variables for the script.
    """
    home, temporary = folder / "home", folder / "tmp"
    for place in (home, temporary):
        place.mkdir(parents=True)
    with (
        screen() as display,
        tempfile.TemporaryDirectory() as runtime,
        (folder / "qgis.log").open("wb") as log,
    ):
        environment = {
            name: value
            for name, value in os.environ.items()
            if not name.startswith(("QGIS_", "QT_", "PYTEST_", "PYTHON", "VIRTUAL_ENV", "XDG_"))
        }
        environment.update(
            DISPLAY=display,
            HOME=str(home),
            TMPDIR=str(temporary),
            XDG_RUNTIME_DIR=runtime,
            LC_ALL="C.UTF-8",
            LIBGL_ALWAYS_SOFTWARE="1",
            QGIS_PLUGINPATH=str(plugins),
            **{name: str(value) for name, value in variables.items()},
        )
        process = subprocess.Popen(
            [
                find_program("qgis"),
                *("--nologo", "--noversioncheck", "--lang", "en"),
                *("--profiles-path", str(make_profile(folder / "profile"))),
                *("--code", str(HERE / script)),
            ],
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
        try:
            yield process
        finally:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait(timeout=20)


def run_desktop(script: str, folder: Path, timeout: float, **variables: object) -> dict:
    """Run a script in QGIS until its end; return its report, with the exit code as "exit"."""
    report = folder / "report.json"
    with desktop(script, folder, GEOMESH_TEST_REPORT=report, **variables) as process:
        try:
            code = process.wait(timeout=timeout)
        except subprocess.TimeoutExpired:
            code = None
    log = (folder / "qgis.log").read_text(errors="replace")[-4000:]
    assert code is not None, f"QGIS did not end within {timeout} s:\n{log}"
    assert report.exists(), f"QGIS ended with {code} and without a report:\n{log}"
    return {"exit": code, "qgis_log": log, **json.loads(report.read_text())}
