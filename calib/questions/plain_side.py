"""What an explanation of a test of plain responses needs beyond the decision itself."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from calib.correlation.response_residual import ResponseResidual
from calib.forward import Targets
from calib.missing.findings import Trial
from calib.questions.hypotheses import ModelHypotheses
from calib.questions.one_test import OneTest
from calib.questions.verify import plain_errors, plain_scatter, whitened


@dataclass(frozen=True, eq=False)
class PlainSide(OneTest):
    """Measured plain responses against a function.

    Attributes
    ----------
    withheld : mapping from group to targets
        Responses that enter no fit.
    """

    hypotheses: ModelHypotheses[ResponseResidual]
    withheld: Mapping[str, Targets]

    def errors_of(self, trial: Trial, scale: float) -> pd.DataFrame:
        """See `calib.questions.verify.plain_errors`."""
        s, used = trial.state, self.hypotheses.pair.problem
        withheld = {group: self._whitened(own, trial, s.names, scale) for group, own in self.withheld.items()}
        slope = -s.slope
        if withheld and self.told.held_sd:  # no unknowns of the fit: their columns are not in its slope
            slope = np.hstack([slope, self._whitened(used.targets, trial, (), scale)[1]])
        labels = [row.sensor for row in self.hypotheses.rows]
        return plain_errors(s.residual, slope, s.names, s.prior_sd, labels, withheld, plain_scatter(used))

    def _whitened(
        self, targets: Targets, trial: Trial, names: Sequence[str], scale: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """See `calib.questions.verify.whitened`; of the model with the trial's effects."""
        problem = self.hypotheses.question(trial.names).pair.problem
        residual, jacobian = whitened(problem, targets, trial.state.values, names, self.told.held_sd)
        return residual / scale, jacobian / scale

    def tables(self, stages: Mapping[str, Trial]) -> dict[str, pd.DataFrame]:
        """``response_misfit``: whitened residual of every response by stage."""
        rows = [
            (stage, row.sensor, float(e))
            for stage, trial in stages.items()
            for row, e in zip(self.hypotheses.rows, trial.state.residual, strict=True)
        ]
        return {"response_misfit": pd.DataFrame(rows, columns=["stage", "response", "residual"])}
