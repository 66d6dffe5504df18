"""Adapters of a test of scalar responses and of a test of FRFs to the explanation."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from calib.analyses.hypotheses import ModelHypotheses
from calib.analyses.one_test import OneTest
from calib.analyses.verify import group_errors, measuring, std_behind, whitened
from calib.correlation.frf_residual import FRFResidual
from calib.correlation.mesh import geometry_tables
from calib.correlation.response_residual import ResponseResidual
from calib.forward import Unseen
from calib.missing.explanation import CandidateFit
from calib.problem import Pair


@dataclass(frozen=True, eq=False)
class ScalarAdapter(OneTest):
    """Measured scalar responses against a function, or FRFs against a model with matrices.

    Attributes
    ----------
    held_out : mapping from group to targets or UnseenFRFs
        Held-out responses or FRFs.
    """

    hypotheses: ModelHypotheses[ResponseResidual] | ModelHypotheses[FRFResidual]
    held_out: Unseen

    def errors_of(self, candidate_fit: CandidateFit, scale: float) -> pd.DataFrame:
        """See `calib.analyses.verify.group_errors`."""
        s, used = candidate_fit.fit, self.hypotheses.pair
        problem = self.hypotheses.fit_problem(candidate_fit.names).pair.problem

        def at(pair: Pair, names: Sequence[str]) -> tuple[np.ndarray, np.ndarray]:
            residual, jacobian = whitened(pair, s.values, names, self.facts.held_sd)
            return residual / scale, jacobian / scale

        held_out = {group: at(measuring(problem, own), s.names) for group, own in self.held_out.items() if own}
        slope = -s.slope
        if self.facts.held_sd:  # held parameters are not fitted, so their columns are not in its slope
            slope = np.hstack([slope, at(self.hypotheses.fit_problem(candidate_fit.names).pair, ())[1]])
        labels = [row.sensor for row in self.hypotheses.rows]
        return group_errors(s.residual, slope, s.names, s.prior_sd, labels, held_out, std_behind(used))

    def tables(self, stages: Mapping[str, CandidateFit]) -> dict[str, pd.DataFrame]:
        """``response_misfit``: whitened residual of every response by stage."""
        rows = [
            (stage, row.sensor, float(e))
            for stage, candidate_fit in stages.items()
            for row, e in zip(self.hypotheses.rows, candidate_fit.fit.residual, strict=True)
        ]
        return {"response_misfit": pd.DataFrame(rows, columns=["stage", "response", "residual"])}


@dataclass(frozen=True, eq=False)
class FRFAdapter(ScalarAdapter):
    """Measured FRFs against a model with matrices."""

    hypotheses: ModelHypotheses[FRFResidual]

    def labels(self) -> pd.DataFrame:
        """Labels of the rows of data; ``mode`` is the line, such as ``12.5 Hz``, and ``part`` is ``re`` or ``im``."""
        rows = self.hypotheses.pair.rows
        return super().labels().assign(mode=[f"{row.freq:.10g} Hz" for row in rows], part=[row.part for row in rows])

    def tables(self, stages: Mapping[str, CandidateFit]) -> dict[str, pd.DataFrame]:
        """``frf_misfit``: whitened residuals of every function and line by stage; where effects act; the mesh."""
        rows = self.hypotheses.pair.rows
        columns = {"function": [r.sensor for r in rows], "part": [r.part for r in rows], "freq": [r.freq for r in rows]}
        by_stage = [pd.DataFrame(columns).assign(stage=s, residual=fit.fit.residual) for s, fit in stages.items()]
        parts = pd.concat(by_stage).pivot(index=["stage", "function", "freq"], columns="part", values="residual")
        return {
            "frf_misfit": parts.reset_index()[["stage", "function", "freq", "re", "im"]],
            "effect_places": self.effect_places(),
            **geometry_tables(self.hypotheses.pair.problem.model),
        }
