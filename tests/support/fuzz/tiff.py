"""The structure of a TIFF: its byte order and the entries of its directories."""

from __future__ import annotations

import struct
from dataclasses import dataclass, replace

# Bytes of a value of each type, and its code for `struct`. GDAL writes no other types.
SIZES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8}
SIZES |= {13: 4, 16: 8, 17: 8, 18: 8}
CODES = {1: "B", 3: "H", 4: "I", 6: "b", 8: "h", 9: "i", 11: "f", 12: "d", 13: "I", 16: "Q"}
ASCII = 2


@dataclass(frozen=True)
class Entry:
    """An entry of a directory. `value` holds the bytes of all values, `count` may disagree."""

    tag: int
    kind: int
    count: int
    value: bytes


@dataclass(frozen=True)
class Tiff:
    """A TIFF file: all its bytes, and the directories found in them.

    `build` appends changed directories at the end, so that the offsets of the pixels stay right.
    """

    data: bytes
    order: str
    is_big: bool
    directories: tuple[tuple[Entry, ...], ...]
    starts: tuple[int, ...]

    @classmethod
    def parse(cls, data: bytes) -> Tiff:
        order = "<" if data[:2] == b"II" else ">"
        is_big = struct.unpack(f"{order}H", data[2:4])[0] == 43
        head, number, entry, inline = ("Q", "Q", "HHQ", 8) if is_big else ("I", "H", "HHI", 4)
        directories, starts = [], []
        (start,) = struct.unpack_from(f"{order}{head}", data, 8 if is_big else 4)
        while start:
            starts.append(start)
            (count,) = struct.unpack_from(f"{order}{number}", data, start)
            at = start + struct.calcsize(number)
            entries = []
            for _ in range(count):
                tag, kind, length = struct.unpack_from(f"{order}{entry}", data, at)
                at += struct.calcsize(f"{order}{entry}")
                size, where = SIZES[kind] * length, at
                if size > inline:
                    (where,) = struct.unpack_from(f"{order}{head}", data, at)
                entries.append(Entry(tag, kind, length, data[where : where + size]))
                at += inline
            directories.append(tuple(entries))
            (start,) = struct.unpack_from(f"{order}{head}", data, at)
        return cls(data, order, is_big, tuple(directories), tuple(starts))

    def with_entries(self, number: int, entries: tuple[Entry, ...]) -> Tiff:
        directories = list(self.directories)
        directories[number] = entries
        return replace(self, directories=tuple(directories))

    def values(self, entry: Entry) -> list[float]:
        """Return the values of an entry; of a fraction, numerators and denominators."""
        code = CODES.get(entry.kind, "B")
        count = len(entry.value) // struct.calcsize(code)
        return list(struct.unpack_from(f"{self.order}{count}{code}", entry.value))

    def pack(self, kind: int, values: list[float]) -> bytes:
        """Return values as the bytes of a type. Integers that are too large lose their top."""
        code = CODES.get(kind, "B")
        if code in "fd":
            return b"".join(_float(self.order, code, value) for value in values)
        bits = 8 * struct.calcsize(code)
        whole = [int(value) % (1 << bits) for value in values]
        return struct.pack(f"{self.order}{len(values)}{code.upper()}", *whole)

    def build(self) -> bytes:
        """Return the file with its directories written again at its end."""
        head, number, inline = ("Q", "Q", 8) if self.is_big else ("I", "H", 4)
        out = bytearray(self.data)
        pointer = 8 if self.is_big else 4
        for entries in self.directories:
            out += b"\0" * (-len(out) % 8)
            struct.pack_into(f"{self.order}{head}", out, pointer, len(out))
            table = bytearray(struct.pack(f"{self.order}{number}", len(entries)))
            values = bytearray()
            size = len(table) + len(entries) * (20 if self.is_big else 12)
            after = len(out) + size + struct.calcsize(head)
            for entry in entries:
                table += struct.pack(f"{self.order}HH{head}", entry.tag, entry.kind, entry.count)
                if len(entry.value) <= inline:
                    table += entry.value.ljust(inline, b"\0")
                else:
                    table += struct.pack(f"{self.order}{head}", after + len(values))
                    values += entry.value
            out += table
            pointer = len(out)
            out += struct.pack(f"{self.order}{head}", 0) + values
        return bytes(out)


def _float(order: str, code: str, value: float) -> bytes:
    try:
        return struct.pack(f"{order}{code}", value)
    except OverflowError:  # too large for 32 bits
        return struct.pack(f"{order}{code}", float("inf"))
