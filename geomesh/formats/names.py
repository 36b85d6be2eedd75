"""Names of columns: those that every reader accepts, and those that a user chooses."""

from __future__ import annotations

import re
import unicodedata
from typing import TYPE_CHECKING
from unicodedata import combining

from geomesh.errors import OutputError

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from geomesh.parameters import LayerName

# Of the bytes that NetCDF allows (256), enough for the number of a name that occurs twice.
_LONGEST_NAME = 240

# A message lists so many columns: a raster may have hundreds of bands.
_MOST_LISTED = 60


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


def choose_columns(
    names: Iterable[str], chosen: Sequence[str], layer: LayerName
) -> tuple[str, ...]:
    """Return the chosen columns of a layer, each once.

    Raises
    ------
    OutputError
        If there is no such column. The message lists those that there are.
    """
    known = list(names)
    for name in chosen:
        if name not in known:
            rest = len(known) - _MOST_LISTED
            more = f", and {rest} more" if rest > 0 else ""
            raise OutputError(
                f"the {layer} have no column {name!r}: choose `columns` from "
                f"{', '.join(known[:_MOST_LISTED])}{more}"
            )
    return tuple(dict.fromkeys(chosen))
