"""Problems that read the ledger before they solve, and write into it what they have solved."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from calib.correlation.problem import FunctionProblem, ModalProblem
from calib.errors import EvaluationError
from calib.evaluate import BatchEvaluator
from calib.ledger import Ledger
from calib.outcome import Outcome, attempt, failure
from calib.questions.isolation import evaluator_of
from calib.study import Study


@dataclass(frozen=True, eq=False)
class RecordedFunction:
    """The function of a problem, asked only where the ledger does not know the answer.

    Attributes
    ----------
    asked : callable
        The function itself.
    fingerprint : str
        Of the problem.
    ledger : Ledger
    evaluator : BatchEvaluator
        Of that problem.
    """

    asked: Callable[[Mapping[str, float]], Mapping[str, float]]
    fingerprint: str
    ledger: Ledger
    evaluator: BatchEvaluator

    def __call__(self, values: Mapping[str, float]) -> Mapping[str, float]:
        """Named responses; EvaluationError where the function fails, or did."""
        (outcome,) = self.ledger.evaluate(self.fingerprint, [values], self.evaluator)
        if outcome.status == "failed":
            raise failure(outcome)
        return outcome.responses


def recorded_problem(problem: FunctionProblem, ledger: Ledger) -> FunctionProblem:
    """The same problem behind a ledger; one that is behind one stays as it is."""
    if isinstance(problem.function, RecordedFunction):
        return problem
    asked = RecordedFunction(problem.function, problem.fingerprint, ledger, evaluator_of(problem))
    return replace(problem, function=asked)


def recorded(study: Study, ledger: Ledger) -> Study:
    """The study with a plain function behind the ledger; what else is told needs modes, which no ledger keeps."""
    if not isinstance(study.problem, FunctionProblem):
        return study
    return replace(study, problem=recorded_problem(study.problem, ledger))


def unrecorded(problem: FunctionProblem | ModalProblem) -> FunctionProblem | ModalProblem:
    """The same problem, to be asked anew whatever a ledger knows."""
    if isinstance(problem, FunctionProblem) and isinstance(problem.function, RecordedFunction):
        return replace(problem, function=problem.function.asked)
    return problem


def asked_anew(problem: FunctionProblem | ModalProblem, values: Mapping[str, float]) -> Outcome:
    """One point, whatever a ledger knows of it; its seconds are those of the model, not of a process that starts."""
    problem = unrecorded(problem)
    if isinstance(problem, FunctionProblem):
        return evaluator_of(problem).evaluate([values])[0]
    return attempt(problem.evaluate, values)


def traced(
    problem: FunctionProblem | ModalProblem, values: Mapping[str, float], fault: EvaluationError
) -> EvaluationError:
    """A failure with the traceback of the user's code, which no ledger keeps: the point is asked once more for it."""
    known = isinstance(problem, FunctionProblem) and isinstance(problem.function, RecordedFunction)
    if not known or Outcome(dict(values), "failed", {}, str(fault)).transient:
        return fault
    again = asked_anew(problem, values)
    return failure(again) if again.status == "failed" else fault
