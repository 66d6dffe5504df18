"""The function of a problem that may be the user's own: named values in, named numbers out, whatever it tells.

Of a plain function these are its responses, of a function of modes all frequencies, damping ratios and shapes. So both
run in a child process, and both are kept in a ledger: what is compared with a measurement follows from the numbers.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any, TypeVar

from calib.correlation.problem import FunctionProblem, ModalProblem
from calib.fingerprint import digest_of
from calib.measurement.modal import Sensor
from calib.outcome import Outcome, attempt
from calib.structure.modal_answer import modes_from
from calib.structure.modal_function import Memory, ModalFunctionModel

Function = Callable[[Mapping[str, float]], Mapping[str, float]]
Forward = TypeVar("Forward", bound=FunctionProblem | ModalProblem)


@dataclass(frozen=True, eq=False)
class Numbered:
    """A function of modes that asks another one for their numbers.

    Attributes
    ----------
    numbers : callable
        See `calib.structure.modal_answer.numbers_of`.
    sensors : tuple of Sensor
    damped : bool
    """

    numbers: Function
    sensors: tuple[Sensor, ...]
    damped: bool

    def __call__(self, values: Mapping[str, float]) -> Mapping[str, Any]:
        """Modes as `calib.structure.modal_function.ModalFunctionModel` takes them."""
        return modes_from(self.numbers(values), self.sensors, self.damped)


def numbered(model: ModalFunctionModel, numbers: Function) -> ModalFunctionModel:
    """The model with another function behind it, which tells the numbers of its modes."""
    return replace(model, function=Numbered(numbers, model.sensors, model.damped), memory=Memory())


def function_of(problem: FunctionProblem | ModalProblem) -> Function | None:
    """The function that is asked for numbers; None for a model of matrices, which runs no code of the user's."""
    if isinstance(problem, FunctionProblem):
        return problem.function
    model = problem.model
    if not isinstance(model, ModalFunctionModel):
        return None
    return model.function.numbers if isinstance(model.function, Numbered) else model.numbers


def with_function(problem: Forward, function: Function) -> Forward:
    """The same problem with another function behind it."""
    if isinstance(problem, FunctionProblem):
        return replace(problem, function=function)
    assert isinstance(problem.model, ModalFunctionModel)
    return replace(problem, model=numbered(problem.model, function))


def kept_under(problem: FunctionProblem | ModalProblem) -> str:
    """Fingerprint of those numbers; modes do not depend on what they are compared with."""
    model = problem.model if isinstance(problem, ModalProblem) else None
    return model.fingerprint if isinstance(model, ModalFunctionModel) else problem.fingerprint


def with_library(fingerprint: str, library: str) -> str:
    """Fingerprint of numbers that parameters of a library's effects were asked along with."""
    return digest_of(fingerprint, library)[:16]


def modes_kept_under(problem: FunctionProblem | ModalProblem, library: str) -> tuple[str, ...]:
    """All fingerprints of the numbers of a function of modes; none of another problem, which has its responses only."""
    if isinstance(problem, FunctionProblem) or function_of(problem) is None:
        return ()
    own = kept_under(problem)
    return own, with_library(own, library)


def told_by(problem: FunctionProblem | ModalProblem, numbers: Outcome) -> Outcome:
    """What a problem's responses are where its function has told such numbers, or failed."""
    if isinstance(problem, FunctionProblem) or function_of(problem) is None or numbers.status == "failed":
        return numbers
    found = attempt(with_function(problem, lambda values: numbers.responses).evaluate, numbers.values)
    return replace(found, seconds=numbers.seconds)
