"""Rows on their way from a layer into a file, and how far they are."""

from __future__ import annotations

from concurrent.futures import CancelledError
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator
    from queue import SimpleQueue

    from geomesh.formats.arrow import Layer

BATCH_ROWS = 65_536


class BatchStream:
    """Hands out the batches of a layer, keeps count, and can be stopped from another thread.

    An exception in a generator that a C library draws from comes out as that
    library's own error, with a text at best; `failure` keeps the original.

    Parameters
    ----------
    news : SimpleQueue
        Gets an entry after each batch.
    """

    def __init__(self, news: SimpleQueue[None]) -> None:
        self.rows = 0
        self._news = news
        self.failure: BaseException | None = None
        self._stopped = False

    def stop(self) -> None:
        """Let the next batch be an error."""
        self._stopped = True

    def batches(self, layer: Layer, geometry: str, *, bbox: str | None = None) -> Iterator[Any]:
        """Yield the record batches of a layer, made one at a time."""
        try:
            for start in range(0, len(layer), BATCH_ROWS):
                if self._stopped:
                    raise CancelledError
                batch = layer.batch(slice(start, start + BATCH_ROWS), geometry, bbox=bbox)
                self.rows += batch.num_rows
                yield batch
                self._news.put(None)
        except GeneratorExit:
            raise
        except BaseException as error:
            self.failure = error
            raise
