"""The base model is not left in a valley that an effect, or a further start, leads out of."""

from dataclasses import dataclass, fields, replace

import numpy as np
import pytest

from calib.execution.stage import silent
from calib.missing import decision
from calib.missing.adequacy import adequacy_of, overstated
from calib.missing.base_fit import _is_better, fitted_base, from_further_points, nested
from calib.missing.decision import decide
from calib.missing.goodness import goodness
from calib.missing.refits import Refits
from calib.missing.rules import RULES
from calib.problem.space import Parameter, ParameterSpace
from tests.missing.verdict_cases import dressed, text_of

pytestmark = pytest.mark.usefixtures("fewer_samples")
TRUTH = {"P0": 1.9, "P1": 0.2, "P2": 0.1}
"""Parameters of a complete model that a fit from the nominal values does not reach."""


def rippled(toy):
    """A toy whose first parameter also moves the response on a circle, once around in 1.57: every turn is a valley."""
    plain = toy(effects=4, perturbations=6, parameters=3)
    q = np.linalg.qr(np.random.default_rng(0).standard_normal((len(plain.rows), 3)))[0]

    @dataclass(frozen=True, eq=False)
    class Rippled(type(plain)):
        def _straight(self, values):
            p = 4 * values.get("P0", 0.0)
            return super()._straight(values) + 30.0 * (q[:, 0] * np.sin(p) + q[:, 1] * (1 - np.cos(p)))

        def slope(self, values, name):
            p = 4 * values.get("P0", 0.0)
            turned = 120.0 * (q[:, 0] * np.cos(p) + q[:, 1] * np.sin(p)) if name == "P0" else 0.0
            return super().slope(values, name) + turned

    given = {f.name: getattr(plain, f.name) for f in fields(plain)}
    given["columns"] = {**plain.columns, "P0": 20.0 * q[:, 2]}
    given["base"] = ParameterSpace((Parameter("P0", 0.0, -3.0, 3.0, prior_sd=2.0), *plain.base.parameters[1:]))
    return Rippled(**given)


@pytest.fixture
def trapped(toy):
    """A complete model whose base fit ends in another valley."""
    return dressed(rippled(toy)).drawn(np.random.default_rng(1), TRUTH)


def of(one):
    return Refits(one, decision.DEFAULT, 1.0, silent)


def test_the_base_fit_is_trapped(trapped):
    base = fitted_base(of(trapped), None)
    assert abs(base.fit.values["P0"] - TRUTH["P0"]) > 1.0 and base.fit.misfit > 5 * len(trapped.rows)


def test_a_trapped_base_fit_does_not_make_an_effect(trapped):
    found = decide(trapped)
    assert found.verdict == "nothing_detectable" and found.base.fit.misfit < 1.5 * len(trapped.rows)
    assert found.base.fit.values["P0"] == pytest.approx(TRUTH["P0"], abs=0.2) and found.base_starts > 0


def test_from_a_larger_model_the_base_model_reaches_what_it_contains(trapped):
    fits = of(trapped)
    base = fitted_base(fits, None)
    there = fits.candidate_fit(("E1",), {**trapped.fit_problem(("E1",)).space.values, **TRUTH})
    better = nested(fits, base, there)
    assert better.names == () and better.fit.misfit < base.fit.misfit - 500
    assert nested(fits, better, there) is better  # which gains nothing on it
    assert nested(fits, base, None) is base


@pytest.mark.parametrize(("mean_square", "least"), [(0.5, 1.0), (1.0, 1.0), (400.0, 400.0)])
def test_a_base_fit_is_better_by_one_or_by_the_mean_square_that_is_left(trapped, mean_square, least):
    base = fitted_base(of(trapped), None)
    square = mean_square * len(trapped.rows)

    def leaving(misfit):
        data = base.fit.residual * np.sqrt((misfit - base.fit.shift @ base.fit.shift) / np.sum(base.fit.residual**2))
        return replace(base, fit=replace(base.fit, residual=data))

    assert not _is_better(leaving(square - 0.99 * least), leaving(square))
    assert _is_better(leaving(square - 1.01 * least), leaving(square))


def test_further_points_lead_out_of_a_valley(trapped):
    fits = of(trapped)
    base = fitted_base(fits, None)
    better, tried = from_further_points(fits, base)
    assert better.fit.misfit < 1.5 * len(trapped.rows) and 1 <= tried <= RULES.base_starts


def test_further_points_that_agree_end_the_search(toy):
    fits = of(toy().drawn(np.random.default_rng(1), {"E1": 3.0}))
    base = fitted_base(fits, None)
    same, tried = from_further_points(fits, base)
    assert same is base and 1 < tried < RULES.base_starts


def test_a_decision_begins_where_it_is_told(trapped):
    """As from a stored calibration, which then is not repeated."""
    found = decide(trapped, replace(decision.DEFAULT, begin={**trapped.base.values, **TRUTH}))
    assert found.verdict == "nothing_detectable" and found.base_starts == 0 and not found.begun_anew


@pytest.mark.medium
def test_a_second_fit_of_the_base_model_is_told(cases):
    found = replace(cases["none_explains"], base_starts=0)
    assert "further point" not in text_of(found)
    assert "from 3 further points too" in text_of(replace(found, base_starts=3))


def test_a_poor_calibration_is_no_better_than_the_nominal_values(toy):
    """The better of both counts: a search may have ended anywhere."""
    one = dressed(rippled(toy)).drawn(np.random.default_rng(1), {"P0": 0.2, "P1": 0.2, "P2": 0.1})
    fits = of(one)
    poor, good = fitted_base(fits, {**one.base.values, "P0": 1.8}, only=True), fitted_base(fits, None)
    assert poor.fit.misfit > good.fit.misfit + 500
    assert fitted_base(fits, {**one.base.values, "P0": 1.8}).fit.misfit == pytest.approx(good.fit.misfit, abs=0.1)


def test_an_optimum_is_the_base_fit_though_the_model_is_rejected(toy):
    """The fit of a calibration costs the confirmation that it is one, whatever the model lacks."""
    one = dressed(rippled(toy)).drawn(np.random.default_rng(1), {"P0": 0.2, "E1": 3.0})
    fits = of(one)
    good = fitted_base(fits, None)
    assert not adequacy_of(fits, good, fits.scores(good.fit, one.effects)).passes(0.01)
    counted = one.count[0]
    again = fitted_base(fits, good.fit.values)
    assert again.fit.misfit == pytest.approx(good.fit.misfit, abs=0.1) and one.count[0] - counted <= 3


# -- accuracy that neighbouring values share ---------------------------------------------------------------------------


def smooth(toy, size):
    """Scalar responses with errors far below the stated standard deviation, and a common share of an effect."""
    made = toy(modes=0, sensors=120, effects=3, perturbations=4)
    return made.drawn(np.random.default_rng(2), {"E1": size}, noise=0.3)


def test_scores_prove_nothing_where_values_fit_better_than_independent_errors_would(toy):
    one = smooth(toy, 0.8)
    found = decide(one)
    tests = found.base_adequacy
    assert tests.p_family < 0.01 and tests.overstated and tests.kinds["chi2"].sum() < 0.6 * tests.dof
    assert found.verdict == "nothing_detectable"
    text = text_of(found)
    assert f"{tests.kinds['chi2'].sum():.0f} for {tests.kinds['dof'].sum():.0f} degrees of freedom" in text
    assert "prove nothing" in text


def test_an_effect_beyond_the_standard_deviation_is_named_all_the_same(toy):
    found = decide(smooth(toy, 2.5))
    assert not found.base_adequacy.overstated and found.verdict == "effect" and found.credible == ("E1",)


def test_modes_are_judged_by_their_scores(toy):
    """The standard deviations of modes come from repeats, whose errors are independent."""
    made = toy().drawn(np.random.default_rng(2), {"E1": 0.5}, noise=0.3)
    assert not overstated(goodness(made.calibrated(), made)[0], made)


@pytest.mark.medium
def test_a_model_that_is_nearly_rejected_is_told_with_its_limit(cases):
    found = cases["nothing_detectable"]
    assert "only just" not in text_of(found) and "largest score is" not in text_of(found)
    near = replace(found, base_adequacy=replace(found.base_adequacy, p_named=0.02, p_perturbations=1.0, p_faults=1.0))
    assert near.base_adequacy.p_family == pytest.approx(0.04)
    text = text_of(near)
    scores = np.concatenate([near.base_adequacy.named.magnitude, near.base_adequacy.perturbations.magnitude])
    assert f"The largest score is {scores.max():.1f} (" in text and "of 13 candidates more than 3.4 in 1 %" in text
    assert "Would have been seen" in text and "only just" in text
