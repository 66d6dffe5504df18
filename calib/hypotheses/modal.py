"""Adapter of a modal test to the explanation."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any, TypeAlias, cast

import numpy as np
import pandas as pd

from calib.correlation.mesh_error import MeshError, geometry_tables
from calib.correlation.modal.held_out import covariance_root, held_out_rows, kinds_of
from calib.correlation.modal.problem import ModalProblem
from calib.correlation.modal.residual import ModalResidual
from calib.correlation.modal.rigid import COLUMNS as UNPAIRED_COLUMNS
from calib.correlation.modal.rigid import both_meshes, unpaired_sentence, unpaired_table
from calib.errors.errors import InputError
from calib.execution.stage import Progress, silent
from calib.execution.tasks import each
from calib.hypotheses.design.modal import modal_design
from calib.hypotheses.discretisation_error import discretisation_error
from calib.hypotheses.hypotheses import ModelHypotheses
from calib.hypotheses.one_test import OneTest
from calib.hypotheses.verify import modal_covariance, modal_errors
from calib.missing.candidate_fit import CandidateFit
from calib.missing.explanation import Explanation
from calib.missing.facts import DiscretisationError
from calib.missing.predictions import HeldOut
from calib.missing.recommendation import ExperimentalDesign
from calib.problem.degrees_of_freedom import behind
from calib.structure.modal_model import ModalModel
from calib.structure.model import StructuralModel
from calib.structure.modes import Modes

_Key: TypeAlias = tuple[tuple[str, ...], tuple[tuple[str, float], ...]]


@dataclass(frozen=True, eq=False)
class ModalAdapter(OneTest):
    """Measured modes against a model with modes.

    Attributes
    ----------
    whole : ModalProblem or None
        The problem with all measured data; None where nothing is held out.
    finer : callable
        Returns the same model on a finer mesh, or None.
    """

    hypotheses: ModelHypotheses[ModalResidual]
    whole: ModalProblem | None
    finer: Callable[[], StructuralModel | None] = lambda: None
    _modes: dict[_Key, Modes] = field(init=False, repr=False, default_factory=dict)

    @property
    def problem(self) -> ModalProblem:
        """The problem with the used data, at full order."""
        return self.hypotheses.pair.problem

    @property
    def on_mesh(self) -> bool:
        """Yes: a finer mesh has other modes."""
        return True

    def with_mesh(self, mesh: MeshError) -> ModalAdapter:
        """As for any test; InputError where the finer mesh lacks a mode that was measured."""
        out = super().with_mesh(mesh)
        if lost := both_meshes(out.problem).lost:
            raise InputError(
                f"the finer model does not have the modes {', '.join(sorted(lost))} that were measured",
                place="finer mesh", remedy="change the size of the elements alone",
            )  # fmt: skip
        return out if self.whole is None else replace(out, whole=replace(self.whole, mesh=mesh))

    @property
    def left_out_std(self) -> float:
        """The fewest behind any kind of data."""
        return float(min(self.hypotheses.std_dof.values(), default=np.inf))

    def notes(self) -> list[str]:
        """As for any test, and on stated standard deviations."""
        out, measured = [], self.problem.measured
        if measured.n_repeats == 1 and np.isfinite(measured.freq_std).any():
            out.append("There are no repeats: the standard deviation is the one the file states.")
        return [*out, *super().notes()]

    def errors(
        self, stages: Mapping[str, CandidateFit], scale: float
    ) -> tuple[pd.DataFrame, list[str], dict[str, object]]:
        """As for any test, with notes on unpaired modes; the models at full order are solved as shared tasks."""
        self._solve(list(stages.values()))
        table, notes, figures = super().errors(stages, scale)
        unpaired = filter(None, (unpaired_sentence(self._unpaired(t), _named(t)) for t in stages.values()))
        return table, [*unpaired, *notes], figures

    def errors_of(self, candidate_fit: CandidateFit, scale: float) -> pd.DataFrame:
        """At full order; see `calib.hypotheses.verify.modal_errors`."""
        fit, fitted = candidate_fit.fit, self.at_full_order(candidate_fit.names)
        return modal_errors(
            fitted.problem, self._whole(candidate_fit.names, fitted.problem.model), fit.values, fit.names,
            fit.prior_sd, fitted.floors, self.hypotheses.std_dof, scale, self.facts.held_sd, fit.others, fit.active,
            self._modes.get(_key(candidate_fit)),
            [fault for fault in self.hypotheses.pair.faults if fault.name in self.hypotheses.granted],
        )  # fmt: skip

    def full_residual(self, one: CandidateFit) -> np.ndarray:
        """As for any test; a model that was solved for its errors is not solved again."""
        pair = self.at_full_order(one.names)
        return np.asarray(pair.of(pair.solve(one.fit.values, self._modes.get(_key(one)))))

    def _solve(self, fits: Sequence[CandidateFit]) -> None:
        """Solve models of matrices at full order, each once; a user's function is called when it is needed."""
        new = {_key(one): one for one in fits if _key(one) not in self._modes}
        if not isinstance(self.problem.model, StructuralModel):
            return
        problems = {one.names: self.at_full_order(one.names).problem for one in new.values()}
        requested = [(one.names, one.fit.values) for one in new.values()]
        self._modes.update(zip(new, each(_solved, problems, requested), strict=True))

    def held_out_of(self, candidate_fit: CandidateFit, scale: float) -> dict[str, HeldOut]:
        """At full order, with the covariance of `calib.hypotheses.verify.modal_covariance`."""
        fit, pair = candidate_fit.fit, self.at_full_order(candidate_fit.names)
        whole = self._whole(candidate_fit.names, pair.problem.model)
        if whole is None:
            return {}
        solved = self._modes.get(_key(candidate_fit))
        names, covariance = modal_covariance(
            pair, pair.problem.compare(fit.values, solved), -fit.slope, fit.names, fit.prior_sd, scale,
            self.facts.held_sd, fit.others,
        )  # fmt: skip
        root, known = covariance_root(covariance, names), self.hypotheses.std_dof
        out = {}
        for group, own in held_out_rows(pair.problem, whole, fit.values, names, pair.floors, solved=solved).items():
            kinds = [row.kind for row in own.labels]
            slope = own.slope / scale
            out[group] = HeldOut(
                own.labels, own.value, own.std * scale, np.array([kind != "shape" for kind in kinds]),
                own.residual / scale, fit.names, -slope[:, : len(fit.names)],
                np.hstack([slope @ root, own.factor_spread]), own.factors, own.lost, behind(kinds_of(own), known),
            )  # fmt: skip
        return out

    def residuals_held_out(
        self, names: tuple[str, ...], values: Mapping[str, float], by: Sequence[str]
    ) -> dict[str, tuple[np.ndarray, np.ndarray]]:
        """See `calib.correlation.modal.held_out.held_out_rows`."""
        hypotheses, variants = self.hypotheses, cast(Any, self.hypotheses.variants)
        if self.whole is not None and variants.basis is not None and self.whole.mode_count > variants.basis.count:
            hypotheses = replace(hypotheses, variants=replace(variants, basis=None))  # held-out modes may be higher
        pair = hypotheses.fit_problem(names).pair
        whole = self._whole(names, pair.problem.model)
        if whole is None:
            return {}
        found = held_out_rows(pair.problem, whole, values, by, pair.floors)
        return {group: (own.residual, own.slope) for group, own in found.items()}

    def _whole(self, names: tuple[str, ...], model: ModalModel) -> ModalProblem | None:
        """The problem with all measured data for a model with the named effects."""
        if self.whole is None:
            return None
        return self.whole.with_model(self.problem.model).with_model(model, self.hypotheses.variants.added(names))

    def design(self, found: Explanation, progress: Progress = silent) -> ExperimentalDesign | None:
        """Candidate measurements, from the credible models."""
        whole = self.problem.measured if self.whole is None else self.whole.measured
        every = zip(whole.names, whole.natural_freq.tolist(), strict=True)
        held_out = {name: freq for name, freq in every if name not in self.problem.measured.names}
        used = {sensor.name for sensor in self.problem.measured.sensors}
        held_sensors = tuple(sensor for sensor in whole.sensors if sensor.name not in used)
        if (doubted := self.doubted(found)) is None:
            return None
        candidates, named = doubted
        samples, seed = self.facts.samples, self.facts.seed
        return modal_design(
            self.hypotheses, found.believed, candidates, named, found.noise_scale, held_out, samples, seed, progress,
            held_sensors,
        )  # fmt: skip

    def discretisation_error(self, found: Explanation) -> DiscretisationError | None:
        """Scores that a finer mesh alone would give; None without one."""
        finer = self.finer()
        return None if finer is None else discretisation_error(self.hypotheses, found.base.fit, finer)

    def tables(self, stages: Mapping[str, CandidateFit]) -> dict[str, pd.DataFrame]:
        """``sensor_misfit``: whitened residuals of shapes by sensor; ``unpaired``: modes without partner; the mesh.

        ``effect_places`` where each effect of the library acts on the model, m.
        """
        return {
            "effect_places": self.effect_places(),
            "sensor_misfit": self._sensors(stages),
            "unpaired": pd.concat([self._unpaired(t).assign(stage=s) for s, t in stages.items()])[
                ["stage", *UNPAIRED_COLUMNS]
            ],
            **geometry_tables(self.problem.model),
        }  # fmt: skip

    def _unpaired(self, candidate_fit: CandidateFit) -> pd.DataFrame:
        return unpaired_table(self.hypotheses.fit_problem(candidate_fit.names).at(candidate_fit.fit.values))

    def _sensors(self, stages: Mapping[str, CandidateFit]) -> pd.DataFrame:
        sensors = {s.name: s for s in self.problem.measured.sensors}
        parts: dict[tuple[str, str, str], dict[str, float]] = {}
        for stage, candidate_fit in stages.items():
            for row, e in zip(self.hypotheses.fit_problem(()).pair.rows, candidate_fit.fit.residual, strict=True):
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


def _key(one: CandidateFit) -> _Key:
    """What the modes of a fit at full order depend on."""
    return one.names, tuple(one.fit.values.items())


def _solved(problems: Mapping[tuple[str, ...], ModalProblem], at: tuple[tuple[str, ...], Mapping[str, float]]) -> Modes:
    names, values = at
    problem = problems[names]
    return problem.solve({name: value for name, value in values.items() if name in problem.model.space})


def _named(candidate_fit: CandidateFit) -> str:
    return "The base model" if not candidate_fit.effects else f"The model with {' and '.join(candidate_fit.names)}"
