"""Compare the size in the header of a TIFF with its blocks.

GDAL takes the blocks that the index lacks as empty. So a damaged header that claims a million
rows would give hours of work on zeros, and a wrong width a picture that is mixed up.
"""

from __future__ import annotations

import os
import struct
from typing import TYPE_CHECKING, BinaryIO

from geomesh.errors import SourceError

if TYPE_CHECKING:
    from collections.abc import Mapping

    import rasterio

_WIDTH, _HEIGHT, _BANDS, _PLANES = 256, 257, 277, 284
_STRIP_OFFSETS, _STRIP_ROWS = 273, 278
_TILE_WIDTH, _TILE_HEIGHT, _TILE_OFFSETS = 322, 323, 324
_TAGS = {_WIDTH, _HEIGHT, _BANDS, _PLANES, _STRIP_OFFSETS, _STRIP_ROWS}
_TAGS |= {_TILE_WIDTH, _TILE_HEIGHT, _TILE_OFFSETS}

# Codes for `struct` of the integers that these tags may have, by the type in the directory.
_INTEGERS = {1: "B", 3: "H", 4: "I", 16: "Q"}

_SEPARATE = 2

# GDAL holds a whole block in memory. Few files have blocks of so many values, no compression of
# real pixels makes so many values from a byte, and none has a tile so much larger than the image.
_LARGE_BLOCK = 2**28
_HIGH_RATIO = 2_000
_BEYOND = 16


def check_blocks(name: str, dataset: rasterio.DatasetReader) -> None:
    """Raise SourceError if a local TIFF cannot have the blocks that its header claims.

    Either the index lists fewer of them, or one is huge and the file tiny.

    Parameters
    ----------
    name : str
        Name of the dataset in messages.
    dataset : rasterio dataset
        Of GDAL's driver GTiff.
    """
    try:
        with open(dataset.name, "rb") as file:  # noqa: PTH123
            entries = _first_directory(file)
            size = os.fstat(file.fileno()).st_size
    except (OSError, struct.error):
        return  # a remote file, or a name of the driver
    rows, cols = dataset.block_shapes[0]
    values = rows * cols * (1 if _is_separate(entries) else dataset.count)
    expected, listed = _count_blocks(entries)
    if listed < expected:
        reason = f"have {expected} blocks, but the index of the file lists {listed}"
    elif values >= _LARGE_BLOCK and (
        values >= _HIGH_RATIO * size or rows * cols > _BEYOND * dataset.width * dataset.height
    ):
        reason = f"are in blocks of {cols} x {rows}, but the file has {size} bytes only"
    else:
        return
    raise SourceError(
        f"{name} is damaged: {dataset.width} x {dataset.height} pixels {reason}; download or "
        "export it again"
    )


def _count_blocks(entries: Mapping[int, tuple[int, int]]) -> tuple[int, int]:
    """Return the number of blocks of an image, and how many its index lists."""
    if not {_WIDTH, _HEIGHT} <= set(entries):
        return 0, 0
    width, height = entries[_WIDTH][1], entries[_HEIGHT][1]
    planes = entries.get(_BANDS, (1, 1))[1] if _is_separate(entries) else 1
    if _TILE_OFFSETS in entries:
        across, down = (max(entries.get(tag, (1, 0))[1], 1) for tag in (_TILE_WIDTH, _TILE_HEIGHT))
        return planes * -(-width // across) * -(-height // down), entries[_TILE_OFFSETS][0]
    if _STRIP_OFFSETS not in entries:
        return 0, 0
    rows = max(entries.get(_STRIP_ROWS, (1, height))[1], 1)
    return planes * -(-height // rows), entries[_STRIP_OFFSETS][0]


def _is_separate(entries: Mapping[int, tuple[int, int]]) -> bool:
    """Return whether each band has blocks of its own. A side file may say otherwise to GDAL."""
    return entries.get(_PLANES, (1, 1))[1] == _SEPARATE


def _first_directory(file: BinaryIO) -> dict[int, tuple[int, int]]:
    """Return the count and the first value of each tag that says how the image is divided."""
    head = file.read(16)
    order = {b"II": "<", b"MM": ">"}.get(head[:2])
    if order is None:
        return {}
    (version,) = struct.unpack_from(f"{order}H", head, 2)
    # Of a BigTIFF: the length of a number of entries, of an entry, of an offset; and their codes.
    number, entry, offset = ("Q", "HHQ8s", "Q") if version == 43 else ("H", "HHI4s", "I")
    (start,) = struct.unpack_from(f"{order}{offset}", head, 8 if version == 43 else 4)
    file.seek(start)
    (length,) = struct.unpack(f"{order}{number}", file.read(struct.calcsize(f"{order}{number}")))
    table = file.read(min(length, 4096) * struct.calcsize(f"{order}{entry}"))
    entries = {}
    size = struct.calcsize(f"{order}{entry}")
    for at in range(0, len(table) // size * size, size):
        tag, kind, count, value = struct.unpack_from(f"{order}{entry}", table, at)
        if tag in _TAGS and kind in _INTEGERS:
            # The first value of a list is not needed, only its count.
            (first,) = (
                struct.unpack_from(f"{order}{_INTEGERS[kind]}", value) if count == 1 else (0,)
            )
            entries[tag] = (count, first)
    return entries
