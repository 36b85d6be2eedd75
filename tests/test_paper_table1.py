"""Facts that follow from the paper's Table 1 and eq. (10) by arithmetic alone."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial import Delaunay

from geomesh.mesh.quality import ki, measure

# AB, BC, CA, and Ki from the abstract and from the table.
PROPOSED = (101, 213, 99), 104.46, 102
SILVA = (97, 160, 85), 78.51, 80

corners = arrays(
    np.float64, st.tuples(st.integers(1, 12), st.just(3), st.just(2)), elements=st.floats(-100, 100)
)
labellings = st.integers(0, 2**32 - 1).map(np.random.default_rng)


def sides_of(triangles, lots):
    """Return the sides (3, T) of triangles. For each one, AB, BC and CA are chosen at random."""
    sides = np.linalg.norm(triangles - np.roll(triangles, 1, axis=1), axis=2)
    return lots.permuted(sides, axis=1).T


def all_that_round_to(sides):
    """Return Ki at the limits of the values that round to these sides. Ki is monotone in each."""
    return [float(ki(*ends)) for ends in product(*((s - 0.5, s + 0.5) for s in sides))]


@pytest.mark.parametrize(("sides", "abstract", "table"), [PROPOSED, SILVA])
def test_the_tables_ki_is_the_formula_of_its_sides_and_the_abstracts_is_not(sides, abstract, table):
    assert round(float(ki(*sides))) == table
    possible = all_that_round_to(sides)
    assert min(possible) < table < max(possible)
    assert not min(possible) <= abstract <= max(possible)


def test_no_triangle_has_the_sides_of_the_proposed_model():
    ab, bc, ca = PROPOSED[0]
    assert bc - 0.5 > (ab + 0.5) + (ca + 0.5)


def test_the_sides_of_the_other_model_are_those_of_a_triangle():
    ab, bc, ca = SILVA[0]
    assert bc < ab + ca


@given(corners, labellings)
def test_mean_sides_of_any_triangles_are_sides_of_a_triangle(triangles, lots):
    """This holds for any choice of AB, BC and CA. So 101, 213, 99 are not means over one set."""
    ab, bc, ca = sides_of(triangles, lots).mean(axis=1)
    slack = 1e-9 * (ab + bc + ca)
    assert bc <= ab + ca + slack
    assert ab <= bc + ca + slack
    assert ca <= ab + bc + slack


@given(corners, labellings)
def test_mean_ki_is_below_the_mean_of_either_side_in_its_numerator(triangles, lots):
    """So a mean Ki of 102 or 104.46 and a mean CA of 99 are not from the same triangles."""
    ab, bc, ca = sides_of(triangles, lots)
    found = ki(ab, bc, ca)
    assert (found <= np.minimum(bc, ca) * (1 + 1e-12)).all()
    assert found.mean() <= min(bc.mean(), ca.mean()) * (1 + 1e-12)
    (_, _, mean_ca), abstract, table = PROPOSED
    assert mean_ca < table < abstract


lengths = st.floats(0.01, 1000)


@given(lengths, lengths, lengths)
def test_ki_is_symmetric_in_ca_and_bc_and_in_no_other_two_sides(ab, bc, ca):
    found = float(ki(ab, bc, ca))
    assert found == pytest.approx(ki(ab, ca, bc), rel=1e-12)
    # AB and BC, or AB and CA, are swapped.
    assert found / ki(bc, ab, ca) == pytest.approx(bc / ab, rel=1e-12)
    assert found / ki(ca, bc, ab) == pytest.approx(ca / ab, rel=1e-12)


@given(lengths, lengths, lengths, st.floats(0.01, 100))
def test_ki_of_any_lengths_has_degree_one(ab, bc, ca, factor):
    assert ki(factor * ab, factor * bc, factor * ca) == pytest.approx(factor * ki(ab, bc, ca))


def test_ki_ranks_coarse_meshes_of_one_image_first():
    """With a quarter of the nodes, Ki doubles, but Ki / sqrt(area / N) hardly changes."""
    lots = np.random.default_rng(0)
    summaries = []
    for nodes in (500, 2000):
        points = lots.uniform(0, 256, (nodes, 2))
        triangles = Delaunay(points).simplices.astype(np.int32)
        summaries.append(measure(points, triangles, size=(256, 256)).summary())
    coarse, fine = (summary["measures"]["ki"]["mean"] for summary in summaries)
    assert coarse == pytest.approx(2 * fine, rel=0.1)
    coarse, fine = (summary["ki_normalised"] for summary in summaries)
    assert coarse == pytest.approx(fine, rel=0.1)
