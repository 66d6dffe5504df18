"""Factors of symmetric matrices: what they answer does not depend on the order of elimination."""

from importlib.util import find_spec

import numpy as np
import pytest
import scipy.sparse as sp

from calib.structure.eigenproblem import symmetric_factor as own
from calib.structure.eigenproblem.inertia import count_below
from calib.structure.eigenproblem.symmetric_factor import symmetric_factor

METIS = pytest.param(
    "metis", marks=pytest.mark.skipif(not find_spec("pymetis"), reason="the extra 'metis' is not installed")
)


def cube(side):
    """Three motions at each node of a cubic grid, tied to the 26 neighbours, on soft springs."""
    line = sp.diags_array([np.ones(side - 1), np.ones(side), np.ones(side - 1)], offsets=[-1, 0, 1])
    near = sp.kron(sp.kron(sp.kron(line, line), line), np.ones((3, 3)))
    near = sp.csc_array(near - sp.diags_array(near.diagonal()))
    laplacian = sp.diags_array(near.sum(axis=1)) - near
    return sp.csc_array(laplacian + 0.01 * sp.eye_array(3 * side**3))


@pytest.fixture(params=["minimum degree", METIS])
def order(request, monkeypatch):
    """How the rows of matrices of any size are ordered."""
    monkeypatch.setattr(own, "DISSECTED", 0 if request.param == "metis" else 10**9)
    own._orders.clear()
    return request.param


@pytest.mark.parametrize("shift", [0.0, 3.0, 2.0 + 1.0j])
def test_solutions_and_pivots_are_those_of_the_matrix(order, shift):
    rng = np.random.default_rng(3)
    matrix = sp.csc_array(cube(4) - shift * sp.diags_array(rng.uniform(1, 2, 192)))
    factor = symmetric_factor(matrix)
    assert (factor.order is None) == (order != "metis")
    loads = rng.normal(size=(192, 3)).astype(matrix.dtype)
    np.testing.assert_allclose(matrix @ factor.solve(loads), loads, atol=1e-8)
    np.testing.assert_allclose(factor.solve(loads[:, 0]), factor.solve(loads)[:, 0], rtol=1e-9)
    assert factor.on_diagonal
    sign, size = np.linalg.slogdet(matrix.toarray())
    assert np.prod(factor.pivots / np.abs(factor.pivots)) == pytest.approx(sign)
    assert np.log(np.abs(factor.pivots)).sum() == pytest.approx(size)
    if not np.iscomplexobj(matrix):
        assert np.sum(factor.pivots < 0) == np.sum(np.linalg.eigvalsh(matrix.toarray()) < 0)
        both = loads + 1j * rng.normal(size=loads.shape)
        np.testing.assert_allclose(matrix @ factor.solve_by_parts(both), both, atol=1e-8)


def test_pivots_stand_at_the_rows_of_the_matrix(order):
    """Rows that nothing joins to others are their own pivots."""
    matrix = cube(3).tolil()
    alone = [5, 40, 77]
    matrix[alone, :] = 0.0
    matrix[:, alone] = 0.0
    matrix[alone, alone] = [11.0, 12.0, 13.0]
    assert symmetric_factor(sp.csc_array(matrix)).pivots[alone].tolist() == [11.0, 12.0, 13.0]


@pytest.mark.skipif(not find_spec("pymetis"), reason="the extra 'metis' is not installed")
def test_an_entry_that_is_there_on_one_side_joins_both_rows(monkeypatch):
    """Where terms cancel, rounding can leave one of two entries; METIS takes symmetric graphs alone."""
    import pymetis

    dissect, seen = pymetis.nested_dissection, []
    monkeypatch.setattr(own, "DISSECTED", 0)
    monkeypatch.setattr(pymetis, "nested_dissection", lambda adjacency: seen.append(adjacency) or dissect(adjacency))
    own._orders.clear()
    matrix = cube(5).tolil()
    assert matrix[0, 200] == 0
    matrix[0, 200] = 1e-18
    factor, loads = symmetric_factor(sp.csc_array(matrix)), np.arange(375.0)
    (graph,) = seen
    ends = np.asarray(graph.adj_starts), np.asarray(graph.adjacent)
    edges = sp.csr_array((np.ones(len(ends[1])), ends[1], ends[0]), shape=matrix.shape)
    assert edges[0, 200] == edges[200, 0] == 1 and (edges != edges.T).nnz == 0 and not edges.diagonal().any()
    np.testing.assert_allclose(matrix @ factor.solve(loads), loads, atol=1e-7)


def test_as_many_modes_are_below_a_frequency(order):
    mass = sp.csc_array(sp.eye_array(192))
    true = np.linalg.eigvalsh(cube(4).toarray())
    gaps = np.flatnonzero(np.diff(true) > 1e-3)
    assert len(gaps) >= 5
    for k in gaps:
        between = np.sqrt((true[k] + true[k + 1]) / 2) / (2 * np.pi)
        assert count_below(cube(4), mass, between) == k + 1


@pytest.mark.slow
@pytest.mark.skipif(not find_spec("pymetis"), reason="the extra 'metis' is not installed")
def test_dissection_needs_less_of_solids(monkeypatch):
    matrix = cube(18)
    monkeypatch.setattr(own, "DISSECTED", 0)
    dissected, plain = symmetric_factor(matrix), symmetric_factor(matrix, dissected=False)
    assert plain.order is None and dissected.lu.nnz < 0.8 * plain.lu.nnz


@pytest.mark.skipif(not find_spec("pymetis"), reason="the extra 'metis' is not installed")
def test_one_order_serves_all_matrices_of_a_pattern_and_few_are_kept(monkeypatch):
    monkeypatch.setattr(own, "DISSECTED", 0)
    own._orders.clear()
    first = symmetric_factor(cube(3)).order
    assert symmetric_factor(sp.csc_array(2.0 * cube(3))).order is first
    for side in (4, 5, 6, 7):
        symmetric_factor(cube(side))
    assert len(own._orders) == own._KEPT
    again = symmetric_factor(cube(3)).order
    assert again is not first and np.array_equal(again, first)


@pytest.mark.skipif(not find_spec("pymetis"), reason="the extra 'metis' is not installed")
def test_where_metis_fails_the_factor_finds_its_order(monkeypatch):
    import pymetis

    def fails(**graph):
        raise RuntimeError("Caught an unknown exception!")

    monkeypatch.setattr(own, "DISSECTED", 0)
    monkeypatch.setattr(pymetis, "nested_dissection", fails)
    own._orders.clear()
    assert symmetric_factor(cube(3)).order is None
    own._orders.clear()


def test_without_metis_the_factor_finds_its_order(monkeypatch):
    monkeypatch.setattr(own, "DISSECTED", 0)
    monkeypatch.setattr(own, "metis", lambda: "")
    assert symmetric_factor(cube(3)).order is None
