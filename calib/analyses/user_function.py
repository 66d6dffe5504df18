"""User function of a problem: a mapping from named values to named numbers.

For a function of scalar responses the numbers are these, for a function of modes all frequencies, damping ratios and
shapes. Both kinds therefore run in a child process and are stored in a ledger in the same way; what is compared with a
measurement is computed from the numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from calib.correlation.function_problem import FunctionProblem
from calib.correlation.problem import ModalProblem
from calib.fingerprint import digest_of
from calib.forward import ForwardProblem
from calib.measurement.modal import Sensor
from calib.outcome import Outcome, attempt
from calib.structure.modal_function import Memory, ModalFunctionModel
from calib.structure.modal_result import modes_from

Function = Callable[[Mapping[str, float]], Mapping[str, float]]
Forward = TypeVar("Forward", bound=ForwardProblem)


@dataclass(frozen=True, eq=False)
class Numbered:
    """A function of modes that takes their numbers from another function.

    Attributes
    ----------
    numbers : callable
        See `calib.structure.modal_result.numbers_of`.
    sensors : tuple of Sensor
    damped : bool
    """

    numbers: Function
    sensors: tuple[Sensor, ...]
    damped: bool

    def __call__(self, values: Mapping[str, float]) -> Mapping[str, Any]:
        """Modes, as `calib.structure.modal_function.ModalFunctionModel` expects them."""
        return modes_from(self.numbers(values), self.sensors, self.damped)


def numbered(model: ModalFunctionModel, numbers: Function) -> ModalFunctionModel:
    """The model with another function, which returns the numbers of its modes."""
    return replace(model, function=Numbered(numbers, model.sensors, model.damped), memory=Memory())


def function_of(problem: ForwardProblem) -> Function | None:
    """The function that returns the numbers; None for a model of matrices, which runs no user code."""
    if isinstance(problem, FunctionProblem):
        return problem.function
    model = problem.model
    if not isinstance(model, ModalFunctionModel):
        return None
    return model.function.numbers if isinstance(model.function, Numbered) else model.numbers


def with_function(problem: Forward, function: Function) -> Forward:
    """The same problem with another function."""
    if isinstance(problem, FunctionProblem):
        return replace(problem, function=function)
    assert isinstance(problem, ModalProblem) and isinstance(problem.model, ModalFunctionModel)
    return replace(problem, model=numbered(problem.model, function))


def ledger_key(problem: ForwardProblem) -> str:
    """Fingerprint of the numbers in the ledger; that of modes does not depend on the measurement."""
    model = problem.model if isinstance(problem, ModalProblem) else None
    return model.fingerprint if isinstance(model, ModalFunctionModel) else problem.fingerprint


def with_library(fingerprint: str, library: str) -> str:
    """Fingerprint of numbers that also depend on parameters of a library's effects."""
    return digest_of(fingerprint, library)[:16]


def ledger_keys_of_modes(problem: ForwardProblem, library: str) -> tuple[str, ...]:
    """All fingerprints of the numbers of a function of modes; empty for any other problem."""
    if isinstance(problem, FunctionProblem) or function_of(problem) is None:
        return ()
    own = ledger_key(problem)
    return own, with_library(own, library)


def outcome_of(problem: ForwardProblem, numbers: Outcome) -> Outcome:
    """Outcome of a problem from that of its function: its responses, or the failure."""
    if isinstance(problem, FunctionProblem) or function_of(problem) is None or numbers.status == "failed":
        return numbers
    found = attempt(with_function(problem, lambda values: numbers.responses).evaluate, numbers.values)
    return replace(found, seconds=numbers.seconds)
