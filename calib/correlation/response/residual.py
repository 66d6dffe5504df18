"""Whitened residual of scalar responses, with derivatives by the function itself or by differences."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calib.correlation.response.problem import FunctionProblem, ResponseRow, response_rows
from calib.correlation.rules import RULES
from calib.errors.errors import EvaluationError, InputError
from calib.execution.outcome import named_responses
from calib.problem.candidate import Fault
from calib.problem.differences import STEP, central_jacobian
from calib.problem.space import ParameterSpace
from calib.results.fingerprint import digest_of
from calib.structure.function_model import DERIVES, DerivativesOnRequest, FunctionModel, responses_of, slope_entry
from calib.structure.modal_model import ModalModel

_DEFINITION = "response residual 1"
"""Part of the fingerprint; increment it whenever the same responses would give another residual or derivative."""


def response_std(targets: Mapping[str, tuple[float, float | None]]) -> np.ndarray:
    """Standard deviation of every target, (n_rows,); the assumed relative one where none is known."""
    return np.array([std or RULES.unknown_response_std * abs(value) for value, std in targets.values()])


@dataclass(frozen=True, eq=False)
class ResponseResidual:
    """Whitened differences between measured and computed scalar responses.

    Rows are (measured - model)/std of every target, in their order.

    Attributes
    ----------
    problem : FunctionProblem
        Differences stay within the limits of its space and are one-sided at them.
    step : float
        Half step of a difference, over the range between the limits.

    Raises
    ------
    InputError
        For a target of 0 whose standard deviation is unknown.
    """

    problem: FunctionProblem
    step: float = STEP

    def __post_init__(self) -> None:
        for name, (value, std) in self.problem.targets.items():
            if not std and value == 0:
                raise InputError(
                    f"the target {name!r} is 0 and its standard deviation unknown", place="targets", remedy="give one"
                )

    @property
    def space(self) -> ParameterSpace:
        """Parameters of the model."""
        return self.problem.space

    @property
    def rows(self) -> tuple[ResponseRow, ...]:
        """Labels of the rows, length n_rows."""
        return response_rows(self.problem.targets)

    @property
    def row_freqs(self) -> np.ndarray:
        """NaN: a scalar response stands for no frequency, (n_rows,), Hz."""
        return np.full(len(self.rows), np.nan)

    @property
    def shared_errors(self) -> np.ndarray:
        """(n_rows, 0): errors of responses are independent."""
        return np.zeros((len(self.rows), 0))

    @property
    def relative_std(self) -> np.ndarray:
        """Relative standard deviation of every row, (n_rows,); infinite for a value of 0."""
        values, std = self.measured_values, self.std
        return np.divide(std, np.abs(values), out=np.full(len(std), np.inf), where=values != 0)

    @property
    def std(self) -> np.ndarray:
        """Standard deviation of every row, (n_rows,)."""
        return response_std(self.problem.compared)

    @property
    def measured_values(self) -> np.ndarray:
        """What was measured in every row, (n_rows,)."""
        return np.array([value for value, _ in self.problem.targets.values()], dtype=float)

    @property
    def fitted_factors(self) -> Mapping[tuple[str, str], int]:
        """Empty: no response has a fitted factor."""
        return {}

    @property
    def std_dof(self) -> Mapping[str, float]:
        """Degrees of freedom behind the standard deviation of each kind of row; infinite where it is known."""
        return self.problem.std_dof

    @property
    def fingerprint(self) -> str:
        """Hash that changes whenever the residual or its derivatives at the same named values could."""
        content = (list(self.problem.compared.items()), self.step)
        return digest_of(_DEFINITION, self.problem.fingerprint, content)[:16]

    @property
    def faults(self) -> tuple[Fault, ...]:
        """None."""
        return ()

    def within(self, space: ParameterSpace) -> ResponseResidual:
        """The same with differences that stay within the limits of a space."""
        return replace(self, problem=replace(self.problem, space=space))

    def with_model(self, model: FunctionModel | ModalModel, added: int | None = None) -> ResponseResidual:
        """The same measured responses with another model; ``added`` concerns modes and is ignored."""
        return replace(self, problem=self.problem.with_model(model))

    def of(self, solution: Mapping[str, float]) -> np.ndarray:
        """Whitened residual of responses already computed; EvaluationError for one that is missing or not finite."""
        model = np.array([float(solution.get(name, np.nan)) for name in self.problem.targets])
        if not np.isfinite(model).all():
            worst = int(np.argmin(np.isfinite(model)))
            raise EvaluationError(f"the response {list(self.problem.targets)[worst]!r} is {model[worst]}")
        return (self.measured_values - model) / self.std

    @property
    def told_by_responses(self) -> bool:
        """Whether a solution can be restored from its responses."""
        return True

    def solve(self, values: Mapping[str, float]) -> dict[str, float]:
        """Responses at named values; EvaluationError where the function, possibly user code, fails."""
        return named_responses(self.problem.evaluate, values)

    def responses(self, solution: Mapping[str, float]) -> dict[str, float]:
        """Named responses, which are the solution itself."""
        return dict(solution)

    def restored(self, responses: Mapping[str, float]) -> dict[str, float]:
        """The solution from stored responses."""
        return dict(responses)

    def unpaired(self, solution: Mapping[str, float]) -> frozenset[str]:
        """Empty: scalar responses are matched by name."""
        return frozenset()

    def residual(self, values: Mapping[str, float]) -> np.ndarray:
        """Whitened residual at named values, (n_rows,); EvaluationError where the function fails."""
        return self.of(self.solve(values))

    def jacobian(self, values: Mapping[str, float], names: Sequence[str]) -> np.ndarray:
        """Derivatives that the function returns, else central differences, (n_rows, n_params); see `slope`."""
        return self.slope(values, names, self.solve)

    def slope(
        self,
        values: Mapping[str, float],
        names: Sequence[str],
        at: Callable[[Mapping[str, float]], Mapping[str, float]],
    ) -> np.ndarray:
        """The Jacobian with solutions from ``at``.

        Where the function returns the derivatives of all measured responses by a parameter, see
        `calib.structure.function_model.slope_entry`, they are taken; otherwise two evaluations differ. Integers count
        as fixed.
        """
        space, here = self.problem.space, at(values)
        entries = {name: [slope_entry(response, name) for response in self.problem.targets] for name in names}
        function: Any = self.problem.function
        if isinstance(function, DerivativesOnRequest) and (
            getattr(function, DERIVES, False) or len(responses_of(here)) < len(here)
        ):
            unknown = [name for name, own in entries.items() if any(entry not in here for entry in own)]
            here = {**here, **_told(function, values, unknown)}
        known = {
            name: -np.array([here[entry] for entry in own]) / self.std
            for name, own in entries.items()
            if not space[name].integer and all(entry in here for entry in own)
        }
        others = [name for name in names if name not in known]
        found = central_jacobian(lambda there: self.of(at(there)), space, values, others, self.step)
        columns = known | dict(zip(others, found.T, strict=True))
        return np.column_stack([columns[name] for name in names]) if names else found

    def frequencies(
        self,
        values: Mapping[str, float],
        names: Sequence[str],
        at: Callable[[Mapping[str, float]], Mapping[str, float]],
    ) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
        """Empty: a function has no modes; see `ModalResidual.frequencies`."""
        return (), np.zeros(0), np.zeros((0, len(names)))


def _told(function: DerivativesOnRequest, values: Mapping[str, float], names: Sequence[str]) -> dict[str, float]:
    """Derivatives that a function tells where it is asked; none where it fails, as two evaluations differ as well."""
    try:
        told = named_responses(lambda point: function.derivatives_by(point, names), values)
    except EvaluationError:
        return {}
    return {entry: slope for entry, slope in told.items() if np.isfinite(slope)}
