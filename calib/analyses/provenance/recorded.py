"""Problems behind a ledger: known points are read from it, and new results are written to it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, ClassVar

from calib.analyses.provenance.isolation import ChildFunction, Workers, evaluator_of, injected_evaluator
from calib.errors.errors import EvaluationError
from calib.execution.ahead import ask, is_collecting
from calib.execution.evaluate import Arrived, BatchEvaluator, Evaluator
from calib.execution.executor import Injected
from calib.execution.outcome import Function, Outcome, attempt, failure, point_key
from calib.execution.worker import available_cores
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


WORTH_SHARING = 0.02
"""Seconds of an evaluation from which points are shared: sending one takes a tenth of that."""
SHARED_AFTER = 10.0
"""Seconds of points asked for together before worker processes are started, where their number is not stated."""


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
    several : BatchEvaluator or None
        Evaluates points that are asked for together, by several workers; None where nobody shares them.
    patience : float
        Seconds of such points before it is used.
    """

    asked: Callable[[Mapping[str, float]], Mapping[str, float]]
    fingerprint: str
    ledger: Ledger
    evaluator: BatchEvaluator
    names: frozenset[str] = frozenset()
    library: str = ""
    several: BatchEvaluator | None = None
    patience: float = 0.0
    _times: list[float] = field(init=False, repr=False, default_factory=lambda: [0.0, 0.0])

    is_transparent: ClassVar[bool] = True
    """See `calib.results.fingerprint.digest_of`: what it holds beside the function grows with every point."""

    @property
    def __wrapped__(self) -> Callable[[Mapping[str, float]], Mapping[str, float]]:
        return self.asked

    def __call__(self, values: Mapping[str, float]) -> Mapping[str, float]:
        """Named numbers; EvaluationError where the function fails, or failed before."""
        if self.several is not None and self._times[0] >= WORTH_SHARING:
            ask(self, values, lambda: point_key(values) in self.ledger.lookup(self._kept(values), [point_key(values)]))
        if is_collecting():
            self.ledger.evaluate_ahead(self._kept(values), [values], self.evaluator)
        (outcome,) = self.ledger.evaluate(self._kept(values), [values], self.evaluator)
        if not is_collecting():
            self.ledger.first_use(self._kept(values), point_key(values))
        self._times[0] = max(outcome.seconds, self._times[0])
        if outcome.status == "failed":
            raise failure(outcome)
        return outcome.responses

    def ahead(self, points: Sequence[Mapping[str, float]]) -> None:
        """Evaluate points that are about to be asked for, by several workers once that is worth their start."""
        self._times[1] += self._times[0] * len(points)
        if self.several is None or self._times[1] < self.patience:
            return
        kept = {self._kept(values): True for values in points}
        for key in kept:
            self.ledger.evaluate_ahead(key, [values for values in points if self._kept(values) == key], self.several)

    def _kept(self, values: Mapping[str, float]) -> str:
        """Key in the ledger: points with parameters of effects are stored separately."""
        own = values.keys() <= self.names
        return self.fingerprint if own else with_library(self.fingerprint, self.library)


def recorded(study: LoadedStudy, ledger: Ledger, workers: Workers = 1) -> LoadedStudy:
    """The study with its function behind the ledger; unchanged for matrices, whose modes are not stored.

    Points that are asked for together, such as those of derivatives and of several starts, are shared by ``workers``
    (see `calib.execution.ahead`); results are the same whatever their number.

    Parameters
    ----------
    study : Study
    ledger : Ledger
    workers : int, Injected or None
        As in `calib.analyses.provenance.places.open_evaluator`. A function in this process is shared by an injected
        executor only, since it may not exist elsewhere.
    """
    problem = study.problem
    function: Any = problem.user_function
    if function is None or isinstance(function, RecordedFunction):
        return study
    patience = SHARED_AFTER if workers is None else 0.0
    kept = RecordedFunction(
        function, problem.ledger_key, ledger, evaluator_of(problem), frozenset(problem.space.names),
        study.library_digest, _several(study, workers), patience,
    )  # fmt: skip
    return replace(study, problem=problem.with_function(kept))


def _several(study: LoadedStudy, workers: Workers) -> BatchEvaluator | None:
    """Evaluator of the function of a study by several workers; None where nobody shares its points."""
    function = study.problem.user_function
    if isinstance(workers, Injected):
        if isinstance(function, ChildFunction):
            return injected_evaluator(study, function.evaluator.source, workers)
        return injected_evaluator(study, Evaluated(study.problem, numbers=True), workers)
    count = available_cores() if workers is None else workers
    if count == 1 or not isinstance(function, ChildFunction):
        return None
    return Evaluator(function.evaluator.source, count, study.settings.evaluation_limit)


@dataclass(frozen=True, eq=False)
class Evaluated:
    """Source of an evaluator: a forward problem of this process.

    Attributes
    ----------
    problem : ForwardProblem
    numbers : bool
        Whether a function of modes returns its numbers instead of the responses.
    """

    problem: ForwardProblem
    numbers: bool = False

    def __call__(self) -> Function:
        """From named values to named numbers."""
        return (self.problem.numbers_function if self.numbers else None) or self.problem.evaluate


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
