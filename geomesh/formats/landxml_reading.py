"""Reading LandXML files of geomesh again: to count their faces, and for their document."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any
from xml.parsers import expat

import numpy as np

from geomesh.formats.batch_stream import BATCH_ROWS

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

_CHUNK = 1 << 18


class _Numbers:
    """Reads the numbers of all points and faces, some thousands of elements at a time."""

    def __init__(self) -> None:
        self.counts = {"P": 0, "F": 0}
        self._kind = ""
        self._pending = 0
        self._texts: list[str] = []

    def start(self, element: str, _: Any) -> None:
        """Count an element that begins."""
        if element not in self.counts:
            return
        if element != self._kind or self._pending == BATCH_ROWS:
            self.check()
            self._kind = element
        self.counts[element] += 1
        self._pending += 1

    def text(self, data: str) -> None:
        """Keep the text of points and faces."""
        if self._kind:
            self._texts.append(data)

    def check(self) -> None:
        """Raise ValueError if an element has not three numbers, or a face has no such point."""
        values = np.array("".join(self._texts).split(), np.float64)
        if len(values) != 3 * self._pending:
            raise ValueError(f"<{self._kind}> needs three numbers")
        if self._kind == "F" and not 1 <= values.min() <= values.max() <= self.counts["P"]:
            raise ValueError("a face has a point that does not exist")
        self._texts.clear()
        self._pending = 0


def count_rows(path: Path, layer: str) -> int:  # noqa: ARG001
    """Return the number of faces; raise OSError if the file is damaged."""
    numbers = _Numbers()
    parser = expat.ParserCreate()
    parser.buffer_text = True
    parser.StartElementHandler = numbers.start
    parser.CharacterDataHandler = numbers.text
    try:
        with path.open("rb") as source:
            while chunk := source.read(_CHUNK):
                parser.Parse(chunk)
            parser.Parse(b"", True)
        numbers.check()
    except (expat.ExpatError, ValueError) as error:
        raise OSError(f"the LandXML file is damaged: {error}") from error
    return numbers.counts["F"]


def read_document(path: Path) -> str:
    """Return the metadata document; raise KeyError if there is none."""
    from geomesh.formats.document import KEY

    found = _properties(path)
    for label, value in found:
        if label == KEY:
            return value
    raise KeyError(KEY)


def _properties(path: Path) -> Iterable[tuple[str, str]]:
    """Yield the properties of a file, as far as it is needed: the document comes early."""
    ready: list[tuple[str, str]] = []

    def start(element: str, attributes: dict[str, str]) -> None:
        if element == "Property":
            ready.append((attributes.get("label", ""), attributes.get("value", "")))

    parser = expat.ParserCreate()
    parser.StartElementHandler = start
    try:
        with path.open("rb") as source:
            while chunk := source.read(_CHUNK):
                parser.Parse(chunk)
                yield from ready
                ready.clear()
    except expat.ExpatError as error:
        raise OSError(f"the LandXML file is damaged: {error}") from error
