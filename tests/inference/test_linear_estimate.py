"""Standard deviations of an estimate by linear equations: against draws of the noise, and beside least squares."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.analyses.fit_statistics import ObjectiveTerms, statistics_at
from calib.correlation.frf.nuisance import ChannelError
from calib.hypotheses.linear_start import estimate_by_equations, linear_estimate, linear_start
from calib.inference.considered import At
from calib.inference.constraints import ConstraintRows
from calib.inference.identify import posterior
from calib.inference.linear_estimate import LinearEstimate
from calib.study.loading import module_of

WORLD = module_of(Path(__file__).parents[1] / "template/frf_chain.py")
START = {"k": 1e4, "m": 2.0, "c": 10.0}


def problem_of(frfs, nuisances=()):
    return calib.Problem(WORLD.chain(**START), calib.FRFTest(frfs, nuisances=nuisances)).fit_problem


def estimate_of(frfs):
    posed = problem_of(frfs)
    return linear_estimate(posed.pair, posed.space, posed.space.values)


@pytest.fixture(scope="module")
def frfs():
    return WORLD.measured(1)


@pytest.fixture(scope="module")
def estimate(frfs):
    return estimate_of(frfs)


def test_its_values_are_those_of_the_start(frfs, estimate):
    posed = problem_of(frfs)
    assert dict(estimate.values) == linear_start(posed.pair, posed.space, posed.space.values)
    assert estimate.names == ("k", "c", "m") and estimate.gain.shape == (3, len(posed.pair.rows))


@pytest.mark.medium
def test_the_gain_is_the_derivative_by_the_data(frfs, estimate):
    """A small error of one entry at a resonance, real and imaginary, through the whole iteration."""
    rows = problem_of(frfs).pair.rows
    sizes = np.abs(estimate.gain).max(axis=0)
    for row in np.argsort(-sizes)[:3].tolist():
        label = rows[row]
        at = int(np.argmin(np.abs(frfs.freq - label.freq)))
        names = [f"{r.name}/{f.name}" for r in frfs.responses for f in frfs.references]
        i, j = divmod(names.index(label.sensor), len(frfs.references))
        std = frfs.total_std[at, i, j] * (1 if label.part == "re" else 1j)
        values = frfs.values.copy()
        values[at, i, j] += 0.1 * std
        moved = estimate_of(replace(frfs, values=values))
        for k, name in enumerate(estimate.names):
            change = (moved.values[name] - estimate.values[name]) / 0.1
            # The equations are those of the measured functions, whose change moves their weights a little.
            assert change == pytest.approx(estimate.gain[k, row], rel=0.15, abs=0.02 * np.abs(estimate.gain[k]).max())


@pytest.mark.slow
def test_its_standard_deviations_are_those_of_draws_of_the_noise(frfs, estimate):
    drawn = []
    for seed in range(40):
        rng = np.random.default_rng(seed)
        noise = rng.standard_normal(frfs.values.shape) + 1j * rng.standard_normal(frfs.values.shape)
        found = estimate_of(replace(frfs, values=frfs.values + frfs.total_std * noise))
        drawn.append([found.values[name] for name in estimate.names])
    told = np.sqrt(np.diag(estimate.gain @ estimate.gain.T))
    assert np.std(drawn, axis=0, ddof=1) == pytest.approx(told, rel=0.35)  # 40 draws tell it within 11 %


def small(seed=0):
    """A linear problem of 40 rows and three parameters, of which an estimate determines two."""
    rng = np.random.default_rng(seed)
    slope = rng.standard_normal((40, 3))
    at = At(
        ("a", "b", "n"), {"a": 1.0, "b": 2.0, "n": 0.0}, rng.standard_normal(40), slope, np.array([9, 9, 0.5]), False
    )
    return at, rng


def test_the_estimate_of_least_squares_errs_by_nothing_more():
    at, rng = small()
    uncertain = rng.standard_normal((40, 2))
    covariance = posterior(at.names, at.slope, at.prior_sd).covariance
    same = LinearEstimate(at.values, at.names, -(covariance @ at.slope.T), covariance / at.prior_sd)
    assert np.abs(same.beyond_least_squares(at, uncertain)).max(initial=0.0) < 1e-6
    worse = replace(same, gain=1.1 * same.gain)
    assert np.abs(worse.beyond_least_squares(at, uncertain)).max() > 0.1


def test_standard_deviations_become_those_of_the_estimate():
    """Ten rows of the forty alone, and the nuisance left at its prior."""
    at, rng = small(1)
    uncertain = 0.3 * rng.standard_normal((40, 1))
    own = at.slope[:10, :2]
    gain = np.zeros((2, 40))
    gain[:, :10] = -np.linalg.pinv(own)
    estimate = LinearEstimate(at.values, ("a", "b"), gain, np.zeros((2, 2)))
    errors = gain @ np.hstack([uncertain, at.slope[:, 2:] * at.prior_sd[2]])
    told = np.sqrt(np.diag(gain @ gain.T + errors @ errors.T))
    extra = estimate.beyond_least_squares(at, uncertain)
    known = posterior(at.names, at.slope, at.prior_sd, np.hstack([uncertain, extra]))
    assert known.std[:2] == pytest.approx(told, rel=0.02)  # the priors shrink a little of it
    assert np.all(told > 1.3 * posterior(at.names, at.slope, at.prior_sd, uncertain).std[:2])


def test_the_model_is_tested_anywhere_within_the_estimate():
    at, rng = small(2)
    gain = -np.linalg.pinv(at.slope[:, :2])
    estimate = LinearEstimate(at.values, ("a", "b"), gain, np.zeros((2, 2)))
    constraints = ConstraintRows(rng.standard_normal((1, 3)), np.zeros((1, 0)))
    tested = estimate.tested(at, rng.standard_normal((40, 1)), constraints)
    assert tested.at.names == ("n",) and tested.uncertain.shape == (40, 3) and tested.constraints.held.shape == (1, 3)
    # What the estimate absorbs of the nuisance is no longer in its change of the residual.
    assert np.abs(at.slope[:, :2].T @ tested.at.slope).max() < 1e-9


@pytest.mark.medium
def test_a_model_that_is_right_is_told_to_fit_with_the_wider_standard_deviations(frfs):
    posed = problem_of(frfs, [ChannelError("gain", "3x", prior_sd=2.0)])
    found = estimate_by_equations(posed, posed.space.values)
    own, plain = (statistics_at(posed, ObjectiveTerms(), found.values, None, e) for e in (found, None))
    std, narrow = (
        dict(zip(s.identification.posterior.names, s.identification.posterior.std, strict=True)) for s in (own, plain)
    )
    assert own.p_fit > 1e-3
    for name, true in WORLD.TRUE.items():
        assert std[name] >= 0.999 * narrow[name] / plain.birge and abs(found.values[name] - true) < 4 * std[name]
    assert "equation_errors" in set(own.considered["parameter"])
