"""Intervals of parameters with an unexplained misfit, against truths of linear models by hand."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import scipy.linalg as la
from scipy import stats

from calib.missing.discrepancy import discrepancy, discrepancy_of, parameter_intervals, parameters_sentence
from calib.missing.linearised_fit import LinearisedFit
from calib.missing.rules import RULES
from calib.missing.score import scored
from calib.problem.space import Parameter

P, N, M = 3, 60, 25


def world(seed, size, sparse=False):
    """A linear model of three parameters, fitted to data with small changes by all candidates, or by one alone."""
    rng = np.random.default_rng(seed)
    slope, signatures = rng.standard_normal((N, P)), rng.standard_normal((N, M)) + rng.standard_normal((N, 1))
    truth, sd = rng.standard_normal(P), np.ones(P)
    present = np.where(np.arange(M) == seed % M, size * np.sqrt(M), 0.0) if sparse else size * rng.standard_normal(M)
    data = slope @ truth + signatures @ (present / np.linalg.norm(signatures, axis=0)) + rng.standard_normal(N)
    wide = np.vstack([slope, np.eye(P)])
    values = la.lstsq(wide, np.concatenate([data, np.zeros(P)]))[0]
    names = tuple(f"p{k}" for k in range(P))
    space = {name: Parameter(name, 0.0, -50.0, 50.0) for name in names}
    fit = LinearisedFit(
        (), SimpleNamespace(space=space), names, dict(zip(names, values.tolist(), strict=True)),
        data - slope @ values, slope, sd, values, True,
    )  # fmt: skip
    every = [f"c{k}" for k in range(M)]
    return fit, scored(fit, every, [{}] * M, signatures, np.ones(M, bool), np.zeros(M)), truth


def test_the_posterior_is_that_of_generalised_least_squares():
    fit, scores, _ = world(1, 4.0)
    found = discrepancy(fit, scores)
    columns = scores.raw / scores.size * found.size
    weight = la.inv(np.eye(N) + columns @ columns.T)
    covariance = la.inv(fit.slope.T @ weight @ fit.slope + np.eye(P))
    np.testing.assert_allclose(found.covariance, covariance, rtol=1e-8)
    np.testing.assert_allclose(found.change, covariance @ (fit.slope.T @ weight @ fit.residual - fit.shift), rtol=1e-6)


@pytest.mark.medium
@pytest.mark.parametrize("sparse", [False, True])
def test_the_true_values_lie_inside_where_those_of_the_fit_alone_do_not(sparse):
    """Of 300 parameters at least 95 % within three standard deviations of a count: the size is an upper limit."""
    alone = together = 0
    width = []
    for seed in range(100):
        fit, scores, truth = world(seed, 6.0, sparse)
        found, values = discrepancy(fit, scores), np.array(list(fit.values.values()))
        alone += int(np.sum(np.abs(values - truth) < 1.96 * np.sqrt(np.diag(fit.covariance))))
        std = np.sqrt(np.diag(found.covariance))
        together += int(np.sum(np.abs(values + found.change - truth) < 1.96 * std))
        width += (std / np.sqrt(np.diag(fit.covariance))).tolist()
    assert alone < 0.75 * 300 and 0.91 * 300 < together
    assert 1.0 < np.median(width) < 4.0


def test_the_size_follows_the_misfit_and_is_that_of_noise_without_one():
    """An upper limit: 2 to 3 scores where nothing is present; signatures here are absorbed in part."""
    sizes = [discrepancy(*world(seed, 0.0)[:2]).size for seed in range(20)]
    large = [discrepancy(*world(seed, 6.0)[:2]).size for seed in range(20)]
    assert max(sizes) < 4.0 and max(sizes) < min(large) and 6.0 < np.median(large) < 20.0


def test_what_the_parameters_absorb_wholly_is_left_out():
    fit, scores, _ = world(2, 4.0)
    names = [f"c{k}" for k in range(M + 1)]
    raw = np.hstack([scores.raw, 1e6 * fit.slope[:, :1] + 1e-1 * scores.raw[:, :1]])
    more = scored(fit, names, [{}] * (M + 1), raw, np.ones(M + 1, bool), np.zeros(M + 1))
    one, two = discrepancy(fit, scores), discrepancy(fit, more)
    assert np.isfinite(two.covariance).all()
    # The prior leaves a little of the parameter itself, so that the signature counts by that part alone.
    assert RULES.unexplained_size < 1 and one.size == pytest.approx(two.size, rel=0.3)


def test_the_table_tells_both_intervals_and_only_after_an_unexplained_misfit():
    fit, scores, _ = world(3, 6.0)
    tests = SimpleNamespace(perturbations=scores, named=scored(fit, [], [], np.zeros((N, 0)), [], []))
    found = SimpleNamespace(verdict="none_explains", base=SimpleNamespace(fit=fit), base_adequacy=tests)
    table = parameter_intervals(found.base.fit, discrepancy_of(found))
    wide = discrepancy(fit, scores)
    half = 1.96 * np.sqrt(np.diag(wide.covariance))
    np.testing.assert_allclose(table["high_unexplained"] - table["value_unexplained"], half)
    np.testing.assert_allclose(table["value_unexplained"] - table["value"], wide.change)
    np.testing.assert_allclose(table["value"] - table["low"], 1.96 * np.sqrt(np.diag(fit.covariance)))
    width = np.median(half / (1.96 * np.sqrt(np.diag(fit.covariance))))
    assert f"are {width:.2g} times as wide" in parameters_sentence(table)
    effect = SimpleNamespace(verdict="effect", base=found.base, base_adequacy=tests)
    named = parameter_intervals(effect.base.fit, discrepancy_of(effect))
    assert discrepancy_of(effect) is None and named.empty and parameters_sentence(named) == ""


def test_a_misfit_unlike_every_candidate_leaves_no_interval():
    """Candidates that are present account for the misfit; none does for what is orthogonal to all of them."""
    like = [discrepancy(*world(seed, 6.0)[:2]) for seed in range(20)]
    assert all(found.holds for found in like)
    fit, scores, _ = world(3, 6.0)
    every = np.hstack([fit.slope, scores.raw])
    other = np.random.default_rng(4).standard_normal(N)
    other -= every @ la.lstsq(every, other)[0]
    for length, holds in ((0.0, True), (12.0, False)):
        off = replace(fit, residual=fit.residual + length * other / np.linalg.norm(other))
        found = discrepancy(off, scores)
        rows = off.residual @ la.inv(np.eye(N) + columns(scores, found) @ columns(scores, found).T)
        assert found.holds is holds and len(parameter_intervals(off, found)) == (P if holds else 0)
        # The sum of squares that is left, with the parameters fitted anew under that covariance.
        change = found.covariance @ (off.slope.T @ rows - off.shift)
        left = rows @ off.residual + off.shift @ off.shift - change @ la.solve(found.covariance, change)
        assert found.p == pytest.approx(stats.chi2.sf(left, N), rel=1e-6)


def columns(scores, found):
    return scores.raw / scores.size * found.size


# -- data that were not fitted -----------------------------------------------------------------------------------------


def test_the_presence_of_candidates_moves_the_parameters_as_their_posterior_says():
    """Both posteriors are of one model: ``change`` is what the parameters follow of what is present."""
    fit, scores, _ = world(1, 4.0)
    found = discrepancy(fit, scores)
    np.testing.assert_allclose(found.change, -found.absorbed @ found.presence, rtol=1e-6)
    moved = fit.covariance + (found.absorbed @ found.root) @ (found.absorbed @ found.root).T
    np.testing.assert_allclose(found.covariance, moved, rtol=1e-6)
    assert found.owners == tuple(f"c{k}" for k in range(M))


def test_other_data_are_predicted_as_the_joint_posterior_of_parameters_and_candidates_predicts_them():
    fit, scores, _ = world(1, 4.0)
    found, rng = discrepancy(fit, scores), np.random.default_rng(9)
    slope, raw = rng.standard_normal((7, P)), rng.standard_normal((7, M))
    shift, spread = found.elsewhere(fit.names[::-1], slope[:, ::-1], raw)
    scale = found.size / scores.size
    both, prior = np.hstack([fit.slope, scores.raw * scale]), np.concatenate([fit.shift, np.zeros(M)])
    covariance = la.inv(both.T @ both + np.eye(P + M))
    mean = covariance @ (both.T @ fit.residual - prior)
    wide = np.hstack([slope, raw * scale])
    np.testing.assert_allclose(shift, wide @ mean, rtol=1e-6, atol=1e-9)
    np.testing.assert_allclose(
        spread @ spread.T + slope @ fit.covariance @ slope.T, wide @ covariance @ wide.T, rtol=1e-6, atol=1e-9
    )
