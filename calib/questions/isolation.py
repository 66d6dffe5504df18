"""A study whose function runs in a child process: whatever it does there, the command goes on."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

from calib.correlation.problem import FunctionProblem, ModalProblem
from calib.evaluate import Evaluator
from calib.function import FunctionModel
from calib.outcome import failure
from calib.questions.user_function import function_of, numbered, with_function
from calib.structure.model import StructuralModel
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


def evaluator_of(problem: FunctionProblem | ModalProblem) -> Evaluator:
    """One that asks the problem's function for its numbers where it runs: in its child process, or in this one.

    Of a model of matrices it asks for responses.
    """
    function = function_of(problem)
    if isinstance(function, ChildFunction):
        return function.evaluator
    asked = function if isinstance(problem, ModalProblem) and function is not None else problem.evaluate
    return Evaluator(lambda: asked)


def isolated(study: Study) -> Study:
    """The same study with its function in a child process; a model with matrices runs no foreign code and stays.

    The study's effects are built here, so that what is wrong with them is told, and asked there.
    """
    problem, model = study.problem, study.model
    if isinstance(model, StructuralModel):
        return study
    source = EvaluationSource.of(study, problem)
    child = ChildFunction(Evaluator(source, 1, study.settings.calibration.time_limit, isolated=True))
    return replace(
        study,
        model=replace(model, function=child) if isinstance(model, FunctionModel) else numbered(model, child),
        problem=with_function(problem, child),
        library=tuple(replace(effect, build=partial(_known_there, effect.build)) for effect in study.library),
    )


def _known_there(build: Callable[[Any], Any], model: Any) -> Any:
    """What an effect builds where its parameters are known to the model's function: nothing, unless it is wrong."""
    built = build(model)
    return None if callable(built) else built
