"""Interval of a strength by its profile likelihood."""

from __future__ import annotations

import math

import numpy as np

from calib.errors import EvaluationError
from calib.missing.hypotheses import Altered
from calib.missing.state import State, fitted

_RISE = 1.96
"""Root of the rise of the sum of squares at the ends of a 95 % interval."""
_TRIES = 3


def profile_interval(state: State, name: str) -> tuple[float, float]:
    """95 % interval of one fitted parameter: where the lowest sum of squares rises by 1.96^2.

    The ends of the linearised interval are moved by the root of the rise found there, which is linear in the parameter
    for a Gaussian posterior (Bates and Watts 1988, the profile t). An end beyond a limit is the limit.

    Parameters
    ----------
    state : State
    name : str
    """
    k = state.names.index(name)
    std = float(np.sqrt(state.covariance[k, k]))
    return _end(state, k, -std), _end(state, k, std)


def _end(state: State, k: int, std: float) -> float:
    name = state.names[k]
    p, centre = state.question.space[name], state.values[name]
    here = centre + _RISE * std
    for _ in range(_TRIES):
        inside = min(max(here, p.lower), p.upper)
        rise = _rise(state, k, inside)
        if math.isnan(rise):
            return inside
        if inside != here and rise < _RISE:
            return inside
        if rise <= 0 or inside == centre:
            return inside
        here = centre + (inside - centre) * _RISE / rise
        if abs(rise / _RISE - 1) < 0.05:
            break
    return min(max(here, p.lower), p.upper)


def _rise(state: State, k: int, value: float) -> float:
    """Root of the rise of the lowest sum of squares with one parameter held; NaN where the model cannot be solved."""
    name, column = state.names[k], state.covariance[:, k] / state.covariance[k, k]
    step = column * (value - state.values[name])
    start = {**state.values, **{n: state.values[n] + d for n, d in zip(state.names, step, strict=True)}, name: value}
    p = state.question.space[name]
    own = ((value - p.value) / p.prior_width) ** 2
    try:
        there = fitted(Altered(state.question, held={name: value}), state.effects, start)
    except EvaluationError:
        return math.nan
    return math.sqrt(max(there.misfit + own - state.misfit, 0.0))
