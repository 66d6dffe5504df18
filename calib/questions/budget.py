"""What the discretisation alone would look like: scores of a finer mesh of the same model, nothing missing."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pandas as pd
from scipy.optimize import linear_sum_assignment

from calib.correlation.residual import ModalResidual
from calib.errors import EvaluationError, InputError
from calib.mac import mac
from calib.missing.score import scores
from calib.missing.state import State, fitted
from calib.questions.hypotheses import ModelHypotheses
from calib.questions.prospects import imagined_measurement
from calib.structure.model import StructuralModel
from calib.structure.modes import Modes

_ALIKE = 0.5
ALLOWED = 1.0
"""Largest score that may come from the discretisation."""


@dataclass(frozen=True, eq=False)
class Budget:
    """Scores of every effect and local change on modes of a finer mesh without noise.

    Attributes
    ----------
    table : DataFrame
        ``candidate, kind, score``, largest first; kind is ``effect`` or ``local change``.
    misfit : float
        Sum of squares of the whitened residual left by the fit.
    """

    table: pd.DataFrame
    misfit: float

    @property
    def largest(self) -> float:
        """Largest size of a score."""
        return float(self.table["score"].abs().max()) if len(self.table) else 0.0

    @property
    def sentence(self) -> str:
        """Whether the mesh is fine enough for these data."""
        first = self.table.iloc[0]
        told = (
            f"A finer mesh of the same model gives scores of up to {self.largest:.2f} ({first['candidate']}) by itself"
        )
        if self.largest <= ALLOWED:
            return f"{told}: the discretisation hides and fakes nothing."
        return f"{told}, more than {ALLOWED:g}: refine the mesh before you believe a verdict."


def discretisation_budget(hypotheses: ModelHypotheses[ModalResidual], state: State, finer: StructuralModel) -> Budget:
    """Fit the base model to the noise-free modes of a finer mesh, and score everything.

    Parameters
    ----------
    hypotheses : ModelHypotheses
    state : State
        The base model, fitted to the measurement: the finer mesh takes its values.
    finer : StructuralModel
        The same parameters on a finer mesh.

    Raises
    ------
    InputError
        When the finer model lacks a parameter, cannot be solved, or does not have the modes that were measured.
    """
    try:
        modes = finer.modes({n: state.values[n] for n in finer.space.names}, hypotheses.pair.problem.mode_count)
    except (KeyError, EvaluationError) as fault:
        raise InputError(f"the finer model cannot be solved ({fault})", place="finer_options") from None
    rows = finer.sensor_rows(hypotheses.pair.problem.measured.sensors)
    return budget_of(hypotheses, state, modes, rows @ modes.shapes)


def budget_of(
    hypotheses: ModelHypotheses[ModalResidual], state: State, modes: Modes, sensor_shapes: np.ndarray
) -> Budget:
    """The budget of a twin without noise, given by its modes and their shapes at the sensors, (n_sensors, n_modes)."""
    question = hypotheses.question(())
    found, measured = question.at(state.values), hypotheses.pair.problem.measured
    paired = found.pairing.paired
    names = tuple(measured.names[i] for i in paired)
    similar = mac(found.sensor_shapes[:, found.pairing.model_index[paired]], sensor_shapes)
    which = linear_sum_assignment(-similar)[1]
    if float(similar[np.arange(len(names)), which].min()) < _ALIKE:
        raise InputError("the finer model does not have the modes that were measured", place="finer_options")
    shapes = sensor_shapes[:, which] / np.abs(sensor_shapes[:, which]).max(axis=0)
    twin = imagined_measurement(measured, question.pair.scatter, names, modes, which.tolist(), measured.sensors, shapes)
    problem = hypotheses.pair.problem
    clusters = {m: c for m, c in problem.mode_clusters.items() if m in names}
    imagined = replace(problem, measured=twin, mode_clusters=clusters, override={}, reference=state.values)
    floors = replace(hypotheses.pair.floors, freq=0.0, damping=0.0, shape=0.0)  # they are in the scatter already
    # Priors about the twin's own values: they would pull the fit away from it and look like an error of the mesh.
    space = hypotheses.space
    for p in space.free:
        space = space.replace(p.name, value=state.values[p.name])
    asked = ModelHypotheses(ModalResidual(imagined, floors), hypotheses.variants, space)
    base = fitted(asked.question(()), (), state.values)
    rows: list[tuple[str, str, float]] = []
    for kind, candidates in (("effect", asked.effects), ("local change", asked.atoms)):
        with_grid = {e.name: asked.question((e.name,)) for e in candidates if e.grid}
        tested = scores(base, candidates, with_grid)
        for name in dict.fromkeys(tested.owners):
            own = [k for k, owner in enumerate(tested.owners) if owner == name]
            rows.append((name, kind, max((float(tested.z[k]) for k in own), key=abs)))
    rows.sort(key=lambda row: -abs(row[2]))
    return Budget(pd.DataFrame(rows, columns=["candidate", "kind", "score"]), base.misfit)
