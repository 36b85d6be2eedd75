"""The facts that docs/paper.md derives from the paper's formula and its Table 1."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator

import numpy as np
import pytest
from conftest import SAMPLES
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial import Delaunay

import geomesh
from geomesh.quality import ki, measure

# Table 1: sides AB, BC, CA and Ki, in the paper's order; and what its abstract says.
PROPOSED, PROPOSED_KI, PROPOSED_ABSTRACT = (101, 213, 99), 102, 104.46
SILVA, SILVA_KI, SILVA_ABSTRACT = (97, 160, 85), 80, 78.51

TWO_SAMPLES = ["olinda_landsat7_rgb_uint8.tif", "iguacu_landsat8_rgb_uint16.tif"]


@pytest.mark.parametrize(
    ("sides", "printed", "exact"), [(PROPOSED, PROPOSED_KI, 102.12), (SILVA, SILVA_KI, 79.53)]
)
def test_table_1_is_the_formula_applied_to_its_own_sides(sides, printed, exact):
    ab, bc, ca = sides
    assert 2 * ca * bc / (ca + ab + bc) == pytest.approx(exact, abs=0.005)
    assert float(ki(*sides)) == pytest.approx(exact, abs=0.005)
    assert round(exact) == printed


def rounded_alike(sides: tuple[int, int, int]) -> Iterator[float]:
    """Ki at the corners of the box of all sides that round to those given."""
    for shifts in itertools.product((-0.5, 0.5), repeat=3):
        yield float(ki(*(side + shift for side, shift in zip(sides, shifts, strict=True))))


def test_no_sides_that_round_to_table_1_give_the_figures_of_the_abstract():
    # Ki rises with BC and CA and falls with AB, so its extremes lie at corners.
    assert max(rounded_alike(PROPOSED)) < PROPOSED_ABSTRACT
    assert min(rounded_alike(SILVA)) > SILVA_ABSTRACT


lengths = st.floats(0.1, 1000)


@given(lengths, lengths, lengths, st.floats(1.001, 2))
def test_ki_rises_with_bc_and_ca_and_falls_with_ab(ab, bc, ca, factor):
    assert ki(ab, bc * factor, ca) > ki(ab, bc, ca)
    assert ki(ab, bc, ca * factor) > ki(ab, bc, ca)
    assert ki(ab * factor, bc, ca) < ki(ab, bc, ca)


def test_no_triangle_has_the_sides_of_the_proposed_model():
    ab, bc, ca = PROPOSED
    assert bc > ab + ca
    # Nor is rounding the reason.
    assert bc - 0.5 > (ab + 0.5) + (ca + 0.5)


points = st.tuples(st.floats(0, 256), st.floats(0, 256))


@given(st.lists(st.tuples(points, points, points), min_size=1, max_size=20))
def test_mean_sides_of_any_triangles_are_sides_of_a_triangle(corners):
    a, b, c = np.moveaxis(np.array(corners), 1, 0)
    ab, bc, ca = (np.linalg.norm(p - q, axis=1).mean() for p, q in ((a, b), (b, c), (c, a)))
    assert bc <= (ab + ca) * (1 + 1e-12)


@given(points, points, points)
def test_ki_is_never_above_the_lesser_of_ca_and_bc(a, b, c):
    ab, bc, ca = math.dist(a, b), math.dist(b, c), math.dist(c, a)
    assert ki(ab, bc, ca) <= min(ca, bc) * (1 + 1e-12)
    ordered = sorted((ab, bc, ca))
    assert ki(*ordered) <= ordered[1] * (1 + 1e-12)


def test_the_ki_of_the_proposed_model_is_above_its_own_bound():
    _, bc, ca = PROPOSED
    assert PROPOSED_KI > ca == min(ca, bc)


@given(lengths, lengths, lengths, st.floats(0.01, 100))
def test_ki_has_degree_one(ab, bc, ca, factor):
    assert ki(ab * factor, bc * factor, ca * factor) == pytest.approx(factor * ki(ab, bc, ca))


@given(lengths, lengths, lengths)
def test_ki_is_symmetric_in_ca_and_bc_alone(ab, bc, ca):
    assert ki(ab, bc, ca) == pytest.approx(ki(ab, ca, bc))
    least, middle, greatest = sorted((ab, bc, ca))
    if least < 0.99 * greatest:
        # AB shortest: the numerator has the two longer sides.
        assert ki(least, greatest, middle) > ki(greatest, least, middle)


def test_the_mean_over_the_three_labellings_has_a_closed_form():
    x, y, z = 3.0, 4.0, 5.0
    three = [float(ki(*order)) for order in ((x, y, z), (y, z, x), (z, x, y))]
    assert np.mean(three) == pytest.approx(2 / 3 * (x * y + y * z + z * x) / (x + y + z))


def mean_ki(nodes: np.ndarray, size: float) -> float:
    triangles = Delaunay(nodes).simplices.astype(np.int32)
    return float(measure(nodes, triangles, size=(size, size)).table["ki"].mean())


def test_a_quarter_of_the_points_doubles_ki_and_leaves_the_normalised_ki():
    rng = np.random.default_rng(1)
    side = 256.0
    few, many = rng.random((1000, 2)) * side, rng.random((4000, 2)) * side
    assert mean_ki(few, side) / mean_ki(many, side) == pytest.approx(2, rel=0.05)
    normalised = [mean_ki(p, side) / math.sqrt(side**2 / len(p)) for p in (few, many)]
    assert normalised[0] == pytest.approx(normalised[1], rel=0.05)


@pytest.mark.parametrize("name", TWO_SAMPLES)
def test_as_many_random_points_have_a_higher_ki_than_the_pipeline(name):
    mesh = geomesh.mesh_raster(SAMPLES / name, preset="paper")
    ours = mesh.quality().summary()["measures"]["ki"]["mean"]
    rng = np.random.default_rng(2)
    random = [mean_ki(rng.random((len(mesh.nodes), 2)) * 256, 256) for _ in range(5)]
    assert min(random) > ours


def sides_with_bc_longest(mesh: geomesh.Mesh) -> np.ndarray:
    """AB, BC and CA, (3, T), of a mesh: BC the longest, AB and CA in the order of the corners."""
    corners = mesh.plane_nodes[mesh.triangles]
    lengths = np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=2)
    longest = lengths.argmax(axis=1)[:, None]
    return np.take_along_axis(lengths, (longest + np.array([2, 0, 1])) % 3, axis=1).T


@pytest.mark.parametrize(
    ("name", "told"), [(TWO_SAMPLES[0], (79, 180, 91)), (TWO_SAMPLES[1], (98, 211, 103))]
)
def test_squared_sides_are_of_the_size_of_table_1_and_sides_are_not(name, told):
    sides = sides_with_bc_longest(geomesh.mesh_raster(SAMPLES / name, preset="paper"))
    squared = np.median(sides**2, axis=1)
    # What docs/paper.md tells; another processor may round otherwise.
    np.testing.assert_allclose(squared, told, rtol=0.03)
    assert np.abs(np.log(squared / PROPOSED)).max() < np.log(1.3)
    assert (np.median(sides, axis=1) < np.array(PROPOSED) / 5).all()


@pytest.mark.parametrize("name", TWO_SAMPLES)
def test_a_mean_ki_of_table_1_would_need_fewer_than_ten_nodes(name):
    normalised = (
        geomesh.mesh_raster(SAMPLES / name, preset="paper").quality().summary()["ki_normalised"]
    )
    # Ki = normalised sqrt(A / N), solved for N.
    assert 256**2 * (normalised / PROPOSED_KI) ** 2 < 10


def test_the_square_roots_of_table_1_are_sides_of_triangles():
    for sides in (PROPOSED, SILVA):
        ab, bc, ca = map(math.sqrt, sides)
        assert bc < ab + ca
    ab, bc, ca = map(math.sqrt, PROPOSED)
    angle = math.degrees(math.acos((ab**2 + ca**2 - bc**2) / (2 * ab * ca)))
    assert angle == pytest.approx(93.7, abs=0.1)
