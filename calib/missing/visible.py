"""Smallest visible magnitude of an effect."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from calib.errors.errors import EvaluationError
from calib.missing.hypotheses import FitProblem
from calib.missing.linearised_fit import LinearisedFit
from calib.missing.rules import RULES
from calib.missing.score import Scores
from calib.problem.candidate import Candidate

_ASKED = 12
"""Residuals evaluated for one sign of a magnitude."""
_CLOSE = 1.1
"""Ratio of the ends of the bracket at which the search stops."""
_INWARD = (1.0, 0.99, 0.95, 0.9, 0.8, 0.65, 0.5, 0.3, 0.1)
"""Parts of the limit tried in turn until the model can be evaluated."""
_LEAST = 1e-4
"""Part of the limit below which the search stops."""


def smallest_visible(found: Scores, name: str) -> float:
    """Magnitude of an effect from which it is found with about 90 % power; infinite where the parameters absorb it.

    To first order; see `visible_within_limits` for effects that grow faster than that.
    """
    own = [k for k in found.of(name) if found.size[k] > 0]
    return min((max(RULES.detectable / float(found.size[k]), float(found.onset[k])) for k in own), default=math.inf)


def visible_within_limits(
    fit_problem: FitProblem, fit: LinearisedFit, effect: Candidate, nuisance: Mapping[str, float] = MappingProxyType({})
) -> float:
    """The same by evaluating the model, up to the limits of the magnitude; infinite when even these do not show.

    A loss of stiffness, for instance, changes the data far more near its limit than its derivative predicts. The other
    parameters are updated to first order. The magnitude is bracketed to 10 %. Where the model fails at a limit, the
    largest magnitude that can be evaluated takes its place; if the effect does not show there either, the result is
    NaN, since it might show beyond.

    Parameters
    ----------
    fit_problem : FitProblem
        The fit problem with the effect added.
    fit : LinearisedFit
        Fit without it.
    effect : Candidate
    nuisance : mapping
        Values of its nuisance parameters.
    """
    ends = {effect.magnitude.lower, effect.magnitude.upper} - {effect.magnitude.value}
    found = [_onset(fit_problem, fit, effect, end, nuisance) for end in ends]
    shows = min((size for size in found if not math.isnan(size)), default=math.inf)
    return math.nan if math.isinf(shows) and any(map(math.isnan, found)) else shows


def _onset(
    fit_problem: FitProblem, fit: LinearisedFit, effect: Candidate, end: float, nuisance: Mapping[str, float]
) -> float:
    start = effect.magnitude.value

    def shown(part: float) -> float | None:
        """Length of the projected change over the detectable one; None where the model fails."""
        try:
            there = fit_problem.residual({**fit.values, **nuisance, effect.name: start + part * (end - start)})
        except EvaluationError:
            return None
        return float(np.linalg.norm(fit.project_out((fit.residual - there)[:, None]))) / RULES.detectable

    # Where the model fails at the limit, the largest magnitude that can be evaluated takes its place.
    reached = ((part, size) for part in _INWARD if (size := shown(part)) is not None)
    high, above = next(reached, (0.0, 0.0))
    if above < 1:
        return math.inf if high == 1.0 else math.nan
    low, below = 0.0, 0.0
    for _ in range(_ASKED - 1):
        if high < _LEAST or (low and high / low < _CLOSE):
            break
        if below > 0:  # interpolated by a power law, well inside the bracket
            share = math.log(1 / below) / math.log(above / below)
            part = low * (high / low) ** min(max(share, 0.15), 0.85)
        else:
            part = low + (high - low) / 2 if low else high * min(max(0.7 / above, 0.1), 0.7)
        inside = [part + k / 4 * (high - part) for k in range(4)]
        # Where the model fails inside the bracket, a point nearer to its upper end is tried.
        part, size = next(((p, s) for p in inside if (s := shown(p)) is not None), (high, above))
        if part == high:
            break
        low, below, high, above = (low, below, part, size) if size >= 1 else (part, size, high, above)
    return high * abs(end - start)
