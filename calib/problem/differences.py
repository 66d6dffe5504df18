"""Finite-difference derivatives of a vector, for models that give none."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import partial

import numpy as np

from calib.errors.errors import EvaluationError
from calib.execution.ahead import evaluated_together
from calib.problem.space import Parameter, ParameterSpace

STEP = 1e-4
"""Half step of a central difference, over the range of a parameter."""


def central_jacobian(
    residual: Callable[[Mapping[str, float]], np.ndarray],
    space: ParameterSpace,
    values: Mapping[str, float],
    names: Sequence[str],
    step: float = STEP,
) -> np.ndarray:
    """Derivative of a vector by central differences, per one of each parameter's own unit, shape (n_rows, n_params).

    Parameters
    ----------
    residual : callable
    space : ParameterSpace
        Both points are kept within its limits.
    values : mapping
    names : sequence of str
    step : float
        Half the distance between the two points, as a share of the range between the limits along the scale.
    """
    complete = space.complete(dict(values))
    if not names:
        return np.zeros((len(residual(complete)), 0))
    ask_ahead(residual, complete, [space[name] for name in names], step)
    return np.column_stack([difference(residual, complete, space[name], step) for name in names])


def ask_ahead(
    function: Callable[[Mapping[str, float]], object],
    values: Mapping[str, float],
    parameters: Sequence[Parameter],
    step: float,
    one_sided: bool = False,
) -> None:
    """Evaluate the ends of all differences together, where workers share that; see `difference`."""
    count = 1 if one_sided else None
    ends = [{**values, p.name: end} for p in parameters for end in _ends(values, p, step, one_sided)[:count]]
    evaluated_together([partial(function, end) for end in ends])


def _ends(values: Mapping[str, float], p: Parameter, step: float, one_sided: bool = False) -> list[float]:
    """Ends of a difference within the limits of a parameter; none for an integer and for one that is held."""
    if p.integer or p.lower == p.upper:
        return []
    middle = values[p.name]
    half = step * p.span_at(middle)
    ends = [end for end in (min(middle + half, p.upper), max(middle - half, p.lower)) if end != middle]
    return sorted(ends, key=lambda end: -abs(end - middle)) if one_sided else ends


def difference(
    residual: Callable[[Mapping[str, float]], np.ndarray],
    values: Mapping[str, float],
    p: Parameter,
    step: float,
    one_sided: bool = False,
) -> np.ndarray:
    """Derivative of a vector along one parameter by a central difference within its limits, shape (n_rows,).

    It is one-sided where that is asked for, with the other end only where the first one fails or has an entry that is
    NaN; and at a limit, where one end fails, and for an entry that is NaN at one end; an entry that is NaN at
    both ends has the derivative NaN. Integer and held parameters have the derivative 0.

    Raises
    ------
    EvaluationError
        When the vector cannot be evaluated on either side.
    """
    middle = values[p.name]
    if p.integer or p.lower == p.upper:
        return np.zeros_like(np.asarray(residual(values), dtype=float))
    ends, fault = [], EvaluationError(f"no difference along {p.name!r} lies within its limits")
    for at in _ends(values, p, step, one_sided):
        try:
            ends.append((at, np.asarray(residual({**values, p.name: at}), dtype=float)))
        except EvaluationError as failed:
            fault = failed
        if one_sided and ends and not np.isnan(ends[-1][1]).any():
            break
    if not ends:
        raise fault
    if len(ends) == 1:
        ends.append((middle, np.asarray(residual(values), dtype=float)))
    (a, high), (b, low) = ends
    out = np.asarray((high - low) / (a - b))
    if np.isnan(out).any():
        here = np.asarray(residual(values), dtype=float)
        for at, end in ends:
            if at != middle:
                out = np.where(np.isnan(out), (end - here) / (at - middle), out)
    return out
