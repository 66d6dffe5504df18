"""What an explanation of a study of plain responses needs beyond the decision itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pandas as pd

from calib.function import FunctionModel
from calib.missing.advice import Prospects
from calib.missing.findings import Findings, Trial
from calib.questions.budget import Budget
from calib.questions.function_hypotheses import FunctionHypotheses
from calib.questions.verify import plain_errors
from calib.study import Study, Targets


@dataclass(frozen=True, eq=False)
class PlainSide:
    """A study whose model is a plain function.

    Attributes
    ----------
    study : Study
    hypotheses : FunctionHypotheses
    """

    study: Study
    hypotheses: FunctionHypotheses

    @classmethod
    def of(cls, study: Study) -> PlainSide:
        """Raises InputError when there are too few responses to name anything."""
        assert isinstance(study.model, FunctionModel)
        return cls(study, _hypotheses(study, study.targets))

    def notes(self) -> list[str]:
        """What scatter had to be assumed."""
        return [f"Assumed: {a.item}: {a.value} {a.unit} ({a.reason})." for a in self.hypotheses.assumptions]

    def errors(self, stages: dict[str, Trial], scale: float) -> tuple[pd.DataFrame, list[str], dict[str, object]]:
        """Errors by stage and group of data; failed points are noted."""
        held = self.study.settings.withheld
        groups = {"withheld_sensors": held.sensors, "withheld_modes": held.modes}
        labels = [row.sensor for row in self.hypotheses.rows]
        parts = []
        for stage, trial in stages.items():
            s = trial.state
            withheld = {
                group: self._unseen({n: self.study.whole_targets[n] for n in own}, trial, scale)
                for group, own in groups.items()
            }
            table = plain_errors(s.residual, -s.slope, s.names, s.prior_sd, labels, withheld)
            parts.append(table.assign(stage=stage))
        failures = self.hypotheses.failures
        notes = [f"{len(failures)} points failed; the first: {failures[0].error}."] if failures else []
        return pd.concat(parts, ignore_index=True), notes, {"failed": len(failures)}

    def _unseen(self, targets: Targets, trial: Trial, scale: float) -> tuple[np.ndarray, np.ndarray]:
        names = trial.state.names
        if not targets:
            return np.zeros(0), np.zeros((0, len(names)))
        # Asked with all responses, since a few by themselves are refused; then only the withheld ones are kept.
        question = _hypotheses(self.study, self.study.whole_targets).question(trial.names)
        kept = [k for k, name in enumerate(self.study.whole_targets) if name in targets]
        residual = question.residual(trial.state.values)[kept]
        return residual / scale, question.jacobian(trial.state.values, names)[kept] / scale

    def prospects(self, found: Findings) -> Prospects | None:
        """A function does not tell what else could be measured."""
        return None

    def budget(self, found: Findings) -> Budget | None:
        """A function has no mesh."""
        return None

    def places(self) -> dict[str, tuple[str, tuple[float, float, float], str]]:
        """Local changes of a function have no place."""
        nowhere = (float("nan"),) * 3
        return {a.name: ("parameter", (nowhere[0], nowhere[1], nowhere[2]), "") for a in self.hypotheses.atoms}

    def tables(self, stages: dict[str, Trial]) -> dict[str, pd.DataFrame]:
        """``response_misfit``: whitened residual of every response by stage."""
        rows = [
            (stage, row.sensor, float(e))
            for stage, trial in stages.items()
            for row, e in zip(self.hypotheses.rows, trial.state.residual, strict=True)
        ]
        return {"response_misfit": pd.DataFrame(rows, columns=["stage", "response", "residual"])}


def _hypotheses(study: Study, targets: Targets) -> FunctionHypotheses:
    assert isinstance(study.model, FunctionModel)
    return FunctionHypotheses(
        study.model, targets, study.search_space, study.candidates, repeats=study.settings.measurement.repeats
    )
