"""From which strength an effect shows in the data."""

from __future__ import annotations

import math

import numpy as np

from calib.effect import Effect
from calib.errors import EvaluationError
from calib.missing.hypotheses import Question
from calib.missing.score import DETECTABLE, Scores
from calib.missing.state import State

_HALVINGS = 2
"""Every one asks the model once: such a strength is told to a quarter of its range."""


def smallest_visible(found: Scores, name: str) -> float:
    """Strength of an effect from which it is found with about 90 % power; infinite where parameters absorb it all.

    To first order; see `visible_within_limits` for effects that grow faster than that.
    """
    own = [k for k, owner in enumerate(found.owners) if owner == name and found.size[k] > 0]
    return min((max(DETECTABLE / float(found.size[k]), float(found.onset[k])) for k in own), default=math.inf)


def visible_within_limits(question: Question, state: State, effect: Effect) -> float:
    """The same asked of the model itself, up to the limits of the strength; infinite when not even these show.

    A share by which something is softer, for instance, changes the data far more at its end than its derivative says.
    The other parameters may follow to first order.

    Parameters
    ----------
    question : Question
        The state's question with the effect added.
    state : State
        Fit without it.
    effect : Effect
        Without nuisance parameters.
    """
    ends = {effect.strength.lower, effect.strength.upper} - {effect.strength.value}
    return min((_onset(question, state, effect, end) for end in ends), default=math.inf)


def _onset(question: Question, state: State, effect: Effect, end: float) -> float:
    start = effect.strength.value

    def shows(strength: float) -> bool:
        try:
            there = question.residual({**state.values, effect.name: strength})
        except EvaluationError:
            return False
        return float(np.linalg.norm(state.outside((state.residual - there)[:, None]))) >= DETECTABLE

    if not shows(end):
        return math.inf
    low, high = start, end
    for _ in range(_HALVINGS):
        middle = (low + high) / 2
        low, high = (low, middle) if shows(middle) else (middle, high)
    return abs(high - start)
