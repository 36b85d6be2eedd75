"""The real browsers of the tests: they see what a page does, stay offline, and leave nothing."""

from __future__ import annotations

import http.server
import os
import re
import subprocess
import sys
import tempfile
import threading
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from support import browser_process
from support.bidi import BiDiError
from support.browser import open_browser

if TYPE_CHECKING:
    from collections.abc import Iterator

    from support.browser import Browser

pytestmark = pytest.mark.slow

PAGE = """<!doctype html><meta charset="utf-8"><title>A page</title>
<style>html, body { margin: 0; height: 100% } canvas { position: fixed; left: 20px; top: 10px }
</style>
<body style="background: #204060; touch-action: none"><canvas width="100" height="50"></canvas>
<script>
const seen = [];
for (const kind of ["pointermove", "pointerdown", "pointerup", "wheel", "keydown", "keyup"])
  addEventListener(kind, (event) => {
    const { clientX: x, clientY: y, deltaY, pointerType, key } = event;
    seen.push([kind, ...(key ? [key] : kind === "wheel" ? [x, y, deltaY] : [pointerType, x, y])]);
  });
const gl = document.querySelector("canvas").getContext("webgl2");
if (gl) { gl.clearColor(1, 0, 0.2, 1); gl.clear(gl.COLOR_BUFFER_BIT); }
</script>"""


@pytest.fixture
def page(tmp_path: Path, browser: Browser) -> Browser:
    (tmp_path / "page.html").write_text(PAGE)
    browser.open(tmp_path / "page.html")
    return browser


def processes(mark: str) -> list[str]:
    """Return the running programs whose command line or environment has a word."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            line = (
                process.joinpath("cmdline").read_bytes() + process.joinpath("environ").read_bytes()
            )
        except OSError:
            continue  # it has ended, or is not ours
        if mark.encode() in line:
            found.append(line.decode(errors="replace"))
    return found


def test_values_come_back(page: Browser) -> None:
    assert page.evaluate("document.title") == "A page"
    assert page.evaluate("Promise.resolve({ a: [1, 2.5, '北京'], b: null })") == {
        "a": [1, 2.5, "北京"],
        "b": None,
    }
    assert page.evaluate("new Float64Array([0.1, 3])") == [0.1, 3]
    assert page.evaluate("undefined") is None
    with pytest.raises(BiDiError, match="nowhere is not defined"):
        page.evaluate("nowhere.x")
    with pytest.raises(BiDiError, match=r"not within 0.2 seconds: document.title === 'Other'"):
        page.wait_for("document.title === 'Other'", seconds=0.2)
    page.evaluate("void setTimeout(() => { document.title = 'Other' }, 50)")
    page.wait_for("document.title === 'Other'")


@pytest.mark.parametrize("ratio", [1, 2])
def test_screenshots_have_the_colours_of_the_page_in_device_pixels(
    page: Browser, ratio: int
) -> None:
    page.resize(300, 200, ratio)
    assert page.evaluate("[innerWidth, innerHeight, devicePixelRatio]") == [300, 200, ratio]
    picture = page.screenshot()
    expected = np.full((200 * ratio, 300 * ratio, 3), (0x20, 0x40, 0x60), np.uint8)
    expected[10 * ratio : 60 * ratio, 20 * ratio : 120 * ratio] = (255, 0, 51)
    np.testing.assert_array_equal(picture, expected)
    assert page.evaluate("gl.getParameter(gl.VERSION)").startswith("WebGL 2.0")


@pytest.mark.parametrize("ratio", [1, 2])
def test_a_page_sees_mouse_wheel_keys_and_fingers(page: Browser, ratio: int) -> None:
    page.resize(300, 200, ratio)

    def done(kind: str) -> list:
        found = [event[1:] for event in page.evaluate("seen") if event[0] == kind]
        page.evaluate("seen.length = 0")
        return found

    page.move(70, 30)
    assert done("pointermove") == [["mouse", 70, 30]]
    page.click(71, 31)
    assert done("pointerup") == [["mouse", 71, 31]]
    page.drag((10, 20), (90, 60))
    moves = done("pointermove")
    assert len(moves) > 4
    assert moves[-1] == ["mouse", 90, 60]
    page.wheel(50, 60, -120)
    assert done("wheel") == [[50, 60, -120]]
    page.key("ArrowLeft")
    page.type("a+")
    assert done("keydown") == [["ArrowLeft"], ["a"], ["+"]]
    page.pinch(150, 100, 40, 200)
    assert sorted(done("pointerup")) == [["touch", 50, 100], ["touch", 250, 100]]


def test_errors_messages_and_what_the_policy_forbids_are_seen(
    browser: Browser, tmp_path: Path
) -> None:
    (tmp_path / "bad.html").write_text(
        """<!doctype html><meta charset="utf-8"><meta http-equiv="Content-Security-Policy"
        content="default-src 'none'; script-src 'unsafe-inline'"><script>
        console.log("a message");
        console.error("a complaint");
        setTimeout(() => { throw Error("thrown") }, 0);
        Promise.reject(Error("rejected"));
        new Image().src = "http://map.example/forbidden.png";
        </script>"""
    )
    browser.open(tmp_path / "bad.html")
    assert set(browser.console) == {("info", "a message"), ("error", "a complaint")}
    for text in ("a complaint", "thrown", "rejected", "img-src forbids http://map.example"):
        assert [error for error in browser.errors if text in error], text
    assert browser.outside == []
    browser.new_page(300, 200)
    assert browser.errors == browser.console == browser.requests == []


def test_requests_to_the_network_are_refused_and_kept(page: Browser) -> None:
    assert page.outside == []
    loaded = """new Promise((done) => Object.assign(new Image(),
        { onload: () => done(true), onerror: () => done(false), src: ADDRESS }))"""
    assert page.evaluate(loaded.replace("ADDRESS", '"http://map.example/a.png"')) is False
    # Firefox asks for https instead, so the proxy does not see which file is meant.
    (line,) = page.outside
    assert re.match("(GET http://|CONNECT )map.example[:/]", line)
    assert re.search("https?://map.example/a.png", " ".join(page.requests))


@pytest.fixture
def server(tmp_path: Path) -> Iterator[str]:
    class Quiet(http.server.SimpleHTTPRequestHandler):
        def log_message(self, *args: object) -> None:
            pass

    def handle(*arguments: object) -> Quiet:
        return Quiet(*arguments, directory=tmp_path)  # type: ignore[arg-type]

    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), handle) as server:
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        yield f"http://127.0.0.1:{server.server_address[1]}"
        server.shutdown()
        thread.join()


def test_a_page_of_a_server_of_this_computer(browser: Browser, server: str, tmp_path: Path) -> None:
    (tmp_path / "page.html").write_text(PAGE)
    browser.open(f"{server}/page.html")
    assert browser.evaluate("document.title") == "A page"
    assert f"{server}/page.html" in browser.requests
    assert browser.outside == []


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=pytest.mark.xdist_group(name)) for name in browser_process.NAMES],
)
def test_nothing_of_a_browser_stays_after_a_failure(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Without WebGL, because its page must be shown too."""
    (tmp_path / "page.html").write_text(PAGE)

    def fail(folder: str) -> None:
        monkeypatch.setattr(tempfile, "tempdir", folder)
        with open_browser(name, width=300, height=200, webgl=False) as browser:
            browser.open(tmp_path / "page.html")
            assert browser.evaluate("gl") is None
            assert browser.screenshot()[5, 5].tolist() == [0x20, 0x40, 0x60]
            assert processes(folder)
            raise RuntimeError("the test failed")

    # Not in `tmp_path`, whose name is too long for the sockets of Chromium.
    with tempfile.TemporaryDirectory() as folder:
        with pytest.raises(RuntimeError, match="the test failed"):
            fail(folder)
        assert processes(folder) == []
        assert list(Path(folder).iterdir()) == []


@pytest.mark.parametrize("name", browser_process.NAMES)
def test_without_a_browser_a_test_is_skipped_but_fails_in_ci(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", "")
    for ci, system, outcome in (
        ("", "linux", pytest.skip.Exception),
        ("true", "linux", pytest.fail.Exception),
        ("true", "win32", pytest.skip.Exception),
    ):
        monkeypatch.setenv("CI", ci)
        monkeypatch.setattr(sys, "platform", system)
        with pytest.raises(outcome, match=r"apt-get install (chromium chr|firefox-esr xvfb)"):
            browser_process.need(name)


def test_a_program_that_does_not_start_says_why() -> None:
    complaint = [sys.executable, "-c", "print('no screen today')"]
    with (
        browser_process.process(complaint, dict(os.environ)) as started,
        pytest.raises(AssertionError, match="no screen today"),
    ):
        started.printed("listening on (.*)")
    assert subprocess.run(["ps", "-p", str(started.number)], check=False).returncode == 1
