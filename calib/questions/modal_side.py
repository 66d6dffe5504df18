"""What an explanation of a modal study needs of model and measurement beyond the decision itself."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pandas as pd

from calib.correlation.mesh import elements_table, points_table
from calib.correlation.problem import ModalProblem
from calib.correlation.residual import ModalResidual
from calib.correlation.rigid import COLUMNS as UNPAIRED_COLUMNS
from calib.correlation.rigid import unpaired_sentence, unpaired_table
from calib.correlation.scatter import Floors
from calib.effect import Effect
from calib.function import FunctionModel
from calib.loading import with_effects
from calib.missing.advice import Prospects
from calib.missing.findings import Findings, Trial
from calib.missing.refits import DEFAULT
from calib.outcome import Outcome
from calib.questions.budget import Budget, discretisation_budget
from calib.questions.explanation import Told
from calib.questions.function_hypotheses import Failure
from calib.questions.function_variants import FunctionVariants, kept, modal_function_atoms
from calib.questions.hypotheses import ModalHypotheses, whole_space
from calib.questions.library import modal_hypotheses
from calib.questions.prospects import modal_prospects
from calib.questions.reduction import worthwhile
from calib.questions.verify import modal_errors
from calib.results import Results
from calib.space import ParameterSpace
from calib.structure.atoms import Atom
from calib.structure.modal_function import ModalFunctionModel
from calib.structure.model import StructuralModel
from calib.study import Study

BASIS_ERROR = 0.05
"""Largest difference of whitened residuals on the reduced basis from full order, in units of the scatter."""


@dataclass(frozen=True, eq=False)
class ModalSide:
    """Measured modes against a model that tells modes.

    Attributes
    ----------
    model : StructuralModel or ModalFunctionModel
    problem : ModalProblem
        The data that are used, at full order.
    whole : ModalProblem or None
        All that was measured; None where nothing is withheld.
    hypotheses : ModalHypotheses
    atoms : tuple of Atom
    told : Told
    finer : callable
        The same model on a finer mesh; None where there is none.
    reduced : bool
        Whether the model is one to be asked on a reduced basis.
    budget_of_fits : float
        Solves of the model after which no further effect is fitted.
    failures : sequence of Failure
        Points at which a function gave no answer; it grows while the function is asked.
    """

    model: StructuralModel | ModalFunctionModel
    problem: ModalProblem
    whole: ModalProblem | None
    hypotheses: ModalHypotheses
    atoms: tuple[Atom, ...]
    told: Told
    finer: Callable[[], StructuralModel | None] = lambda: None
    reduced: bool = False
    budget_of_fits: float = DEFAULT.budget
    failures: Sequence[Failure] = ()

    @classmethod
    def of(
        cls,
        study: Study,
        results: Results,
        progress: Callable[[str], None],
        local: tuple[Atom, ...] | None = None,
    ) -> ModalSide:
        """With the reduced basis that is kept among the results, or a new one.

        ``local`` are the local changes that are asked about, by default those of the study's own test.
        """
        problem = study.problem
        assert isinstance(problem, ModalProblem) and not isinstance(study.model, FunctionModel)
        if isinstance(problem.model, ModalFunctionModel):  # which may be behind a ledger
            space = study.search_space.without(study.condition)
            return cls.of_function(
                problem.model, problem, study.whole_problem(), study.candidates, space, Told.of(study), study.test
            )
        assert isinstance(study.model, StructuralModel)
        hypotheses, asked = modal_hypotheses(study, results, progress, local)
        return cls(
            study.model, problem, study.whole_problem(), hypotheses, asked, Told.of(study), study.finer_model,
            worthwhile(study),
        )  # fmt: skip

    @classmethod
    def of_function(
        cls,
        model: ModalFunctionModel,
        problem: ModalProblem,
        whole: ModalProblem | None,
        effects: tuple[Effect, ...],
        space: ParameterSpace,
        told: Told,
        test: str = "",
    ) -> ModalSide:
        """Of a function, which pays for derivatives in calls; there is no bound that fits them all.

        ``space`` may lack parameters that are held for this test only; ``test`` is its name where there are several.
        """
        model = kept(model)  # all that is told asks for points that the decision has asked for
        problem = replace(problem, model=model)
        whole = None if whole is None else replace(whole, model=model)
        asked, held = whole_space(space, model.space), [name for name in model.space.names if name not in space]
        local = modal_function_atoms(model, asked, problem.measured.sensors, test, held)
        variants = FunctionVariants(replace(model, space=asked), effects, tuple(a.effect for a in local))
        hypotheses = ModalHypotheses(problem, variants, space, Floors())
        return cls(model, problem, whole, hypotheses, local, told, budget_of_fits=math.inf, failures=variants.failures)

    @property
    def relative_std(self) -> np.ndarray:
        """See `calib.questions.explain.Side`."""
        return self.hypotheses.relative_std

    def notes(self) -> list[str]:
        """What was asked at full order against the study's wish, and what scatter had to be assumed."""
        out, measured = [], self.problem.measured
        if self.reduced and self.hypotheses.variants.basis is None:
            out.append("No reduced basis reached its tolerance: the full model was asked.")
        if measured.n_repeats == 1 and np.isfinite(measured.freq_std).any():
            out.append("There are no repeats: the scatter is the one the file states.")
        return [*out, *self.told.notes]

    def errors(self, stages: dict[str, Trial], scale: float) -> tuple[pd.DataFrame, list[str], dict[str, object]]:
        """Errors by stage and group of data at full order; what to note, and how far the reduced basis was off."""
        problem, hypotheses, whole = self.problem, self.hypotheses, self.whole
        known = {e.name for e in hypotheses.effects}
        parts, worst = [], 0.0
        for stage, trial in stages.items():
            state = trial.state
            model = with_effects(self.model, [e for e in trial.effects if e.name in known], "explain")
            assert not isinstance(model, FunctionModel)
            more = model.n_modes - self.model.n_modes
            fitted = replace(problem, model=model, mode_count=problem.mode_count + more, base=problem)
            everything = (
                None if whole is None else replace(whole, model=model, mode_count=whole.mode_count + more, base=whole)
            )
            table = modal_errors(
                fitted, everything, state.values, state.names, state.prior_sd, hypotheses.floors,
                hypotheses.scatter_freedom, scale, self.told.held_sd,
            )  # fmt: skip
            parts.append(table.assign(stage=stage))
            full = ModalResidual(fitted, hypotheses.floors).residual(state.values) / scale
            worst = max(worst, float(np.abs(full - state.residual).max()))
        notes = list(filter(None, (unpaired_sentence(self._unpaired(t), _named(t)) for t in stages.values())))
        if worst > BASIS_ERROR:
            notes.append(f"The reduced basis errs by {worst:.2g} standard deviations; set use = false in [reduction].")
        return pd.concat(parts, ignore_index=True), notes, {"basis_error": worst}

    def failing(self) -> set[str]:
        """Effects of all points at which a function failed.

        Of matrices there are none: an effect without which the model is solved has failed where it is not among the
        candidates.
        """
        return {name for failure in self.failures for name in failure.effects}

    def failed(self) -> list[Outcome]:
        """All points at which a function failed.

        Matrices run no code of the user's at a point, and their effects are built before any is solved.
        """
        return [failure.outcome for failure in self.failures]

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

    def places(self) -> dict[str, tuple[str, tuple[float, float, float], str]]:
        """Kind, place and sensor of every local change."""
        return {a.effect.name: (a.kind, a.place, a.sensor) for a in self.atoms}

    def tables(self, stages: dict[str, Trial]) -> dict[str, pd.DataFrame]:
        """``sensor_misfit``: whitened residuals of shapes by sensor; ``unpaired``: modes without partner; the mesh."""
        mesh = self.model.mesh
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

    def _sensors(self, stages: dict[str, Trial]) -> pd.DataFrame:
        sensors = {s.name: s for s in self.hypotheses.problem.measured.sensors}
        parts: dict[tuple[str, str, str], dict[str, float]] = {}
        for stage, trial in stages.items():
            for row, e in zip(self.hypotheses.rows, trial.state.residual, strict=True):
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
