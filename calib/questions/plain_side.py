"""What an explanation of a study of plain responses needs beyond the decision itself."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from calib.correlation.problem import FunctionProblem
from calib.forward import Targets
from calib.function import FunctionModel, extend_function
from calib.missing.advice import Prospects
from calib.missing.findings import Findings, Trial
from calib.outcome import Outcome
from calib.questions.budget import Budget
from calib.questions.explanation import Told
from calib.questions.function_hypotheses import Failure, FunctionHypotheses
from calib.questions.verify import plain_errors, plain_scatter, whitened, withheld_targets
from calib.study import Study


@dataclass(frozen=True, eq=False)
class PlainSide:
    """Measured plain responses against a function.

    Attributes
    ----------
    problem : FunctionProblem
        The data that are used.
    withheld : mapping from group to targets
        Responses that enter no fit.
    hypotheses : FunctionHypotheses
    told : Told
    """

    problem: FunctionProblem
    withheld: Mapping[str, Targets]
    hypotheses: FunctionHypotheses
    told: Told

    @classmethod
    def of(cls, study: Study) -> PlainSide:
        """What a study of plain responses asks; where it is one test of several, changes of one test bear its name."""
        assert isinstance(study.model, FunctionModel)
        problem = study.problem
        assert isinstance(problem, FunctionProblem)
        hypotheses = FunctionHypotheses(
            study.model,
            study.targets,
            study.search_space.without(study.condition),
            study.candidates,
            problem.repeats,
            shares=problem.shares,
            test=study.test,
        )
        return cls(problem, withheld_targets(study), hypotheses, Told.of(study))

    @property
    def relative_std(self) -> np.ndarray:
        """See `calib.questions.explain.Side`."""
        return self.hypotheses.relative_std

    @property
    def budget_of_fits(self) -> float:
        """A function pays for its derivatives in calls; there is no bound that fits them all."""
        return math.inf

    def notes(self) -> list[str]:
        """What scatter is claimed or had to be assumed."""
        return list(self.told.notes)

    def errors(self, stages: dict[str, Trial], scale: float) -> tuple[pd.DataFrame, list[str], dict[str, object]]:
        """Errors by stage and group of data; failed points are noted."""
        labels = [row.sensor for row in self.hypotheses.rows]
        scatter, held_sd = plain_scatter(self.problem), self.told.held_sd
        parts = []
        for stage, trial in stages.items():
            s = trial.state
            withheld = {group: self._whitened(own, trial, s.names, scale) for group, own in self.withheld.items()}
            slope = -s.slope
            if withheld and held_sd:  # no unknowns of the fit: their columns are not in its slope
                slope = np.hstack([slope, self._whitened(self.problem.targets, trial, (), scale)[1]])
            table = plain_errors(s.residual, slope, s.names, s.prior_sd, labels, withheld, scatter)
            parts.append(table.assign(stage=stage))
        failures = self.hypotheses.failures
        notes = []
        if failures:
            points = f"{len(failures)} point{'s' * (len(failures) > 1)} failed"
            notes = [f"{points}; the first{_with(failures[0])}: {failures[0].outcome.error}."]
        return pd.concat(parts, ignore_index=True), notes, {"failed": len(failures)}

    def _whitened(
        self, targets: Targets, trial: Trial, names: Sequence[str], scale: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """See `calib.questions.verify.whitened`; of the model with the trial's effects."""
        model = extend_function(self.hypotheses.answers.model, trial.effects)
        problem = replace(self.problem, space=model.space, function=model.function)
        residual, jacobian = whitened(problem, targets, trial.state.values, names, self.told.held_sd)
        return residual / scale, jacobian / scale

    def failing(self) -> set[str]:
        """Effects of all points that failed."""
        return {name for failure in self.hypotheses.failures for name in failure.effects}

    def failed(self) -> list[Outcome]:
        """All points that failed."""
        return [failure.outcome for failure in self.hypotheses.failures]

    def prospects(self, found: Findings) -> Prospects | None:
        """A function does not tell what else could be measured."""
        return None

    def budget(self, found: Findings) -> Budget | None:
        """A function has no mesh."""
        return None

    def places(self) -> dict[str, tuple[str, tuple[float, float, float], str]]:
        """Local changes of a function have no place."""
        nowhere = (math.nan, math.nan, math.nan)
        kinds = {a.name: "response" if a.of_measurement else "parameter" for a in self.hypotheses.atoms}
        return {name: (kind, nowhere, "") for name, kind in kinds.items()}

    def tables(self, stages: dict[str, Trial]) -> dict[str, pd.DataFrame]:
        """``response_misfit``: whitened residual of every response by stage."""
        rows = [
            (stage, row.sensor, float(e))
            for stage, trial in stages.items()
            for row, e in zip(self.hypotheses.rows, trial.state.residual, strict=True)
        ]
        return {"response_misfit": pd.DataFrame(rows, columns=["stage", "response", "residual"])}


def _with(failure: Failure) -> str:
    return f" (with {', '.join(failure.effects)})" if failure.effects else ""
