"""What a further measurement promises about two models, against linear problems that are solved outright."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from calib.missing.draws import drawn
from calib.missing.evidence import ln_evidence
from calib.missing.option import Option
from calib.missing.rivals import Rival, Rivals, _density
from calib.missing.state import State

N, MORE, P = 24, 8, 3
MEASURED = np.arange(N) < N - MORE
NEW = Option("new sensors", "sensor", rows=~MEASURED)
TWICE = Option("twice the repeats", "repeats", scale=1 / np.sqrt(2))
BENCH = Option("a test of P0", "bench", prior_sd={"P0": 0.3})
SIZE = 6.0


class Open:
    """A question without limits."""

    class Any:
        lower, upper = -np.inf, np.inf

    def __getitem__(self, name):
        return self.Any

    @property
    def space(self):
        return self


def columns(seed, rho=0.95):
    """Of the parameters, and of two effects that what is measured hardly tells apart."""
    rng = np.random.default_rng(seed)
    common = rng.standard_normal(N) / 3
    a, b = (np.sqrt(rho) * common + np.sqrt(1 - rho) * rng.standard_normal(N) / 3 for _ in "ab")
    a[~MEASURED], b[~MEASURED] = rng.standard_normal((2, MORE)) / 4
    return rng.standard_normal((N, P)), a, b


def fit(design, y, prior_sd, names, centre=None):
    """A linear model's state with the data y: exact."""
    centre = np.zeros(len(names)) if centre is None else centre
    information = design.T @ design + np.diag(1 / prior_sd**2)
    x = np.linalg.solve(information, design.T @ y + centre / prior_sd**2)
    values = dict(zip(names, x.tolist(), strict=True))
    return State((names[-1],), Open(), names, values, y - design @ x, design, prior_sd, (x - centre) / prior_sd)


def rivals(seed, truth=(0.5, -1.0, 0.3, SIZE), count=40):
    """Both effects fitted to data made with the first one; and designs and data."""
    theta, *effects = columns(seed)
    y = np.column_stack([theta, effects[0]]) @ truth + np.random.default_rng([seed, 1]).standard_normal(N)
    pair, designs = [], []
    for name, one in zip("ab", effects, strict=True):
        design, names = np.column_stack([theta, one]), (*(f"P{k}" for k in range(P)), name)
        state = fit(design[MEASURED], y[MEASURED], np.array([1.0, 1.0, 1.0, SIZE]), names)
        points = drawn(state, count, seed)
        rows = np.array([design @ [p[n] for n in names] for p in points])
        predicted = design @ [state.values[n] for n in names]
        there = np.ones(N, dtype=bool)
        rival = Rival(
            name,
            evidence(state),
            state,
            predicted,
            design,
            points,
            rows,
            np.ones(rows.shape, bool),
            there,
            np.zeros((N, 0)),
        )
        pair.append(rival)
        designs.append(design)
    return Rivals((pair[0], pair[1]), MEASURED, seed), designs, y


def evidence(state):
    return ln_evidence(state, ())


def solved(found, designs, y, option, repeats=400):
    """Log odds for the truth from complete fits to old and simulated new data together."""
    rng, values, weights = np.random.default_rng(99), [], []
    for k, share in enumerate(found.weights):
        truth = found.pair[k]
        x0 = np.array([truth.state.values[n] for n in truth.state.names])
        root = np.linalg.cholesky(truth.state.covariance)
        for _ in range(repeats):
            x = x0 + root @ rng.standard_normal(len(x0))
            new = designs[k] @ x + rng.standard_normal(N)
            told = (
                x[0]
                + option.prior_sd.get("P0", 0.0)
                / np.sqrt(1 - option.prior_sd.get("P0", 0.0) ** 2)
                * rng.standard_normal()
            )
            rows = MEASURED if option is TWICE else ~MEASURED if option is NEW else np.zeros(N, bool)
            both = []
            for design, one in zip(designs, found.pair, strict=True):
                a, data = np.vstack([design[MEASURED], design[rows]]), np.concatenate([y[MEASURED], new[rows]])
                if option is BENCH:
                    sd = 0.3 / np.sqrt(1 - 0.3**2)
                    a = np.vstack([a, np.eye(P + 1)[0] / sd])
                    data = np.append(data, told / sd)
                both.append(evidence(fit(a, data, one.state.prior_sd, one.state.names)))
            values.append(both[k] - both[1 - k])
            weights.append(share / repeats)
    return np.array(values), np.array(weights)


@pytest.mark.parametrize("option", [NEW, TWICE, BENCH])
@pytest.mark.parametrize("seed", [1, *(pytest.param(s, marks=pytest.mark.slow) for s in (2, 3))])
def test_the_promise_is_what_fits_to_old_and_new_data_give(option, seed):
    found, designs, y = rivals(seed)
    values, weights = solved(found, designs, y, option)
    told, spread = found.odds(option), values.std()
    assert told.mean == pytest.approx(np.average(values, weights=weights), abs=0.25 * spread)
    low, high = np.quantile(values, (0.1, 0.9), weights=weights, method="inverted_cdf")
    assert told.low == pytest.approx(low, abs=0.5 * spread) and told.high == pytest.approx(high, abs=0.5 * spread)
    assert told.chance == pytest.approx(np.sum(weights[values > 3.0]) / weights.sum(), abs=0.12)


def test_known_points_give_half_of_the_distance_between_the_predictions():
    """With nothing left open, the log odds grow by ``|m|^2/2`` and scatter by ``|m|``."""
    found, _, _ = rivals(1)
    pair = []
    for one in found.pair:
        sharp = replace(one.state, slope=1e9 * one.state.slope)
        same = replace(one, state=sharp, drawn=np.array([one.fit]), points=one.points[:1], seen=one.seen[:1])
        pair.append(replace(same, ln_evidence=0.0))
    told = replace(found, pair=tuple(pair))
    m = float(np.linalg.norm((pair[0].fit - pair[1].fit)[~MEASURED]))
    odds = told.odds(NEW)
    assert odds.mean == pytest.approx(m**2 / 2, abs=4 * m / np.sqrt(400))
    assert (odds.high - odds.low) == pytest.approx(2 * 1.2816 * m, rel=0.2)
    assert told.difference(NEW) == pytest.approx(m**2, rel=1e-6)


def test_what_is_not_seen_at_a_point_brings_nothing_there():
    """A mode that is lost at half of the points promises half of what it brings."""
    found, _, _ = rivals(1, count=20)
    half = [replace(r, seen=r.seen & ((np.arange(20) % 2 == 0)[:, None] | MEASURED)) for r in found.pair]
    none = [replace(r, seen=r.seen & MEASURED) for r in found.pair]
    gone = [found.pair[0], replace(found.pair[1], there=MEASURED)]
    now = sum(
        w * s * (found.pair[0].ln_evidence - found.pair[1].ln_evidence)
        for w, s in zip(found.weights, (1, -1), strict=True)
    )
    whole, some, nothing, lost = (replace(found, pair=tuple(p)).odds(NEW).mean for p in (found.pair, half, none, gone))
    assert nothing == pytest.approx(now, abs=1e-9) and lost == pytest.approx(now, abs=1e-9)
    assert some - now == pytest.approx((whole - now) / 2, rel=0.35) and whole - now > 1


def test_the_same_seed_promises_the_same():
    found, _, _ = rivals(2)
    assert found.odds(NEW) == found.odds(NEW) != replace(found, seed=7).odds(NEW)


def test_a_bench_test_that_says_less_than_is_known_changes_nothing():
    found, _, _ = rivals(2)
    now = (found.weights[0] - found.weights[1]) * (found.pair[0].ln_evidence - found.pair[1].ln_evidence)
    assert found.odds(Option("", "bench", prior_sd={"P0": 5.0})).mean == pytest.approx(now, abs=1e-9)


def test_weights_are_the_odds_now():
    found, _, _ = rivals(3)
    ratio = np.exp(found.pair[0].ln_evidence - found.pair[1].ln_evidence)
    assert found.weights[0] / found.weights[1] == pytest.approx(ratio) and sum(found.weights) == pytest.approx(1)


def test_what_is_loose_besides_the_parameters_counts_as_open():
    """Against the covariance of the new data written out."""
    found, _, _ = rivals(2)
    loose = np.random.default_rng(5).standard_normal((N, 2))
    pair = tuple(replace(r, loose=loose) for r in found.pair)
    both = replace(found, pair=pair)
    m = (pair[0].fit - pair[1].fit)[~MEASURED]
    total = 0.0
    for one in pair:
        g = one.slope[~MEASURED]
        s = np.eye(MORE) + g @ one.state.covariance @ g.T + loose[~MEASURED] @ loose[~MEASURED].T
        total += m @ np.linalg.solve(s, m) / 2
    assert both.difference(NEW) == pytest.approx(total)
    assert both.difference(NEW) < found.difference(NEW) and both.odds(NEW).mean < found.odds(NEW).mean


def test_the_predictive_density_is_that_of_a_gaussian():
    found, _, _ = rivals(2)
    loose = np.random.default_rng(5).standard_normal((N, 2))
    tests, new = np.random.default_rng(6).standard_normal((3, MORE)), ~MEASURED
    for one in (found.pair[0], replace(found.pair[1], loose=loose)):
        spread = one.spread[new]
        told = multivariate_normal(one.fit[new], np.eye(MORE) + spread @ spread.T).logpdf(tests)
        shared = -0.5 * MORE * np.log(2 * np.pi)
        np.testing.assert_allclose(_density(one, tests, new.astype(float), new, {}), told - shared)
