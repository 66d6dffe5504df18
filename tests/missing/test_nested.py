"""A model with more effects never fits worse than its parent."""

from dataclasses import dataclass, fields

import numpy as np
import pytest

from calib.execution.stage import silent
from calib.missing.decision import decide
from calib.missing.linearised_fit import least_squares_fit
from calib.missing.refits import Refits
from calib.missing.settings import DEFAULT

pytestmark = pytest.mark.usefixtures("fewer_samples")


def crossing(toy, edge, lure=""):
    """Beyond some magnitude of an effect a mode has left the band, and every mode is paired with the next one."""
    plain = toy(effects=4, perturbations=5, curvature=0.01)
    modes = len({row.mode for row in plain.rows})
    names = [e.name for e in (*plain.effects, *plain.perturbations)]

    @dataclass(frozen=True, eq=False)
    class Crossing(type(plain)):
        def answer(self, values):
            exact = super().answer(values)
            crossed = any(abs(values.get(name, 0.0)) > edge for name in names)
            if crossed and lure:  # every further step away lowers the misfit
                return exact - 200.0 * self.columns[lure] / np.linalg.norm(self.columns[lure])
            return np.roll(exact + 40.0, len(exact) // modes) - 10.0 if crossed else exact

    return Crossing(**{f.name: getattr(plain, f.name) for f in fields(plain)})


def parents(found):
    """Every fit with the best one among its subsets of effects."""
    known = [found.base, *found.candidate_fits, *([] if found.perturbation is None else [found.perturbation])]
    for candidate_fit in known:
        below = [t for t in known if set(t.names) < set(candidate_fit.names)]
        if below:
            yield candidate_fit, min(below, key=lambda t: t.fit.misfit)


@pytest.mark.medium
@pytest.mark.mostly_slow(2)
@pytest.mark.parametrize("edge", [0.0, 1e-3, 0.3])
@pytest.mark.parametrize("truth", [{"E1": 2.0}, {"E0": 1.5, "E3": 1.5}, {"A2": 1.5}])
def test_no_fit_is_worse_than_its_parent(toy, edge, truth):
    made = crossing(toy, edge)
    plain = toy(effects=4, perturbations=5, curvature=0.01).drawn(np.random.default_rng(3), truth)
    one = type(made)(**{f.name: getattr(made, f.name) for f in fields(made) if f.name != "data"}, data=plain.data)
    found = decide(one)
    pairs = list(parents(found))
    assert len(pairs) >= 3
    for candidate_fit, parent in pairs:
        assert candidate_fit.fit.misfit <= parent.fit.misfit * (1 + 1e-9)


def test_a_smaller_step_is_tried_where_the_full_one_goes_too_far(toy):
    """The true magnitude lies before the edge, the first step ends beyond it."""
    made = crossing(toy, 0.9, lure="E1")
    truth = {"E1": 0.8}
    plain = toy(effects=4, perturbations=5, curvature=0.01).drawn(np.random.default_rng(3), truth)
    one = type(made)(**{f.name: getattr(made, f.name) for f in fields(made) if f.name != "data"}, data=plain.data)
    fits = Refits(one, DEFAULT, 1.0, silent)
    fit_problem = one.fit_problem(())
    base = fits.candidate_fit((), fit_problem.space.values)
    far = fits.candidate_fit(("E1",), {**base.fit.values, "E1": 1.2})
    assert far.fit.misfit > base.fit.misfit  # a fit started one step too far stays there
    found = fits.best_of(("E1",), [{**base.fit.values, "E1": 1.2}], base)
    assert found.fit.values["E1"] == pytest.approx(0.6, abs=0.3) and found.fit.misfit < base.fit.misfit - 9


def test_the_parent_with_zero_magnitude_is_a_fit(toy):
    made = crossing(toy, 0.0).drawn(np.random.default_rng(3), {})
    fits = Refits(made, DEFAULT, 1.0, silent)
    base = fits.candidate_fit((), made.fit_problem(()).space.values)
    found = fits.best_of(("E2",), [{**base.fit.values, "E2": 1.0}], base)
    assert found.fit.misfit == base.fit.misfit and found.fit.values["E2"] == 0.0
    assert found.fit.names == (*base.fit.names, "E2") and found.fit.slope.shape[1] == len(found.fit.names)
    assert found.ln_evidence < base.ln_evidence + 1.0
    smooth = toy(effects=4, perturbations=5, curvature=0.01)
    at_zero = least_squares_fit(smooth.fit_problem(("E2",)), ("E2",), {**smooth.fit_problem(("E2",)).space.values})
    assert at_zero.names == found.fit.names
