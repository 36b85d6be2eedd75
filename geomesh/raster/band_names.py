"""Name the bands of a source: one column name for each, made from what the source says.

Names are computed for all bands of a source at once. So the name of a band does not depend on
which bands are chosen, nor on their order.
"""

from __future__ import annotations

import unicodedata
from collections import Counter, defaultdict
from dataclasses import dataclass
from typing import TYPE_CHECKING

from geomesh.parameters import STATISTICS

if TYPE_CHECKING:
    from collections.abc import Container, Sequence

LONGEST_NAME = 40

# Names of the other columns of a mesh, and of columns that file formats add.
RESERVED = frozenset(
    (
        *("id", "n0", "n1", "n2", "area", "ab", "bc", "ca", "ki", "min_angle", "shape"),
        *("count", "color", "ki_min", "ki_mean", "max_angle", "edge_ratio", "aspect_ratio"),
        *("radius_ratio", "condition", "scaled_jacobian", "equiangle_skew"),
        *("relative_size_squared", "map_ki", "map_ki_min", "map_ki_mean"),
        *("kind", "col", "row", "scale", "response", "octave", "angle"),
        *("left", "right", "length", "constrained"),
        *("fid", "ogc_fid", "geom", "geometry", "bbox"),
    )
)


@dataclass(frozen=True)
class BandText:
    """What a source says about a band.

    Parameters
    ----------
    texts : tuple of str
        Texts to name the band after, the best one first.
    details : tuple of str
        What tells the band from others with the same texts, such as its time and its level.
    """

    texts: tuple[str, ...] = ()
    details: tuple[str, ...] = ()


def name_bands(bands: Sequence[BandText]) -> tuple[str, ...]:
    """Return a column name for each band of a source, or b1, b2, ... if it says nothing.

    A name has lower-case letters of any script, digits and underscores, starts with a letter
    and has at most 40 characters. No two names are equal, even if case is ignored. A name is
    not that of another column, and not that of a statistic of another band. Bands that would
    have the same name get their number at its end.

    Parameters
    ----------
    bands : sequence of BandText
        All bands of the source, in order.
    """
    plain = [_valid(text, number) for number, text in enumerate(_join_details(bands), start=1)]
    count = Counter(map(_key, plain))
    taken = set(count)
    names = []
    for number, name in enumerate(plain, start=1):
        if count[_key(name)] > 1 or _statistic_of(name) in count:
            name = _numbered(name, number, taken)  # noqa: PLW2901
            taken.add(_key(name))
        names.append(name)
    return tuple(names)


def _join_details(bands: Sequence[BandText]) -> list[str]:
    """Return the name of each band, with those of its details that differ in its group.

    A group has the same texts. All its bands are named after the first text that leaves room
    for the details.
    """
    groups = defaultdict(list)
    for position, band in enumerate(bands):
        groups[band.texts].append(position)
    names = [""] * len(bands)
    for texts, members in groups.items():
        details = [bands[position].details for position in members]
        ends = [to_name(" ".join(each)) for each in _differing(details)]
        room = LONGEST_NAME - max(len(end) + bool(end) for end in ends)
        stems = [_started(name) for name in map(to_name, texts) if name]
        fitting = (name for name in stems if len(name) <= room)
        stem = next(fitting, shorten(min(stems, key=len, default=""), max(room, 1)))
        for position, end in zip(members, ends, strict=True):
            names[position] = "_".join(filter(None, (stem, end)))
    return names


def _differing(details: Sequence[tuple[str, ...]]) -> list[list[str]]:
    """Return, for each band of a group, the details that are not the same in all of them."""
    if len({len(each) for each in details}) > 1:
        return [list(each) for each in details]
    differs = [len(set(column)) > 1 for column in zip(*details, strict=True)]
    return [[text for text, kept in zip(each, differs, strict=True) if kept] for each in details]


def to_name(text: str) -> str:
    """Return a text in lower case, with an underscore for each run of other characters.

    Letters, digits and marks of any script are kept.
    """
    lower = unicodedata.normalize("NFKC", unicodedata.normalize("NFKC", text).lower())
    kept = [_kept(letter) for letter in lower]
    words = "".join(kept).split("_")
    # A mark changes the letter before it. Without one it would stand alone.
    return "_".join(filter(None, (_without_marks(word) for word in words)))


def _kept(letter: str) -> str:
    if unicodedata.category(letter) == "Cf" or "\ufe00" <= letter <= "\ufe0f":
        return ""  # invisible: it joins letters or chooses their variant
    return letter if f"b{letter}".isidentifier() else "_"


def _without_marks(word: str) -> str:
    while word and unicodedata.category(word[0]).startswith("M"):
        word = word[1:]
    return word


def shorten(name: str, longest: int) -> str:
    """Return a name of at most `longest` characters, cut between two words if that keeps most."""
    if len(name) <= longest:
        return name
    cut = name[:longest].rstrip("_")
    words = name[: longest + 1].rpartition("_")[0].rstrip("_")
    return words if 2 * len(words) > longest else cut


def _started(name: str) -> str:
    """Return a name that starts with a letter."""
    return name if name.isidentifier() else f"b_{name}"


def _valid(name: str, number: int) -> str:
    name = shorten(_started(name) if name else f"b{number}", LONGEST_NAME)
    return name if name not in RESERVED else f"b_{name}"


def _key(name: str) -> str:
    return unicodedata.normalize("NFKC", name.casefold())


def _statistic_of(name: str) -> str | None:
    """Return the key of the band that has this name as one of its statistics, or None."""
    stem, _, statistic = _key(name).rpartition("_")
    return stem if statistic in STATISTICS else None


def _numbered(name: str, number: int, taken: Container[str]) -> str:
    """Return the name with the number of the band at its end, as often as it takes."""
    end = f"_{number}"
    while True:
        numbered = shorten(name, LONGEST_NAME - len(end)) + end
        key = _key(numbered)
        if key not in taken and not any(f"{key}_{each}" in taken for each in STATISTICS):
            return numbered
        end += f"_{number}"
