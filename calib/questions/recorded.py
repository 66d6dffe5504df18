"""Problems that read the ledger before they solve, and write into it what they have solved."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from calib.correlation.compare import Comparison
from calib.correlation.problem import FunctionProblem, ModalProblem
from calib.correlation.residual import ModalResidual
from calib.errors import EvaluationError
from calib.evaluate import BatchEvaluator
from calib.ledger import Ledger, key_of
from calib.outcome import Outcome, attempt, failure
from calib.questions.isolation import evaluator_of
from calib.study import Study

_REMEMBERED = 8
"""Solved points kept with their modes, so that a derivative does not solve them again."""


@dataclass(eq=False)
class Counts:
    """Points that were asked: those the model was solved at, those already known, and those without an answer.

    A derivative asks for points too: by differences each of their ends, of modes the point itself.
    """

    solved: int = 0
    reused: int = 0
    failed: int = 0

    @property
    def asked(self) -> int:
        """All of them."""
        return self.solved + self.reused + self.failed


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
    counts : Counts
        Of what it is asked.
    """

    asked: Callable[[Mapping[str, float]], Mapping[str, float]]
    fingerprint: str
    ledger: Ledger
    evaluator: BatchEvaluator
    counts: Counts = field(default_factory=Counts)

    def __call__(self, values: Mapping[str, float]) -> Mapping[str, float]:
        """Named responses; EvaluationError where the function fails, or did."""
        key = key_of(values)
        before = self.ledger.lookup(self.fingerprint, [key]).get(key)
        (outcome,) = self.ledger.evaluate(self.fingerprint, [values], self.evaluator)
        if outcome.status == "failed":
            self.counts.failed += 1
            raise failure(outcome)
        if before is not None and before.status == "ok":
            self.counts.reused += 1
        else:
            self.counts.solved += 1
        return outcome.responses


def recorded_problem(problem: FunctionProblem, ledger: Ledger, counts: Counts | None = None) -> FunctionProblem:
    """The same problem behind a ledger, with counts of its own; one that is behind one stays there."""
    counts = counts or Counts()
    if isinstance(problem.function, RecordedFunction):
        return replace(problem, function=replace(problem.function, counts=counts))
    asked = RecordedFunction(problem.function, problem.fingerprint, ledger, evaluator_of(problem), counts)
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


@dataclass(frozen=True, eq=False)
class RecordedModes:
    """The whitened residual of modes and its derivatives; the ledger keeps both, since they need modes.

    Attributes
    ----------
    inner : ModalResidual
    ledger : Ledger
    counts : Counts
        Of what it is asked.
    """

    inner: ModalResidual
    ledger: Ledger
    counts: Counts = field(default_factory=Counts)
    _identity: str = field(init=False, repr=False)
    _solved: dict[str, Comparison] = field(init=False, repr=False, default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_identity", self.inner.fingerprint)

    @property
    def problem(self) -> ModalProblem:
        """What is solved."""
        return self.inner.problem

    def residual(self, values: Mapping[str, float]) -> np.ndarray:
        """Vector (n_rows,); EvaluationError where the model cannot be solved, or could not be."""
        complete = self.problem.space.complete(values)
        key = key_of(complete)
        known = self.ledger.vectors(self._identity, key, [""])
        if "" in known:
            self.counts.reused += 1
        else:
            known = {"": self.inner.of(self.at(complete))}
            self.ledger.keep_vectors(self._identity, key, known)
        return known[""]

    def jacobian(self, values: Mapping[str, float], names: Sequence[str]) -> np.ndarray:
        """Derivative of the vector per one of each parameter's own unit, (n_rows, n_params)."""
        complete = self.problem.space.complete(values)
        key = key_of(complete)
        known = self.ledger.vectors(self._identity, key, names)
        new = [name for name in names if name not in known]
        if new:
            found = self.at(self.inner.regular(complete, new))
            slope = self.inner.slope_of(found, new, self.inner.derivatives(found, new))
            columns = dict(zip(new, slope.T, strict=True))
            self.ledger.keep_vectors(self._identity, key, columns)
            known = known | columns
        elif names:
            self.counts.reused += 1
        return np.column_stack([known[name] for name in names]) if names else np.zeros((self.inner.n_rows, 0))

    def freq_jacobian(
        self, values: Mapping[str, float], names: Sequence[str]
    ) -> tuple[tuple[str, ...], np.ndarray, np.ndarray]:
        """As `ModalResidual.freq_jacobian` of all model modes."""
        found = self.at(self.inner.regular(self.problem.space.complete(values), names))
        return self.inner.freq_jacobian(values, names, every=True, found=found)

    def at(self, values: Mapping[str, float]) -> Comparison:
        """Model against measurement at all parameters; a point that could not be solved is not tried again."""
        key, identity = key_of(values), self.problem.fingerprint
        if key in self._solved:
            self.counts.reused += 1
            return self._solved[key]
        before = self.ledger.lookup(identity, [key]).get(key)
        if before is not None and before.status == "failed" and not before.transient:
            self.counts.failed += 1
            raise EvaluationError(before.error)
        started = time.perf_counter()
        try:
            found = self.problem.compare(values)
        except EvaluationError as fault:
            outcome = Outcome(dict(values), "failed", {}, str(fault), time.perf_counter() - started)
            self.ledger.append(identity, [outcome])
            self.counts.failed += 1
            raise
        self.counts.solved += 1
        seconds = time.perf_counter() - started
        self.ledger.append(identity, [Outcome(dict(values), "ok", self.problem.responses(found), "", seconds)])
        while len(self._solved) >= _REMEMBERED:
            del self._solved[next(iter(self._solved))]
        self._solved[key] = found
        return found
