"""A proxy that refuses everything and keeps what it was asked for: nothing reaches the network."""

from __future__ import annotations

from contextlib import contextmanager
from socketserver import StreamRequestHandler, ThreadingTCPServer
from threading import Thread
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator


class Server(ThreadingTCPServer):
    daemon_threads = True

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Refusal)
        self.asked: list[str] = []


class Refusal(StreamRequestHandler):
    server: Server

    def handle(self) -> None:
        if line := self.rfile.readline().decode(errors="replace").strip():
            self.server.asked.append(line)
            self.wfile.write(b"HTTP/1.1 502 Bad Gateway\r\nContent-Length: 0\r\n\r\n")


@contextmanager
def refusing_proxy() -> Iterator[tuple[int, list[str]]]:
    """Run the proxy; yield its port and the first lines of the requests, which it refuses."""
    with Server() as server:
        thread = Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
        thread.start()
        try:
            yield server.server_address[1], server.asked
        finally:
            server.shutdown()
            thread.join()
