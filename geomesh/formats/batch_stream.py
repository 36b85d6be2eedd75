"""BatchStream: the batches of a layer on the way into a file, with progress."""

from __future__ import annotations

from concurrent.futures import CancelledError
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator
    from queue import SimpleQueue

    from geomesh.formats.arrow import Layer

BATCH_ROWS = 65_536


class BatchStream:
    """Yields the batches of a layer and counts rows; another thread can stop it.

    If a C library reads from a generator, it replaces an exception in the generator by an
    error of its own, which has only the text at best. `failure` keeps the original exception.

    Parameters
    ----------
    events : SimpleQueue
        Gets an entry after each batch.
    """

    def __init__(self, events: SimpleQueue[None]) -> None:
        self.rows = 0
        self._events = events
        self.failure: BaseException | None = None
        self._stopped = False

    def stop(self) -> None:
        """Raise an error instead of the next batch."""
        self._stopped = True

    def advance(self, rows: int) -> None:
        """Count rows that a format has written itself; raise CancelledError after `stop`."""
        if self._stopped:
            raise CancelledError
        self.rows += rows
        self._events.put(None)

    def batches(self, layer: Layer, geometry: str, *, bbox: str | None = None) -> Iterator[Any]:
        """Yield the record batches of a layer, each made when it is needed."""
        try:
            for start in range(0, len(layer), BATCH_ROWS):
                if self._stopped:
                    raise CancelledError
                batch = layer.batch(slice(start, start + BATCH_ROWS), geometry, bbox=bbox)
                self.rows += batch.num_rows
                yield batch
                self._events.put(None)
        except GeneratorExit:
            raise
        except BaseException as error:
            self.failure = error
            raise
