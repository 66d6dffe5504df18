"""Isolation: a study whose function runs in a child process, so that a crash there does not end the command."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeAlias

from calib.execution.evaluate import Evaluator
from calib.execution.executor import ExecutorEvaluator, Injected
from calib.execution.outcome import failure
from calib.execution.worker import Source
from calib.experiment.test import ForwardProblem
from calib.problem.effect import Effect
from calib.study.several import AnyStudy
from calib.study.study import EvaluationSource, LoadedStudy
from calib.study.study_file import StudyFile

if TYPE_CHECKING:
    from calib.execution.cluster import ClusterEvaluator

Workers: TypeAlias = int | Injected | None
"""Who evaluates points: a number of processes, None for one per core where that pays, an executor or a cluster."""


@dataclass(frozen=True, eq=False)
class ChildFunction:
    """A study's function in one child process, which starts at the first call and is kept.

    The child also has the effects of the study's library: it applies those whose parameters are among the values.

    Attributes
    ----------
    evaluator : Evaluator
        With one process of its own, which ends with this object or with the command.
    """

    evaluator: Evaluator

    def __call__(self, values: Mapping[str, float]) -> Mapping[str, float]:
        """Named responses; EvaluationError where the function fails, takes too long or ends its process."""
        (outcome,) = self.evaluator.evaluate([values])
        if outcome.status == "failed":
            raise failure(outcome)
        return outcome.responses


def evaluator_of(problem: ForwardProblem) -> Evaluator:
    """Evaluator of the numbers of a problem's function, in its child process or in this one.

    For a model of matrices it evaluates responses.
    """
    function = problem.user_function
    if isinstance(function, ChildFunction):
        return function.evaluator
    evaluated = problem.numbers_function or problem.evaluate
    return Evaluator(lambda: evaluated)


def isolated(study: LoadedStudy) -> LoadedStudy:
    """The same study with its function in a child process; a model of matrices runs no user code and stays as it is.

    The study's effects are built here, so that errors in them are reported, and evaluated there.
    """
    problem: Any = study.problem
    model: Any = study.model
    if problem.user_function is None:
        return study
    source = EvaluationSource.of(study, problem)
    child = ChildFunction(Evaluator(source, 1, study.settings.evaluation_limit, isolated=True))
    return replace(
        study,
        model=model.with_function(child),
        problem=problem.with_function(child),
        library=tuple(map(_known_there, study.library)),
    )


def _known_there(effect: Effect) -> Effect:
    """The effect and its richer members, each built by the other process."""
    richer = None if effect.richer is None else _known_there(effect.richer)
    return replace(effect, build=KnownThere(effect.build), richer=richer)


@dataclass(frozen=True)
class KnownThere:
    """Build of an effect that the child's function applies itself: None, or what an invalid builder returned.

    Attributes
    ----------
    function : callable
        The builder.
    """

    function: Callable[[Any], Any]

    def __call__(self, model: Any) -> Any:
        """None where the builder returns a function of the extended parameters."""
        built = self.function(model)
        return None if callable(built) else built


def stated_time_limit(study: StudyFile) -> float | None:
    """The time limit in a study's file; None where it has none, since the default holds for the own pool only."""
    given = study.settings.calibration
    return given.time_limit if "time_limit" in given.model_fields_set else None


def injected_evaluator(study: AnyStudy, source: Source, workers: Injected) -> ExecutorEvaluator | ClusterEvaluator:
    """Evaluator of a study's points by an executor or a cluster; InputError where that cannot keep its time limit."""
    if study.in_memory:
        return workers.evaluator(source)
    return workers.evaluator(source, stated_time_limit(study), study.settings.evaluation_limit)
