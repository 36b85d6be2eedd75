"""Change the chunks of a PNG, and keep their checksums right."""

from __future__ import annotations

import zlib
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np

Chunk = tuple[bytes, bytes]

_NEW: list[Chunk] = [
    (b"tRNS", b"\0\x05" * 3),
    (b"tRNS", b"\0"),
    (b"PLTE", bytes(range(30))),
    (b"gAMA", bytes(4)),
    (b"tEXt", b"Comment\0H\xf6he"),
    (b"IDAT", bytes(10)),
    (b"IEND", b""),
]


def change_png(data: bytes, random: np.random.Generator) -> bytes:
    """Return a PNG with other pixels, other bytes in a chunk, or a chunk more or less."""
    chunks = read_chunks(data)
    at = int(random.integers(len(chunks)))
    what = random.random()
    if what < 0.2:
        del chunks[at]
    elif what < 0.5:
        chunks.insert(at, _NEW[int(random.integers(len(_NEW)))])
    else:
        kind, content = chunks[at if what < 0.7 else 1]
        is_pixels = kind == b"IDAT" and random.random() < 0.8
        changed = bytearray(zlib.decompress(content) if is_pixels else content or b"\0")
        for _ in range(2 ** int(random.integers(5))):
            changed[int(random.integers(len(changed)))] = int(random.integers(256))
        content = zlib.compress(bytes(changed)) if is_pixels else bytes(changed)
        chunks[at if what < 0.7 else 1] = kind, content
    return build_png(chunks)


def read_chunks(data: bytes) -> list[Chunk]:
    chunks, at = [], 8
    while at < len(data):
        end = at + 8 + int.from_bytes(data[at : at + 4])
        chunks.append((data[at + 4 : at + 8], data[at + 8 : end]))
        at = end + 4
    return chunks


def build_png(chunks: list[Chunk]) -> bytes:
    out = b"\x89PNG\r\n\x1a\n"
    for kind, content in chunks:
        checksum = zlib.crc32(kind + content).to_bytes(4)
        out += len(content).to_bytes(4) + kind + content + checksum
    return out
