"""Read-only columns without an object per row: whole, as a Table, and by blocks."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

_BLOCK = 8192


def read_only(array: ArrayLike, dtype: Any = None) -> NDArray[Any]:
    """Return `array` as a contiguous ndarray that refuses writes.

    An array that is read-only already is returned as it is; any other is
    copied, so the caller's own array stays writable and independent.
    """
    source = np.asarray(array, dtype=dtype)
    base = source.base
    shared = isinstance(base, np.ndarray) and base.flags.writeable
    if source.flags.writeable or shared or not source.flags.c_contiguous:
        source = np.array(source, order="C")
        source.flags.writeable = False
    return source


def blocks(rows: int) -> Iterator[slice]:
    """Cut rows into blocks of which temporary arrays are small and stay in the cache."""
    return (slice(start, start + _BLOCK) for start in range(0, rows, _BLOCK))


@dataclass(frozen=True, eq=False)
class Table(Mapping[str, NDArray[Any]]):
    """A frozen mapping from column name to a one-dimensional array.

    Parameters
    ----------
    columns : mapping of str to array_like, each of shape (n,)
        Copied unless read-only already.
    length : int, optional
        Number of rows; needed only where there is no column to tell it.

    Raises
    ------
    ValueError
        If a column is not one-dimensional or the lengths differ.
    """

    columns: Mapping[str, NDArray[Any]]
    length: int = -1

    def __post_init__(self) -> None:
        columns = {name: read_only(values) for name, values in self.columns.items()}
        length = self.length
        for name, values in columns.items():
            length = values.shape[0] if length < 0 and values.ndim else length
            if values.shape != (length,):
                raise ValueError(f"column {name!r} has shape {values.shape}, expected ({length},)")
        object.__setattr__(self, "columns", columns)
        object.__setattr__(self, "length", max(length, 0))

    def __reduce__(self) -> tuple[Any, ...]:
        # Copies and pickles are built anew, so that their arrays are read-only too.
        return Table, (dict(self.columns), self.length)

    # Tables are compared by identity: equal arrays would make no single truth value.
    __eq__ = object.__eq__
    __hash__ = object.__hash__

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self.columns[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.columns)

    def __len__(self) -> int:
        return len(self.columns)

    def with_columns(self, columns: Mapping[str, ArrayLike]) -> Table:
        """Return a table with `columns` added, or replaced where the name exists."""
        added = {name: np.asarray(values) for name, values in columns.items()}
        return Table({**self.columns, **added}, self.length)

    def take(self, rows: NDArray[np.intp] | slice) -> Table:
        """Return the table of the given rows, in that order."""
        taken = {name: values[rows] for name, values in self.columns.items()}
        return Table(taken, len(np.arange(self.length)[rows]))
