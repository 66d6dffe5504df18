"""Problems behind a ledger: known points are read from it, and new results are written to it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

from calib.analyses.provenance.isolation import evaluator_of
from calib.errors.errors import EvaluationError
from calib.execution.evaluate import Arrived, BatchEvaluator
from calib.execution.outcome import Outcome, attempt, failure, point_key
from calib.experiment.test import ForwardProblem
from calib.results.fingerprint import digest_of
from calib.results.ledger import Ledger
from calib.study.study import LoadedStudy


def with_library(fingerprint: str, library: str) -> str:
    """Fingerprint of numbers that also depend on parameters of a library's effects."""
    return digest_of(fingerprint, library)[:16]


def ledger_keys_of_modes(problem: ForwardProblem, library: str) -> tuple[str, ...]:
    """All fingerprints of the numbers of a function of modes; empty for any other problem."""
    if problem.numbers_function is None:
        return ()
    own = problem.ledger_key
    return own, with_library(own, library)


def outcome_of(problem: ForwardProblem, numbers: Outcome) -> Outcome:
    """Outcome of a problem from that of its function: its responses, or the failure."""
    if problem.numbers_function is None or numbers.status == "failed":
        return numbers
    found = attempt(problem.with_function(lambda values: numbers.responses).evaluate, numbers.values)
    return replace(found, seconds=numbers.seconds)


@dataclass(frozen=True, eq=False)
class RecordedFunction:
    """The function of a problem, called only at points that are not in the ledger.

    Attributes
    ----------
    asked : callable
        The function itself.
    fingerprint : str
        Key of its numbers in the ledger; the `ledger_key` of the problem.
    ledger : Ledger
    evaluator : BatchEvaluator
        Of that function.
    names : frozenset of str
        Parameters of the model.
    library : str
        Digest of the effects whose parameters may also be among the values; such points are stored separately.
    """

    asked: Callable[[Mapping[str, float]], Mapping[str, float]]
    fingerprint: str
    ledger: Ledger
    evaluator: BatchEvaluator
    names: frozenset[str] = frozenset()
    library: str = ""

    def __call__(self, values: Mapping[str, float]) -> Mapping[str, float]:
        """Named numbers; EvaluationError where the function fails, or failed before."""
        own = values.keys() <= self.names
        kept = self.fingerprint if own else with_library(self.fingerprint, self.library)
        (outcome,) = self.ledger.evaluate(kept, [values], self.evaluator)
        if outcome.status == "failed":
            raise failure(outcome)
        return outcome.responses


def recorded_problem(problem: ForwardProblem, ledger: Ledger, library: str = "") -> ForwardProblem:
    """The same problem with its function behind a ledger; unchanged for matrices, or if it is behind one already."""
    function = problem.user_function
    if function is None or isinstance(function, RecordedFunction):
        return problem
    names = frozenset(problem.space.names)
    return problem.with_function(
        RecordedFunction(function, problem.ledger_key, ledger, evaluator_of(problem), names, library)
    )


def recorded(study: LoadedStudy, ledger: Ledger) -> LoadedStudy:
    """The study with its function behind the ledger; unchanged for matrices, whose modes are not stored."""
    return replace(study, problem=recorded_problem(study.problem, ledger, study.library_digest))


def unrecorded(problem: ForwardProblem) -> ForwardProblem:
    """The same problem without its ledger, so that points are evaluated again."""
    function = problem.user_function
    return problem.with_function(function.asked) if isinstance(function, RecordedFunction) else problem


def reevaluated_numbers(problem: ForwardProblem, values: Mapping[str, float]) -> Outcome:
    """Numbers of the function at one point (for matrices its responses), evaluated again even if stored."""
    return evaluator_of(unrecorded(problem)).evaluate([values])[0]


def reevaluated(problem: ForwardProblem, values: Mapping[str, float]) -> Outcome:
    """One point, evaluated again even if stored; its duration excludes the start of a process."""
    if problem.user_function is None:
        return attempt(problem.evaluate, values)
    return outcome_of(problem, reevaluated_numbers(problem, values))


def traced(problem: ForwardProblem, values: Mapping[str, float], fault: EvaluationError) -> EvaluationError:
    """A failure with the traceback of the user's code, which no ledger stores: the point is evaluated again."""
    kept = isinstance(problem.user_function, RecordedFunction)
    if not kept or Outcome(dict(values), "failed", {}, str(fault)).transient:
        return fault
    again = reevaluated(problem, values)
    return failure(again) if again.status == "failed" else fault


@dataclass(frozen=True, eq=False)
class ModesEvaluator:
    """Evaluates batches of a problem whose function returns modes: these are computed, stored, and compared here.

    Attributes
    ----------
    problem : ForwardProblem
        Where its function is behind a ledger, modes are looked up and stored there.
    numbers : BatchEvaluator
        Evaluates the function.
    """

    problem: ForwardProblem
    numbers: BatchEvaluator

    @property
    def isolated(self) -> bool:
        """Whether the function runs in another process."""
        return self.numbers.isolated

    def evaluate(self, points: Sequence[Mapping[str, float]], arrived: Arrived = lambda outcome: None) -> list[Outcome]:
        """Responses in the order of the points, each also passed to ``arrived`` as soon as it is there."""
        found: dict[str, Outcome] = {}

        def came(numbers: Outcome) -> None:
            found[point_key(numbers.values)] = outcome = outcome_of(self.problem, numbers)
            arrived(outcome)

        function = self.problem.user_function
        evaluator = _WithListener(self.numbers, came)
        if isinstance(function, RecordedFunction):
            numbers = function.ledger.evaluate(function.fingerprint, points, evaluator)
        else:
            numbers = evaluator.evaluate(points)
        for one in numbers:  # stored ones do not arrive
            if point_key(one.values) not in found:
                came(one)
        return [found[point_key(values)] for values in points]


@dataclass(frozen=True, eq=False)
class _WithListener:
    """An evaluator with one more listener for arriving outcomes."""

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
