"""Real browsers for tests: open a page, look at it, and use it as a hand would.

    with open_browser("firefox", width=800, height=600) as browser:
        browser.open(path)
        browser.click(400, 300)
        assert browser.evaluate("document.title") == "A map"
        assert not browser.errors

Both browsers are driven by WebDriver BiDi. They reach no network: a proxy of the tests refuses
all addresses but those of this computer, and keeps them in `outside`.
"""

from __future__ import annotations

import base64
import json
from contextlib import contextmanager, suppress
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image
from websockets.exceptions import WebSocketException

from support.bidi import BiDiError, Connection, connected
from support.browser_process import running
from support.refusing_proxy import refusing_proxy

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from numpy.typing import NDArray

# Keys by their names in the DOM, as WebDriver writes them.
KEYS = {
    "Backspace": "\ue003",
    "Tab": "\ue004",
    "Enter": "\ue007",
    "Shift": "\ue008",
    "Control": "\ue009",
    "Escape": "\ue00c",
    "PageUp": "\ue00e",
    "PageDown": "\ue00f",
    "End": "\ue010",
    "Home": "\ue011",
    "ArrowLeft": "\ue012",
    "ArrowUp": "\ue013",
    "ArrowRight": "\ue014",
    "ArrowDown": "\ue015",
}
MOVES = 8
TURNED = "wheelSeenByTest"
LISTEN = 'addEventListener("wheel", () => done(), { capture: true, once: true })'

# What a page may not do is reported by an event, not in the console of BiDi.
WATCH = """(report) => addEventListener("securitypolicyviolation", (event) =>
    report(`${event.effectiveDirective} forbids ${event.blockedURI} ${event.sample}`))"""

# Typed arrays become lists. JSON has no NaN: it becomes None.
EVALUATE = """async (expression) => {
    const plain = (key, value) => ArrayBuffer.isView(value) ? Array.from(value) : value;
    try { return JSON.stringify({ value: await expression() }, plain) }
    catch (error) { return JSON.stringify({ error: String(error) }) }
}"""


class Browser:
    """A browser with one page.

    Attributes
    ----------
    requests
        Every address that the page asked for. Firefox leaves out files.
    outside
        First lines of requests that went to the network, of the page or the browser itself.
    console
        Messages of the page: (level, text).
    errors
        Uncaught errors of the page, errors in its console, and what its security policy forbade.
    """

    def __init__(self, name: str, outside: list[str]) -> None:
        self.name = name
        self.outside = outside
        self.requests: list[str] = []
        self._console: list[tuple[str, str]] = []
        self._errors: list[str] = []
        self._page = ""

    def start(self, connection: Connection) -> None:
        self._bidi = connection
        if self.name == "firefox":
            self._bidi.send("session.new", capabilities={})
        events = ["log.entryAdded", "network.beforeRequestSent", "script.message"]
        self._bidi.send("session.subscribe", events=events)
        report = {"type": "channel", "value": {"channel": "forbidden"}}
        self._bidi.send("script.addPreloadScript", functionDeclaration=WATCH, arguments=[report])

    def happened(self, event: str, about: dict[str, Any]) -> None:
        if event == "network.beforeRequestSent":
            self.requests.append(about["request"]["url"])
        elif event == "script.message":
            self._errors.append(about["data"]["value"])
        elif event == "log.entryAdded":
            text = about["text"] or ""
            if about["type"] == "console":
                self._console.append((about["level"], text))
            if about["level"] == "error":
                self._errors.append(text)

    @property
    def console(self) -> list[tuple[str, str]]:
        self.evaluate("0")  # what was reported before comes before the answer
        return self._console

    @property
    def errors(self) -> list[str]:
        self.evaluate("0")
        return self._errors

    def new_page(self, width: int, height: int, device_pixel_ratio: float = 1) -> None:
        """Replace the page by an empty one of a size in CSS pixels, and forget what happened."""
        old = self._page
        self._page = self._bidi.send("browsingContext.create", type="tab")["context"]
        pages = self._bidi.send("browsingContext.getTree")["contexts"]
        for page in [page["context"] for page in pages if page["context"] != self._page]:
            if page == old or not old:
                self._bidi.send("browsingContext.close", context=page)
        self.resize(width, height, device_pixel_ratio)
        for list_ in (self.requests, self.outside, self._console, self._errors):
            list_.clear()

    def open(self, page: Path | str) -> None:
        """Open a file or an address, and wait until it is loaded with all that it names."""
        url = page.resolve().as_uri() if isinstance(page, Path) else page
        self._bidi.send("browsingContext.navigate", context=self._page, url=url, wait="complete")

    def resize(self, width: int, height: int, device_pixel_ratio: float = 1) -> None:
        self._bidi.send(
            "browsingContext.setViewport",
            context=self._page,
            viewport={"width": width, "height": height},
            devicePixelRatio=device_pixel_ratio,
        )

    def darken(self) -> None:
        """Make the page dark, as if the user preferred that; only in Chromium."""
        features = {"prefers-color-scheme": "dark"}
        self._bidi.send(
            "emulation.setMediaFeaturesOverride", contexts=[self._page], features=features
        )

    def evaluate(self, expression: str) -> Any:
        """Return the value of a JavaScript expression, awaited if it is a promise."""
        done = self._bidi.send(
            "script.evaluate",
            expression=f"({EVALUATE})(async () => ({expression}))",
            target={"context": self._page},
            awaitPromise=True,
        )
        if done["type"] == "exception":
            raise BiDiError(f"{expression}: {done['exceptionDetails']['text']}")
        found = json.loads(done["result"]["value"])
        if "error" in found:
            raise BiDiError(f"{expression}: {found['error']}")
        return found.get("value")

    def wait_for(self, condition: str, seconds: float = 30) -> None:
        """Wait until a JavaScript expression is true."""
        late = json.dumps(f"not within {seconds} seconds: {condition}")
        self.evaluate(f"""new Promise((done, fail) => {{
            const end = performance.now() + {seconds * 1000};
            const look = () => ({condition}) ? done()
                : performance.now() > end ? fail(Error({late})) : setTimeout(look, 10);
            look();
        }})""")

    def screenshot(self) -> NDArray[np.uint8]:
        """Return what the page shows, (H, W, 3) in device pixels."""
        taken = self._bidi.send("browsingContext.captureScreenshot", context=self._page)
        picture = Image.open(BytesIO(base64.b64decode(taken["data"])))
        return np.asarray(picture.convert("RGB"))

    def _perform(self, *sources: dict[str, Any]) -> None:
        named = [
            source | {"id": f"{source['type']}{k}{source.get('parameters')}"}
            for k, source in enumerate(sources)
        ]
        self._bidi.send("input.performActions", context=self._page, actions=named)

    def _mouse(self, *actions: dict[str, Any]) -> None:
        self._perform(
            {"type": "pointer", "parameters": {"pointerType": "mouse"}, "actions": actions}
        )

    def move(self, x: float, y: float) -> None:
        """Move the mouse to a place in CSS pixels."""
        self._mouse(_to(x, y))

    def click(self, x: float, y: float) -> None:
        self._mouse(_to(x, y), _down(), _up())

    def drag(self, start: tuple[float, float], end: tuple[float, float]) -> None:
        self._mouse(_to(*start), _down(), *_path(start, end), _up())

    def wheel(self, x: float, y: float, dy: float) -> None:
        """Turn the wheel at a place; a positive `dy` scrolls down."""
        # Chromium takes device pixels, and its answer does not wait for the page.
        scale = self.evaluate("devicePixelRatio") if self.name == "chromium" else 1
        turn = {"type": "scroll", "deltaX": 0, "deltaY": round(dy * scale)}
        self.evaluate(f"void (window.{TURNED} = new Promise((done) => {LISTEN}))")
        self._perform({"type": "wheel", "actions": [_to(x, y) | turn]})
        self.evaluate(f"window.{TURNED}")

    def key(self, *names: str) -> None:
        """Press keys together, and release them: names of the DOM, or characters."""
        values = [KEYS.get(name, name) for name in names]
        actions = [{"type": "keyDown", "value": value} for value in values]
        actions += [{"type": "keyUp", "value": value} for value in reversed(values)]
        self._perform({"type": "key", "actions": actions})

    def type(self, text: str) -> None:
        for character in text:
            self.key(character)

    def touch(self, *paths: Sequence[tuple[float, float]]) -> None:
        """Put a finger on the start of each path, move all to the ends together, lift them."""
        self._perform(
            *(
                {
                    "type": "pointer",
                    "parameters": {"pointerType": "touch"},
                    "actions": [_to(*path[0]), _down(), *_path(path[0], path[-1]), _up()],
                }
                for path in paths
            )
        )

    def pinch(self, x: float, y: float, start: float, end: float) -> None:
        """Move two fingers, at first `start` pixels apart, until they are `end` pixels apart."""
        self.touch(
            [(x - start / 2, y), (x - end / 2, y)],
            [(x + start / 2, y), (x + end / 2, y)],
        )

    def close(self) -> None:
        """Ask the browser to end."""
        with suppress(BiDiError, WebSocketException):
            self._bidi.send("browser.close")


def _to(x: float, y: float) -> dict[str, Any]:
    return {"type": "pointerMove", "x": round(x), "y": round(y)}


def _down() -> dict[str, Any]:
    return {"type": "pointerDown", "button": 0}


def _up() -> dict[str, Any]:
    return {"type": "pointerUp", "button": 0}


def _path(start: tuple[float, float], end: tuple[float, float]) -> list[dict[str, Any]]:
    return [_to(*place) for place in np.linspace(start, end, MOVES + 1)[1:].tolist()]


@contextmanager
def open_browser(
    name: str,
    *,
    width: int = 800,
    height: int = 600,
    device_pixel_ratio: float = 1,
    webgl: bool = True,
) -> Iterator[Browser]:
    """Start a browser, "chromium" or "firefox", with an empty page; end it on leaving."""
    with refusing_proxy() as (port, outside), running(name, proxy=port, webgl=webgl) as address:
        browser = Browser(name, outside)
        with connected(address, browser.happened) as connection:
            try:
                browser.start(connection)
                browser.new_page(width, height, device_pixel_ratio)
                yield browser
            finally:
                browser.close()
