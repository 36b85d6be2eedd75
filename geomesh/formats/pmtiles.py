"""PMTiles, version 3: all tiles of a map in one file, which a web server only has to hand out.

A reader fetches the first 16 kB, which hold the header and the root directory, then parts of the
rest. So the root comes first here, then the tiles, and at the end the metadata and the leaves of
the directory, whose sizes are known only when the tiles are written.
"""

from __future__ import annotations

import gzip
import json
import struct
from dataclasses import dataclass
from typing import IO, TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray

_MAGIC = b"PMTiles\x03"
_HEADER = struct.Struct("<8s11Q6B4iB2i")
_ROOM = 16_384  # of the header and the root directory
_GZIP, _MVT = 2, 1

# Entries of a leaf of the directory: it is fetched as a whole.
_LEAF = 4096


@dataclass(frozen=True, eq=False)
class Directory:
    """Where the tiles are in the file.

    Attributes
    ----------
    ids : int64 (n,)
        Numbers of the tiles, rising: see `geomesh.formats.mercator.tile_ids`.
    offsets, lengths : int64 (n,)
        Bytes from the start of the tiles.
    """

    ids: NDArray[np.int64]
    offsets: NDArray[np.int64]
    lengths: NDArray[np.int64]


@dataclass(frozen=True)
class Place:
    """What a map shows first.

    Parameters
    ----------
    min_zoom, max_zoom : int
    bounds : (west, south, east, north)
        In degrees.
    """

    min_zoom: int
    max_zoom: int
    bounds: tuple[float, float, float, float]

    @property
    def center(self) -> tuple[float, float]:
        """Longitude and latitude of the middle."""
        west, south, east, north = self.bounds
        return (west + east) / 2, (south + north) / 2


class ArchiveWriter:
    """Writes tiles into a file, in the order of their numbers.

    Parameters
    ----------
    file : binary file, opened for writing
    """

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        self._ids: list[int] = []
        self._lengths: list[int] = []
        file.write(bytes(_ROOM))

    def add(self, tile_id: int, data: bytes) -> None:
        """Write a tile, compressed by gzip."""
        self._file.write(data)
        self._ids.append(tile_id)
        self._lengths.append(len(data))

    def finish(self, place: Place, metadata: Mapping[str, Any]) -> None:
        """Write metadata, directory and header."""
        ids, lengths = np.array(self._ids, np.int64), np.array(self._lengths, np.int64)
        offsets = np.cumsum(lengths) - lengths
        document = gzip.compress(json.dumps(metadata).encode(), mtime=0)
        root, leaves = _directories(ids, offsets, lengths)
        end = _ROOM + int(lengths.sum())
        self._file.write(document + leaves)
        west, south, east, north = (round(side * 1e7) for side in place.bounds)
        lon, lat = (round(side * 1e7) for side in place.center)
        header = _HEADER.pack(
            *(_MAGIC, _HEADER.size, len(root)),
            *(end, len(document), end + len(document), len(leaves)),
            *(_ROOM, int(lengths.sum()), len(ids), len(ids), len(ids)),
            *(1, _GZIP, _GZIP, _MVT, place.min_zoom, place.max_zoom),
            *(west, south, east, north, place.min_zoom, lon, lat),
        )
        self._file.seek(0)
        self._file.write(header + root)


class Archive:
    """The tiles of a file.

    Parameters
    ----------
    file : binary file, opened for reading

    Raises
    ------
    ValueError
        If the file is not PMTiles of version 3.
    """

    def __init__(self, file: IO[bytes]) -> None:
        self._file = file
        fields = _HEADER.unpack(file.read(_HEADER.size).ljust(_HEADER.size))
        if fields[0] != _MAGIC:
            raise ValueError("this is not a PMTiles file of version 3")
        root, root_size, about, about_size, self._leaves, _, self._tiles = fields[1:8]
        self.metadata: dict[str, Any] = json.loads(gzip.decompress(self._read(about, about_size)))
        self.directory = self._entries(self._read(root, root_size))

    def tile(self, entry: int) -> bytes:
        """Return the data of the tile at an index of the directory, still compressed."""
        offset, length = self.directory.offsets[entry], self.directory.lengths[entry]
        return self._read(self._tiles + int(offset), int(length))

    def _read(self, start: int, size: int) -> bytes:
        self._file.seek(start)
        return self._file.read(size)

    def _entries(self, data: bytes) -> Directory:
        numbers = _from_varints(gzip.decompress(data))
        count = int(numbers[0])
        steps, runs, lengths, moved = numbers[1 : 1 + 4 * count].reshape(4, count)
        ids, offsets = np.cumsum(steps), moved - 1
        follows = moved == 0
        for k in np.flatnonzero(follows).tolist():
            offsets[k] = offsets[k - 1] + lengths[k - 1]
        if count and runs[0] == 0:
            leaves = [
                self._entries(self._read(self._leaves + int(start), int(size)))
                for start, size in zip(offsets, lengths, strict=True)
            ]
            return Directory(
                np.concatenate([leaf.ids for leaf in leaves]),
                np.concatenate([leaf.offsets for leaf in leaves]),
                np.concatenate([leaf.lengths for leaf in leaves]),
            )
        return Directory(ids, offsets, lengths)


def _directories(
    ids: NDArray[np.int64], offsets: NDArray[np.int64], lengths: NDArray[np.int64]
) -> tuple[bytes, bytes]:
    """Return the root directory, and its leaves if the entries do not fit into it."""
    runs = np.ones(len(ids), np.int64)
    root, size = _pack(ids, runs, lengths, offsets), _LEAF
    if len(root) <= _ROOM - _HEADER.size:
        return root, b""
    while True:
        starts = range(0, len(ids), size)
        leaves = [
            _pack(*(part[start : start + size] for part in (ids, runs, lengths, offsets)))
            for start in starts
        ]
        sizes = np.array([len(leaf) for leaf in leaves], np.int64)
        firsts = ids[np.array(starts)]
        root = _pack(firsts, np.zeros_like(sizes), sizes, np.cumsum(sizes) - sizes)
        if len(root) <= _ROOM - _HEADER.size:
            return root, b"".join(leaves)
        size *= 2


def _pack(
    ids: NDArray[np.int64],
    runs: NDArray[np.int64],
    lengths: NDArray[np.int64],
    offsets: NDArray[np.int64],
) -> bytes:
    # The offset of an entry is left out if its tile follows the one before.
    moved = offsets + 1
    moved[1:][offsets[1:] == offsets[:-1] + lengths[:-1]] = 0
    steps = np.diff(ids, prepend=0)
    count = np.array([len(ids)], np.int64)
    return gzip.compress(_to_varints(np.concatenate([count, steps, runs, lengths, moved])), mtime=0)


def _to_varints(numbers: NDArray[np.int64]) -> bytes:
    """Return whole numbers as varints: 7 bits a byte, the lowest first."""
    left = numbers.astype(np.uint64)
    columns: list[NDArray[np.uint8]] = []
    used: list[NDArray[np.bool_]] = []
    while not columns or left.any():
        used.append((left > 0) if columns else np.ones(len(left), bool))
        columns.append((left & np.uint64(127)).astype(np.uint8))
        left >>= np.uint64(7)
    bytes_, kept = np.column_stack(columns), np.column_stack(used)
    bytes_[:, :-1][kept[:, 1:]] |= 128
    return bytes_[kept].tobytes()


def _from_varints(data: bytes) -> NDArray[np.int64]:
    octets = np.frombuffer(data, np.uint8)
    ends = np.flatnonzero(octets < 128)
    starts = np.concatenate([[0], ends[:-1] + 1])
    numbers = np.zeros(len(ends), np.int64)
    for place in range(int((ends - starts).max(initial=0)) + 1):
        within = starts + place <= ends
        part = octets[(starts + place)[within]].astype(np.int64) & 127
        numbers[within] |= part << (7 * place)
    return numbers
