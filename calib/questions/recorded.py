"""Problems that read the ledger before they solve, and write into it what they have solved."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from calib.correlation.problem import FunctionProblem, ModalProblem
from calib.errors import EvaluationError
from calib.evaluate import Arrived, BatchEvaluator
from calib.ledger import Ledger
from calib.outcome import Outcome, attempt, failure, key_of
from calib.questions.isolation import evaluator_of
from calib.questions.user_function import Forward, function_of, kept_under, told_by, with_function, with_library
from calib.study import Study


@dataclass(frozen=True, eq=False)
class RecordedFunction:
    """The function of a problem, asked only where the ledger does not know the answer.

    Attributes
    ----------
    asked : callable
        The function itself.
    fingerprint : str
        Of its numbers, see `calib.questions.user_function.kept_under`.
    ledger : Ledger
    evaluator : BatchEvaluator
        Of that function.
    names : frozenset of str
        Parameters of the model that asks.
    library : str
        Digest of the effects whose parameters may be among the values besides; such points are kept apart.
    """

    asked: Callable[[Mapping[str, float]], Mapping[str, float]]
    fingerprint: str
    ledger: Ledger
    evaluator: BatchEvaluator
    names: frozenset[str] = frozenset()
    library: str = ""

    def __call__(self, values: Mapping[str, float]) -> Mapping[str, float]:
        """Named numbers; EvaluationError where the function fails, or did."""
        own = values.keys() <= self.names
        kept = self.fingerprint if own else with_library(self.fingerprint, self.library)
        (outcome,) = self.ledger.evaluate(kept, [values], self.evaluator)
        if outcome.status == "failed":
            raise failure(outcome)
        return outcome.responses


def recorded_problem(problem: Forward, ledger: Ledger, library: str = "") -> Forward:
    """The same problem with its function behind a ledger; matrices, and what is behind one, stay as they are."""
    function = function_of(problem)
    if function is None or isinstance(function, RecordedFunction):
        return problem
    names = frozenset(problem.space.names)
    return with_function(
        problem, RecordedFunction(function, kept_under(problem), ledger, evaluator_of(problem), names, library)
    )


def recorded(study: Study, ledger: Ledger) -> Study:
    """The study with its function behind the ledger; of matrices no ledger keeps the modes."""
    return replace(study, problem=recorded_problem(study.problem, ledger, study.library_digest))


def unrecorded(problem: Forward) -> Forward:
    """The same problem, to be asked anew whatever a ledger knows."""
    function = function_of(problem)
    return with_function(problem, function.asked) if isinstance(function, RecordedFunction) else problem


def numbers_anew(problem: FunctionProblem | ModalProblem, values: Mapping[str, float]) -> Outcome:
    """Numbers of the function at one point (of matrices responses), whatever a ledger knows of it."""
    return evaluator_of(unrecorded(problem)).evaluate([values])[0]


def asked_anew(problem: FunctionProblem | ModalProblem, values: Mapping[str, float]) -> Outcome:
    """One point, whatever a ledger knows of it; its seconds are those of the model, not of a process that starts."""
    if function_of(problem) is None:
        return attempt(problem.evaluate, values)
    return told_by(problem, numbers_anew(problem, values))


def traced(
    problem: FunctionProblem | ModalProblem, values: Mapping[str, float], fault: EvaluationError
) -> EvaluationError:
    """A failure with the traceback of the user's code, which no ledger keeps: the point is asked once more for it."""
    if (
        not isinstance(function_of(problem), RecordedFunction)
        or Outcome(dict(values), "failed", {}, str(fault)).transient
    ):
        return fault
    again = asked_anew(problem, values)
    return failure(again) if again.status == "failed" else fault


@dataclass(frozen=True, eq=False)
class ModesEvaluator:
    """Evaluates batches of a problem whose function tells modes: these are asked for, kept, and compared here.

    Attributes
    ----------
    problem : ModalProblem
        Where its function is behind a ledger, modes are looked up there and kept.
    numbers : BatchEvaluator
        Asks the function.
    """

    problem: ModalProblem
    numbers: BatchEvaluator

    @property
    def isolated(self) -> bool:
        """Whether the function runs in another process."""
        return self.numbers.isolated

    def evaluate(self, points: Sequence[Mapping[str, float]], arrived: Arrived = lambda outcome: None) -> list[Outcome]:
        """Responses in the order of the points, each also told to ``arrived`` as soon as it is there."""
        found: dict[str, Outcome] = {}

        def came(numbers: Outcome) -> None:
            found[key_of(numbers.values)] = outcome = told_by(self.problem, numbers)
            arrived(outcome)

        function = function_of(self.problem)
        asked = _Heard(self.numbers, came)
        if isinstance(function, RecordedFunction):
            numbers = function.ledger.evaluate(function.fingerprint, points, asked)
        else:
            numbers = asked.evaluate(points)
        for one in numbers:  # those that were known
            if key_of(one.values) not in found:
                came(one)
        return [found[key_of(values)] for values in points]


@dataclass(frozen=True, eq=False)
class _Heard:
    """An evaluator that tells one more listener what arrives."""

    inner: BatchEvaluator
    listener: Arrived

    @property
    def isolated(self) -> bool:
        return self.inner.isolated

    def evaluate(self, points: Sequence[Mapping[str, float]], arrived: Arrived = lambda outcome: None) -> list[Outcome]:
        def both(outcome: Outcome) -> None:
            arrived(outcome)
            self.listener(outcome)

        return self.inner.evaluate(points, both)
