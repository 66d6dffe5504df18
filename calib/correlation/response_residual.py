"""Plain responses against a measurement in units of its scatter, with derivatives by differences."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib.correlation.problem import FunctionProblem
from calib.correlation.responses import ResponseRow, response_rows
from calib.differences import central_jacobian
from calib.errors import EvaluationError, InputError
from calib.fingerprint import digest_of
from calib.function import FunctionModel
from calib.outcome import answered
from calib.space import ParameterSpace

UNKNOWN_STD = 0.01
"""Standard deviation where none is known, over the size of the value."""

_DEFINITION = "response residual 1"
"""Part of the fingerprint; to be counted up whenever the same responses would give another residual or derivative."""


def response_std(targets: Mapping[str, tuple[float, float | None]]) -> np.ndarray:
    """Standard deviation of every target, (n_rows,); the assumed share where none is known."""
    return np.array([std or UNKNOWN_STD * abs(value) for value, std in targets.values()])


@dataclass(frozen=True, eq=False)
class ResponseResidual:
    """Whitened differences between measured and computed plain responses.

    Rows are (measured - model)/std of every target, in their order.

    Attributes
    ----------
    problem : FunctionProblem
        Differences stay within the limits of its space and are one-sided at them.
    step : float
        Half a difference, over the range between the limits.

    Raises
    ------
    InputError
        For a target of 0 whose standard deviation is unknown.
    """

    problem: FunctionProblem
    step: float = 1e-4

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
        """What every entry compares, length n_rows."""
        return response_rows(self.problem.targets)

    @property
    def relative_std(self) -> np.ndarray:
        """Standard deviation of every row over the size of its value, (n_rows,); infinite for a value of 0."""
        values, std = np.array([value for value, _ in self.problem.targets.values()]), self.std
        return np.divide(std, np.abs(values), out=np.full(len(std), np.inf), where=values != 0)

    @property
    def std(self) -> np.ndarray:
        """Standard deviation of every row, (n_rows,)."""
        return response_std(self.problem.targets)

    @property
    def fitted_factors(self) -> Mapping[tuple[str, str], int]:
        """None: no response has a free factor."""
        return {}

    @property
    def scatter_freedom(self) -> Mapping[str, float]:
        """Degrees of freedom behind the scatter of each kind of row; infinite where it is known."""
        return self.problem.scatter_freedom

    @property
    def fingerprint(self) -> str:
        """Hash that changes whenever the residual or its derivatives at the same named values could."""
        told = (list(self.problem.targets.items()), self.step)
        return digest_of(_DEFINITION, self.problem.fingerprint, told)[:16]

    def with_model(self, model: FunctionModel, added: int | None = None) -> ResponseResidual:
        """The same measured responses against another model; ``added`` is of modes."""
        return replace(self, problem=self.problem.with_model(model))

    def of(self, answer: Mapping[str, float]) -> np.ndarray:
        """Whitened residual of responses already computed; EvaluationError for one that is missing or not finite."""
        model = np.array([float(answer.get(name, np.nan)) for name in self.problem.targets])
        if not np.isfinite(model).all():
            worst = int(np.argmin(np.isfinite(model)))
            raise EvaluationError(f"the response {list(self.problem.targets)[worst]!r} is {model[worst]}")
        return (np.array([value for value, _ in self.problem.targets.values()]) - model) / self.std

    @property
    def told_by_responses(self) -> bool:
        """Whether a solution can be restored from its responses."""
        return True

    def solve(self, values: Mapping[str, float]) -> dict[str, float]:
        """Responses at named values; EvaluationError where the function, which may be the user's own, gives none."""
        return answered(self.problem.evaluate, values)

    def responses(self, solution: Mapping[str, float]) -> dict[str, float]:
        """They are the solution."""
        return dict(solution)

    def restored(self, responses: Mapping[str, float]) -> dict[str, float]:
        """A solution from responses that were kept."""
        return dict(responses)

    def unpaired(self, solution: Mapping[str, float]) -> frozenset[str]:
        """None: plain responses are told by their names."""
        return frozenset()

    def residual(self, values: Mapping[str, float]) -> np.ndarray:
        """Whitened residual at named values, (n_rows,); EvaluationError where the function gives no answer."""
        return self.of(self.solve(values))

    def jacobian(self, values: Mapping[str, float], names: Sequence[str]) -> np.ndarray:
        """Central differences, two evaluations a parameter, (n_rows, n_params); whole numbers count as fixed."""
        return self.slope(values, names, self.solve)

    def slope(
        self,
        values: Mapping[str, float],
        names: Sequence[str],
        at: Callable[[Mapping[str, float]], Mapping[str, float]],
    ) -> np.ndarray:
        """The same with solutions from ``at``."""
        return central_jacobian(lambda there: self.of(at(there)), self.problem.space, values, names, self.step)

    def frequencies(
        self,
        values: Mapping[str, float],
        names: Sequence[str],
        at: Callable[[Mapping[str, float]], Mapping[str, float]],
    ) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
        """None: a function has no modes; see `ModalResidual.frequencies`."""
        return (), np.zeros(0), np.zeros((0, len(names)))
