"""From which strength an effect shows in the data."""

from __future__ import annotations

import math
from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from calib.effect import Effect
from calib.errors import EvaluationError
from calib.missing.hypotheses import Question
from calib.missing.rules import RULES
from calib.missing.score import Scores
from calib.missing.state import State

_ASKED = 12
"""Residuals asked of the model for one sign of a strength."""
_CLOSE = 1.1
"""Ratio of the ends of the bracket that is close enough."""
_INWARD = (1.0, 0.99, 0.95, 0.9, 0.8, 0.65, 0.5, 0.3, 0.1)
"""Parts of the limit that are asked in turn until the model can be evaluated."""
_LEAST = 1e-4
"""Part of the limit below which nothing is looked for."""


def smallest_visible(found: Scores, name: str) -> float:
    """Strength of an effect from which it is found with about 90 % power; infinite where parameters absorb it all.

    To first order; see `visible_within_limits` for effects that grow faster than that.
    """
    own = [k for k in found.of(name) if found.size[k] > 0]
    return min((max(RULES.detectable / float(found.size[k]), float(found.onset[k])) for k in own), default=math.inf)


def visible_within_limits(
    question: Question, state: State, effect: Effect, nuisance: Mapping[str, float] = MappingProxyType({})
) -> float:
    """The same asked of the model itself, up to the limits of the strength; infinite when not even these show.

    A share by which something is softer, for instance, changes the data far more at its end than its derivative says.
    The other parameters may follow to first order. The strength is bracketed to 10 %. Where the model fails at a limit
    the largest strength takes its place that can be evaluated; if the effect does not show there either, nobody knows
    whether it would beyond: NaN.

    Parameters
    ----------
    question : Question
        The state's question with the effect added.
    state : State
        Fit without it.
    effect : Effect
    nuisance : mapping
        Values of its nuisance parameters.
    """
    ends = {effect.strength.lower, effect.strength.upper} - {effect.strength.value}
    found = [_onset(question, state, effect, end, nuisance) for end in ends]
    shows = min((size for size in found if not math.isnan(size)), default=math.inf)
    return math.nan if math.isinf(shows) and any(map(math.isnan, found)) else shows


def _onset(question: Question, state: State, effect: Effect, end: float, nuisance: Mapping[str, float]) -> float:
    start = effect.strength.value

    def shown(part: float) -> float | None:
        """Length of the change that the parameters cannot absorb, over what is detectable; None where a model fails."""
        try:
            there = question.residual({**state.values, **nuisance, effect.name: start + part * (end - start)})
        except EvaluationError:
            return None
        return float(np.linalg.norm(state.outside((state.residual - there)[:, None]))) / RULES.detectable

    # A model that fails at its limit tells nothing of smaller strengths: from there the next that it can be asked for.
    reached = ((part, size) for part in _INWARD if (size := shown(part)) is not None)
    high, above = next(reached, (0.0, 0.0))
    if above < 1:
        return math.inf if high == 1.0 else math.nan
    low, below = 0.0, 0.0
    for _ in range(_ASKED - 1):
        if high < _LEAST or (low and high / low < _CLOSE):
            break
        if below > 0:  # a power of the strength through both ends, well inside the bracket
            share = math.log(1 / below) / math.log(above / below)
            part = low * (high / low) ** min(max(share, 0.15), 0.85)
        else:
            part = low + (high - low) / 2 if low else high * min(max(0.7 / above, 0.1), 0.7)
        inside = [part + k / 4 * (high - part) for k in range(4)]
        # A failure inside the bracket tells nothing either: the next point nearer to its upper end is asked.
        part, size = next(((p, s) for p in inside if (s := shown(p)) is not None), (high, above))
        if part == high:
            break
        low, below, high, above = (low, below, part, size) if size >= 1 else (part, size, high, above)
    return high * abs(end - start)
