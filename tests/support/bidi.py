"""WebDriver BiDi: commands to a browser, and the events that it reports, over one web socket."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from websockets.sync.client import connect

if TYPE_CHECKING:
    from collections.abc import Iterator

    from websockets.sync.client import ClientConnection

TIMEOUT = 120.0
Report = Callable[[str, dict[str, Any]], None]


class BiDiError(AssertionError):
    """The browser refused a command, or a script in the page failed."""


class Connection:
    """A socket to a browser. Events go to `report` while an answer is waited for, in order."""

    def __init__(self, socket: ClientConnection, report: Report) -> None:
        self._socket = socket
        self._report = report
        self._sent = 0

    def send(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Return the result of a command."""
        self._sent += 1
        number = self._sent
        self._socket.send(json.dumps({"id": number, "method": method, "params": parameters}))
        end = time.monotonic() + TIMEOUT
        while True:
            try:
                message = json.loads(self._socket.recv(max(end - time.monotonic(), 0)))
            except TimeoutError:
                raise BiDiError(f"{method}: no answer in {TIMEOUT:.0f} seconds") from None
            if message["type"] == "event":
                self._report(message["method"], message["params"])
            elif message.get("id") == number:
                break
        if message["type"] == "error":
            raise BiDiError(f"{method}: {message['error']}: {message['message']}")
        result: dict[str, Any] = message["result"]
        return result


@contextmanager
def connected(address: str, report: Report) -> Iterator[Connection]:
    # The answer to a screenshot is large, and a proxy of the environment is not for this.
    with connect(address, max_size=None, max_queue=None, proxy=None) as socket:
        yield Connection(socket, report)
