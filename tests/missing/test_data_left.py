"""An effect is named only with degrees of freedom left and no larger leave-one-out error."""

from dataclasses import replace

import numpy as np
import pytest

from calib.execution.stage import silent
from calib.inference.leave_one_out import leave_one_out
from calib.missing.adequacy import predicts
from calib.missing.decision import DEFAULT, decide
from calib.missing.refits import Refits
from calib.problem.degrees_of_freedom import effective_dof

pytestmark = pytest.mark.usefixtures("fewer_samples")


def error(toy, candidate_fit):
    groups = [row.mode or row.sensor for row in toy.rows]
    s = candidate_fit.fit
    return np.linalg.norm(leave_one_out(s.residual, s.slope, s.prior_sd, groups).residual)


@pytest.mark.medium
@pytest.mark.mostly_slow(1)
@pytest.mark.parametrize("seed", [1, 4, 18])
def test_with_as_many_unknowns_as_data_nothing_is_named(toy, seed):
    """Three parameters and two effects: five responses leave no degrees of freedom, eight leave three."""

    def explained(responses):
        made = toy(
            seed=seed, modes=0, sensors=responses, parameters=3, effects=5, perturbations=0, size=40.0, reach=20.0
        )
        return decide(made.drawn(np.random.default_rng(seed), {"E0": 1.0, "E1": 1.0}))

    few, enough = explained(5), explained(8)
    assert few.credible == () and not few.names_something
    (pair,) = [t for t in few.candidate_fits if set(t.names) == {"E0", "E1"}]
    assert effective_dof(pair.fit.slope, pair.fit.prior_sd) < 1
    assert enough.verdict == "two_effects" and set(enough.credible) == {"E0", "E1"}
    assert effective_dof(enough.chosen.fit.slope, enough.chosen.fit.prior_sd) == pytest.approx(3, abs=0.2)


def pulled(toy, seed):
    """E0 and E1 cancel except in one mode and for a small part that only noise determines."""
    made = toy(
        seed=seed, modes=4, sensors=3, kinds=("frequency", "shape"), parameters=2, effects=3, perturbations=0,
        size=20.0, signed=("E0", "E1"),
    )  # fmt: skip
    one = np.array([row.mode == "M1" for row in made.rows])
    rng = np.random.default_rng(seed)
    alone, common = one * rng.standard_normal(len(one)), 100 * rng.standard_normal(len(one)) / np.sqrt(len(one))
    weak = 2 * rng.standard_normal(len(one)) * ~one
    more = {"E0": common + 40 * alone + weak, "E1": -common + 40 * alone + weak, "hidden": alone}
    made = replace(made, columns={**made.columns, **more})
    return made.drawn(np.random.default_rng(seed), {"hidden": 20.0})


@pytest.mark.medium
@pytest.mark.mostly_slow(2)
@pytest.mark.parametrize("seed", [0, 2, 6, 7, 11])
def test_two_effects_that_predict_left_out_modes_worse_are_not_named(toy, seed, monkeypatch):
    one = pulled(toy, seed)
    assert not decide(one).names_something  # one mode alone is wrong, which explains as much
    monkeypatch.setattr("calib.missing.blame.wrong_datum", lambda *given: None)
    found = decide(one)
    (pair,) = [t for t in found.candidate_fits if set(t.names) == {"E0", "E1"}]
    rises = error(one, pair) > error(one, found.base)
    assert rises == (seed in (2, 7, 11))
    assert (found.verdict == "two_effects") == (not rises) and (found.credible == ()) == rises


def test_the_leave_one_out_error_is_compared_with_that_of_the_base_model(toy):
    one = toy().drawn(np.random.default_rng(7), {"E1": 1.5})
    found, fits = decide(one), Refits(one, DEFAULT, 1.0, silent)
    worse = replace(found.chosen, fit=replace(found.chosen.fit, residual=20 * found.chosen.fit.residual))
    assert predicts(fits, found.chosen, found.base) and not predicts(fits, worse, found.base)
