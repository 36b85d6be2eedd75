"""Change the directories of a TIFF, or values of its pixels."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from support.fuzz.numbers import NUMBERS, REAL, WHOLE, Random, pick
from support.fuzz.tiff import ASCII, CODES, Entry, Tiff

if TYPE_CHECKING:
    from collections.abc import Callable

CRS_CODES = [0, 1, 1024, 2000, 2180, 3031, 3857, 4035, 4258, 4269, 4326, 4978, 4979, 5041, 5498]
CRS_CODES += [5773, 7405, 9001, 9102, 9518, 10726, 20000, 26986, 32601, 32661, 32725, 32767, 65535]

_CRS_KEYS = [2048, 2050, 2051, 2052, 2054, 2056, 3072, 3074, 3075, 3076, 4096, 4098, 4099]

# Where a changed entry matters, and the type of a new one.
TAGS = {
    254: 4, 256: 4, 257: 4, 258: 3, 259: 3, 262: 3, 266: 3, 270: 2, 273: 4, 274: 3, 277: 3, 278: 4,
    279: 4, 280: 3, 281: 3, 284: 3, 292: 4, 305: 2, 306: 2, 317: 3, 320: 3, 322: 4, 323: 4, 324: 4,
    325: 4, 330: 4, 338: 3, 339: 3, 340: 12, 341: 12, 347: 7, 529: 5, 530: 3, 531: 3, 532: 5,
    33550: 12, 33922: 12, 34264: 12, 34735: 3, 34736: 12, 34737: 2, 42112: 2, 42113: 2, 50674: 4,
    50844: 12,
}  # fmt: skip
NODATA, METADATA, GEO_KEYS = 42113, 42112, 34735
# A file with other values in these can often still be opened.
MILD = [262, 270, 274, 280, 281, 305, 306, 317, 320, 338, 340, 341, 33550, 33922, 34264, GEO_KEYS]
MILD += [34736, 34737, METADATA, NODATA, METADATA, NODATA, 50844]
# How many values a tag has, if not one.
COUNTS = {
    320: 768,
    33550: 3,
    33922: 6,
    34264: 16,
    GEO_KEYS: 16,
    34736: 3,
    50844: 92,
    530: 2,
    532: 6,
}

TEXTS = [
    b"",
    b"\0",
    b"\xff\xfe\x80",
    "北京".encode(),
    b"a" * 70_000,
    b"a\nb\tc\x1b[31m",
    b"<",
    b"%s%n",
]
_ITEMS = [
    '<Item name="DESCRIPTION" sample="{n}" role="description">{text}</Item>',
    '<Item name="SCALE" sample="{n}" role="scale">{number}</Item>',
    '<Item name="OFFSET" sample="{n}" role="offset">{number}</Item>',
    '<Item name="UNITTYPE" sample="{n}" role="unittype">{text}</Item>',
    '<Item name="COLORINTERP" sample="{n}" role="colorinterp">{color}</Item>',
    '<Item name="NBITS" sample="{n}" domain="IMAGE_STRUCTURE">{number}</Item>',
    '<Item name="SIGNEDBYTE" domain="IMAGE_STRUCTURE">{number}</Item>',
    '<Item name="AREA_OR_POINT">{text}</Item>',
    '<Item name="NODATA_VALUES">{number} {number} {number}</Item>',
    '<Item name="{text}" sample="{n}">{text}</Item>',
    "<Item>",
    '<!DOCTYPE a [<!ENTITY b "c">]>&b;',
]
_COLORS = ["Alpha", "Palette", "Red", "Undefined", "Blue", "YCbCr_Y", "nonsense", "Gray", "Pan"]


def _change_value(tiff: Tiff, random: Random) -> Tiff:
    """Replace one value, or the text, of an entry."""
    number, entries, at = _an_entry(tiff, random)
    entry = entries[at]
    if entry.kind == ASCII:
        return _replace(tiff, number, at, _text_entry(entry.tag, random))
    values = tiff.values(entry)
    if not values:  # its type was changed before
        return tiff
    index = int(random.integers(len(values)))
    values[index] = _other(values[index], entry, random)
    if random.random() < 0.1:
        values = [values[index]] * len(values)
    return _replace(tiff, number, at, replace(entry, value=tiff.pack(entry.kind, values)))


def _other(value: float, entry: Entry, random: Random) -> float:
    if CODES.get(entry.kind) in ("d", "f"):
        near = [value * 1.000001, -value, value * 1e6, value / 1e6, value + 1, value * 1e-12]
        return float(pick(random, REAL + near))
    if entry.tag == GEO_KEYS:
        return float(pick(random, CRS_CODES + WHOLE))
    near = [value + 1, value - 1, value * 2, value // 2, value + 16, int(random.integers(1 << 32))]
    return int(pick(random, WHOLE + near))  # an int: 2**64 - 1 is no float


def _change_kind(tiff: Tiff, random: Random) -> Tiff:
    """Change the type, the count or the tag of an entry, but not its bytes."""
    number, entries, at = _an_entry(tiff, random)
    entry = entries[at]
    most = 2**64 if tiff.is_big else 2**32
    changes = {
        "kind": int(pick(random, [*range(20), 65535])),
        "count": int(pick(random, [*WHOLE, entry.count + 1, max(entry.count - 1, 0)])) % most,
        "tag": int(pick(random, [*TAGS, 65000])),
    }
    name = pick(random, list(changes))
    return _replace(tiff, number, at, replace(entry, **{name: changes[name]}))


def _change_length(tiff: Tiff, random: Random) -> Tiff:
    """Remove values at the end of an entry, or repeat its values."""
    number, entries, at = _an_entry(tiff, random)
    entry = entries[at]
    size = len(entry.value) // max(entry.count, 1)
    count = int(pick(random, [0, 1, 3, entry.count - 1, entry.count + 1, 2 * entry.count, 70_000]))
    value = (entry.value * (count // max(entry.count, 1) + 1))[: count * size]
    return _replace(tiff, number, at, replace(entry, count=max(count, 0), value=value))


def _remove(tiff: Tiff, random: Random) -> Tiff:
    number, entries, at = _an_entry(tiff, random)
    return tiff.with_entries(number, entries[:at] + entries[at + 1 :])


def _add(tiff: Tiff, random: Random) -> Tiff:
    """Add an entry, or replace the one with its tag."""
    number = int(random.integers(len(tiff.directories)))
    tag = int(pick(random, MILD if random.random() < 0.7 else list(TAGS)))
    kind = TAGS[tag]
    if kind == ASCII:
        entry = _text_entry(tag, random)
    else:
        count = COUNTS.get(tag, 1)
        if random.random() < 0.1:
            count = int(pick(random, [0, 1, 2, 3, 4, 12, 16, 768]))
        empty = Entry(tag, kind, count, b"")
        values = [_other(1, empty, random) for _ in range(2 * count if kind in (5, 10) else count)]
        entry = replace(empty, value=tiff.pack(4 if kind in (5, 10) else kind, values))
    others = [other for other in tiff.directories[number] if other.tag != tag]
    return tiff.with_entries(number, tuple(sorted([*others, entry], key=lambda e: e.tag)))


def _resize(tiff: Tiff, random: Random) -> Tiff:
    """Change width, height, or the size of tiles and strips."""
    entries = tiff.directories[0]
    sizes = [i for i, e in enumerate(entries) if e.tag in (256, 257, 278, 322, 323)]
    if not sizes:
        return tiff
    at = pick(random, sizes)
    entry = replace(entries[at], kind=4, count=1)
    value = _other((tiff.values(entries[at]) or [0])[0], entry, random)
    return _replace(tiff, 0, at, replace(entry, value=tiff.pack(4, [value])))


def _change_crs(tiff: Tiff, random: Random) -> Tiff:
    """Replace all keys of the georeference: kinds of CRS, codes and units."""
    keys = {key: int(pick(random, CRS_CODES)) for key in random.choice(_CRS_KEYS, 4).tolist()}
    keys |= {1024: int(pick(random, [1, 1, 2, 2, 3, 32767])), 1025: 1}
    values: list[float] = [1, 1, int(pick(random, [0, 1])), len(keys)]
    for key, code in sorted(keys.items()):
        values += [key, 0, 1, code]
    entry = Entry(GEO_KEYS, 3, len(values), tiff.pack(3, values))
    others = [other for other in tiff.directories[0] if other.tag != GEO_KEYS]
    return tiff.with_entries(0, tuple(sorted([*others, entry], key=lambda e: e.tag)))


def _change_pixels(tiff: Tiff, random: Random) -> Tiff:
    """Put special numbers among the values of an uncompressed image."""
    tags = {entry.tag: tiff.values(entry) for entry in tiff.directories[0]}
    kind = {(32, 3): 11, (64, 3): 12}.get((*tags.get(258, [8])[:1], *tags.get(339, [1])[:1]), 3)
    strips = list(zip(tags.get(273, []), tags.get(279, []), strict=False))
    data = bytearray(tiff.data)
    if tags.get(259) == [1] and strips:
        for _ in range(2 ** int(random.integers(8))):
            start, size = pick(random, strips)
            at = int(start) + 8 * int(random.integers(min(size, len(data)) // 8 + 1))
            value = tiff.pack(kind, [pick(random, REAL if kind > 3 else WHOLE)])
            data[at : at + len(value)] = value
    return replace(tiff, data=bytes(data))


def _text_entry(tag: int, random: Random) -> Entry:
    if tag == NODATA and random.random() < 0.9:
        text = pick(random, NUMBERS).encode()
    elif tag == METADATA and random.random() < 0.9:
        items = "".join(pick(random, _ITEMS) for _ in range(random.integers(1, 5)))
        filled = items.format(
            n=pick(random, [0, 1, 2, 4, 5, -1, 2**31, "x"]),
            number=pick(random, NUMBERS),
            text=pick(
                random,
                ["red", "北京", "", "a" * 3000, "&#1;", "red", "nan", "alpha", "\x00", "H\xf6he"],
            ),
            color=pick(random, _COLORS),
        )
        text = f"<GDALMetadata>{filled}</GDALMetadata>".encode(
            pick(random, ["utf-8"] * 4 + ["latin-1"]), "replace"
        )
    else:
        text = pick(random, TEXTS)
    text += b"\0" * bool(random.random() < 0.9)
    return Entry(tag, ASCII, len(text), text)


def _an_entry(tiff: Tiff, random: Random) -> tuple[int, tuple[Entry, ...], int]:
    """Return the number of a directory, its entries and the index of one that has a value."""
    number = 0 if random.random() < 0.7 else int(random.integers(len(tiff.directories)))
    entries = tiff.directories[number]
    filled = [i for i, e in enumerate(entries) if len(e.value) // max(e.count, 1)]
    mild = [i for i in filled if entries[i].tag in MILD]
    return number, entries, pick(random, mild if mild and random.random() < 0.5 else filled)


def _replace(tiff: Tiff, number: int, at: int, entry: Entry) -> Tiff:
    entries = tiff.directories[number]
    return tiff.with_entries(number, (*entries[:at], entry, *entries[at + 1 :]))


CHANGES: list[Callable[[Tiff, Random], Tiff]] = [_change_value] * 4
CHANGES += [_add] * 4 + [
    _change_crs,
    _change_crs,
    _change_pixels,
    _resize,
    _change_kind,
    _change_length,
    _remove,
]
