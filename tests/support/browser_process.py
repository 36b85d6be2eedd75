"""Start Chromium and Firefox, unseen, with a profile of their own, and end them completely."""

from __future__ import annotations

import json
import os
import re
import shutil
import signal
import subprocess
import sys
from collections import deque
from contextlib import contextmanager, suppress
from http.client import HTTPConnection
from pathlib import Path
from queue import Empty, Queue
from tempfile import TemporaryDirectory
from threading import Thread
from typing import TYPE_CHECKING

import pytest

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

# Seconds to wait for a start, and for an end that was asked for.
TIMEOUT, PATIENCE = 60, 10
BLANK = "about:blank"
SCREEN = "1920x1200x24"
NAMES = ("chromium", "firefox")

# What each browser needs: names of the program, and the package of Debian.
PROGRAMS = {
    "chromium": (("chromium", "chromium-browser", "google-chrome"), "chromium"),
    "chromedriver": (("chromedriver",), "chromium-driver"),
    "firefox": (("firefox-esr", "firefox"), "firefox-esr"),
    "Xvfb": (("Xvfb",), "xvfb"),
}
NEEDS = {"chromium": ("chromium", "chromedriver"), "firefox": ("firefox", "Xvfb")}

# No graphics card is needed, and the browser itself asks for nothing in the network.
CHROMIUM = [
    "--headless=new",
    "--no-sandbox",
    "--no-first-run",
    "--no-default-browser-check",
    "--remote-debugging-port=0",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--ignore-gpu-blocklist",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-default-apps",
    "--disable-domain-reliability",
    "--disable-extensions",
    "--disable-sync",
    "--disable-breakpad",
    "--disable-crash-reporter",
    "--metrics-recording-only",
    "--no-pings",
    "--gaia-url=http://127.0.0.1:9",
    "--component-updater=url-source=http://127.0.0.1:9/",
    "--password-store=basic",
    "--disable-dev-shm-usage",
    "--force-color-profile=srgb",
    "--hide-scrollbars",
    "--lang=en-US",
    "--disable-features=OptimizationHints,MediaRouter,Translate,AutofillServerCommunication",
]
FIREFOX: dict[str, bool | int | str] = {
    "webgl.force-enabled": True,
    "webgl.disable-fail-if-major-performance-caveat": True,
    "gfx.color_management.mode": 0,
    "network.captive-portal-service.enabled": False,
    "network.connectivity-service.enabled": False,
    "network.dns.disablePrefetch": True,
    "network.prefetch-next": False,
    "network.proxy.type": 1,
    "network.trr.mode": 5,
    "app.update.disabledForTesting": True,
    "app.normandy.enabled": False,
    "app.shield.optoutstudies.enabled": False,
    "browser.aboutwelcome.enabled": False,
    "browser.discovery.enabled": False,
    "browser.newtabpage.enabled": False,
    "browser.region.network.url": "",
    "browser.safebrowsing.blockedURIs.enabled": False,
    "browser.safebrowsing.downloads.enabled": False,
    "browser.safebrowsing.malware.enabled": False,
    "browser.safebrowsing.phishing.enabled": False,
    "browser.safebrowsing.provider.google4.updateURL": "",
    "browser.safebrowsing.provider.google5.updateURL": "",
    "browser.safebrowsing.provider.mozilla.updateURL": "",
    "browser.search.update": False,
    "browser.shell.checkDefaultBrowser": False,
    "browser.startup.homepage_override.mstone": "ignore",
    "browser.startup.page": 0,
    "browser.topsites.contile.enabled": False,
    "datareporting.healthreport.uploadEnabled": False,
    "datareporting.policy.dataSubmissionEnabled": False,
    "dom.push.connection.enabled": False,
    "dom.security.https_first": False,
    "extensions.blocklist.enabled": False,
    "extensions.getAddons.cache.enabled": False,
    "extensions.update.enabled": False,
    "intl.accept_languages": "en-US",
    "media.gmp-manager.updateEnabled": False,
    "messaging-system.rsexperimentloader.enabled": False,
    "nimbus.rollouts.enabled": False,
    "privacy.trackingprotection.enabled": False,
    "services.settings.server": "data:,#remote-settings-dummy/v1",
    "signon.autofillForms": False,
    "toolkit.telemetry.enabled": False,
    "toolkit.telemetry.server": "",
    "toolkit.telemetry.unified": False,
}


def need(name: str) -> dict[str, str]:
    """Return the programs of a browser. Without them a test is skipped; in CI on Linux it fails."""
    found = {}
    for what in NEEDS[name]:
        names, _ = PROGRAMS[what]
        found[what] = next(filter(None, map(shutil.which, names)), "")
    missing = [PROGRAMS[what][1] for what, path in found.items() if not path]
    if missing:
        how = f"{name} is not on this computer: apt-get install {' '.join(missing)}"
        must = os.environ.get("CI") == "true" and sys.platform == "linux"
        (pytest.fail if must else pytest.skip)(how)
    return found


class Process:
    """A program in a process group of its own, whose output is read all the time."""

    def __init__(self, arguments: Sequence[str], environment: Mapping[str, str]) -> None:
        self._program = subprocess.Popen(
            arguments,
            env=environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            start_new_session=True,
        )
        self._name = arguments[0]
        self.number = self._program.pid
        self._lines: Queue[str] = Queue()
        self._last: deque[str] = deque(maxlen=20)
        self._reader = Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        assert self._program.stdout
        for line in self._program.stdout:
            self._last.append(line)
            self._lines.put(line)
        self._lines.put("")

    def printed(self, pattern: str) -> str:
        """Wait for a line with a pattern, and return the pattern's group."""
        while True:
            try:
                line = self._lines.get(timeout=TIMEOUT)
            except Empty:
                line = ""
            if found := re.search(pattern, line):
                return found[1]
            if not line:
                raise AssertionError(f"{self._name} did not start:\n{''.join(self._last)}")

    def end(self, patience: float = 0) -> None:
        """Wait so many seconds for the program to end by itself, then end its whole group."""
        for signal_, seconds in ((0, patience), (signal.SIGTERM, PATIENCE), (signal.SIGKILL, None)):
            with suppress(ProcessLookupError):
                os.killpg(self.number, signal_)
            with suppress(subprocess.TimeoutExpired):
                self._program.wait(seconds)
        self._reader.join(TIMEOUT)
        assert self._program.stdout
        self._program.stdout.close()


@contextmanager
def process(arguments: Sequence[str], variables: Mapping[str, str]) -> Iterator[Process]:
    started = Process(arguments, variables)
    try:
        yield started
    finally:
        started.end()


def environment(folder: Path) -> dict[str, str]:
    """Return an environment where all that a browser writes goes into a folder."""
    kept = {"PATH", "LANG", "LD_LIBRARY_PATH"}
    (folder / "home").mkdir()
    (folder / "tmp").mkdir()
    return {name: value for name, value in os.environ.items() if name in kept} | {
        "HOME": str(folder / "home"),
        "TMPDIR": str(folder / "tmp"),
        "XDG_RUNTIME_DIR": str(folder / "tmp"),
        "LIBGL_ALWAYS_SOFTWARE": "1",
        "MOZ_CRASHREPORTER_DISABLE": "1",
        "MOZ_REMOTE_SETTINGS_DEVTOOLS": "1",  # without it, Firefox ignores services.settings.server
    }


@contextmanager
def chromium(programs: Mapping[str, str], folder: Path, proxy: int, webgl: bool) -> Iterator[str]:
    """Run Chromium, and chromedriver, which translates BiDi; yield the address of the socket."""
    options = [*CHROMIUM, f"--proxy-server=127.0.0.1:{proxy}", f"--user-data-dir={folder}/profile"]
    if not webgl:
        options.append("--disable-3d-apis")
    variables = environment(folder)
    with (
        process([programs["chromium"], *options, BLANK], variables) as browser,
        process([programs["chromedriver"], "--port=0"], variables) as driver,
    ):
        port = int(browser.printed(r"DevTools listening on ws://[^:]+:(\d+)/"))
        client = HTTPConnection("127.0.0.1", int(driver.printed(r"successfully on port (\d+)")))
        attach = {"debuggerAddress": f"127.0.0.1:{port}"}
        wanted = {"alwaysMatch": {"webSocketUrl": True, "goog:chromeOptions": attach}}
        client.request("POST", "/session", json.dumps({"capabilities": wanted}))
        answer = json.loads(client.getresponse().read())["value"]
        client.close()
        yield answer["capabilities"]["webSocketUrl"]
        browser.end(PATIENCE)


@contextmanager
def firefox(programs: Mapping[str, str], folder: Path, proxy: int, webgl: bool) -> Iterator[str]:
    """Run Firefox, which speaks BiDi itself; yield the address of the socket.

    It has a display of its own, which nobody sees: when headless, it has no WebGL.
    """
    settings = FIREFOX | {"webgl.disabled": not webgl}
    for kind in ("http", "ssl"):
        settings |= {f"network.proxy.{kind}": "127.0.0.1", f"network.proxy.{kind}_port": proxy}
    lines = [f"user_pref({json.dumps(k)}, {json.dumps(v)});" for k, v in settings.items()]
    profile = folder / "profile"
    profile.mkdir()
    (profile / "user.js").write_text("\n".join(lines))
    screen = ["-screen", "0", SCREEN, "-nolisten", "tcp", "-noreset", "-displayfd", "1"]
    options = ["--no-remote", "--profile", str(profile), "--remote-debugging-port", "0", BLANK]
    variables = environment(folder)
    with process([programs["Xvfb"], *screen], variables) as display:
        variables["DISPLAY"] = ":" + display.printed(r"^(\d+)$")
        with process([programs["firefox"], *options], variables) as browser:
            yield browser.printed(r"WebDriver BiDi listening on (ws://\S+)") + "/session"
            browser.end(PATIENCE)


@contextmanager
def running(name: str, *, proxy: int, webgl: bool) -> Iterator[str]:
    """Run a browser. On leaving, it gets a moment to end by itself; nothing of it stays."""
    programs = need(name)
    run = {"chromium": chromium, "firefox": firefox}[name]
    with (
        TemporaryDirectory(prefix="geomesh-browser-") as folder,
        run(programs, Path(folder), proxy, webgl) as address,
    ):
        yield address
