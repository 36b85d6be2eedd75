"""Read-only columns of a table, and blocks of rows."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

_BLOCK = 8192


def read_only(array: ArrayLike, dtype: Any = None) -> NDArray[Any]:
    """Return `array` as a contiguous, read-only ndarray.

    An array that is already read-only is returned without a copy. Any other array is
    copied, so the caller can still change it.
    """
    source = np.asarray(array, dtype=dtype)
    base = source.base
    shared = isinstance(base, np.ndarray) and base.flags.writeable
    if source.flags.writeable or shared or not source.flags.c_contiguous:
        source = np.array(source, order="C")
        source.flags.writeable = False
    return source


def blocks(rows: int) -> Iterator[slice]:
    """Return slices of at most 8192 rows: temporary arrays of that size stay in the cache."""
    return (slice(start, start + _BLOCK) for start in range(0, rows, _BLOCK))


@dataclass(frozen=True, eq=False)
class Table(Mapping[str, NDArray[Any]]):
    """A frozen mapping from column name to a one-dimensional array.

    Parameters
    ----------
    columns : mapping of str to array_like, each of shape (n,)
        Copied, unless already read-only.
    length : int, optional
        Number of rows. Needed only for a table without columns.

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
        # Copies and pickles call the constructor, so that their arrays are read-only too.
        return Table, (dict(self.columns), self.length)

    # Compare tables by identity: a comparison of arrays gives an array, not True or False.
    __eq__ = object.__eq__
    __hash__ = object.__hash__

    def __getitem__(self, name: str) -> NDArray[Any]:
        return self.columns[name]

    def __iter__(self) -> Iterator[str]:
        return iter(self.columns)

    def __len__(self) -> int:
        return len(self.columns)

    def with_columns(self, columns: Mapping[str, ArrayLike]) -> Table:
        """Return a table with `columns` added. A column of the same name is replaced."""
        added = {name: np.asarray(values) for name, values in columns.items()}
        return Table({**self.columns, **added}, self.length)

    def take(self, rows: NDArray[np.intp] | slice) -> Table:
        """Return a table of the given rows, in that order."""
        taken = {name: values[rows] for name, values in self.columns.items()}
        return Table(taken, len(np.arange(self.length)[rows]))
