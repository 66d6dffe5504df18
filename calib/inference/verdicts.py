"""One verdict and sentence per parameter: on a limit, stable, identified, confounded."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from calib.errors.errors import InputError
from calib.inference.constraints import Hold
from calib.inference.identify import Identifiability, faults, needed_std
from calib.inference.rules import RULES, WIDE
from calib.problem.space import Parameter, ParameterSpace

if TYPE_CHECKING:
    import pandas as pd

DOUBTS = {
    "misfit": "the model does not fit, so that the standard deviations do not hold",
    "held_out": "validation data contradict the model, so that the standard deviations do not hold",
    "few_data": "fewer than two effective degrees of freedom are left, too few to see an error of the model",
}
"""Why no parameter of a fit is identified, whatever its standard deviation."""


def integer_std(numbers: np.ndarray, misfits: np.ndarray, centre: float = 0.0, sd: float = math.inf) -> float:
    """Standard deviation of an integer parameter from the lowest misfit at each value.

    ``p(n) ~ exp(-misfit(n)/2 - ((n - centre)/sd)^2/2)``: the misfit is a whitened sum of squares, minimised over all
    other parameters (profile likelihood). A parabola through the neighbours, as for continuous parameters, would claim
    a standard deviation of half a step where a neighbour is in fact excluded.

    Parameters
    ----------
    numbers, misfits : ndarray (n,)
        Values tried, the best one and its neighbours at least; an infinite misfit marks an impossible value.
    centre, sd : float
        Prior; default none.

    Raises
    ------
    InputError
        When no value has a finite misfit.
    """
    numbers, misfits = np.asarray(numbers, dtype=float), np.asarray(misfits, dtype=float)
    total = misfits + ((numbers - centre) / sd) ** 2
    if not np.any(np.isfinite(total)):
        raise InputError("no value of the integer could be evaluated", place="identifiability")
    weight = np.exp(-0.5 * (np.where(np.isfinite(total), total, np.inf) - np.nanmin(total)))
    weight /= weight.sum()
    mean = float(weight @ numbers)
    return math.sqrt(max(float(weight @ (numbers - mean) ** 2), 0.0))


def parameter_verdicts(
    space: ParameterSpace,
    values: Mapping[str, float],
    found: Identifiability,
    spread: Mapping[str, float] | None = None,
    whole: Mapping[str, float] | None = None,
    fits: bool | None = None,
    birge: float = 1.0,
    differing: Mapping[str, float] | None = None,
    held_by: Mapping[str, Hold] | None = None,
    doubts: Sequence[str] = (),
) -> pd.DataFrame:
    """Verdict and sentence for every free parameter.

    Parameters
    ----------
    space : ParameterSpace
    values : mapping
        At the optimum.
    found : Identification
    spread : mapping, optional
        Largest difference between cases over the range, from several searches or starts.
    whole : mapping, optional
        Standard deviations of integer parameters, see `integer_std`; without it they get no verdict.
    fits : bool, optional
        Whether the model fits within the measurement uncertainty; None where unknown.
    birge : float
        Factor by which the measurement uncertainty is scaled for the misfit; mentioned where it is not 1.
    differing : mapping, optional
        Parameters by which equally good solutions differ, and their largest differences over the range, see
        `calib.inference.agreement.Agreement`: none of them is identified, however small its standard deviation at one.
    held_by : mapping, optional
        Limits and constraints that hold parameters, see `calib.inference.constraints.holds`.
    doubts : sequence of str
        Why no parameter is identified, of `DOUBTS`.

    Returns
    -------
    DataFrame
        ``parameter, value, unit, lower, upper, ratio, on_limit, suggested_limit, spread, stable, std, low, high,
        needed, data_share, identified, not_identified, confounded_with, fits_within_std, sentence``; missing where
        unknown.
        ``low, high`` is the interval of 95 %, of one side where a limit or constraint holds the parameter.
        ``not_identified`` holds the reasons of `calib.inference.identify.faults`, ``constraint`` for a parameter that a
        constraint holds, ``beside_limit`` for one beside what a limit or constraint holds, ``solutions`` for one by
        which equally good solutions differ, and the doubts.
        A limit is suggested half a range further out; a limit of 0 is physical
        and stays.
    """
    import pandas as pd

    known = zip(found.posterior.std.tolist(), found.posterior.data_share.tolist(), strict=True)
    stds = dict(zip(found.posterior.names, known, strict=True))
    rows = []
    for p in space.free:
        ratio = p.position(values[p.name])
        width = None if spread is None or not math.isfinite(spread.get(p.name, math.nan)) else spread[p.name]
        std, share, identified = math.nan, math.nan, None
        why: tuple[str, ...] = ()
        if p.name in stds:
            std, share = stds[p.name]
        elif whole is not None and p.name in whole:
            std = whole[p.name]
            share = max(1.0 - (std / p.prior_width) ** 2, 0.0)
        side = p.limit_at(values[p.name], None if p.integer else std, found.searched)
        limit = _suggested(p, side)
        if p.integer and math.isfinite(limit):
            limit = float(math.floor(limit) if side == "lower" else math.ceil(limit))
        if not math.isnan(std):
            why = faults(p, std, share, values[p.name], found.searched)
            identified = not why
        hold = (held_by or {}).get(p.name)
        if hold is not None and hold.by and not math.isnan(std):
            why, identified = (*why, "constraint"), False
        elif hold is not None and hold.beside and not math.isnan(std):
            why, identified = (*why, "beside_limit"), False
        if doubts and not math.isnan(std):
            why, identified = (*doubts, *why), False
        low, high = _interval(p, values[p.name], math.nan if p.integer else std, hold)
        # Correlations are those of the reported solution: they say nothing on the distance to another one.
        others = [] if identified else found.confounded_with(p.name)
        trade = None if identified or others or p.name not in stds else found.trades_with(p.name)
        apart = (differing or {}).get(p.name)
        if apart is not None:
            why, identified = (*why, "solutions"), False
        stable = None if width is None else bool(width <= RULES.stable)
        rows.append(
            {
                "parameter": p.name,
                "value": values[p.name],
                "unit": p.unit,
                "lower": p.lower,
                "upper": p.upper,
                "ratio": ratio,
                "on_limit": side is not None,
                "suggested_limit": limit,
                "spread": math.nan if width is None else width,
                "stable": stable,
                "std": std,
                "low": low,
                "high": high,
                "needed": needed_std(p, values[p.name]),
                "data_share": share,
                "identified": identified,
                "not_identified": ", ".join(why),
                "confounded_with": ", ".join(others),
                "fits_within_std": fits,
                "sentence": _sentence(
                    p,
                    needed_std(p, values[p.name]),
                    side,
                    limit,
                    width,
                    std,
                    share,
                    None if identified is None else why,
                    birge,
                    others,
                    trade,
                    apart,
                    _of_one_side(hold, low, high, p.unit),
                ),
            }
        )
    return pd.DataFrame(rows)


def identified_sentence(verdicts: pd.DataFrame) -> str:
    """How many parameters are identified and which are not, from the table of `parameter_verdicts`."""
    assessed = verdicts[verdicts["identified"].notna()]
    bad = assessed.loc[~assessed["identified"].astype(bool), "parameter"].tolist()
    count = f"{len(assessed) - len(bad)} of {len(assessed)} parameters are identified"
    first = [str(why).split(", ")[0] for why in assessed["not_identified"]] if "not_identified" in assessed else []
    if first and set(first) <= set(DOUBTS):
        return f"{count}: {DOUBTS[first[0]]}."
    return count + (f"; not {', '.join(bad)}." if bad else ".")


def _interval(p: Parameter, value: float, std: float, hold: Hold | None) -> tuple[float, float]:
    """Interval of 95 % within the limits; NaN without a standard deviation."""
    if math.isnan(std):
        return math.nan, math.nan
    low, high = (-WIDE * std, WIDE * std) if hold is None else hold.interval(std)
    low, high = p.moved(value, low), p.moved(value, high)
    return max(low, min(p.lower, value)), min(high, max(p.upper, value))


def _of_one_side(hold: Hold | None, low: float, high: float, unit: str) -> str:
    """What holds a parameter and the interval that is left, in words; empty where nothing does."""
    if hold is None or math.isnan(low):
        return ""
    scale = "" if unit == "-" else f" {unit}"
    if hold.beside:
        return f"{hold.beside}, which the fit is against, moves it by {hold.beyond:.2g} standard deviations"
    left = f"(95 %: {low:.4g} to {high:.4g}{scale})"
    return f"the constraint {hold.by!r} holds it {left}" if hold.by else f" {left}"


def _suggested(p: Parameter, side: str | None) -> float:
    """A limit further out on the side of the active one, NaN where there is none."""
    lower, upper, half = p.lower, p.upper, 0.5 * (p.upper - p.lower)
    if p.is_log:
        return {"upper": p.at(1.5), "lower": p.at(-0.5)}.get(side or "", math.nan)
    if side == "upper":
        return (0.0 if upper < 0 < upper + half else upper + half) if upper != 0 else math.nan
    if side == "lower" and lower != 0:
        return lower - half if lower < 0 else max(lower - half, lower / 2)
    return math.nan


def _sentence(
    p: Parameter,
    needed: float,
    side: str | None,
    limit: float,
    width: float | None,
    std: float,
    share: float,
    why: Sequence[str] | None,
    birge: float,
    others: Sequence[str],
    trade: tuple[str, float] | None,
    apart: float | None,
    held: str,
) -> str:
    scale = "" if p.unit == "-" else f" {p.unit}"
    wider = "" if birge == 1.0 else f", measurement uncertainty scaled by {birge:.2g} for the misfit"
    words = []
    if side is not None:
        cure = f"widen it to {limit:.4g}{scale} if possible" if math.isfinite(limit) else "the limit is physical"
        words.append(f"Sits on its {side} search limit: {cure}, or suspect something missing in the model.")
    if why is None:
        kind = "is an integer and is not assessed by derivatives" if p.integer else "was not assessed"
        words.append(f"It {kind}.")
    elif not why and p.integer:
        words.append("Identified: its other values fit much worse.")
    elif not why:
        part = f"{std:.3g}{scale} (needed: {needed:.3g}{scale}{wider})"
        words.append(f"Identified, standard deviation {part}.")
    elif math.isinf(std):
        words.append("Not identified: neither data nor prior say anything on it.")
    else:
        words.append(f"Not identified: {'; '.join(_reasons(why, std, share, needed, scale, wider, apart, held))}.")
    if others:
        words.append(f"It is confounded with {', '.join(others)}.")
    if trade is not None:
        words.append(f"It trades most with {trade[0]} (correlation {trade[1]:.2f}).")
    if apart is None and width is not None and width > RULES.stable:
        words.append(f"Its spread over the cases is {100 * width:.0f} % of its search range.")
    return " ".join(words)


def _reasons(
    why: Sequence[str],
    std: float,
    share: float,
    needed: float,
    scale: str,
    wider: str,
    apart: float | None,
    held: str,
) -> list[str]:
    given = "less than 1" if share < 0.01 else f"only {100 * share:.0f}"
    words = {
        **DOUBTS,
        "wide": f"standard deviation {std:.3g}{scale}, more than is needed, {needed:.3g}{scale}{wider}",
        "prior": f"the data give {given} % of the information on it",
        "limit": f"a limit holds it{held}",
        "constraint": held,
        "beside_limit": held,
        "solutions": f"solutions that fit equally well differ by {100 * (apart or 0.0):.0f} % of its search range",
    }
    return [words[reason] for reason in why]
