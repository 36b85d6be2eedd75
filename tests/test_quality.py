"""Quality: figures computed by hand, the paper's Table 1, and properties that always hold."""

from __future__ import annotations

import json
import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from geomesh.mesh.quality import ki, measure

ONE = np.array([[0, 1, 2]], np.int32)
LENGTHS = ("ab", "bc", "ca", "ki", "ki_min", "ki_mean")
SHAPES = (
    "min_angle",
    "max_angle",
    "edge_ratio",
    "aspect_ratio",
    "radius_ratio",
    "condition",
    "shape",
    "scaled_jacobian",
    "equiangle_skew",
)

EQUILATERAL = (
    [(0, 0), (2, 0), (1, math.sqrt(3))],
    {
        "ab": 2,
        "bc": 2,
        "ca": 2,
        "ki": 4 / 3,
        "ki_min": 4 / 3,
        "ki_mean": 4 / 3,
        "area": math.sqrt(3),
        "min_angle": 60,
        "max_angle": 60,
        "edge_ratio": 1,
        "aspect_ratio": 1,
        "radius_ratio": 1,
        "condition": 1,
        "shape": 1,
        "scaled_jacobian": 1,
        "equiangle_skew": 0,
        "relative_size_squared": 1,
    },
)
THREE_FOUR_FIVE = (
    [(0, 0), (3, 0), (0, 4)],
    {
        "ab": 3,
        "bc": 5,
        "ca": 4,
        "ki": 40 / 12,
        "ki_min": 24 / 12,
        "ki_mean": 2 / 3 * 47 / 12,
        "area": 6,
        "min_angle": math.degrees(math.asin(3 / 5)),
        "max_angle": 90,
        "edge_ratio": 5 / 3,
        "aspect_ratio": 5 * 12 / (4 * math.sqrt(3) * 6),
        "radius_ratio": 2.5 / (2 * 1),
        "condition": 50 / (24 * math.sqrt(3)),
        "shape": 24 * math.sqrt(3) / 50,
        "scaled_jacobian": 2 / math.sqrt(3) * 3 / 5,
        "equiangle_skew": (60 - math.degrees(math.asin(3 / 5))) / 60,
        "relative_size_squared": 1,
    },
)
RIGHT_ISOSCELES = (
    [(0, 0), (1, 0), (0, 1)],
    {
        "ab": 1,
        "bc": math.sqrt(2),
        "ca": 1,
        "ki": 2 * math.sqrt(2) / (2 + math.sqrt(2)),
        "ki_min": 2 / (2 + math.sqrt(2)),
        "area": 0.5,
        "min_angle": 45,
        "max_angle": 90,
        "edge_ratio": math.sqrt(2),
        "aspect_ratio": math.sqrt(2) * (2 + math.sqrt(2)) / (2 * math.sqrt(3)),
        "radius_ratio": math.sqrt(2) / 2 / (2 - math.sqrt(2)),
        "condition": 4 / (2 * math.sqrt(3)),
        "shape": math.sqrt(3) / 2,
        "scaled_jacobian": math.sqrt(2 / 3),
        "equiangle_skew": 0.25,
    },
)
# Apex 1e-9 above the middle of a base of 2: two angles of atan(1e-9).
NEEDLE = (
    [(-1, 0), (1, 0), (0, 1e-9)],
    {
        "ab": 1,
        "bc": 2,
        "ca": 1,
        "ki": 1,
        "ki_min": 0.5,
        "area": 1e-9,
        "min_angle": math.degrees(1e-9),
        "edge_ratio": 2,
        "aspect_ratio": 2 / math.sqrt(3) * 1e9,
        "radius_ratio": 8 / 16 * 1e18,
        "condition": 1.5 / math.sqrt(3) * 1e9,
        "shape": math.sqrt(3) / 1.5 * 1e-9,
        "scaled_jacobian": 2 / math.sqrt(3) * 1e-9,
    },
)


@pytest.mark.parametrize("orientation", [[0, 1, 2], [2, 1, 0]])
@pytest.mark.parametrize(
    ("points", "expected"), [EQUILATERAL, THREE_FOUR_FIVE, RIGHT_ISOSCELES, NEEDLE]
)
def test_measures_are_those_worked_out_by_hand(points, expected, orientation):
    triangles = np.array([orientation], np.int32)
    table = measure(np.array(points, float), triangles, size=(1, 1)).table
    for name, value in expected.items():
        assert table[name][0] == pytest.approx(value, rel=1e-12, abs=1e-14), name


def test_columns_come_in_the_documented_order():
    table = measure(np.array(THREE_FOUR_FIVE[0], float), ONE, size=(1, 1)).table
    assert list(table) == list(EQUILATERAL[1])


def test_ki_is_the_papers_table_1_of_its_own_sides():
    found = ki([101, 97], [213, 160], [99, 85])
    assert np.round(found, 2).tolist() == [102.12, 79.53]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "points", [[(0, 0), (1, 0), (3, 0)], [(1, 1), (1, 1), (2, 2)], [(5, 5), (5, 5), (5, 5)]]
)
def test_triangles_without_area_give_infinity_or_zero_and_no_warning(points):
    quality = measure(np.array(points, float), ONE, size=(1, 1))
    row = {name: values[0] for name, values in quality.table.items()}
    assert not any(math.isnan(value) for value in row.values())
    for name in ("aspect_ratio", "radius_ratio", "condition"):
        assert row[name] == math.inf
    for name in ("area", "min_angle", "shape", "scaled_jacobian", "relative_size_squared"):
        assert row[name] == 0
    assert row["equiangle_skew"] == 1
    json.dumps(quality.summary(), allow_nan=False)


@pytest.mark.filterwarnings("error")
def test_a_mesh_without_triangles_has_a_summary_of_none():
    quality = measure(np.zeros((0, 2)), np.zeros((0, 3), np.int32), size=(4, 3))
    summary = quality.summary()
    assert summary["triangles"] == 0
    assert summary["measures"]["ki"]["mean"] is None


coordinates = st.integers(-4000, 4000).map(lambda k: k / 16)
corner_lists = st.lists(st.tuples(coordinates, coordinates), min_size=3, max_size=3, unique=True)


def measured(points) -> dict[str, float]:
    table = measure(np.asarray(points, float), ONE, size=(1, 1)).table
    return {name: float(values[0]) for name, values in table.items()}


@given(corner_lists)
def test_the_labellings_of_ki_keep_their_order_and_bounds(points):
    row = measured(points)
    slack = 1 + 1e-14
    assert row["ki_min"] <= row["ki_mean"] * slack
    assert row["ki_mean"] <= row["ki"] * slack
    assert row["ki"] <= min(row["ca"], row["bc"]) * slack
    assert row["ab"] <= row["ca"] <= row["bc"]
    mean = np.mean([ki(*np.roll([row["ab"], row["bc"], row["ca"]], k)) for k in range(3)])
    assert row["ki_mean"] == pytest.approx(mean)


@given(corner_lists, st.floats(0, 6.3), coordinates, coordinates, st.permutations(range(3)))
def test_measures_do_not_depend_on_place_direction_or_numbering(points, turn, dx, dy, order):
    before = measured(points)
    assume(before["area"] > 1)
    cosine, sine = math.cos(turn), math.sin(turn)
    moved = np.array(points) @ np.array([[cosine, sine], [-sine, cosine]]) + (dx, dy)
    after = measured(moved[list(order)])
    assert after == pytest.approx(before, rel=1e-7, abs=1e-7)


@given(corner_lists, st.floats(0.01, 100))
def test_ki_grows_with_the_scale_and_shapes_do_not(points, factor):
    before = measured(points)
    assume(before["area"] > 1)
    after = measured(np.array(points) * factor)
    for name in LENGTHS:
        assert after[name] == pytest.approx(before[name] * factor, rel=1e-9)
    for name in SHAPES:
        assert after[name] == pytest.approx(before[name], rel=1e-7, abs=1e-7)


def test_summary_of_two_triangles_typed_by_hand():
    # A 3-4-5 triangle and one with three times its area on the other side of the edge of 4.
    points = np.array([(0, 0), (3, 0), (0, 4), (-9, 0)], float)
    triangles = np.array([[0, 1, 2], [0, 2, 3]], np.int32)
    quality = measure(points, triangles, size=(20, 10))
    summary = json.loads(json.dumps(quality.summary(), allow_nan=False))
    root = math.sqrt(97)
    small, large = 40 / 12, 2 * 9 * root / (13 + root)
    assert (summary["nodes"], summary["triangles"], summary["size"]) == (4, 2, [20, 10])
    assert "AB is the shortest" in summary["labelling"]
    assert summary["ki_normalised"] == pytest.approx((small + large) / 2 / math.sqrt(50))
    sides = {"ab": 3.5, "bc": (5 + root) / 2, "ca": 6.5}
    assert summary["mean_sides"] == pytest.approx(sides)
    assert summary["share_min_angle_under"] == {"10": 0.0, "20": 0.0}
    step = large - small
    assert summary["measures"]["ki"] == pytest.approx(
        {
            "mean": small + step / 2,
            "median": small + step / 2,
            "p5": small + step * 0.05,
            "p25": small + step * 0.25,
            "p75": small + step * 0.75,
            "p95": small + step * 0.95,
            "min": small,
            "max": large,
        }
    )
    assert summary["measures"]["area"]["mean"] == 12
    # The areas are 6 and 18, and their mean is 12.
    assert quality.table["relative_size_squared"].tolist() == pytest.approx([1 / 4, 4 / 9])


def test_the_share_of_small_angles_counts_triangles():
    # Right triangles whose smallest angles are 5.7, 14.0 and 45 degrees.
    points = np.array([(0, 0), (10, 0), (10, 1), (10, 2.5), (10, 10)], float)
    triangles = np.array([[0, 1, 2], [0, 1, 3], [0, 1, 4]], np.int32)
    shares = measure(points, triangles, size=(10, 10)).summary()["share_min_angle_under"]
    assert shares == pytest.approx({"10": 1 / 3, "20": 2 / 3})


def test_measures_do_not_depend_on_how_many_triangles_are_seen_at_once(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rng = np.random.default_rng(5)
    points, triangles = rng.random((50, 2)), rng.integers(0, 50, (100, 3)).astype(np.int32)
    whole = measure(points, triangles, size=(1, 1)).table
    monkeypatch.setattr("geomesh.arrays.table._BLOCK", 7)
    again = measure(points, triangles, size=(1, 1)).table
    for name, values in whole.items():
        np.testing.assert_array_equal(again[name], values)
