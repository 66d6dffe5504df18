"""Base class of the adapters of a single test."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, Self

import numpy as np
import pandas as pd

from calib.correlation.basis import BasisRequirements
from calib.correlation.mesh_error import MeshError
from calib.errors.errors import EvaluationError
from calib.execution.outcome import Outcome
from calib.execution.stage import Progress, silent
from calib.hypotheses.hypotheses import Failure, ModelHypotheses
from calib.hypotheses.rules import RULES
from calib.missing.between_tests import Differences
from calib.missing.candidate_fit import CandidateFit
from calib.missing.discrepancy import Discrepancy
from calib.missing.explanation import Explanation
from calib.missing.facts import DiscretisationError, MeasurementFacts, Places
from calib.missing.predictions import HeldOut, prediction_tables
from calib.missing.recommendation import ExperimentalDesign
from calib.missing.score import Scores
from calib.missing.settings import DEFAULT
from calib.problem.candidate import Candidate
from calib.problem.effect import Effect
from calib.problem.labels import label_table
from calib.problem.space import ParameterSpace
from calib.structure.effect_places import effect_places
from calib.structure.effects.perturbations import Perturbation
from calib.structure.reduction.effect_basis import covering_fits

LABELS = ("kind", "mode", "sensor", "part")
"""Columns of the labels of every kind of test; ``part`` is ``re`` or ``im``, empty where there are no parts."""


@dataclass(frozen=True, eq=False)
class OneTest(ABC):
    """One test against one model; see `calib.missing.adapter.Adapter`.

    Attributes
    ----------
    hypotheses : ModelHypotheses
    perturbations : tuple of Perturbation
        Its local perturbations.
    facts : MeasurementFacts
    reduced : bool
        Whether a reduced basis was requested and worthwhile.
    near : mapping from str to float, optional
        Parameters of the model about which its basis was made; None for one within all limits, or none at all.
    """

    hypotheses: ModelHypotheses[Any]
    perturbations: tuple[Perturbation, ...]
    facts: MeasurementFacts
    reduced: bool = field(default=False, kw_only=True)
    near: Mapping[str, float] | None = field(default=None, kw_only=True)
    _full: dict[tuple[str, ...], Any] = field(init=False, repr=False, default_factory=dict, kw_only=True)

    @property
    def budget_of_fits(self) -> float:
        """Model evaluations after which no further effect is fitted.

        Unbounded for a function, whose derivatives cost calls: their number depends on its parameters.
        """
        return DEFAULT.budget if self.hypotheses.variants.calls is None else math.inf

    def notes(self) -> list[str]:
        """Notes on a missing reduced basis, on claimed or assumed standard deviations, and on repeats that disagree."""
        out = []
        if self.reduced and self.hypotheses.variants.basis is None:
            out.append("No reduced basis reached its tolerance: the full model was used.")
        return [*out, *self.facts.notes]

    def covering(self, fits: Iterable[CandidateFit]) -> Self:
        """The same, with a basis about fits grown where they lie outside what it represents; itself where none does."""
        variants: Any = self.hypotheses.variants
        if self.near is None or variants.basis is None:
            return self
        known = {e.name: e for e in (*variants.effects, *variants.perturbations)}
        asked = {}
        for one in fits:
            own = [known[name] for name in one.names if name in known]
            names = (*variants.model.space.names, *(p.name for effect in own for p in effect.parameters))
            values = {name: one.fit.values[name] for name in names if name in one.fit.values}
            asked[(one.names if own else (), *values.values())] = own, values
        basis = covering_fits(variants.reduced, asked.values())
        if basis is variants.basis:
            return self
        return replace(self, hypotheses=replace(self.hypotheses, variants=replace(variants, basis=basis)))

    def at_full_order(self, names: tuple[str, ...]) -> Any:
        """The pair of the model with the named effects, at full order."""
        if names not in self._full:
            variants = self.hypotheses.variants
            self._full[names] = self.hypotheses.pair.with_model(variants.built(names), variants.added(names))
        return self._full[names]

    def basis_error(self, fits: Iterable[CandidateFit], scale: float) -> float:
        """Largest difference of whitened residuals on the reduced basis from full order; 0 without a basis."""
        if self.hypotheses.variants.basis is None:
            return 0.0
        full = [self.full_residual(one) / scale - one.fit.residual for one in fits]
        return float(max(np.abs(difference).max() for difference in full))

    def full_residual(self, one: CandidateFit) -> np.ndarray:
        """Whitened residual of a fit at full order, (n_rows,)."""
        return np.asarray(self.at_full_order(one.names).residual(one.fit.values))

    def errors(
        self, stages: Mapping[str, CandidateFit], scale: float
    ) -> tuple[pd.DataFrame, list[str], dict[str, object]]:
        """Errors by stage and group of data, notes such as failed points, and entries of the summary.

        Of a model of matrices with a note on the error of its reduced basis.
        """
        table = pd.concat([self.errors_of(t, scale).assign(stage=s) for s, t in stages.items()], ignore_index=True)
        failures = self.hypotheses.failures
        notes = []
        if failures:
            points = f"{len(failures)} point{'s' * (len(failures) > 1)} failed"
            notes = [f"{points}; the first{_with(failures[0])}: {failures[0].outcome.error}."]
        if self.hypotheses.variants.calls is not None:  # a user's function, which has no basis
            return table, notes, {"failed": len(failures)}
        worst = self.basis_error(stages.values(), scale)
        if worst > RULES.basis_error:
            notes.append(
                f"The reduced basis is off by {worst:.2g} standard deviations; set use = false in [reduction]."
            )
        return table, notes, {"basis_error": worst}

    @property
    def on_mesh(self) -> bool:
        """Whether the error of a mesh shows in what was measured."""
        return False

    def with_mesh(self, mesh: MeshError) -> Self:
        """The same with an uncertain multiple of the error of the mesh among its parameters."""
        hypotheses = self.hypotheses
        space = ParameterSpace((*hypotheses.space.parameters, mesh.parameter), hypotheses.space.constraints)
        pair = replace(hypotheses.pair, problem=replace(hypotheses.pair.problem, mesh=mesh))
        return replace(self, hypotheses=replace(hypotheses, pair=pair, space=space))

    def granting(self, faults: Sequence[str]) -> Self:
        """The same with faults of the measurement among the parameters of its base model."""
        return replace(self, hypotheses=self.hypotheses.granting(tuple(faults))) if faults else self

    def with_effects(self, effects: Sequence[Effect]) -> ModelHypotheses[Any]:
        """Its hypotheses with further effects."""
        return self.hypotheses.with_more(effects)

    def between(self, found: Explanation) -> Differences | None:
        """None: there is no other test to differ from."""
        return None

    @abstractmethod
    def errors_of(self, candidate_fit: CandidateFit, scale: float) -> pd.DataFrame:
        """Errors of one fit by group of data, in units of ``scale`` times the standard deviation."""

    @abstractmethod
    def held_out_of(self, candidate_fit: CandidateFit, scale: float) -> dict[str, HeldOut]:
        """Held-out data by group beside the predictions of a fit; empty where nothing is held out."""

    @abstractmethod
    def residuals_held_out(
        self, names: tuple[str, ...], values: Mapping[str, float], by: Sequence[str]
    ) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """Whitened residual of held-out data by group, (n,), and its derivatives by some parameters, (n, n_by).

        Of the model with the named effects, on its reduced basis where that has modes enough.
        """

    def predictions(
        self, candidate_fit: CandidateFit, wide: Discrepancy, scale: float
    ) -> tuple[pd.DataFrame, pd.DataFrame]:
        """Predictions and errors of held-out data, with a discrepancy too; see `calib.missing.predictions`.

        Parameters
        ----------
        candidate_fit : CandidateFit
            The base model.
        wide : Discrepancy
        scale : float
            Factor on the standard deviation.
        """
        held_out = self.held_out_of(candidate_fit, scale)
        changes = self._changed(candidate_fit, wide, scale) if held_out else {}
        return prediction_tables(held_out, wide, changes)

    def _changed(self, candidate_fit: CandidateFit, wide: Discrepancy, scale: float) -> dict[str, np.ndarray]:
        """Changes of the predictions of held-out data by every column of a discrepancy, (n, m).

        0 for candidates that this test cannot have, and where the model fails.
        """
        values = candidate_fit.fit.values
        own = {e.name for e in (*self.hypotheses.effects, *self.hypotheses.perturbations)}
        plain = [k for k, name in enumerate(wide.owners) if name in own and not wide.points[k]]
        found = self._slopes(values, [wide.owners[k] for k in plain])
        out = {group: np.zeros((len(e), len(wide.owners))) for group, (e, _) in found.items()}
        for group, (_, slope) in found.items():
            out[group][:, plain] = -slope / scale
        for k, (name, point) in enumerate(zip(wide.owners, wide.points, strict=True)):
            if name not in own or not point:
                continue
            try:
                there = self.residuals_held_out((name,), {**values, **point}, ())
            except EvaluationError:
                continue
            for group, (e, _) in found.items():
                out[group][:, k] = (e - there[group][0]) / (point[name] * scale)
        return out

    def _slopes(self, values: Mapping[str, float], by: Sequence[str]) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """As `residuals_held_out` of the base model; 0 for parameters by which there is no derivative."""
        try:
            return self.residuals_held_out((), values, by)
        except EvaluationError:
            found = self.residuals_held_out((), values, ())
        slopes = {group: np.zeros((len(e), len(by))) for group, (e, _) in found.items()}
        for k, name in enumerate(by):
            try:
                alone = self.residuals_held_out((), values, (name,))
            except EvaluationError:
                continue
            for group, (_, slope) in alone.items():
                slopes[group][:, k] = slope[:, 0]
        return {group: (e, slopes[group]) for group, (e, _) in found.items()}

    def labels(self) -> pd.DataFrame:
        """Labels of the rows of data: `LABELS`, then the columns that the test adds to them."""
        table = label_table(self.hypotheses.rows)
        return table.reindex(columns=[*dict.fromkeys([*LABELS, *table.columns])], fill_value="")

    @abstractmethod
    def tables(self, stages: Mapping[str, CandidateFit]) -> dict[str, pd.DataFrame]:
        """Further tables by name."""

    def effect_places(self) -> pd.DataFrame:
        """Where each effect of the library acts on a model of matrices, m: ``effect, x, y, z``; empty for others."""
        model, rows = self.hypotheses.variants.model, list[tuple[object, ...]]()
        if self.hypotheses.variants.calls is None:
            rows = [(e.name, *place) for e in self.hypotheses.effects for place in effect_places(model, e)]
        return pd.DataFrame(rows, columns=["effect", "x", "y", "z"])

    def richer(self, name: str, progress: Progress = silent) -> Self | None:
        """The same with the next richer member in the place of an effect; None without one.

        EvaluationError where the model cannot be solved with it, ToleranceError where no reduced basis represents it.
        """
        variants = self.hypotheses.variants
        simpler = next((e for e in self.hypotheses.effects if e.name == name), None)
        if simpler is None or simpler.richer is None:
            return None
        basis = variants.basis
        if basis is not None:
            wanted = BasisRequirements.of(self.hypotheses.pair.problem, basis.tolerance, self.facts.seed)
            basis = wanted.with_effects(
                variants.model, basis, self.hypotheses.space, [simpler.richer], (), progress, self.near
            )
        exchanged = variants.exchanged(simpler, simpler.richer, basis)
        return replace(self, hypotheses=replace(self.hypotheses, variants=exchanged))

    def failing(self) -> set[str]:
        """Effects that were nonzero at any point at which a function failed."""
        return {name for failure in self.hypotheses.failures for name in failure.effects}

    def failed(self) -> list[Outcome]:
        """All points at which a function failed."""
        return [failure.outcome for failure in self.hypotheses.failures]

    def design(self, found: Explanation, progress: Progress = silent) -> ExperimentalDesign | None:
        """None: further responses of a function are unknown."""
        return None

    def doubted(self, found: Explanation) -> tuple[list[Candidate], Scores] | None:
        """Effects for which candidate measurements are proposed, with their scores; None where there are none.

        Where nothing explains the misfit, local perturbations that locate it.
        """
        if found.verdict == "none_explains" and found.place is not None:
            return list(found.place.effects), found.base_adequacy.perturbations
        candidates = [e for g in found.groups for e in g.effects]
        return (candidates, found.base_adequacy.named) if candidates else None

    def discretisation_error(self, found: Explanation) -> DiscretisationError | None:
        """None: there is no mesh."""
        return None

    def places(self) -> Places:
        """Kind, location (m) and sensor of every local perturbation and every fault of the measurement, by name."""
        local = {a.effect.name: (a.kind, a.place, a.sensor) for a in self.perturbations}
        return local | {f.name: (f.kind, f.place, f.sensor) for f in self.hypotheses.pair.faults}


def _with(failure: Failure) -> str:
    return f" (with {', '.join(failure.effects)})" if failure.effects else ""
