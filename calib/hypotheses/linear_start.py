"""Start of a fit of FRFs: the linear cross-model equations of `calib.inference.cmcf`, with the priors.

Least squares on FRFs end in the next of many minima where resonances are off by more than their width. Equation errors
are linear in the matrices and have no such minima, so their solution comes near enough.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, TypeGuard

import numpy as np
import scipy.linalg as la
import scipy.sparse as sp

from calib.correlation.frf.residual import FRFResidual
from calib.errors.errors import EvaluationError, InputError
from calib.inference.cmcf import cmcf
from calib.inference.cmcf_equations import Change, CmcfSettings, InitialModel, Kind, MeasuredReceptance
from calib.inference.linear_estimate import LinearEstimate
from calib.measurement.frf import MeasuredFRFs
from calib.problem.joint import JointProblem
from calib.problem.prior import Prior
from calib.problem.problem import PairProblem
from calib.problem.space import ParameterSpace
from calib.structure.frf import motion_factor
from calib.structure.model import StructuralModel
from calib.structure.reduction.static_reduction import static_reduction

EQUATION_ERROR = 0.05
"""Relative error assumed of the equations: noise, and modes that the measured places do not represent. A start needs no
better; the fit weighs by the standard deviations."""
LEVEL = 4
"""Of the iterated IRS, at which the lowest modes of a reduced model have converged (Li and Hong 2012)."""
ROUNDS = 2
"""Linearisations: the second about the first solution, for parameters in which the matrices are not linear."""
_INDEPENDENT = 1e-8
"""Smallest singular value over the largest of the sensors' rows, below which two of them measure the same motion."""


def linear_start(residual: FRFResidual, space: ParameterSpace, values: Mapping[str, float]) -> dict[str, float] | None:
    """Values from which a fit of FRFs starts: those of `linear_estimate`, or how far it came."""
    return _solved(residual, space, values)[0]


def linear_estimate(residual: FRFResidual, space: ParameterSpace, values: Mapping[str, float]) -> LinearEstimate | None:
    """The solution of the linear cross-model equations, and how errors of the data change it.

    Parameters
    ----------
    residual : FRFResidual
        Its model is solved at full order.
    space : ParameterSpace
        Its free parameters that are not integers are moved, within their limits; their priors hold them where the
        equations say nothing.
    values : mapping
        All parameters, about which the first linearisation is.

    Returns
    -------
    LinearEstimate or None
        None where the equations cannot be posed: a reference without a response at the same place, no line on which
        every function was measured, or sensors that measure the same motion; or where they have no solution.
    """
    return _solved(residual, space, values)[1]


def _solved(
    residual: FRFResidual, space: ParameterSpace, values: Mapping[str, float]
) -> tuple[dict[str, float] | None, LinearEstimate | None]:
    """Where the linearisations lead, and the estimate where the last of them has a solution."""
    problem = residual.problem
    own, measured = problem.loaded_model, _near_resonances(problem.measured)
    model = own.whole
    names = [p.name for p in space.free if not p.integer and p.name in model.space]
    if not names:
        return None, None
    equations = _equations_of(model, measured)
    if equations is None:
        return None, None
    at_sensors, receptance = equations
    lower, upper = (np.array([getattr(space[name], end) for name in names]) for end in ("lower", "upper"))
    point = {name: value for name, value in values.items() if name in model.space}
    start = np.clip([point[name] for name in names], lower, upper)  # a predicted step may lead beyond the limits
    point.update(zip(names, start.tolist(), strict=True))
    for _ in range(ROUNDS):
        here = np.array([point[name] for name in names])
        sd = Prior.of(space).widths(point, names)
        initial = _initial(model, point, names, sd, at_sensors, receptance)
        settings = CmcfSettings(orders=min(len(receptance.freq), len(initial.masters) // 2 + 1))
        try:
            found = cmcf(
                initial,
                receptance,
                settings,
                np.full(len(names), 1 / EQUATION_ERROR),
                -Prior.of(space).residual(point, names),
            )
        except (EvaluationError, InputError):
            return {**values, **point}, None
        steps = zip(names, here.tolist(), (found.changes[-1] * sd).tolist(), strict=True)
        moved = np.clip([space[name].moved(value, step) for name, value, step in steps], lower, upper)
        point.update(zip(names, moved.tolist(), strict=True))
    slope = np.zeros((len(names), *problem.measured.values.shape), dtype=complex)
    factor = motion_factor(problem.measured.quantity, receptance.freq)[:, None, None]
    slope[:, np.searchsorted(problem.measured.freq, receptance.freq)] = sd[:, None, None, None] * found.slope / factor
    prior_gain = sd[:, None] * found.prior_slope * EQUATION_ERROR
    found_values = {**values, **point}
    return found_values, LinearEstimate(found_values, tuple(names), residual.gain(slope), prior_gain)


def has_linear_start(pair: object) -> TypeGuard[FRFResidual]:
    """Whether fits of a test have a linear start: FRFs alone."""
    return isinstance(pair, FRFResidual)


def linear_starts(
    problem: PairProblem[Any] | JointProblem, values: Mapping[str, float]
) -> tuple[dict[str, float], ...]:
    """Further starts of a least-squares fit: the linear one of tests of FRFs; none for other tests.

    Each test is solved alone; a parameter of several starts from the last of them.
    """
    found: dict[str, float] = {}
    for part in _parts(problem):
        if has_linear_start(part.pair):
            found |= linear_start(part.pair, part.space, _own(part, values)) or {}
    return ({name: found.get(name, value) for name, value in values.items()},) if found else ()


def estimate_by_equations(
    problem: PairProblem[Any] | JointProblem, values: Mapping[str, float]
) -> LinearEstimate | None:
    """The linear estimate of one test of FRFs, among all values; None for other or several tests, or no solution."""
    if isinstance(problem, JointProblem) or not has_linear_start(problem.pair):
        return None
    found = linear_estimate(problem.pair, problem.space, _own(problem, values))
    return None if found is None else replace(found, values={**values, **{n: found.values[n] for n in found.names}})


def _parts(problem: PairProblem[Any] | JointProblem) -> tuple[PairProblem[Any], ...]:
    return tuple(problem.parts.values()) if isinstance(problem, JointProblem) else (problem,)


def _own(part: PairProblem[Any], values: Mapping[str, float]) -> dict[str, float]:
    """Values of the parameters of one test."""
    return dict(part.pair.space.complete({name: value for name, value in values.items() if name in part.pair.space}))


def _near_resonances(measured: MeasuredFRFs) -> MeasuredFRFs:
    """The lines near resonances, where few modes make up the FRFs; all where there is no resonance."""
    try:
        return measured.lines_near_resonances()
    except InputError:
        return measured


def _equations_of(
    model: StructuralModel, measured: MeasuredFRFs
) -> tuple[tuple[sp.csc_array, np.ndarray], MeasuredReceptance] | None:
    """Coordinates in which the responses are degrees of freedom, these, and the receptance at them."""
    rows, forces = model.sensor_rows(measured.responses), model.sensor_rows(measured.references)
    at = [next((i for i, row in enumerate(rows) if np.allclose(row, force)), -1) for force in forces]
    lines = np.flatnonzero((measured.freq > 0) & np.isfinite(measured.values).all(axis=(1, 2)))
    if min(at) < 0 or not len(lines):
        return None
    turned = _at_sensors(rows)
    if turned is None:
        return None
    freq = measured.freq[lines]
    receptance = measured.values[lines] / motion_factor(measured.quantity, freq)[:, None, None]
    return turned, MeasuredReceptance(freq, receptance, np.array(at))


def _at_sensors(rows: np.ndarray) -> tuple[sp.csc_array, np.ndarray] | None:
    """Coordinates of which some are the motions at the sensors: L (n_dof, n_dof) with ``x = L y``, and which ones.

    The best pivots of the rows (n_sensors, n_dof) become these motions, all other degrees of freedom stay. None where
    two rows are alike.
    """
    _, triangle, order = la.qr(rows, mode="economic", pivoting=True)
    size = np.abs(np.diag(triangle))
    if len(rows) > rows.shape[1] or not size[-1] > _INDEPENDENT * size[0]:
        return None
    chosen = order[: len(rows)]
    kept = np.ones(rows.shape[1], dtype=bool)
    kept[chosen] = False
    inverse = np.linalg.inv(rows[:, chosen])
    turn = sp.lil_array(sp.diags_array(kept.astype(float)))
    rest = -inverse @ np.where(kept, rows, 0.0)
    for i, dof in enumerate(chosen.tolist()):
        for j in np.flatnonzero(np.abs(rest[i]) > 0).tolist():
            turn[dof, j] = rest[i, j]
        for j, master in enumerate(chosen.tolist()):
            turn[dof, master] = inverse[i, j]
    return sp.csc_array(turn), chosen


def _initial(
    model: StructuralModel,
    values: Mapping[str, float],
    names: list[str],
    sd: np.ndarray,
    at_sensors: tuple[sp.csc_array, np.ndarray],
    receptance: MeasuredReceptance,
) -> InitialModel:
    """The model linearised at named values, in the sensors' coordinates; changes are in prior standard deviations."""
    turn, masters = at_sensors

    def turned(matrix: sp.csc_array) -> sp.csc_array:
        return sp.csc_array(turn.T @ matrix @ turn)

    stiffness, damping, mass = map(turned, model.matrices(values))
    changes = []
    for name, width in zip(names, sd, strict=True):
        slopes = model.matrix_derivatives(values, name)
        kinds: tuple[Kind, ...] = ("stiffness", "viscous", "mass")
        parts = [(k, turned(s) * width) for k, s in zip(kinds, slopes, strict=True) if abs(s).max() > 0]
        if parts:
            changes.append(Change(name, *parts[0], tuple(parts[1:]), is_factor=False))
    return InitialModel(
        stiffness, mass, tuple(changes), masters, lambda k, m: static_reduction(k, m, masters, LEVEL).transformation,
        viscous=damping,
    )  # fmt: skip
