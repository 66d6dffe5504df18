"""Least squares of plain responses, for models without matrices: derivatives by differences."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calib.errors import EvaluationError, InputError
from calib.space import Parameter, ParameterSpace


@dataclass(frozen=True, eq=False)
class DifferencedResponses:
    """Least squares of plain responses, with derivatives by central differences.

    Attributes
    ----------
    evaluate : callable
        Named values to named responses, such as ``FunctionProblem.evaluate``.
    targets : mapping from response name to (value, std or None)
        Measured; the residual is (measured - model)/std.
    space : ParameterSpace
        Differences stay within its limits and are one-sided at them.
    step : float
        Half the difference, over the range.
    unknown_std : float
        Standard deviation where none is known, over the size of the value.
    """

    evaluate: Callable[[Mapping[str, float]], Mapping[str, float]]
    targets: Mapping[str, tuple[float, float | None]]
    space: ParameterSpace
    step: float = 1e-4
    unknown_std: float = 0.01

    def __post_init__(self) -> None:
        if not self.targets:
            raise InputError("no target is given", place="targets", remedy="name at least one measured response")
        for name, (value, std) in self.targets.items():
            if not std and value == 0:
                raise InputError(
                    f"the target {name!r} is 0 and its standard deviation unknown", place="targets", remedy="give one"
                )

    @property
    def std(self) -> np.ndarray:
        """Standard deviation of every target, (n_rows,); the assumed share where none is known."""
        return np.array([std or self.unknown_std * abs(value) for value, std in self.targets.values()])

    def residual(self, values: Mapping[str, float]) -> np.ndarray:
        """(measured - model)/std of every target; EvaluationError for a response that is missing or not finite."""
        answer = self.evaluate(values)
        out = np.empty(len(self.targets))
        for k, (name, (value, _)) in enumerate(self.targets.items()):
            response = float(answer.get(name, math.nan))
            if not math.isfinite(response):
                raise EvaluationError(f"the response {name!r} is {response}")
            out[k] = value - response
        return out / self.std

    def jacobian(self, values: Mapping[str, float], names: Sequence[str]) -> np.ndarray:
        """Central differences, two evaluations a parameter; whole-number parameters count as fixed."""
        return central_jacobian(self.residual, self.space, values, names, self.step)


def central_jacobian(
    residual: Callable[[Mapping[str, float]], np.ndarray],
    space: ParameterSpace,
    values: Mapping[str, float],
    names: Sequence[str],
    step: float = 1e-4,
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
        Over the range between the limits.
    """
    complete = space.complete(dict(values))
    if not names:
        return np.zeros((len(residual(complete)), 0))
    return np.column_stack([difference(residual, complete, space[name], step) for name in names])


def difference(
    residual: Callable[[Mapping[str, float]], np.ndarray], values: Mapping[str, float], p: Parameter, step: float
) -> np.ndarray:
    """Derivative of a vector along one parameter by a central difference within its limits, shape (n_rows,).

    At a limit, or where one end fails, it is one-sided. Whole-number and held parameters have the derivative 0.

    Raises
    ------
    EvaluationError
        When the vector cannot be had on either side.
    """
    middle, half = values[p.name], step * (p.upper - p.lower)
    if p.integer or half == 0:
        return np.zeros_like(np.asarray(residual(values), dtype=float))
    ends, fault = [], EvaluationError(f"no difference along {p.name!r} lies within its limits")
    for at in (min(middle + half, p.upper), max(middle - half, p.lower)):
        if at == middle:
            continue
        try:
            ends.append((at, np.asarray(residual({**values, p.name: at}), dtype=float)))
        except EvaluationError as failed:
            fault = failed
    if not ends:
        raise fault
    if len(ends) == 1:
        ends.append((middle, np.asarray(residual(values), dtype=float)))
    (a, high), (b, low) = ends
    return (high - low) / (a - b)
