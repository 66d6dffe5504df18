"""Responses of all tests of a problem at many points, evaluated in this process or by a given executor."""

from __future__ import annotations

from collections.abc import Mapping
from concurrent.futures import Executor
from contextlib import AbstractContextManager
from dataclasses import dataclass

from calib.analyses.case import objective_for
from calib.api.protocols import PosedProblem
from calib.execution.evaluate import Evaluator
from calib.execution.executor import ExecutorEvaluator, Injected
from calib.execution.outcome import Function
from calib.experiment import ForwardProblem
from calib.experiment.modal import Model, Test
from calib.inference.objective import JointObjective, Objective
from calib.problem.joint import of_test
from calib.results.fingerprint import digest_of


def own(model: Model, test: Test, values: Mapping[str, float]) -> dict[str, float]:
    """The values that belong to a model and a test, except those that the test's condition sets."""
    space = test.space(model)
    return {name: v for name, v in values.items() if name in space and name not in test.condition}


@dataclass(frozen=True, eq=False)
class Responses:
    """The forward model of searches and samples: named values in, named responses out.

    Attributes
    ----------
    problems : mapping from str to ForwardProblem
        Each test's model against the data in use, by name of the test.
    names : mapping from str to set of str
        Parameters of each test.
    """

    problems: Mapping[str, ForwardProblem]
    names: Mapping[str, frozenset[str]]

    @classmethod
    def of(cls, problem: PosedProblem) -> Responses:
        """Responses of a problem."""
        names = {test.name: frozenset(own(model, test, test.space(model).values)) for model, test in problem.pairs}
        return cls({test.name: test.problem(model) for model, test in problem.pairs}, names)

    def __call__(self) -> Function:
        """The evaluation function: this object is the source of an evaluator."""
        return self.at

    def at(self, values: Mapping[str, float]) -> dict[str, float]:
        """Responses at the values of all parameters, each prefixed by its test's name. See `JointObjective`."""
        return {
            of_test(test, name): value
            for test, problem in self.problems.items()
            for name, value in problem.evaluate({n: v for n, v in values.items() if n in self.names[test]}).items()
        }

    @property
    def fingerprint(self) -> str:
        """Changes whenever the responses at the same values could; those of a `Pair` have other names."""
        parts = []
        for test, problem in self.problems.items():
            held = {name: value for name, value in problem.space.values.items() if name not in self.names[test]}
            parts.append((test, problem.fingerprint, sorted(held.items())))
        return digest_of("responses by test", parts)[:16]

    @property
    def objective(self) -> Objective:
        """Objective of a search: that of a study with one test, summed over the tests."""
        return JointObjective({test: objective_for(problem) for test, problem in self.problems.items()})

    @property
    def measured(self) -> dict[str, str]:
        """Responses of a sensitivity analysis, with their names in its tables."""
        several = len(self.problems) > 1
        return {
            of_test(test, name): of_test(test, name) if several else name
            for test, problem in self.problems.items()
            for name in problem.sensitivity_responses
        }

    def evaluator(self, executor: Executor | Injected | None) -> AbstractContextManager[Evaluator | ExecutorEvaluator]:
        """Evaluator of batches of points: this process, or an executor."""
        return Evaluator(self) if executor is None else ExecutorEvaluator(self, executor)
