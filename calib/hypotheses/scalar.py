"""Adapters of tests whose data are compared value by value, scalar responses and FRFs, to the explanation."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd

from calib.correlation.frf.residual import FRFResidual
from calib.correlation.mesh_error import geometry_tables
from calib.correlation.response.residual import ResponseResidual
from calib.execution.stage import Progress, silent
from calib.experiment.held_out import HeldOutGroups
from calib.hypotheses.design.frf import frf_design
from calib.hypotheses.discretisation_error import frf_discretisation_error
from calib.hypotheses.hypotheses import ModelHypotheses
from calib.hypotheses.one_test import OneTest
from calib.hypotheses.verify import group_errors, held_out_residuals, predicted_spread, std_behind, whitened
from calib.missing.candidate_fit import CandidateFit
from calib.missing.explanation import Explanation
from calib.missing.facts import DiscretisationError, MeasurementFacts
from calib.missing.predictions import HeldOut
from calib.missing.recommendation import ExperimentalDesign
from calib.problem.effect import Effect
from calib.problem.problem import Pair
from calib.problem.space import ParameterSpace
from calib.structure.effects.perturbations import Perturbation
from calib.structure.effects.variants import Variants
from calib.structure.model import StructuralModel
from calib.structure.reduction.basis import Basis


def _no_finer() -> None:
    return None


@dataclass(frozen=True, eq=False)
class GroupAdapter(OneTest):
    """Data that are compared entry by entry, and held out by group.

    Attributes
    ----------
    held_out : mapping from group to HeldOutData
    """

    hypotheses: ModelHypotheses[ResponseResidual] | ModelHypotheses[FRFResidual]
    held_out: HeldOutGroups

    @property
    def left_out_std(self) -> float:
        """Those behind all rows together."""
        return std_behind(self.hypotheses.pair)

    def errors_of(self, candidate_fit: CandidateFit, scale: float) -> pd.DataFrame:
        """See `calib.hypotheses.verify.group_errors`."""
        s, pair = candidate_fit.fit, self._measuring(candidate_fit.names)
        held_out, slope = self._unseen(candidate_fit, pair, scale), self._uncertain(candidate_fit, pair, scale)
        labels = [row.sensor for row in self.hypotheses.rows]
        return group_errors(
            s.residual, slope, s.names, s.prior_sd, labels, held_out, self.left_out_std, s.others, s.active
        )

    def held_out_of(self, candidate_fit: CandidateFit, scale: float) -> dict[str, HeldOut]:
        """With the covariance of `calib.hypotheses.verify.predicted_spread`."""
        fit, pair = candidate_fit.fit, self._measuring(candidate_fit.names)
        slope, out = self._uncertain(candidate_fit, pair, scale), {}
        for group, (e, g) in self._unseen(candidate_fit, pair, scale).items():
            own = self.held_out[group].pair(pair.problem)
            out[group] = HeldOut(
                own.rows, own.measured_values, own.std * scale, np.zeros(len(e), dtype=bool), e, fit.names,
                -g[:, : len(fit.names)], predicted_spread(slope, fit.names, fit.prior_sd, g, fit.others),
                std_dof=self.left_out_std,
            )  # fmt: skip
        return out

    def residuals_held_out(
        self, names: tuple[str, ...], values: Mapping[str, float], by: Sequence[str]
    ) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """See `calib.hypotheses.verify.whitened`."""
        problem = self.hypotheses.fit_problem(names).pair.problem
        return {group: whitened(own.pair(problem), values, by) for group, own in self.held_out.items()}

    def _unseen(
        self, candidate_fit: CandidateFit, pair: Pair, scale: float
    ) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """See `calib.hypotheses.verify.held_out_residuals`."""
        fit = candidate_fit.fit
        unseen = held_out_residuals(pair.problem, self.held_out, fit.values, fit.names, self.facts.held_sd)
        return {group: (residual / scale, jacobian / scale) for group, (residual, jacobian) in unseen.items()}

    def _uncertain(self, candidate_fit: CandidateFit, pair: Pair, scale: float) -> np.ndarray:
        """Derivative of the residual of the used data, and its changes by one standard deviation of held parameters."""
        fit, held_sd = candidate_fit.fit, self.facts.held_sd
        if not held_sd:
            return -fit.slope
        # Held parameters are not fitted, so their columns are not in its slope.
        return np.hstack([-fit.slope, whitened(pair, fit.values, (), held_sd)[1] / scale])

    def _measuring(self, names: tuple[str, ...]) -> Pair:
        """The pair of a model with the named effects, by which held-out data are predicted."""
        return self.hypotheses.fit_problem(names).pair


@dataclass(frozen=True, eq=False)
class ScalarAdapter(GroupAdapter):
    """Measured scalar responses against a function."""

    hypotheses: ModelHypotheses[ResponseResidual]

    def tables(self, stages: Mapping[str, CandidateFit]) -> dict[str, pd.DataFrame]:
        """``response_misfit``: whitened residual of every response by stage."""
        rows = [
            (stage, row.sensor, float(e))
            for stage, candidate_fit in stages.items()
            for row, e in zip(self.hypotheses.rows, candidate_fit.fit.residual, strict=True)
        ]
        return {"response_misfit": pd.DataFrame(rows, columns=["stage", "response", "residual"])}


@dataclass(frozen=True, eq=False)
class FRFAdapter(GroupAdapter):
    """Measured FRFs against a model with matrices.

    Attributes
    ----------
    finer : callable
        Returns the model on a finer mesh, None without one.
    """

    hypotheses: ModelHypotheses[FRFResidual]
    finer: Callable[[], StructuralModel | None] = field(default=_no_finer, kw_only=True)

    @property
    def on_mesh(self) -> bool:
        """Yes: a finer mesh has other FRFs."""
        return True

    @staticmethod
    def of(
        pair: FRFResidual,
        effects: tuple[Effect, ...],
        local: tuple[Perturbation, ...],
        space: ParameterSpace,
        facts: MeasurementFacts,
        held_out: HeldOutGroups,
        basis: Basis | None = None,
        reduced: bool = False,
        finer: Callable[[], StructuralModel | None] = _no_finer,
    ) -> FRFAdapter:
        """The adapter of a model at full order; ``space`` holds the parameters of its fits.

        Fits use the ``basis``, which serves the effects too; held-out FRFs are predicted at full order. ``reduced`` as
        in `OneTest`, ``finer`` as in the class.
        """
        model = pair.problem.model
        assert model.reducible is not None
        variants = Variants(model.reducible, effects, tuple(perturbation.effect for perturbation in local), basis)
        hypotheses = ModelHypotheses(pair, variants, space)
        return FRFAdapter(hypotheses, local, facts, held_out, reduced=reduced, finer=finer)

    def _measuring(self, names: tuple[str, ...]) -> Pair:
        return super()._measuring(names) if self.hypotheses.variants.basis is None else self.at_full_order(names)

    def design(self, found: Explanation, progress: Progress = silent) -> ExperimentalDesign | None:
        """Candidate measurements, from the credible models."""
        if (doubted := self.doubted(found)) is None:
            return None
        unseen: Mapping[str, Any] = self.held_out
        held_out = {group: own.measured for group, own in unseen.items()}
        return frf_design(
            self.hypotheses, found.believed, *doubted, found.noise_scale, held_out, self.facts.samples,
            self.facts.seed, progress,
        )  # fmt: skip

    def discretisation_error(self, found: Explanation) -> DiscretisationError | None:
        """Scores that a finer mesh alone would give; None without one."""
        finer = self.finer()
        return None if finer is None else frf_discretisation_error(self.hypotheses, found.base.fit, finer)

    def labels(self) -> pd.DataFrame:
        """Labels of the rows of data; ``mode`` is the line, such as ``12.5 Hz``."""
        table = super().labels()
        return table.assign(mode=[f"{freq:.10g} Hz" for freq in table["freq"]])

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
