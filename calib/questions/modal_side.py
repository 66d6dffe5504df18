"""What an explanation of a modal test needs beyond the decision itself."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

import numpy as np
import pandas as pd

from calib.correlation.mesh import elements_table, points_table
from calib.correlation.problem import ModalProblem
from calib.correlation.residual import ModalResidual
from calib.correlation.rigid import COLUMNS as UNPAIRED_COLUMNS
from calib.correlation.rigid import unpaired_sentence, unpaired_table
from calib.missing.advice import Prospects
from calib.missing.findings import Findings, Trial
from calib.questions.budget import Budget, discretisation_budget
from calib.questions.hypotheses import ModelHypotheses
from calib.questions.one_test import OneTest
from calib.questions.prospects import modal_prospects
from calib.questions.verify import modal_errors
from calib.structure.model import StructuralModel

BASIS_ERROR = 0.05
"""Largest difference of whitened residuals on the reduced basis from full order, in units of the scatter."""


@dataclass(frozen=True, eq=False)
class ModalSide(OneTest):
    """Measured modes against a model that tells modes.

    Attributes
    ----------
    whole : ModalProblem or None
        All that was measured; None where nothing is withheld.
    finer : callable
        The same model on a finer mesh; None where there is none.
    reduced : bool
        Whether the model is one to be asked on a reduced basis.
    """

    hypotheses: ModelHypotheses[ModalResidual]
    whole: ModalProblem | None
    finer: Callable[[], StructuralModel | None] = lambda: None
    reduced: bool = False
    _full: dict[tuple[str, ...], ModalResidual] = field(init=False, repr=False, default_factory=dict)

    @property
    def problem(self) -> ModalProblem:
        """The data that are used, at full order."""
        return self.hypotheses.pair.problem

    def notes(self) -> list[str]:
        """What was asked at full order against the study's wish, and what scatter had to be assumed."""
        out, measured = [], self.problem.measured
        if self.reduced and self.hypotheses.variants.basis is None:
            out.append("No reduced basis reached its tolerance: the full model was asked.")
        if measured.n_repeats == 1 and np.isfinite(measured.freq_std).any():
            out.append("There are no repeats: the scatter is the one the file states.")
        return [*out, *super().notes()]

    def errors(self, stages: Mapping[str, Trial], scale: float) -> tuple[pd.DataFrame, list[str], dict[str, object]]:
        """As of any test; modes without partner are noted too, and how far the reduced basis was off."""
        table, notes, figures = super().errors(stages, scale)
        notes += filter(None, (unpaired_sentence(self._unpaired(t), _named(t)) for t in stages.values()))
        worst = 0.0
        for trial in stages.values():
            full = self._at_full_order(trial.names).residual(trial.state.values) / scale
            worst = max(worst, float(np.abs(full - trial.state.residual).max()))
        if worst > BASIS_ERROR:
            notes.append(f"The reduced basis errs by {worst:.2g} standard deviations; set use = false in [reduction].")
        return table, notes, {**figures, "basis_error": worst}

    def errors_of(self, trial: Trial, scale: float) -> pd.DataFrame:
        """At full order; see `calib.questions.verify.modal_errors`."""
        state, fitted, whole = trial.state, self._at_full_order(trial.names), self.whole
        if whole is not None:
            added = self.hypotheses.variants.added(trial.names)
            whole = whole.with_model(self.problem.model).with_model(fitted.problem.model, added)
        return modal_errors(
            fitted.problem, whole, state.values, state.names, state.prior_sd, fitted.floors,
            self.hypotheses.scatter_freedom, scale, self.told.held_sd,
        )  # fmt: skip

    def _at_full_order(self, names: tuple[str, ...]) -> ModalResidual:
        if names not in self._full:
            variants = self.hypotheses.variants
            self._full[names] = self.hypotheses.pair.with_model(variants.built(names), variants.added(names))
        return self._full[names]

    def prospects(self, found: Findings) -> Prospects | None:
        """What else could be measured, seen from what may be the truth."""
        whole = self.problem.measured if self.whole is None else self.whole.measured
        every = zip(whole.names, whole.natural_freq.tolist(), strict=True)
        withheld = {name: freq for name, freq in every if name not in self.problem.measured.names}
        candidates = [e for g in found.groups for e in g.effects]
        named = found.base_check.named
        if found.verdict == "none_explains" and found.atom is not None:  # to see where what is unexplained lies
            candidates, named = list(found.atom.effects), found.base_check.atoms
        if not candidates:
            return None
        draws, seed = self.told.draws, self.told.seed
        return modal_prospects(
            self.hypotheses, found.believed, candidates, named, found.noise_scale, withheld, draws, seed
        )

    def budget(self, found: Findings) -> Budget | None:
        """What a finer mesh alone would look like; None without one."""
        finer = self.finer()
        return None if finer is None else discretisation_budget(self.hypotheses, found.base.state, finer)

    def tables(self, stages: Mapping[str, Trial]) -> dict[str, pd.DataFrame]:
        """``sensor_misfit``: whitened residuals of shapes by sensor; ``unpaired``: modes without partner; the mesh."""
        mesh = self.problem.model.mesh
        points = points_table(mesh)
        return {
            "sensor_misfit": self._sensors(stages),
            "unpaired": pd.concat([self._unpaired(t).assign(stage=s) for s, t in stages.items()])[
                ["stage", *UNPAIRED_COLUMNS]
            ],
            **({"mesh_points": points, "mesh_elements": elements_table(mesh)} if len(points) else {}),
        }  # fmt: skip

    def _unpaired(self, trial: Trial) -> pd.DataFrame:
        return unpaired_table(self.hypotheses.question(trial.names).at(trial.state.values))

    def _sensors(self, stages: Mapping[str, Trial]) -> pd.DataFrame:
        sensors = {s.name: s for s in self.problem.measured.sensors}
        parts: dict[tuple[str, str, str], dict[str, float]] = {}
        for stage, trial in stages.items():
            for row, e in zip(self.hypotheses.question(()).pair.rows, trial.state.residual, strict=True):
                if row.kind == "shape":
                    parts.setdefault((stage, row.mode, row.sensor), {})[row.part] = float(e)
        rows = []
        for (stage, mode, name), entry in parts.items():
            s = sensors[name]
            point = s.point or (np.nan, np.nan, np.nan)
            rows.append(
                (stage, mode, name, s.node, s.direction, *point, entry.get("re", np.nan), entry.get("im", np.nan))
            )
        columns = ["stage", "mode", "sensor", "node", "direction", "x", "y", "z", "re", "im"]
        return pd.DataFrame(rows, columns=columns)


def _named(trial: Trial) -> str:
    return "The base model" if not trial.effects else f"The model with {' and '.join(trial.names)}"
