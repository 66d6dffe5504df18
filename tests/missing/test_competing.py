"""Expected Bayes factors after a further measurement, against complete fits of linear models."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from calib.hypotheses.design.imagined import truncated_samples
from calib.missing.competing import CandidateMeasurement, CompetingModel, CompetingModels, _density, sharpness
from calib.missing.evidence import ln_evidence
from calib.missing.linearised_fit import LinearisedFit

N, MORE, P = 24, 8, 3
MEASURED = np.arange(N) < N - MORE
NEW = CandidateMeasurement("new sensors", "sensor", rows=~MEASURED)
TWICE = CandidateMeasurement("twice the repeats", "repeats", scale=1 / np.sqrt(2))
BENCH = CandidateMeasurement("a test of P0", "bench", prior_sd={"P0": 0.3})
SIZE = 6.0


class Open:
    """A fit problem without limits."""

    class Any:
        lower, upper = -np.inf, np.inf

    def __getitem__(self, name):
        return self.Any

    @property
    def space(self):
        return self


def columns(seed, rho=0.95):
    """Columns of the parameters and of two effects that are nearly collinear in the measured rows."""
    rng = np.random.default_rng(seed)
    common = rng.standard_normal(N) / 3
    a, b = (np.sqrt(rho) * common + np.sqrt(1 - rho) * rng.standard_normal(N) / 3 for _ in "ab")
    a[~MEASURED], b[~MEASURED] = rng.standard_normal((2, MORE)) / 4
    return rng.standard_normal((N, P)), a, b


def optimum(design, y, prior_sd, names, centre=None):
    """Exact fit of a linear model to the data y."""
    centre = np.zeros(len(names)) if centre is None else centre
    information = design.T @ design + np.diag(1 / prior_sd**2)
    x = np.linalg.solve(information, design.T @ y + centre / prior_sd**2)
    values = dict(zip(names, x.tolist(), strict=True))
    return LinearisedFit((names[-1],), Open(), names, values, y - design @ x, design, prior_sd, (x - centre) / prior_sd)


def competing(seed, truth=(0.5, -1.0, 0.3, SIZE), count=40):
    """Both effects fitted to data simulated with the first one; with the design matrices and the data."""
    theta, *effects = columns(seed)
    y = np.column_stack([theta, effects[0]]) @ truth + np.random.default_rng([seed, 1]).standard_normal(N)
    pair, designs = [], []
    for name, one in zip("ab", effects, strict=True):
        design, names = np.column_stack([theta, one]), (*(f"P{k}" for k in range(P)), name)
        fit = optimum(design[MEASURED], y[MEASURED], np.array([1.0, 1.0, 1.0, SIZE]), names)
        points = truncated_samples(fit, count, seed)
        rows = np.array([design @ [p[n] for n in names] for p in points])
        predicted = design @ [fit.values[n] for n in names]
        there = np.ones(N, dtype=bool)
        competitor = CompetingModel(
            name,
            evidence(fit),
            fit,
            predicted,
            design,
            points,
            rows,
            np.ones(rows.shape, bool),
            there,
            np.zeros((N, 0)),
        )
        pair.append(competitor)
        designs.append(design)
    return CompetingModels((pair[0], pair[1]), MEASURED, seed), designs, y


def evidence(fit):
    return ln_evidence(fit, ())


def solved(found, designs, y, measurement, repeats=400):
    """Log Bayes factors for the truth, from complete fits to old and simulated new data together."""
    rng, values, weights = np.random.default_rng(99), [], []
    for k, share in enumerate(found.weights):
        truth = found.pair[k]
        x0 = np.array([truth.fit.values[n] for n in truth.fit.names])
        root = np.linalg.cholesky(truth.fit.covariance)
        for _ in range(repeats):
            x = x0 + root @ rng.standard_normal(len(x0))
            new = designs[k] @ x + rng.standard_normal(N)
            value = (
                x[0]
                + measurement.prior_sd.get("P0", 0.0)
                / np.sqrt(1 - measurement.prior_sd.get("P0", 0.0) ** 2)
                * rng.standard_normal()
            )
            rows = MEASURED if measurement is TWICE else ~MEASURED if measurement is NEW else np.zeros(N, bool)
            both = []
            for design, one in zip(designs, found.pair, strict=True):
                a, data = np.vstack([design[MEASURED], design[rows]]), np.concatenate([y[MEASURED], new[rows]])
                if measurement is BENCH:
                    sd = 0.3 / np.sqrt(1 - 0.3**2)
                    a = np.vstack([a, np.eye(P + 1)[0] / sd])
                    data = np.append(data, value / sd)
                both.append(evidence(optimum(a, data, one.fit.prior_sd, one.fit.names)))
            values.append(both[k] - both[1 - k])
            weights.append(share / repeats)
    return np.array(values), np.array(weights)


@pytest.mark.slow
@pytest.mark.parametrize("measurement", [NEW, *(pytest.param(m, marks=pytest.mark.slow) for m in (TWICE, BENCH))])
@pytest.mark.parametrize("seed", [1, *(pytest.param(s, marks=pytest.mark.slow) for s in (2, 3))])
def test_the_expected_bayes_factor_is_that_of_fits_to_old_and_new_data(measurement, seed):
    found, designs, y = competing(seed)
    values, weights = solved(found, designs, y, measurement)
    estimate, spread = found.bayes_factor(measurement), values.std()
    assert estimate.mean == pytest.approx(np.average(values, weights=weights), abs=0.25 * spread)
    low, high = np.quantile(values, (0.1, 0.9), weights=weights, method="inverted_cdf")
    assert estimate.low == pytest.approx(low, abs=0.5 * spread) and estimate.high == pytest.approx(
        high, abs=0.5 * spread
    )
    assert estimate.chance == pytest.approx(np.sum(weights[values > 3.0]) / weights.sum(), abs=0.12)


def test_certain_parameters_give_half_of_the_squared_distance():
    """Without posterior uncertainty the log Bayes factor grows by ``|m|^2/2``, with a standard deviation of ``|m|``."""
    found, _, _ = competing(1)
    pair = []
    for one in found.pair:
        sharp = replace(one.fit, slope=1e9 * one.fit.slope)
        same = replace(
            one, fit=sharp, sampled=np.array([one.predicted]), points=one.points[:1], sampled_rows=one.sampled_rows[:1]
        )
        pair.append(replace(same, ln_evidence=0.0))
    certain = replace(found, pair=tuple(pair))
    m = float(np.linalg.norm((pair[0].predicted - pair[1].predicted)[~MEASURED]))
    bayes_factor = certain.bayes_factor(NEW)
    assert bayes_factor.mean == pytest.approx(m**2 / 2, abs=4 * m / np.sqrt(400))
    assert (bayes_factor.high - bayes_factor.low) == pytest.approx(2 * 1.2816 * m, rel=0.2)
    assert certain.difference(NEW) == pytest.approx(m**2, rel=1e-6)


def test_a_row_missing_at_a_sample_adds_nothing_there():
    """A mode missing at half of the samples adds half of its expected log Bayes factor."""
    found, _, _ = competing(1, count=20)
    half = [
        replace(r, sampled_rows=r.sampled_rows & ((np.arange(20) % 2 == 0)[:, None] | MEASURED)) for r in found.pair
    ]
    none = [replace(r, sampled_rows=r.sampled_rows & MEASURED) for r in found.pair]
    gone = [found.pair[0], replace(found.pair[1], rows_at_fit=MEASURED)]
    now = sum(
        w * s * (found.pair[0].ln_evidence - found.pair[1].ln_evidence)
        for w, s in zip(found.weights, (1, -1), strict=True)
    )
    whole, some, nothing, lost = (
        replace(found, pair=tuple(p)).bayes_factor(NEW).mean for p in (found.pair, half, none, gone)
    )
    assert nothing == pytest.approx(now, abs=1e-9) and lost == pytest.approx(now, abs=1e-9)
    assert some - now == pytest.approx((whole - now) / 2, rel=0.35) and whole - now > 1


def test_the_same_seed_gives_the_same_bayes_factor():
    found, _, _ = competing(2)
    assert found.bayes_factor(NEW) == found.bayes_factor(NEW) != replace(found, seed=7).bayes_factor(NEW)


def test_a_bench_test_less_accurate_than_the_posterior_changes_nothing():
    found, _, _ = competing(2)
    now = (found.weights[0] - found.weights[1]) * (found.pair[0].ln_evidence - found.pair[1].ln_evidence)
    assert found.bayes_factor(CandidateMeasurement("", "bench", prior_sd={"P0": 5.0})).mean == pytest.approx(
        now, abs=1e-9
    )


def test_a_bench_test_leaves_the_standard_deviation_that_it_states():
    fit = competing(2)[0].pair[0].fit
    prior = fit.prior_sd[fit.names.index("P0")]
    assert 1 / (1 / prior**2 + sharpness(fit, "P0", 0.3) ** 2) == pytest.approx(0.3**2) and prior > 0.3
    assert sharpness(fit, "P0", 2 * prior) == 0.0


def test_weights_are_the_bayes_factors_now():
    found, _, _ = competing(3)
    ratio = np.exp(found.pair[0].ln_evidence - found.pair[1].ln_evidence)
    assert found.weights[0] / found.weights[1] == pytest.approx(ratio) and sum(found.weights) == pytest.approx(1)


def test_profiled_out_factors_widen_the_predictions():
    """Against the covariance of the new data written out."""
    found, _, _ = competing(2)
    loose = np.random.default_rng(5).standard_normal((N, 2))
    pair = tuple(replace(r, loose=loose) for r in found.pair)
    both = replace(found, pair=pair)
    m = (pair[0].predicted - pair[1].predicted)[~MEASURED]
    total = 0.0
    for one in pair:
        g = one.slope[~MEASURED]
        s = np.eye(MORE) + g @ one.fit.covariance @ g.T + loose[~MEASURED] @ loose[~MEASURED].T
        total += m @ np.linalg.solve(s, m) / 2
    assert both.difference(NEW) == pytest.approx(total)
    assert both.difference(NEW) < found.difference(NEW) and both.bayes_factor(NEW).mean < found.bayes_factor(NEW).mean


def test_the_predictive_density_is_that_of_a_gaussian():
    found, _, _ = competing(2)
    loose = np.random.default_rng(5).standard_normal((N, 2))
    tests, new = np.random.default_rng(6).standard_normal((3, MORE)), ~MEASURED
    for one in (found.pair[0], replace(found.pair[1], loose=loose)):
        spread = one.spread[new]
        exact = multivariate_normal(one.predicted[new], np.eye(MORE) + spread @ spread.T).logpdf(tests)
        shared = -0.5 * MORE * np.log(2 * np.pi)
        np.testing.assert_allclose(_density(one, tests, new.astype(float), new, {}), exact - shared)
