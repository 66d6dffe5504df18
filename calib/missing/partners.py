"""Measured modes that a fitted model has no partner for, and the effects that would give them one."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from calib.effect import Effect
from calib.errors import EvaluationError
from calib.missing.hypotheses import Hypotheses, Question
from calib.missing.rules import RULES
from calib.missing.state import State


def pairing_points(
    hypotheses: Hypotheses, state: State, candidates: Sequence[Effect], question: Callable[[str], Question]
) -> dict[str, dict[str, float]]:
    """Where effects pair measured modes that a fitted model leaves without a partner.

    Rows of such modes are constant: an effect that would bring the mode changes nothing to first order, and no step
    leads there. So every candidate is tried over decades of its strength, within its limits, with the nuisance
    parameters of its grid.

    Parameters
    ----------
    hypotheses : Hypotheses
    state : State
        The fit.
    candidates : sequence of Effect
    question : callable
        Takes the name of a candidate, returns the state's question with that candidate added.

    Returns
    -------
    dict
        For each effect that pairs a further mode, the point that pairs most, and among these the one that leaves the
        smallest sum of squares. Empty, and nothing solved, when no mode is without a partner.
    """
    lost = hypotheses.unpaired(state.effects, state.values)
    out = {}
    for effect in candidates if lost else ():
        tried = []
        for point in tried_points(effect):
            values = {**state.values, **point}
            try:
                residual = question(effect.name).residual(values)
                gained = len(lost) - len(hypotheses.unpaired((*state.effects, effect.name), values))
            except EvaluationError:
                continue
            tried.append((-gained, float(residual @ residual), point))
        best = min(tried, key=lambda one: one[:2], default=None)
        if best is not None and best[0] < 0:
            out[effect.name] = best[2]
    return out


def tried_points(effect: Effect) -> list[dict[str, float]]:
    """Decades of strength on both sides that the limits allow, each with the nuisance parameters of the grid."""
    p = effect.strength
    sizes = [sign * effect.plausible * 10.0**k for k in RULES.decades for sign in (1.0, -1.0)]
    sizes = [s for s in sizes if p.lower <= s <= p.upper and s != p.value]
    nuisances = {tuple((q.name, point[q.name]) for q in effect.nuisance) for point in effect.grid} or {()}
    return [{p.name: size, **dict(one)} for one in sorted(nuisances) for size in np.sort(sizes).tolist()]
