"""Names that every reader accepts: ASCII letters, digits and underscores."""

from __future__ import annotations

import re
import unicodedata
from typing import TYPE_CHECKING
from unicodedata import combining

if TYPE_CHECKING:
    from collections.abc import Iterable

# Of the bytes that NetCDF allows (256), enough for the number of a name that occurs twice.
_LONGEST_NAME = 240


def legal_name(name: str, taken: Iterable[str]) -> str:
    """Return a name that every reader accepts: ASCII letters, digits and underscores.

    Letters lose their accents; characters of other scripts become their code points, so that
    different names stay different for a reader too.

    Parameters
    ----------
    name : str
    taken : iterable of str
        Names that it must not equal.
    """
    plain = unicodedata.normalize("NFKD", name)
    parts = (each if each.isascii() else f"u{ord(each):x}" for each in plain if not combining(each))
    legal = re.sub("[^A-Za-z0-9_]", "_", "".join(parts))
    legal = legal if legal[:1].isalpha() else f"b_{legal}"
    stem, turn = legal[:_LONGEST_NAME], 1
    legal = stem
    while legal in taken:
        turn += 1
        legal = f"{stem}_{turn}"
    return legal
