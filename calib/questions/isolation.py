"""A study whose function runs in a child process: whatever it does there, the command goes on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from calib.correlation.problem import FunctionProblem
from calib.evaluate import Evaluator
from calib.function import FunctionModel
from calib.outcome import failure
from calib.study import EvaluationSource, Study


@dataclass(frozen=True, eq=False)
class ChildFunction:
    """A study's function as asked in one child process, which is started when first asked and kept.

    The child knows the effects of the study's library, too: their parameters among the values are enough.

    Attributes
    ----------
    evaluator : Evaluator
        Of one process of its own; it ends with this object, or with the command.
    """

    evaluator: Evaluator

    def __call__(self, values: Mapping[str, float]) -> Mapping[str, float]:
        """Named responses; EvaluationError where the function fails, takes too long or ends its process."""
        (outcome,) = self.evaluator.evaluate([values])
        if outcome.status == "failed":
            raise failure(outcome)
        return outcome.responses


def evaluator_of(problem: FunctionProblem) -> Evaluator:
    """One that asks the problem's function where it runs: in its child process, or in this one."""
    if isinstance(problem.function, ChildFunction):
        return problem.function.evaluator
    return Evaluator(lambda: problem.evaluate)


def isolated(study: Study) -> Study:
    """The same study with its function in a child process; a model with matrices runs no foreign code and stays.

    The study's effects are built here, so that what is wrong with them is told, and asked there.
    """
    problem, model = study.problem, study.model
    if not isinstance(problem, FunctionProblem) or not isinstance(model, FunctionModel):
        return study
    source = EvaluationSource(str(study.file.resolve()), problem.fingerprint, "", tuple(study.adopted.items()))
    child = ChildFunction(Evaluator(source, 1, study.settings.calibration.time_limit, isolated=True))
    return replace(
        study,
        model=replace(model, function=child),
        problem=replace(problem, function=child),
        library=tuple(replace(effect, build=partial(_known_there, effect.build)) for effect in study.library),
    )


def _known_there(build: Callable[[Any], Any], model: Any) -> Any:
    """What an effect builds where its parameters are known to the model's function: nothing, unless it is wrong."""
    built = build(model)
    return None if callable(built) else built
