"""Evidence against brute-force integration."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from calib.missing.evidence import favoured, ln_bayes_linear, ln_evidence, model_probabilities, rescaled
from calib.missing.rules import RULES
from calib.missing.score import scores
from calib.problem.space import ParameterSpace


def with_prior(toy, sd, lower=0.0):
    def magnitude(e):
        return replace(e.magnitude, prior_sd=sd, lower=lower)

    return replace(toy, effects=tuple(replace(e, magnitude=magnitude(e)) for e in toy.effects))


def exact_ln_bayes(toy, names):
    """By a fine grid over one or two magnitudes; the parameters are integrated exactly, as part of the noise."""
    known = [next(e for e in toy.effects if e.name == n) for n in names]
    a = np.column_stack([toy.columns[p.name] for p in toy.base.parameters])
    s = np.array([p.prior_width for p in toy.base.parameters])
    g = np.column_stack([toy.columns[n] for n in names])
    weigh = np.linalg.inv(np.eye(len(toy.data)) + (a * s**2) @ a.T)
    curve, right = g.T @ weigh @ g, g.T @ weigh @ toy.data
    best, std = np.linalg.solve(curve, right), np.sqrt(np.diag(np.linalg.inv(curve)))
    axes, steps, priors = [], [], []
    for e, b, sd in zip(known, best, std, strict=True):
        low = b - 12 * sd if e.signed else max(b - 12 * sd, 0.0)
        high = max(b, 0.0) + 12 * sd
        steps.append((high - low) / 2000)
        axes.append(low + steps[-1] * (np.arange(2000) + 0.5))
        priors.append(stats.norm.pdf(axes[-1], 0, e.plausible) * (1 if e.signed else 2))
    if len(names) == 1:
        density = np.exp(right[0] * axes[0] - 0.5 * curve[0, 0] * axes[0] ** 2) * priors[0]
    else:
        first, second = axes[0][:, None], axes[1][None, :]
        ln = right[0] * first + right[1] * second - curve[0, 1] * first * second
        ln = ln - 0.5 * curve[0, 0] * first**2 - 0.5 * curve[1, 1] * second**2
        density = np.exp(ln) * np.outer(*priors)
    return np.log(density.sum() * np.prod(steps))


def found_ln_bayes(toy, names):
    known = {e.name: e for e in toy.effects}
    fit = toy.calibrated(*names)
    return ln_evidence(fit, [known[n] for n in names]) - ln_evidence(toy.calibrated(), []), fit


@pytest.mark.parametrize("signed", [(), ("E0",)])
@pytest.mark.parametrize("truth", [0.0, 0.35, 1.4, -0.6])
@pytest.mark.parametrize("sd", [0.05, 1.0, 30.0])
def test_one_magnitude(toy, signed, truth, sd):
    toy = toy(effects=2, signed=signed, modes=4, sensors=4)
    toy = with_prior(toy, sd, lower=-50.0 if signed else 0.0).drawn(np.random.default_rng(1), {"E0": truth})
    value, fit = found_ln_bayes(toy, ("E0",))
    assert fit.values["E0"] == 0.0 if truth == -0.6 and not signed else (fit.values["E0"] > 0 or truth <= 0)
    assert value == pytest.approx(exact_ln_bayes(toy, ("E0",)), abs=0.01)


@pytest.mark.parametrize("truth", [{"E0": 1.0, "E1": 0.6}, {"E0": 1.0, "E1": -0.5}, {"E0": 0.5, "E1": 0.0}])
@pytest.mark.parametrize("signed", [("E0", "E1"), ()])
def test_two_magnitudes(toy, truth, signed):
    toy = with_prior(toy(effects=2, signed=signed, modes=4, sensors=4, parameters=2), 0.8, -50.0 if signed else 0.0)
    across = np.linalg.qr(np.column_stack([toy.columns[n] for n in ("P0", "P1", "E0", "E1")]))[0][:, 2:]
    toy = replace(toy, columns={**toy.columns, "E0": 6 * across[:, 0], "E1": 6 * across[:, 1]})
    toy = toy.drawn(np.random.default_rng(2), truth)
    assert found_ln_bayes(toy, ("E0", "E1"))[0] == pytest.approx(exact_ln_bayes(toy, ("E0", "E1")), abs=0.01)


def test_correlated_signed_magnitudes(toy):
    toy = with_prior(toy(effects=2, signed=("E0", "E1"), modes=4, sensors=4, parameters=2), 0.8, -50.0)
    toy = replace(toy, columns={**toy.columns, "E1": 0.8 * toy.columns["E0"] + 0.6 * toy.columns["E1"]})
    toy = toy.drawn(np.random.default_rng(3), {"E0": 0.7, "E1": 0.4})
    assert found_ln_bayes(toy, ("E0", "E1"))[0] == pytest.approx(exact_ln_bayes(toy, ("E0", "E1")), abs=0.01)


def test_a_magnitude_at_its_limit_pulls_correlated_parameters_along(toy):
    """The unconstrained minimum differs in the parameters too."""
    toy = toy(effects=1, modes=4, sensors=4, reach=10.0)
    column = 0.8 * 8 * toy.columns["P0"] / np.linalg.norm(toy.columns["P0"]) + 0.6 * toy.columns["E0"]
    toy = replace(toy, columns={**toy.columns, "E0": column}).drawn(np.random.default_rng(4), {"E0": -1.0})
    value, fit = found_ln_bayes(toy, ("E0",))
    assert fit.values["E0"] == 0.0
    assert value == pytest.approx(exact_ln_bayes(toy, ("E0",)), abs=0.01)


def test_units_do_not_matter(toy):
    toy = toy(effects=1).drawn(np.random.default_rng(5), {"E0": 0.6})
    own = tuple(replace(p, lower=p.lower * 1e6, upper=p.upper * 1e6, prior_sd=1e6) for p in toy.base.parameters)
    columns = {n: c / (1e-8 if n == "E0" else 1e6 if n in toy.base else 1.0) for n, c in toy.columns.items()}
    magnitude = replace(toy.effects[0].magnitude, upper=50e-8, prior_sd=1e-8)
    other = replace(
        toy, base=ParameterSpace(own), columns=columns, effects=(replace(toy.effects[0], magnitude=magnitude),)
    )
    assert found_ln_bayes(toy, ("E0",))[0] == pytest.approx(found_ln_bayes(other, ("E0",))[0], abs=3e-3)


def test_the_score_gives_the_bayes_factor_without_a_fit(toy):
    toy = toy(effects=4, signed=("E0", "E1", "E2", "E3")).drawn(np.random.default_rng(6), {"E0": 0.7, "E1": -0.5})
    found = scores(toy.calibrated(), toy.effects, {})
    linear = ln_bayes_linear(found.magnitude, found.size, np.ones(4))
    exact = [found_ln_bayes(toy, (e.name,))[0] for e in toy.effects]
    np.testing.assert_allclose(linear, exact, atol=3e-3)
    assert ln_bayes_linear(np.array([-5.0]), np.array([3.0]), np.ones(1)) == pytest.approx(-0.5 * np.log(10))


@pytest.mark.parametrize("factor", [1 / 3, 3.0, 10.0])
@pytest.mark.parametrize("truth", [0.2, 1.2])
def test_rescaling_the_plausible_magnitude_equals_a_new_fit(toy, factor, truth):
    toy = toy(effects=1, signed=("E0",)).drawn(np.random.default_rng(7), {"E0": truth})
    value, fit = found_ln_bayes(toy, ("E0",))
    std = float(np.sqrt(fit.covariance[-1, -1]))
    other = with_prior(toy, factor, lower=-500.0)
    assert rescaled(value, fit.values["E0"], std, 1.0, factor) == pytest.approx(
        found_ln_bayes(other, ("E0",))[0], abs=4e-3
    )
    assert rescaled(value, fit.values["E0"], std, 1.0, 1.0) == value
    assert rescaled(value, 0.0, 1.0, 1.0, factor) == value  # without information the prior does not matter


def test_probabilities_sum_to_one_and_irrelevant_effects_lower_them():
    base, weights = model_probabilities(np.array([4.0, 1.0]))
    assert base + weights.sum() == pytest.approx(1.0)
    assert weights[0] / weights[1] == pytest.approx(np.exp(3.0))
    assert weights[0] / base == pytest.approx(np.exp(4.0) / 2)
    for irrelevant in (1, 10, 1000):
        more, longer = model_probabilities(np.array([4.0, 1.0] + [-1.0] * irrelevant))
        assert more + longer.sum() == pytest.approx(1.0) and longer[0] < weights[0]
    assert model_probabilities(np.zeros(50))[0] == pytest.approx(0.5)
    assert model_probabilities(np.array([]))[0] == 1.0
    assert model_probabilities(np.array([1e4, -1e4]))[1].tolist() == [1.0, 0.0]
    assert np.exp(RULES.credible) == pytest.approx(20, rel=0.01)


@pytest.mark.parametrize(("magnitude", "std"), [(0.5, 0.02), (0.03, 0.02), (-0.2, 0.05), (0.001, 0.05), (3.0, 0.9)])
def test_a_fault_has_the_plausible_size_of_largest_evidence(magnitude, std):
    """Against all smaller plausible sizes, one by one."""
    each = [rescaled(2.0, magnitude, std, 1.0, factor) for factor in np.geomspace(1e-6, 1, 4001)]
    assert favoured(2.0, magnitude, std, 1.0) == pytest.approx(max(each), abs=1e-4)


def test_a_fault_of_the_measurement_has_its_evidence_raised(toy):
    made = toy(effects=1, signed=("E0",)).drawn(np.random.default_rng(1), {"E0": 0.3})
    (known,), fit = made.effects, made.calibrated("E0")
    k = fit.names.index("E0")
    std = float(np.sqrt(fit.covariance[k, k]))
    plain, raised = ln_evidence(fit, [known]), ln_evidence(fit, [replace(known, of_measurement=True)])
    assert raised > plain
    assert raised == pytest.approx(favoured(plain, fit.values["E0"], std, known.plausible))
