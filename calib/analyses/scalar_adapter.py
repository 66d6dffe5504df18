"""Adapter of a test of scalar responses to the explanation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from calib.analyses.hypotheses import ModelHypotheses
from calib.analyses.one_test import OneTest
from calib.analyses.verify import scalar_errors, scalar_std, whitened
from calib.correlation.response_residual import ResponseResidual
from calib.forward import Targets
from calib.missing.explanation import CandidateFit


@dataclass(frozen=True, eq=False)
class ScalarAdapter(OneTest):
    """Measured scalar responses against a function.

    Attributes
    ----------
    held_out : mapping from group to targets
        Held-out responses.
    """

    hypotheses: ModelHypotheses[ResponseResidual]
    held_out: Mapping[str, Targets]

    def errors_of(self, candidate_fit: CandidateFit, scale: float) -> pd.DataFrame:
        """See `calib.analyses.verify.scalar_errors`."""
        s, used = candidate_fit.fit, self.hypotheses.pair.problem
        held_out = {group: self._whitened(own, candidate_fit, s.names, scale) for group, own in self.held_out.items()}
        slope = -s.slope
        if self.facts.held_sd:  # held parameters are not fitted, so their columns are not in its slope
            slope = np.hstack([slope, self._whitened(used.targets, candidate_fit, (), scale)[1]])
        labels = [row.sensor for row in self.hypotheses.rows]
        return scalar_errors(s.residual, slope, s.names, s.prior_sd, labels, held_out, scalar_std(used))

    def _whitened(
        self, targets: Targets, candidate_fit: CandidateFit, names: Sequence[str], scale: float
    ) -> tuple[np.ndarray, np.ndarray]:
        """See `calib.analyses.verify.whitened`; for the model with the effects of the candidate fit."""
        problem = self.hypotheses.fit_problem(candidate_fit.names).pair.problem
        residual, jacobian = whitened(problem, targets, candidate_fit.fit.values, names, self.facts.held_sd)
        return residual / scale, jacobian / scale

    def tables(self, stages: Mapping[str, CandidateFit]) -> dict[str, pd.DataFrame]:
        """``response_misfit``: whitened residual of every response by stage."""
        rows = [
            (stage, row.sensor, float(e))
            for stage, candidate_fit in stages.items()
            for row, e in zip(self.hypotheses.rows, candidate_fit.fit.residual, strict=True)
        ]
        return {"response_misfit": pd.DataFrame(rows, columns=["stage", "response", "residual"])}
