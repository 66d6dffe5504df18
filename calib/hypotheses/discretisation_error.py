"""Discretisation error: the scores that a finer mesh of the same model gives when nothing is missing."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
import pandas as pd
from scipy.optimize import linear_sum_assignment

from calib.correlation import rules as comparison
from calib.correlation.frf.residual import FRFResidual
from calib.correlation.mesh_error import MeshError
from calib.correlation.modal.residual import ModalResidual
from calib.errors.errors import EvaluationError, InputError
from calib.hypotheses.design.imagined_measurement import imagined_measurement
from calib.hypotheses.hypotheses import ModelHypotheses, VariantPair
from calib.hypotheses.rules import RULES
from calib.measurement.accuracy import NOTHING
from calib.measurement.mac import mac
from calib.missing.adapter import Adapter
from calib.missing.facts import DiscretisationError
from calib.missing.linearised_fit import LinearisedFit, least_squares_fit
from calib.missing.nearest_integers import nearest_whole
from calib.missing.score import scores
from calib.problem.shared_points import run_shared
from calib.structure.model import StructuralModel
from calib.structure.modes import Modes

P = TypeVar("P", bound=VariantPair)


def discretisation_error(
    hypotheses: ModelHypotheses[ModalResidual], fit: LinearisedFit, finer: StructuralModel
) -> DiscretisationError:
    """Fit the base model to the noise-free modes of a finer mesh, and score all effects and local perturbations.

    Parameters
    ----------
    hypotheses : ModelHypotheses
    fit : LinearisedFit
        The base model, fitted to the measurement; the finer mesh takes its parameter values.
    finer : StructuralModel
        The same parameters on a finer mesh.

    Raises
    ------
    InputError
        When the finer model lacks a parameter, cannot be solved, or does not have the modes that were measured.
    """
    try:
        modes = finer.modes({n: fit.values[n] for n in finer.space.names}, hypotheses.pair.problem.mode_count)
    except (KeyError, EvaluationError) as fault:
        raise InputError(f"the finer model cannot be solved ({fault})", place="finer_options") from None
    rows = finer.sensor_rows(hypotheses.pair.problem.measured.sensors)
    return discretisation_error_of(hypotheses, fit, modes, rows @ modes.shapes)


def discretisation_error_of(
    hypotheses: ModelHypotheses[ModalResidual], fit: LinearisedFit, modes: Modes, sensor_shapes: np.ndarray
) -> DiscretisationError:
    """Discretisation error from a noise-free twin: its modes, and their shapes at the sensors (n_sensors, n_modes)."""
    fit_problem = hypotheses.fit_problem(())
    found, measured = fit_problem.at(fit.values), hypotheses.pair.problem.measured
    paired = found.pairing.paired
    names = tuple(measured.names[i] for i in paired)
    similar = mac(found.sensor_shapes[:, found.pairing.model_index[paired]], sensor_shapes)
    which = linear_sum_assignment(-similar)[1]
    if float(similar[np.arange(len(names)), which].min()) < comparison.RULES.mesh_mac:
        raise InputError("the finer model does not have the modes that were measured", place="finer_options")
    shapes = sensor_shapes[:, which] / np.abs(sensor_shapes[:, which]).max(axis=0)
    twin = imagined_measurement(measured, fit_problem.pair.std, names, modes, which.tolist(), measured.sensors, shapes)
    problem = hypotheses.pair.problem
    clusters = {m: c for m, c in problem.mode_clusters.items() if m in names}
    imagined = replace(problem, measured=twin, mode_clusters=clusters, override={}, reference=fit.values)
    # The standard deviations of the twin contain the floors already.
    floors = replace(hypotheses.pair.floors, freq=0.0, damping=0.0, shape=0.0)
    return _scored(ModalResidual(imagined, floors), hypotheses, fit)


def frf_discretisation_error(
    hypotheses: ModelHypotheses[FRFResidual], fit: LinearisedFit, finer: StructuralModel
) -> DiscretisationError:
    """Fit the base model to the noise-free FRFs of a finer mesh, and score all effects and local perturbations.

    Parameters and errors are those of `discretisation_error`.
    """
    problem = hypotheses.pair.problem
    measured = problem.measured
    try:
        point = fit.values if problem.mesh is None else problem.mesh.without(fit.values)
        functions = problem.of_mesh(finer).functions(point)
    except (KeyError, EvaluationError, InputError) as fault:
        raise InputError(f"the finer model has no such FRFs ({fault})", place="finer_options") from None
    values = np.where(np.isfinite(measured.values), functions, np.nan)
    # Its standard deviation contains the claimed accuracy already.
    twin = replace(measured, values=values, std=hypotheses.pair.entry_std, accuracy=NOTHING)
    return _scored(replace(hypotheses.pair, problem=replace(problem, measured=twin)), hypotheses, fit)


def _scored(pair: P, hypotheses: ModelHypotheses[P], fit: LinearisedFit) -> DiscretisationError:
    """Scores of all candidates of the hypotheses on a noise-free twin."""
    # Priors are centred on the twin's values: otherwise they would pull the fit away, which looks like a mesh error.
    # The error of the mesh keeps its own about 0, which is what is asked for.
    space, mesh = hypotheses.space, pair.problem.mesh
    for p in space.free:
        if mesh is None or p.name != mesh.name:
            space = space.replace(p.name, value=fit.values[p.name])
    against_twin = ModelHypotheses(pair, hypotheses.variants, space)
    base = least_squares_fit(against_twin.fit_problem(()), (), fit.values)
    rows: list[tuple[str, str, float]] = []
    local = [one for one in against_twin.perturbations if not one.of_measurement]
    for kind, candidates in (("effect", against_twin.effects), ("local perturbation", local)):
        with_grid = {e.name: against_twin.fit_problem((e.name,)) for e in candidates if e.grid}
        tested = scores(base, candidates, with_grid)
        for name in dict.fromkeys(tested.owners):
            own = [k for k, owner in enumerate(tested.owners) if owner == name]
            rows.append((name, kind, max((float(tested.z[k]) for k in own), key=abs)))
    rows.sort(key=lambda row: -abs(row[2]))
    table = pd.DataFrame(rows, columns=["candidate", "kind", "score"])
    return DiscretisationError(table, base.misfit, RULES.mesh_score)


def with_mesh_error(adapter: Adapter, finer: StructuralModel | None, sd: float, test: str = "") -> Adapter:
    """The adapter with an uncertain multiple of the change to a finer mesh among its parameters.

    The base model is fitted, both meshes are compared there, and again after a fit with that change. Fitted along with
    every model and projected out of every score, the multiple counts like the covariance ``sd^2 d d^T`` added to that
    of the data, ``d`` the change of the predictions (see `calib.correlation.mesh_error.MeshError`).

    Parameters
    ----------
    adapter : Adapter
    finer : StructuralModel or None
        The same parameters on a finer mesh.
    sd : float
        Standard deviation of the multiple.
    test : str
        Name of the test, where there are several; each has a multiple of its own.

    Raises
    ------
    InputError
        Without a finer mesh of a model of matrices, or where it has other parameters or modes.
    EvaluationError
        When the base model cannot be fitted.
    """
    if finer is None or not adapter.on_mesh:
        raise InputError(
            "mesh_sd states an error of the mesh, but no finer mesh is known", place="explain, mesh_sd",
            remedy="name its model options in finer_options, or leave mesh_sd out",
        )  # fmt: skip
    of_test: Any = adapter  # of one test
    fit_problem = of_test.hypotheses.fit_problem(())
    begin = nearest_whole(fit_problem, fit_problem.space.values)
    linear = of_test.hypotheses.linear_start((), begin)
    starts = [start for start in (begin, linear) if start is not None]
    run_shared(least_squares_fit, [(fit_problem, (), start, 1) for start in starts])
    fits = [least_squares_fit(fit_problem, (), start, 1) for start in starts]
    values, out = min(fits, key=lambda fit: fit.misfit).values, of_test
    for k in range(RULES.mesh_fits):
        mesh = MeshError(of_test.hypotheses.variants.model, finer, fit_problem.pair.space.complete(values), sd, test)
        out = of_test.with_mesh(mesh)
        if k < RULES.mesh_fits - 1:
            again = least_squares_fit(out.hypotheses.fit_problem(()), (), values, 1)
            values = mesh.without(again.values)
    found: Adapter = out
    return found


def mesh_words(sd: float | None) -> tuple[str, ...]:
    """How uncertain the mesh is taken to be, in a sentence; none for an exact mesh."""
    if sd is None:
        return ()
    return (f"The error of the mesh counts as uncertain, by {sd:.3g} times the change to a finer mesh.",)
