"""Effects that pair measured modes which a fitted model leaves unpaired."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from calib.errors.errors import EvaluationError
from calib.missing.hypotheses import FitProblem, Hypotheses
from calib.missing.linearised_fit import LinearisedFit
from calib.missing.rules import RULES
from calib.problem.candidate import Candidate
from calib.problem.shared_points import solve_shared


def pairing_points(
    hypotheses: Hypotheses,
    fit: LinearisedFit,
    candidates: Sequence[Candidate],
    fit_problem: Callable[[str], FitProblem],
) -> dict[str, dict[str, float]]:
    """Points at which effects pair measured modes that a fitted model leaves unpaired.

    The rows of such modes are constant, so that the derivative by an effect that would add the mode is zero. Every
    candidate is therefore tried over decades of its magnitude, within its limits, with the nuisance parameters of its
    grid.

    Parameters
    ----------
    hypotheses : Hypotheses
    fit : LinearisedFit
    candidates : sequence of Candidate
    fit_problem : callable
        Takes the name of a candidate, returns the fit problem with that candidate added.

    Returns
    -------
    dict
        For each effect that pairs a further mode, the point that pairs most, and among these the one with the smallest
        sum of squares. Empty, without any evaluation, when no mode is unpaired.
    """
    unpaired = hypotheses.unpaired(fit.effects, fit.values)
    out = {}
    tried = {effect.name: tried_points(effect) for effect in candidates if unpaired}
    solve_shared((fit_problem(name), {**fit.values, **point}) for name, points in tried.items() for point in points)
    for effect in candidates if unpaired else ():
        trials = []
        for point in tried[effect.name]:
            values = {**fit.values, **point}
            try:
                residual = fit_problem(effect.name).residual(values)
                gained = len(unpaired) - len(hypotheses.unpaired((*fit.effects, effect.name), values))
            except EvaluationError:
                continue
            trials.append((-gained, float(residual @ residual), point))
        best = min(trials, key=lambda one: one[:2], default=None)
        if best is not None and best[0] < 0:
            out[effect.name] = best[2]
    return out


def tried_points(effect: Candidate) -> list[dict[str, float]]:
    """Decades of magnitude of either sign within the limits, each with the nuisance parameters of the grid."""
    p = effect.magnitude
    sizes = [sign * effect.plausible * 10.0**k for k in RULES.decades for sign in (1.0, -1.0)]
    sizes = [s for s in sizes if p.lower <= s <= p.upper and s != p.value]
    nuisances = {tuple((q.name, point[q.name]) for q in effect.nuisance) for point in effect.grid} or {()}
    return [{p.name: size, **dict(one)} for one in sorted(nuisances) for size in np.sort(sizes).tolist()]
