"""Profile-likelihood interval of a magnitude."""

from __future__ import annotations

import math

import numpy as np

from calib.errors.errors import EvaluationError
from calib.inference.rules import WIDE
from calib.missing.hypotheses import Altered
from calib.missing.linearised_fit import LinearisedFit, least_squares_fit

_TRIES = 3
"""Most corrections of one end; for a Gaussian posterior the first one is exact."""


def profile_interval(fit: LinearisedFit, name: str) -> tuple[float, float]:
    """95 % interval of one fitted parameter: where the profiled sum of squares increases by 1.96^2.

    The ends of the linearised interval are corrected by the root of the increase found there, which is linear in the
    parameter for a Gaussian posterior (profile t; Bates and Watts 1988). Errors that rows share do not average out:
    they move both ends away from the fitted value as they widen its standard deviation (`LinearisedFit.std`). An end
    beyond a limit is set to the limit.

    Parameters
    ----------
    fit : LinearisedFit
    name : str
    """
    k = fit.names.index(name)
    std, p, centre = float(np.sqrt(fit.covariance[k, k])), fit.fit_problem.space[name], fit.values[name]
    low, high, wider = _end(fit, k, -std), _end(fit, k, std), float(fit.std[k]) / std
    if wider > 1:
        low, high = max(centre + wider * (low - centre), p.lower), min(centre + wider * (high - centre), p.upper)
    return low, high


def _end(fit: LinearisedFit, k: int, std: float) -> float:
    name = fit.names[k]
    p, centre = fit.fit_problem.space[name], fit.values[name]
    here = centre + WIDE * std
    for _ in range(_TRIES):
        inside = min(max(here, p.lower), p.upper)
        rise = _rise(fit, k, inside)
        if math.isnan(rise):
            return inside
        if inside != here and rise < WIDE:
            return inside
        if rise <= 0 or inside == centre:
            return inside
        here = centre + (inside - centre) * WIDE / rise
        if abs(rise / WIDE - 1) < 0.05:
            break
    return min(max(here, p.lower), p.upper)


def _rise(fit: LinearisedFit, k: int, value: float) -> float:
    """Root of the increase of the sum of squares with one parameter held; NaN where the model cannot be solved."""
    name, column = fit.names[k], fit.covariance[:, k] / fit.covariance[k, k]
    step = column * (value - fit.values[name])
    start = {**fit.values, **{n: fit.values[n] + d for n, d in zip(fit.names, step, strict=True)}, name: value}
    p = fit.fit_problem.space[name]
    own = p.pull(value) ** 2
    try:
        there = least_squares_fit(Altered(fit.fit_problem, held={name: value}), fit.effects, start)
    except EvaluationError:
        return math.nan
    return math.sqrt(max(there.misfit + own - fit.misfit, 0.0))
