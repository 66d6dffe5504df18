"""Degrees of freedom against the hat matrix, simulated data and closed forms."""

import math

import numpy as np
import pytest
from scipy import stats

from calib.problem.degrees_of_freedom import KNOWN, behind, beside_known, effective_dof, p_value, repeats_dof, row_dof


def test_they_are_rows_less_the_trace_of_the_hat_matrix():
    rng = np.random.default_rng(1)
    g, s = rng.standard_normal((9, 4)) * [1.0, 10.0, 1e-3, 1e3], np.array([0.3, 2.0, 50.0, 1e-3])
    hat = g @ np.linalg.inv(g.T @ g + np.diag(1 / s**2)) @ g.T
    np.testing.assert_allclose(row_dof(g, s), 1 - np.diag(hat), atol=1e-12)
    assert effective_dof(g, s, fitted_factors=2) == pytest.approx(7 - np.trace(hat))
    other = np.array([1e6, 1e-3, 1.0, 7.0])  # units of the parameters
    np.testing.assert_allclose(row_dof(g / other, s * other), 1 - np.diag(hat), atol=1e-12)


def test_parameters_count_as_far_as_the_data_determine_them():
    g = np.column_stack([np.ones(6), np.zeros(6), np.arange(6.0)])
    assert effective_dof(g, np.full(3, np.inf)) == pytest.approx(4.0)  # one acts on nothing
    assert effective_dof(g, np.array([np.inf, 1.0, 1e-9])) == pytest.approx(5.0)  # another is held by its prior
    assert effective_dof(np.column_stack([g, g]), np.full(6, np.inf)) == pytest.approx(4.0)  # each parameter twice
    assert effective_dof(np.zeros((6, 0)), np.zeros(0)) == 6.0


def test_the_sum_of_squares_of_a_correct_model_has_their_mean():
    rng = np.random.default_rng(2)
    g, s = rng.standard_normal((8, 5)), np.array([0.1, 0.3, 1.0, 3.0, np.inf])
    sums = []
    for _ in range(4000):
        sampled = np.where(np.isfinite(s), rng.standard_normal(5) * np.where(np.isfinite(s), s, 0), 0.0)
        y = g @ sampled + rng.standard_normal(8)
        theta = np.linalg.solve(g.T @ g + np.diag(1 / s**2), g.T @ y)
        sums.append(np.sum((y - g @ theta) ** 2))
    assert np.mean(sums) == pytest.approx(effective_dof(g, s), abs=4 * np.std(sums) / np.sqrt(len(sums)))


def test_repeats_stand_behind_the_standard_deviation():
    kinds = ["frequency"] * 4 + ["shape"] * 10
    assert repeats_dof(kinds, 5) == {"frequency": 16.0, "shape": 40.0}
    assert set(repeats_dof(kinds, None).values()) == set(repeats_dof(kinds, 1).values()) == {math.inf}
    assert behind({"frequency": 4.0, "shape": 10.0}, {"frequency": 16.0, "shape": 28.0}) == pytest.approx(
        14**2 / (4**2 / 16 + 10**2 / 28)
    )
    assert behind({"frequency": 4.0}, repeats_dof(kinds, None)) == KNOWN


def test_a_known_contribution_raises_the_degrees_of_freedom():
    """Welch and Satterthwaite: twice the moments of a sum of an estimated variance and a known one."""
    assert beside_known(8.0, np.full(3, 0.5)) == pytest.approx(8 * 2**2)
    assert beside_known(8.0, np.zeros(3)) == math.inf and beside_known(8.0, np.array([])) == 8.0
    rng = np.random.default_rng(2)
    shares = np.array([0.2, 0.5, 0.9])
    own = rng.chisquare(6, (200_000, 3)) / 6
    alone, common = (np.mean(shares * e + 1 - shares, axis=1) for e in (own, own[:, :1]))
    for sampled, pooled, dof in ((common, True, 6.0), (alone, False, 18.0)):
        assert beside_known(dof, shares, pooled) == pytest.approx(2 / np.var(sampled), rel=0.03)


def test_a_row_without_a_contribution_from_repeats_adds_no_degrees_of_freedom():
    kinds = ["response"] * 4
    assert repeats_dof(kinds, 3, [1.0, 1.0, 1.0, 0.0])["response"] == pytest.approx(6 / 0.75**2)
    assert repeats_dof(kinds, 3, [0.0] * 4)["response"] == math.inf


def test_the_p_value_is_that_of_chi_square_or_of_an_f_variate():
    assert p_value(12.0, 7.5) == pytest.approx(stats.chi2.sf(12.0, 7.5))
    assert p_value(12.0, 7.5, 20.0) == pytest.approx(stats.f.sf(12.0 / 7.5, 7.5, 20.0))
    np.testing.assert_allclose(p_value(np.array([1.0, 9.0]), np.array([2.0, 3.0])), stats.chi2.sf([1.0, 9.0], [2, 3]))


@pytest.mark.parametrize("dof", [-1.0, 0.0, 0.4, 0.9])
def test_without_a_degree_of_freedom_only_a_nonzero_residual_is_evidence(dof):
    assert p_value(0.0, dof) == 1.0
    assert p_value(30.0, dof) < 1e-7
    if dof > 0:
        assert p_value(4.0, dof) >= stats.chi2.sf(4.0, dof)
