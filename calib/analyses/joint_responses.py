"""Responses of all tests of a study at many points, evaluated in this process or by a given executor."""

from __future__ import annotations

from collections.abc import Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace

from calib.analyses.provenance.isolation import Workers, injected_evaluator
from calib.analyses.provenance.recorded import unrecorded
from calib.correlation.modal.problem import ModalProblem
from calib.execution.evaluate import BatchEvaluator, Evaluator
from calib.execution.executor import Injected
from calib.execution.outcome import Function
from calib.experiment.test import ForwardProblem
from calib.inference.objective import FrequencyMacObjective, JointObjective, Objective, ResponseObjective
from calib.problem.joint import of_test
from calib.results.fingerprint import digest_of
from calib.study.search_settings import CalibrationSettings
from calib.study.several import AnyStudy
from calib.study.study import LoadedStudy


def own_values(study: LoadedStudy, values: Mapping[str, float]) -> dict[str, float]:
    """The values that belong to a test and its model, except those that its condition sets."""
    return {name: v for name, v in values.items() if name in study.problem.space and name not in study.condition}


def objective_for(problem: ForwardProblem, settings: CalibrationSettings) -> FrequencyMacObjective | ResponseObjective:
    """Objective that a search minimises, of a model against its measurement."""
    if not isinstance(problem, ModalProblem):
        return ResponseObjective(problem.search_targets)
    measured = problem.measured
    return FrequencyMacObjective(
        modes=measured.names,
        natural_freq=dict(zip(measured.names, measured.natural_freq.tolist(), strict=True)),
        weight_freq=settings.weight_freq,
        weight_mac=settings.weight_mac,
        use_mac=measured.has_shapes,
    )


@dataclass(frozen=True, eq=False)
class Responses:
    """The forward model of searches and samples: named values in, named responses out.

    Attributes
    ----------
    problems : mapping from str to ForwardProblem
        Each test's model against the data in use, by name of the test.
    names : mapping from str to set of str
        Parameters of each test.
    own_points : bool
        Whether the points hold all parameters of the only test, so that its own fingerprint tells its responses.
    """

    problems: Mapping[str, ForwardProblem]
    names: Mapping[str, frozenset[str]]
    own_points: bool = False

    @classmethod
    def of(cls, study: AnyStudy, instead: Mapping[str, ForwardProblem] | None = None) -> Responses:
        """Responses of a study; ``instead`` holds problems that replace its own, by name of the test."""
        problems = {one.test: (instead or {}).get(one.test, one.problem) for one in study.studies}
        names = {one.test: frozenset(own_values(one, one.search_space.values)) for one in study.studies}
        complete = all(set(one.problem.space.names) <= set(study.search_space.names) for one in study.studies)
        return cls(problems, names, len(problems) == 1 and complete)

    def __call__(self) -> Function:
        """The evaluation function: this object is the source of an evaluator."""
        return self.at

    def at(self, values: Mapping[str, float]) -> dict[str, float]:
        """Responses at the values of all parameters; of several tests each is prefixed by its name."""
        if len(self.problems) == 1:
            (problem,) = self.problems.values()
            return dict(problem.evaluate(values))
        return {
            of_test(test, name): value
            for test, problem in self.problems.items()
            for name, value in problem.evaluate({n: v for n, v in values.items() if n in self.names[test]}).items()
        }

    @property
    def fingerprint(self) -> str:
        """Changes whenever the responses at the same values could; those of a `Pair` have other names."""
        if self.own_points:
            (problem,) = self.problems.values()
            return problem.fingerprint
        parts = []
        for test, problem in self.problems.items():
            held = {name: value for name, value in problem.space.values.items() if name not in self.names[test]}
            parts.append((test, problem.fingerprint, sorted(held.items())))
        return digest_of("responses by test", parts)[:16]

    def objective(self, settings: CalibrationSettings) -> Objective:
        """Objective of a search: that of its only test, or the sum over all."""
        every = {test: objective_for(problem, settings) for test, problem in self.problems.items()}
        return JointObjective(every) if len(every) > 1 else next(iter(every.values()))

    @property
    def measured(self) -> tuple[str, ...]:
        """Responses of a sensitivity analysis."""
        several = len(self.problems) > 1
        return tuple(
            of_test(test, name) if several else name
            for test, problem in self.problems.items()
            for name in problem.sensitivity_responses
        )

    def evaluator(self, study: AnyStudy, workers: Workers) -> AbstractContextManager[BatchEvaluator]:
        """Evaluator of batches of points: this process, an executor or a cluster."""
        bare = replace(self, problems={test: unrecorded(problem) for test, problem in self.problems.items()})
        if isinstance(workers, Injected):
            return injected_evaluator(study, bare, workers)
        return Evaluator(bare)
