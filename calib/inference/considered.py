"""Considered parameters: held ones whose values are uncertain, and what they add to the uncertainty of fitted ones."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple, Protocol

import numpy as np
import pandas as pd

from calib.errors.errors import EvaluationError
from calib.inference.constraints import ConstraintRows
from calib.inference.gauss_newton import fit
from calib.inference.identify import posterior
from calib.inference.region import InfeasibleError
from calib.inference.rules import RULES
from calib.problem.space import ParameterSpace

COLUMNS = ("parameter", "value", "unit", "std", "adds_to", "std_without", "std_with", "matters", "words")


class Fittable(Protocol):
    """A problem that can be fitted again with a held parameter elsewhere."""

    @property
    def space(self) -> ParameterSpace:
        """Its free parameters are fitted."""
        ...

    def residual(self, values: Mapping[str, float]) -> np.ndarray:
        """See `calib.inference.gauss_newton.LeastSquares`."""
        ...

    def jacobian(self, values: Mapping[str, float], names: Sequence[str]) -> np.ndarray:
        """See `calib.inference.gauss_newton.LeastSquares`."""
        ...


class At(NamedTuple):
    """A fit at its end.

    Attributes
    ----------
    names : tuple of str
        Fitted parameters.
    values : mapping from str to float
    residual : ndarray (n_rows,)
        Whitened.
    slope : ndarray (n_rows, n_params)
        Its derivative.
    prior_sd : ndarray (n_params,)
    fitted : bool
        Whether least squares ended there, so that a fit elsewhere can be compared with it.
    """

    names: tuple[str, ...]
    values: Mapping[str, float]
    residual: np.ndarray
    slope: np.ndarray
    prior_sd: np.ndarray
    fitted: bool


def changes_by_held(problem: Fittable, at: At, held_sd: Mapping[str, float]) -> np.ndarray:
    """Change of the whitened residual by one standard deviation of each held parameter, (n_rows, n_held).

    The shift of the estimates that follows, ``B = -V G^T H``, is linear. Where that is too coarse, H is taken from the
    residual at one standard deviation to either side (sigma points; Julier and Uhlmann 2004), within the limits, and
    after a fit B from new fits there: H is then the change that leads to this B.

    Parameters
    ----------
    problem : Fittable
    at : At
    held_sd : mapping from str to float
        Standard deviations of the held parameters.
    """
    if not held_sd:
        return np.zeros((len(at.residual), 0))
    covariance = posterior(at.names, at.slope, at.prior_sd).covariance
    std = np.sqrt(np.diag(covariance))
    linear = problem.jacobian(at.values, tuple(held_sd)) * list(held_sd.values())
    columns = [
        _column(problem, at, covariance, std, name, sd, linear[:, k]) for k, (name, sd) in enumerate(held_sd.items())
    ]
    return np.column_stack(columns)


def _column(
    problem: Fittable, at: At, covariance: np.ndarray, std: np.ndarray, name: str, sd: float, linear: np.ndarray
) -> np.ndarray:
    """The change by one held parameter; linear where the model cannot be evaluated to either side."""
    p, value = problem.space[name], at.values[name]
    ends = [min(max(value + way * sd, min(p.lower, value)), max(p.upper, value)) for way in (-1, 1)]
    width = (ends[1] - ends[0]) / sd
    if not width > 0 or not np.all(np.isfinite(std)):
        return linear
    points = [{**at.values, name: end} for end in ends]
    try:
        low, high = (problem.residual(point) for point in points)
    except EvaluationError:
        return linear
    secant = (high - low) / width
    bent = (high - at.residual) / (ends[1] - value) * sd if ends[1] > value else secant
    shifts = covariance @ (at.slope.T @ np.column_stack([secant - linear, bent - linear]))
    if np.all(np.abs(shifts) <= RULES.linear * std[:, None]):
        return linear
    if not at.fitted:
        return secant
    try:
        moved = [fit(problem, problem.space, point).values for point in points]
    except (EvaluationError, InfeasibleError):
        return secant
    shift = np.array([moved[1][n] - moved[0][n] for n in at.names]) / width
    # Of all H with this B the one that differs from the secant within the columns of G.
    scale = np.where(std > 0, std, 1.0)
    g = at.slope * scale
    wanted = g.T @ secant + (g.T @ g + np.diag((scale / at.prior_sd) ** 2)) @ (shift / scale)
    return np.asarray(secant - g @ np.linalg.lstsq(g.T @ g, wanted, rcond=1e-10)[0])


def explained_by_held(
    at: At, held: np.ndarray, constraints: ConstraintRows, stuck: Sequence[bool]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The fit as it would be with held parameters free under their priors, to first order.

    Its sum of squares tests the model with the covariance ``H H^T`` added to that of the data.

    Parameters
    ----------
    at : At
        At its optimum.
    held : ndarray (n_rows, n_held)
        From `changes_by_held`.
    constraints : ConstraintRows
        Rows beside the data.
    stuck : sequence of bool, length n_params
        Parameters that a limit holds; they stay there.

    Returns
    -------
    residual : ndarray (n_rows,)
    slope : ndarray (n_rows, n_params + n_held)
    prior_sd : ndarray (n_params + n_held,)
    """
    n, free = len(at.names), ~np.asarray(stuck, dtype=bool)
    slope, sd = np.hstack([at.slope, held]), np.concatenate([at.prior_sd, np.ones(held.shape[1])])
    if not held.shape[1]:
        return at.residual, slope, sd
    kept = np.concatenate([free, np.ones(held.shape[1], dtype=bool)])
    beside = np.hstack([constraints.slope, constraints.held])
    rows = (np.vstack([slope, beside]) * np.where(np.isfinite(sd), sd, 1.0))[:, kept]
    prior = np.isfinite(sd[kept]).astype(float)
    gradient = np.concatenate([np.zeros(n), held.T @ at.residual])[kept]  # of the fitted ones none is left
    step = -np.linalg.lstsq(rows.T @ rows + np.diag(prior), gradient, rcond=1e-13)[0]
    return at.residual + rows[: len(at.residual)] @ step, slope, sd


def considered_table(
    space: ParameterSpace,
    at: At,
    held: np.ndarray,
    held_sd: Mapping[str, float],
    constraints: ConstraintRows,
    birge: float = 1.0,
) -> pd.DataFrame:
    """What each held parameter adds to the standard deviation of the fitted one that it affects most.

    Parameters
    ----------
    space : ParameterSpace
    at : At
    held : ndarray (n_rows, n_held)
        From `changes_by_held`.
    held_sd : mapping from str to float
    constraints : ConstraintRows
    birge : float
        As in `calib.inference.identify.identify`.

    Returns
    -------
    DataFrame
        `COLUMNS`; those that matter first, by the share of the variance that they add. ``std_without`` and ``std_with``
        are those of ``adds_to`` without and with this parameter alone; it ``matters`` where it gives at least
        `Rules.considered` of that variance.
    """
    rows = []
    slope = np.vstack([at.slope / birge, constraints.slope])
    alone = posterior(at.names, slope, at.prior_sd)
    for k, (name, sd) in enumerate(held_sd.items()):
        h = np.concatenate([held[:, k] / birge, constraints.held[:, k]])
        shift = alone.covariance @ (slope.T @ h)
        with np.errstate(invalid="ignore", divide="ignore"):
            share = np.nan_to_num(shift**2 / (shift**2 + alone.std**2))
        if not len(share):
            continue
        most = int(np.argmax(share))
        to, unit = at.names[most], space[name].unit
        without, with_it = float(alone.std[most]), float(np.hypot(alone.std[most], shift[most]))
        matters = bool(share[most] >= RULES.considered)
        scale, own = (("" if u == "-" else f" {u}") for u in (space[to].unit, unit))
        words = (
            f"{name} is held at {at.values[name]:.4g} ± {sd:.3g}{own}, which takes the standard deviation of {to} from "
            f"{without:.3g} to {with_it:.3g}{scale}: select it, or state how sure its value is."
        )
        rows.append((share[most], (name, at.values[name], unit, sd, to, without, with_it, matters, words)))
    rows.sort(key=lambda row: -row[0])
    return pd.DataFrame([row for _, row in rows], columns=list(COLUMNS))
