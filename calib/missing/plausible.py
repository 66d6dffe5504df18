"""Whether a fitted model can be believed: no parameter strained, no strength or nuisance out of its physical range."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd
from scipy import special

from calib.effect import Effect
from calib.missing.rules import RULES
from calib.missing.state import State
from calib.space import Parameter


def strain(state: State, added: Sequence[Effect] = ()) -> pd.DataFrame:
    """How far each calibration parameter had to go, against how far it would go in a right model.

    In a right model ``theta - c`` scatters by ``sqrt(s^2 - V)``: the prior's standard deviation less what the data
    leave open. Beyond the normal quantile for all parameters together, something that is missing is being absorbed.

    Returns
    -------
    DataFrame
        ``parameter, unit, adopted, value, prior_sd, standardised, limit, strained``.
    """
    columns = ["parameter", "unit", "adopted", "value", "prior_sd", "standardised", "limit", "strained"]
    return pd.DataFrame(_strains(state, added), columns=columns)


def _strains(state: State, added: Sequence[Effect]) -> list[tuple[str, str, float, float, float, float, float, bool]]:
    """Rows of `strain`; a decision asks for hundreds of them."""
    own = {name for effect in added for name in effect.names}
    index = [k for k, name in enumerate(state.names) if name not in own]
    limit = float(-special.ndtri(RULES.strain / (2 * max(len(index), 1))))
    rows = []
    for k in index:
        name, s = state.names[k], float(state.prior_sd[k])
        p = state.question.space[name]
        told = max(s**2 - float(state.covariance[k, k]), 1e-6 * s**2)
        score = float(state.shift[k]) * s / np.sqrt(told)
        rows.append((name, p.unit, p.value, state.values[name], s, score, limit, bool(abs(score) > limit)))
    return rows


def implausible(state: State, added: Sequence[Effect]) -> str:
    """Why a fitted model is not believable, in words; empty when it is."""
    reasons = []
    for name, *_, score, _, strained in _strains(state, added):
        if strained:
            reasons.append(f"{name} had to move {score:+.1f} prior standard deviations")
    for effect in added:
        p = effect.strength
        for limit in (p.upper, p.lower) if effect.signed else (p.upper,):
            if _held(state, p, limit):
                reasons.append(f"{effect.name} is on its limit of {_with_unit(limit, p)}")
        for q in effect.nuisance:
            here = state.values[q.name]
            on = [limit for limit in (q.upper, q.lower) if _held(state, q, limit)]
            if on:
                reasons.append(f"{q.name} is on its limit of {_with_unit(on[0], q)}")
            elif abs(here - q.value) > RULES.nuisance * q.prior_width:
                reasons.append(f"{q.name} = {_with_unit(here, q)} is far from {q.value:.4g}")
    return "; ".join(reasons)


def _held(state: State, p: Parameter, limit: float) -> bool:
    """Whether a limit holds a fitted parameter: next to it for its range, and for what the data leave open."""
    near = RULES.at_limit * (p.upper - p.lower)
    if p.name in state.names:
        k = state.names.index(p.name)
        near = min(near, RULES.at_limit_std * float(np.sqrt(state.covariance[k, k])))
    return abs(state.values[p.name] - limit) <= near


def _with_unit(value: float, p: Parameter) -> str:
    return f"{value:.4g}" if p.unit == "-" else f"{value:.4g} {p.unit}"
