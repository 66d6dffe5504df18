"""Counting modes by inertia against LAPACK."""

import numpy as np
import pytest
import scipy.linalg as la
import scipy.sparse as sp
from hypothesis import given
from hypothesis import strategies as st

from calib.errors.errors import EvaluationError
from calib.structure.eigenproblem.inertia import count_below


def pair(seed, n=30, massless=0):
    rng = np.random.default_rng(seed)
    a, b = rng.standard_normal((2, n, n))
    k, m = a @ a.T + np.eye(n), b @ b.T + np.eye(n)
    idle = rng.permutation(n)[:massless]
    m[idle], m[:, idle] = 0.0, 0.0
    return k, m


@given(st.integers(0, 2**32 - 1), st.sampled_from([0, 7]))
def test_the_count_is_that_of_lapack(seed, massless):
    k, m = pair(seed, massless=massless)
    inverse = la.eigh(m, k, eigvals_only=True)
    freq = np.sort(1 / np.sqrt(inverse[inverse > 1e-12])) / (2 * np.pi)
    for below in (0, 1, len(freq) // 2, len(freq)):
        edges = np.concatenate([[0.0], freq, [2 * freq[-1]]])
        middle = 0.5 * (edges[below] + edges[below + 1])
        assert count_below(sp.csc_array(k), sp.csc_array(m), middle) == below


def test_repeated_modes_and_rigid_motions_count_with_multiplicity():
    turn = np.linalg.qr(np.random.default_rng(1).standard_normal((40, 40)))[0]
    squares = np.concatenate([np.zeros(3), np.full(17, 100.0), np.full(20, 400.0)])
    k = sp.csc_array(turn @ np.diag(squares) @ turn.T)
    found = [count_below(k, sp.csc_array(np.eye(40)), omega / (2 * np.pi)) for omega in (1.0, 9.9, 10.1, 21.0)]
    assert found == [3, 3, 20, 40]


def test_an_inaccurate_count_is_refused():
    nothing = sp.csc_array((2, 2))
    with pytest.raises(EvaluationError, match=r"cannot be counted: a pivot vanishes"):
        count_below(sp.csc_array([[0.0, 5.0], [5.0, 0.0]]), nothing, 1.0)
    # Pivots so small that their inverse swamps all other entries.
    small = sp.csc_array(np.ones((4, 4)) - (1 - 1e-14) * np.eye(4))
    with pytest.raises(EvaluationError, match="cannot be counted: the factor is too inaccurate"):
        count_below(small, sp.csc_array((4, 4)), 1.0)
    with pytest.raises(EvaluationError, match="cannot be counted"):
        count_below(sp.csc_array((3, 3)), sp.csc_array((3, 3)), 1.0)
