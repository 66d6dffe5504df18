"""A large effect is found although it has led the base fit into another valley."""

import math
from dataclasses import dataclass, fields, replace

import numpy as np
import pytest

from calib.execution.stage import silent
from calib.missing import decision, restarts
from calib.missing.decision import decide
from calib.missing.linearised_fit import least_squares_fit
from calib.missing.plausible import parameter_pulls
from calib.missing.refits import Refits
from calib.missing.restarts import led_astray
from calib.missing.rules import RULES
from calib.problem.space import Parameter, ParameterSpace

pytestmark = pytest.mark.usefixtures("fewer_samples")

TRUTH = {"P0": 0.1, "P1": 0.2, "P2": 0.1, "E0": 1.0}


def turning(toy, size, radius, prior=1.0):
    """A toy whose first parameter moves the response on a circle: far from 0 it acts the other way.

    The signature of E0 is nearly that of a rotation by 150 degrees.
    """
    plain = toy(effects=4, perturbations=6, parameters=3)

    @dataclass(frozen=True, eq=False)
    class Turning(type(plain)):
        def _straight(self, values):
            p = values.get("P0", 0.0)
            turned = self.columns["u"] * np.sin(p) + self.columns["v"] * (1 - np.cos(p))
            return super()._straight({**values, "P0": 0.0}) + radius * turned

        def slope(self, values, name):
            if name != "P0":
                return super().slope(values, name)
            return radius * (self.columns["u"] * np.cos(values["P0"]) + self.columns["v"] * np.sin(values["P0"]))

    q = np.linalg.qr(np.random.default_rng(0).standard_normal((len(plain.rows), 3)))[0]
    turn = np.deg2rad(150.0)
    chord = q[:, 0] * np.sin(turn) + q[:, 1] * (1 - np.cos(turn))
    own = size * (0.9 * chord / np.linalg.norm(chord) + np.sqrt(0.19) * q[:, 2])
    given = {f.name: getattr(plain, f.name) for f in fields(plain)}
    given["columns"] = {**plain.columns, "u": q[:, 0], "v": q[:, 1], "E0": own}
    given["base"] = ParameterSpace((Parameter("P0", 0.0, -4.0, 4.0, prior_sd=prior), *plain.base.parameters[1:]))
    return Turning(**given)


@pytest.mark.parametrize(("size", "radius"), [(150.0, 10.0), (150.0, 30.0), (70.0, 30.0)])
def test_a_large_effect_behind_a_ridge_is_named_and_measured(toy, size, radius, monkeypatch):
    one = turning(toy, size, radius).drawn(np.random.default_rng(1), TRUTH)
    found = decide(one)
    assert abs(found.base.fit.values["P0"]) > 2.4 and found.begun_anew
    assert found.verdict == "effect" and found.credible == ("E0",) and found.noise_scale == 1.0
    fit_problem = one.fit_problem(("E0",))
    from_truth = least_squares_fit(fit_problem, ("E0",), {**fit_problem.space.values, **TRUTH})
    assert found.chosen.fit.misfit == pytest.approx(from_truth.misfit, abs=0.1)
    assert found.chosen.fit.values["E0"] == pytest.approx(1.0, abs=0.1)
    # Started from the base fit alone, the fit stays in the wrong valley.
    monkeypatch.setattr(decision, "led_astray", lambda base, adequacy: False)
    monkeypatch.setattr(decision, "nested", lambda fits, base, larger: base)
    lost = decide(replace(one, count=[0]))
    assert lost.chosen.fit.misfit * lost.noise_scale**2 > from_truth.misfit + 9 and not lost.begun_anew


def test_beside_a_base_fit_that_leaves_a_multiple_of_the_rows_effects_start_from_the_nominal_values(toy, monkeypatch):
    one = turning(toy, 150.0, 30.0).drawn(np.random.default_rng(1), TRUTH)
    monkeypatch.setattr(decision, "fit_singles", lambda *given: pytest.fail("fitted beside the base fit first"))
    found = decide(one)
    assert found.base.fit.misfit > RULES.trapped * len(one.rows)
    assert found.verdict == "effect" and found.credible == ("E0",) and found.begun_anew


def test_the_better_fit_of_each_effect_counts(toy):
    one = turning(toy, 150.0, 30.0).drawn(np.random.default_rng(1), TRUTH)
    fits = Refits(one, decision.DEFAULT, 1.0, silent)
    start = fits.fit_problem(("E0",)).space.values
    good, poor = (fits.candidate_fit(("E0",), {**start, **at}) for at in (TRUTH, {"P0": 3.0}))
    other = fits.candidate_fit(("E1",), one.fit_problem(("E1",)).space.values)
    assert good.fit.misfit < poor.fit.misfit - 1
    for first, second in (([good], [poor, other]), ([poor, other], [good])):
        assert restarts.better_of(first, second) == [good, other]


def test_refits_from_nominal_values_keep_to_their_budget(toy):
    one = turning(toy, 150.0, 30.0).drawn(np.random.default_rng(1), TRUTH)
    found = decide(one)
    assert found.begun_anew and found.evaluations <= (1 + RULES.anew) * decision.DEFAULT.budget + 20
    least = decide(replace(one, count=[0]), replace(decision.DEFAULT, budget=0.0))
    assert not least.begun_anew and least.evaluations < 60


def test_an_effect_named_at_once_needs_no_refit_from_nominal_values(toy):
    found = decide(toy().drawn(np.random.default_rng(7), {"E1": 3.0}))
    assert found.verdict == "effect" and not found.begun_anew


def test_a_base_model_is_led_astray_by_the_stated_rule(toy):
    made = toy()
    quiet = decide(made.drawn(np.random.default_rng(2), {}))
    assert not led_astray(quiet.base, quiet.base_adequacy)
    named = quiet.base_adequacy.named
    loud = replace(quiet.base_adequacy, named=replace(named, z=named.z + 20.0))
    assert led_astray(quiet.base, loud) and led_astray(quiet.base, replace(quiet.base_adequacy, p_fit=1e-9))
    pulled = decide(made.drawn(np.random.default_rng(2), {"P3": 6.0, "E1": 1.0}))
    assert parameter_pulls(pulled.base.fit)["pulled"].any() and led_astray(pulled.base, pulled.base_adequacy)


def test_integers_are_chosen_again(toy):
    """In the wrong valley another integer fits better; the refit from the nominal values finds the true one."""
    made = turning(toy, 150.0, 30.0)
    rng = np.random.default_rng(5)
    places = 6.0 * rng.standard_normal((len(made.rows), 3)) / np.sqrt(len(made.rows))
    places[:, 2] += 0.2 * made.columns["E0"]
    space = ParameterSpace((*made.base.parameters, Parameter("place", 1, 0, 2, integer=True)))
    one = replace(made, base=space, columns={**made.columns, "place": places})
    one = one.drawn(np.random.default_rng(1), {**TRUTH, "place": 0})
    found = decide(one)
    assert found.base.fit.values["place"] != 0 and found.begun_anew
    assert found.credible == ("E0",) and found.chosen.fit.values["place"] == 0


def test_every_effect_is_started_from_its_linear_solution(toy):
    """No first-order prediction at the base or the nominal values leads to E0: its linear solution does."""
    far = TRUTH | {"P0": 2.5}
    one = turning(toy, 150.0, 30.0).drawn(np.random.default_rng(1), far)

    @dataclass(frozen=True, eq=False)
    class Solved(type(one)):
        def linear_start(self, names, values):
            return {**values, **far} if names == ("E0",) else None

    solved = Solved(**{f.name: getattr(one, f.name) for f in fields(one)} | {"count": [0]})
    found = {}
    for made in (one, solved):
        fits = Refits(made, decision.DEFAULT, 1.0, silent)
        base = fits.candidate_fit((), made.base.values)
        others = [fits.candidate_fit(("E1",), base.fit.values)]
        effects = [e for e in made.effects if e.name in ("E0", "E1")]
        found[made is solved] = restarts._starts(fits, effects), restarts.restarted(fits, base, others, effects)
    (without, astray), (starts, refitted) = found[False], found[True]
    assert len(starts) == len(without) + 1
    predicted, name, start = starts[0]
    assert name == "E0" and start["P0"] == far["P0"] and start["E0"] == far["E0"]
    enough = 1.5 * len(one.rows)
    assert predicted < enough < min(found.fit.misfit for found in astray)
    assert refitted[0].names == ("E0",) and refitted[0].fit.misfit < enough
    told = list[tuple[object, ...]]()
    restarts._starts(Refits(solved, decision.DEFAULT, 1.0, lambda *stage: told.append(stage)), solved.effects)
    assert len(told) > len(solved.effects)  # of hundreds, each may take a while


@pytest.mark.parametrize("trapped", [RULES.trapped, math.inf])
def test_further_starts_follow_while_every_fit_is_trapped(toy, trapped, monkeypatch):
    """The third start of E0 leads to it; after it no more are fitted, and none where what is left is no multiple."""
    one = turning(toy, 150.0, 30.0).drawn(np.random.default_rng(1), TRUTH)
    fits, sizes, asked = Refits(one, decision.DEFAULT, 1.0, silent), (0.1, 0.0, 0.2, 0.0, 1.0, 3.0), list[float]()
    base, rows, best_of = fits.candidate_fit((), one.base.values), len(one.rows), Refits.best_of
    assert base.fit.misfit > 1.5 * RULES.trapped * rows

    def trapped_below(self, names, starts, parent):
        asked.append(starts[0]["E0"])
        return best_of(self, names, starts, parent) if asked[-1] >= 1.0 else self.grown(names, parent)

    starts = [(float(k), "E0", {**one.base.values, "E0": size}) for k, size in enumerate(sizes)]
    monkeypatch.setattr(restarts, "_starts", lambda fits, effects: starts)
    monkeypatch.setattr(Refits, "best_of", trapped_below)
    monkeypatch.setattr(restarts, "RULES", replace(RULES, trapped=trapped))
    (found,) = restarts.restarted(fits, base, [fits.grown(("E0",), base)], one.effects)
    within = found.fit.misfit < 1.5 * rows
    if trapped == math.inf:
        assert asked == [0.1, 0.0] and not within
    else:
        assert asked == [0.1, 0.0, 0.2, 1.0] and within  # 0 is the base model again
