"""HTML and SVG elements as text: all that is not an element is escaped."""

from __future__ import annotations

import re
from html import escape
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterable

# Attributes of an element; None: left out.
Attributes = dict[str, "str | float | None"]

# Elements without content.
_EMPTY = ("br", "hr", "img", "meta", "link")
# Elements of SVG that are closed at once.
_SHAPES = ("circle", "line", "path", "rect")

# Characters that no HTML document can contain: controls, halves of pairs, and those that are
# none, the last two of each plane.
_REFUSED = re.compile(
    "[\x00-\x08\x0b\x0e-\x1f\x7f-\x9f\ud800-\udfff\ufdd0-\ufdef"
    + "".join(f"{chr((plane << 16) + 0xFFFE)}{chr((plane << 16) + 0xFFFF)}" for plane in range(17))
    + "]"
)


class Markup(str):
    """Text that is HTML already."""

    __slots__ = ()


def text(value: str) -> Markup:
    """Return a text as HTML. Characters that HTML cannot contain are replaced."""
    return Markup(escape(_REFUSED.sub("\ufffd", value.replace("\x0c", " ").replace("\r", " "))))


def join(parts: Iterable[str]) -> Markup:
    """Return parts one after the other. Those that are not Markup are escaped."""
    return Markup("".join(part if isinstance(part, Markup) else text(part) for part in parts))


def el(name: str, /, *content: str, **attributes: str | float | None) -> Markup:
    """Return an element.

    Parameters
    ----------
    name : str
    *content : str
        Text, which is escaped, or Markup.
    **attributes
        `class_` is the class; an underline in a name stands for a dash. None: left out.
    """
    written = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{text(str(value))}"'
        for key, value in attributes.items()
        if value is not None
    )
    if name in _EMPTY:
        return Markup(f"<{name}{written}>")
    if name in _SHAPES and not content:
        return Markup(f"<{name}{written}/>")
    return Markup(f"<{name}{written}>{join(content)}</{name}>")
