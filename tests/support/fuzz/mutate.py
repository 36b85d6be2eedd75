"""Change a file of a raster: its structure, its text, or any bytes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from support.fuzz import structure, texts
from support.fuzz.numbers import Random, pick
from support.fuzz.png import change_png
from support.fuzz.tiff import Tiff

if TYPE_CHECKING:
    from support.fuzz.originals import Original


def mutate(original: Original, random: Random) -> bytes:
    """Return the changed bytes of the file `original.changed`."""
    data = original.changed.read_bytes()
    if original.kind == "text" and random.random() < 0.9:
        for _ in range(random.integers(1, 4)):
            data = pick(random, texts.CHANGES)(data, random)
        return data
    if original.kind == "png" and random.random() < 0.8:
        return change_png(data, random)
    if original.kind == "tiff" and random.random() < 0.85:
        tiff = Tiff.parse(data)
        for _ in range(pick(random, [1, 1, 1, 2, 3])):
            tiff = pick(random, structure.CHANGES)(tiff, random)
        data = tiff.build()
        if random.random() < 0.9:
            return data
    return pick(random, _BYTE_CHANGES)(data, random)


def _flip(data: bytes, random: Random) -> bytes:
    changed = bytearray(data)
    for _ in range(2 ** int(random.integers(6))):
        changed[int(random.integers(len(data)))] ^= 1 << int(random.integers(8))
    return bytes(changed)


def _flip_head(data: bytes, random: Random) -> bytes:
    """Replace bytes at the beginning, where the header and often the directories are."""
    head = bytearray(data[: int(pick(random, [16, 64, 512]))])
    for _ in range(random.integers(1, 5)):
        head[int(random.integers(len(head)))] = int(pick(random, [0, 1, 2, 127, 128, 255]))
    return bytes(head) + data[len(head) :]


def _truncate(data: bytes, random: Random) -> bytes:
    return data[
        : int(pick(random, [0, 3, 8, 100, len(data) - 1, *random.integers(len(data), size=9)]))
    ]


def _swap(data: bytes, random: Random) -> bytes:
    """Change the mark of the byte order, or the order of each pair of bytes."""
    if random.random() < 0.5 and data[:2] in (b"II", b"MM"):
        return {b"II": b"MM", b"MM": b"II"}[data[:2]] + data[2:]
    start, stop = sorted(int(n) for n in random.integers(len(data), size=2))
    part = np.frombuffer(data[start : start + (stop - start) // 2 * 2], np.uint16)
    return data[:start] + part.byteswap().tobytes() + data[start + 2 * len(part) :]


def _move(data: bytes, random: Random) -> bytes:
    """Remove, repeat, or fill a block."""
    start, stop = sorted(int(n) for n in random.integers(len(data), size=2))
    part = data[start:stop]
    filler = bytes([pick(random, [0, 255])]) * len(part)
    return data[:start] + pick(random, [b"", part * 2, filler, part[::-1]]) + data[stop:]


_BYTE_CHANGES = [_flip, _flip, _flip_head, _truncate, _swap, _move]
