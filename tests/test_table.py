"""Table: columns in order, read-only, always of equal length."""

from __future__ import annotations

import copy
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from geomesh.arrays.table import Table, read_only


@pytest.fixture
def table() -> Table:
    return Table({"id": [0, 1, 2], "kind": ["feature", "border", "feature"], "x": [0.5, 1.5, 2.5]})


def test_columns_keep_their_order(table: Table) -> None:
    assert list(table) == ["id", "kind", "x"]
    assert list(table.keys()) == ["id", "kind", "x"]
    assert len(table) == 3
    assert table.length == 3


def test_a_column_refuses_writes(table: Table) -> None:
    with pytest.raises(ValueError, match="read-only"):
        table["x"][0] = 9


def test_a_table_refuses_new_attributes(table: Table) -> None:
    with pytest.raises(AttributeError):
        table.length = 9  # type: ignore[misc]


def test_the_callers_array_stays_writable_and_apart() -> None:
    mine = np.arange(3)
    table = Table({"a": mine})
    mine[0] = 99
    assert table["a"].tolist() == [0, 1, 2]


def test_a_missing_column_is_a_key_error(table: Table) -> None:
    with pytest.raises(KeyError):
        table["absent"]
    assert "absent" not in table


@pytest.mark.parametrize(
    ("columns", "length"),
    [
        pytest.param({"a": [1, 2], "b": [1, 2, 3]}, -1, id="unequal"),
        pytest.param({"a": [1, 2]}, 3, id="another length than told"),
        pytest.param({"a": [[1, 2], [3, 4]]}, -1, id="two dimensions"),
        pytest.param({"a": 5}, -1, id="a number"),
        pytest.param({"a": []}, 2, id="empty beside a length"),
    ],
)
def test_columns_that_do_not_fit_are_refused_by_name(columns: dict, length: int) -> None:
    with pytest.raises(ValueError, match=rf"column '{list(columns)[-1]}' has shape"):
        Table(columns, length)


def test_a_table_without_columns_may_have_rows() -> None:
    assert Table({}).length == 0
    assert Table({}, 7).length == 7
    assert Table({}, 7).take(np.array([1, 2])).length == 2
    assert Table({"a": []}).length == 0


def test_with_columns_adds_at_the_end_and_replaces_in_place(table: Table) -> None:
    changed = table.with_columns({"kind": [7, 8, 9], "new": [1, 2, 3]})
    assert list(changed) == ["id", "kind", "x", "new"]
    assert changed["kind"].tolist() == [7, 8, 9]
    assert table["kind"].tolist() == ["feature", "border", "feature"]
    assert "new" not in table


def test_with_columns_refuses_another_length(table: Table) -> None:
    with pytest.raises(ValueError, match="column 'new' has shape"):
        table.with_columns({"new": [1, 2]})


@given(st.lists(st.integers(0, 2), max_size=9))
def test_take_is_what_numpy_takes(rows: list[int]) -> None:
    table = Table({"a": [10, 20, 30], "b": ["x", "y", "z"]})
    taken = table.take(np.array(rows, np.intp))
    assert taken["a"].tolist() == [[10, 20, 30][row] for row in rows]
    assert taken["b"].tolist() == [["x", "y", "z"][row] for row in rows]
    assert taken.length == len(rows)


def test_take_accepts_a_slice(table: Table) -> None:
    assert table.take(slice(1, None))["id"].tolist() == [1, 2]


@pytest.mark.parametrize("again", [copy.deepcopy, lambda t: pickle.loads(pickle.dumps(t))])
def test_a_copied_table_is_equal_and_still_read_only(again, table: Table) -> None:
    other = again(table)
    assert list(other) == list(table)
    for name in table:
        np.testing.assert_array_equal(other[name], table[name])
        assert other[name].dtype == table[name].dtype
        assert not other[name].flags.writeable


def test_read_only_copies_what_can_be_written() -> None:
    mine = np.arange(6.0)
    kept = read_only(mine)
    mine[0] = 99
    assert kept[0] == 0
    assert not kept.flags.writeable
    assert mine.flags.writeable


def test_read_only_returns_what_is_read_only_already() -> None:
    kept = read_only([1.0, 2.0])
    assert read_only(kept) is kept


def test_read_only_arrays_are_contiguous() -> None:
    column = np.arange(12).reshape(4, 3)[:, 1]
    assert read_only(column).flags.c_contiguous
    frozen = column[:]
    frozen.flags.writeable = False
    assert read_only(frozen).flags.c_contiguous


def test_read_only_converts_to_the_type_asked_for() -> None:
    assert read_only([1, 2], np.int32).dtype == np.int32
