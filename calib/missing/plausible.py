"""Physical plausibility of a fitted model: pulls of parameters, and limits of magnitudes and nuisance parameters."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, TypeAlias

import numpy as np
import pandas as pd
from scipy import special

from calib.missing.linearised_fit import LinearisedFit
from calib.missing.rules import RULES
from calib.problem.candidate import Candidate
from calib.problem.space import Parameter
from calib.results.answer import signed

_NAMED = 3
"""Pulled parameters that are told one by one."""
_Pull: TypeAlias = tuple[str, str, float, float, float, float, float, bool]
"""A row of `parameter_pulls`."""


def parameter_pulls(fit: LinearisedFit, added: Sequence[Candidate] = ()) -> pd.DataFrame:
    """Pull of each calibration parameter: its shift over the standard deviation of that shift.

    In a correctly specified model ``theta - c`` has the variance ``s^2 - V``, prior less posterior, and the pull is
    standard normal (Demortier and Lyons 2002). A parameter is pulled when its pull exceeds the normal quantile for all
    parameters together; it then absorbs a missing effect.

    Returns
    -------
    DataFrame
        ``parameter, unit, nominal, value, prior_sd, standardised, limit, pulled``.
    """
    columns = ["parameter", "unit", "nominal", "value", "prior_sd", "standardised", "limit", "pulled"]
    return pd.DataFrame(_pulls(fit, added), columns=columns)


def _pulls(fit: LinearisedFit, added: Sequence[Candidate]) -> list[_Pull]:
    """Rows of `parameter_pulls`, without the cost of a DataFrame: a decision needs hundreds of them."""
    own = {name for effect in added for name in effect.names}
    index = [k for k, name in enumerate(fit.names) if name not in own]
    limit = float(-special.ndtri(RULES.pull / (2 * max(len(index), 1))))
    rows = []
    for k in index:
        name, s = fit.names[k], float(fit.prior_sd[k])
        p = fit.fit_problem.space[name]
        variance = max(s**2 - float(fit.covariance[k, k]), 1e-6 * s**2)
        score = float(fit.shift[k]) * s / np.sqrt(variance)
        rows.append((name, p.unit, p.value, fit.values[name], s, score, limit, bool(abs(score) > limit)))
    return rows


def implausible(fit: LinearisedFit, added: Sequence[Candidate]) -> str:
    """Why a fitted model is implausible, in words; empty when it is plausible."""
    reasons = _pull_words(_pulls(fit, added))
    for effect in added:
        p, side = effect.magnitude, limit_of(fit, effect.magnitude)
        if side == "upper" or (side == "lower" and effect.signed):
            reasons.append(f"{effect.name} is on its limit of {_with_unit(getattr(p, side), p)}")
        if not is_whole(fit, effect):
            reasons.append(f"{effect.name} is there by {100 * fit.values[effect.name]:.2g} % only")
        for q in (q for q in effect.nuisance if not q.integer):  # a choice, of which the ends are as good as any
            here, side = fit.values[q.name], limit_of(fit, q)
            if side is not None:
                reasons.append(f"{q.name} is on its limit of {_with_unit(getattr(q, side), q)}")
            elif abs(q.pull(here)) > RULES.nuisance:
                reasons.append(f"{q.name} = {_with_unit(here, q)} is far from {q.value:.4g}")
    return "; ".join(reasons)


def _pull_words(rows: Sequence[_Pull]) -> list[str]:
    """Which parameters are pulled; of more than `_NAMED` those that are pulled most, with the number of others."""
    pulled_rows = [(name, score, limit) for name, *_, score, limit, pulled in rows if pulled]
    if len(pulled_rows) <= _NAMED:
        return [
            f"{name} has shifted by {signed(score, 1)} times its expected deviation (limit {limit:.1f})"
            for name, score, limit in pulled_rows
        ]
    most = sorted(pulled_rows, key=lambda row: -abs(row[1]))[:_NAMED]
    named = ", ".join(f"{name} by {signed(score, 1)}" for name, score, _ in most)
    return [
        f"{len(pulled_rows)} of {len(rows)} parameters have shifted too far, most of all {named} expected deviations "
        f"(limit {pulled_rows[0][2]:.1f})"
    ]


def limit_of(fit: LinearisedFit, p: Parameter) -> Literal["lower", "upper"] | None:
    """The limit that a fitted parameter is on; integers have no posterior standard deviation."""
    std = None
    if p.name in fit.names:
        k = fit.names.index(p.name)
        std = float(np.sqrt(fit.covariance[k, k]))
    return p.limit_at(fit.values[p.name], std)


def is_whole(fit: LinearisedFit, effect: Candidate) -> bool:
    """Whether a candidate that is there wholly or not at all has a magnitude of 1 or nearly (`DecisionRules.whole`)."""
    return not effect.whole or abs(fit.values[effect.name] - 1.0) < RULES.whole


def has_possible_size(fit: LinearisedFit, effect: Candidate) -> bool:
    """Whether no limit holds the fitted magnitude of a candidate, and it is whole where it must be."""
    return limit_of(fit, effect.magnitude) is None and is_whole(fit, effect)


def _with_unit(value: float, p: Parameter) -> str:
    return f"{value:.4g}" if p.unit == "-" else f"{value:.4g} {p.unit}"
