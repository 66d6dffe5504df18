"""A model with more effects never fits worse than the one it begins from, whatever happens on the way."""

from dataclasses import dataclass, fields

import numpy as np
import pytest

from calib.missing.explain import explain
from calib.missing.refits import DEFAULT, Refits
from calib.missing.state import fitted


def crossing(toy, edge, lure=""):
    """Beyond an effect's strength a mode has left the window, and every mode is paired with the next one."""
    plain = toy(effects=4, atoms=5, curvature=0.01)
    modes = len({row.mode for row in plain.rows})
    names = [e.name for e in (*plain.effects, *plain.atoms)]

    @dataclass(frozen=True, eq=False)
    class Crossing(type(plain)):
        def answer(self, values):
            exact = super().answer(values)
            crossed = any(abs(values.get(name, 0.0)) > edge for name in names)
            if crossed and lure:  # every further step away seems to help
                return exact - 200.0 * self.columns[lure] / np.linalg.norm(self.columns[lure])
            return np.roll(exact + 40.0, len(exact) // modes) - 10.0 if crossed else exact

    return Crossing(**{f.name: getattr(plain, f.name) for f in fields(plain)})


def parents(found):
    """Every fit with the best one of fewer effects that it holds."""
    known = [found.base, *found.trials, *([] if found.atom is None else [found.atom])]
    for trial in known:
        below = [t for t in known if set(t.names) < set(trial.names)]
        if below:
            yield trial, min(below, key=lambda t: t.state.misfit)


@pytest.mark.parametrize("edge", [0.0, 1e-3, 0.3])
@pytest.mark.parametrize("truth", [{"E1": 2.0}, {"E0": 1.5, "E3": 1.5}, {"A2": 1.5}])
def test_no_fit_ends_above_the_one_it_began_from(toy, edge, truth):
    made = crossing(toy, edge)
    plain = toy(effects=4, atoms=5, curvature=0.01).drawn(np.random.default_rng(3), truth)
    one = type(made)(**{f.name: getattr(made, f.name) for f in fields(made) if f.name != "data"}, data=plain.data)
    found = explain(one)
    pairs = list(parents(found))
    assert len(pairs) >= 3
    for trial, parent in pairs:
        assert trial.state.misfit <= parent.state.misfit * (1 + 1e-9)


def test_a_smaller_step_is_followed_where_the_whole_one_crosses(toy):
    """The right strength lies before the edge, the first step beyond it."""
    made = crossing(toy, 0.9, lure="E1")
    truth = {"E1": 0.8}
    plain = toy(effects=4, atoms=5, curvature=0.01).drawn(np.random.default_rng(3), truth)
    one = type(made)(**{f.name: getattr(made, f.name) for f in fields(made) if f.name != "data"}, data=plain.data)
    fits = Refits(one, DEFAULT, 1.0, lambda words: None)
    question = one.question(())
    base = fits.trial((), question.space.values)
    far = fits.trial(("E1",), {**base.state.values, "E1": 1.2})
    assert far.state.misfit > base.state.misfit  # one step too far stays there
    found = fits.best_of(("E1",), [{**base.state.values, "E1": 1.2}], base)
    assert found.state.values["E1"] == pytest.approx(0.6, abs=0.3) and found.state.misfit < base.state.misfit - 9


def test_a_parent_counts_with_the_further_effect_at_nothing(toy):
    made = crossing(toy, 0.0).drawn(np.random.default_rng(3), {})
    fits = Refits(made, DEFAULT, 1.0, lambda words: None)
    base = fits.trial((), made.question(()).space.values)
    found = fits.best_of(("E2",), [{**base.state.values, "E2": 1.0}], base)
    assert found.state.misfit == base.state.misfit and found.state.values["E2"] == 0.0
    assert found.state.names == (*base.state.names, "E2") and found.state.slope.shape[1] == len(found.state.names)
    assert found.ln_evidence < base.ln_evidence + 1.0
    smooth = toy(effects=4, atoms=5, curvature=0.01)
    at_zero = fitted(smooth.question(("E2",)), ("E2",), {**smooth.question(("E2",)).space.values})
    assert at_zero.names == found.state.names
