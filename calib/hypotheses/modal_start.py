"""Start of a fit of many measured shapes: their equations of motion, which are linear in the matrices.

Least squares on hundreds of sensors end in the next of many minima where close modes are exchanged or mixed. What
measured shapes leave of their equation of motion knows no pairs, so that its solution comes near from far away.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from calib.correlation.modal.comparison import Comparison
from calib.correlation.modal.residual import ModalResidual
from calib.inference.even_weights import Leap
from calib.measurement.mac import most_real
from calib.problem.prior import Prior
from calib.problem.space import ParameterSpace
from calib.structure.model import StructuralModel
from calib.structure.reduction.reduced import ReducedModel

ROUNDS = 5
"""Linearisations, each about the solution before: the model's own modes, in which shapes are expanded, move too."""
ENOUGH = 0.01
"""Largest change of a parameter, over its range, after which no further one follows."""
EQUATION_ERROR = 0.003
"""Relative error assumed of the equations beside that of the noise: where it is small, equations that noise hardly
reaches count most, and those that it biases hardly."""
SENSORS = 2
"""Fewest sensors for each mode in which shapes are expanded."""
EXPLAINED = 0.8
"""Least share of a measured shape that these modes describe where it counts."""


def modal_leap(problem: Any) -> Leap | None:
    """What leads near the measured modes from any values; None where the model has no matrices to be solved for."""
    pair = getattr(problem, "pair", None)
    if not isinstance(pair, ModalResidual) or not isinstance(pair.problem.model, StructuralModel | ReducedModel):
        return None
    space: ParameterSpace = problem.space
    names = [p.name for p in space.free if not p.integer and p.name in pair.problem.model.space]

    def leap(values: Mapping[str, float]) -> dict[str, float]:
        point, prior = dict(values), Prior.of(space)
        lower, upper = (np.array([getattr(space[name], end) for name in names]) for end in ("lower", "upper"))
        for _ in range(ROUNDS):
            here = np.array([point[name] for name in names])
            widths = prior.widths(point, names)
            span = np.array([space[name].span_at(point[name]) for name in names])
            unit = np.where(np.isfinite(widths), widths, span)
            posed = _equations(problem.at(point), pair.regular(point, names), names)
            if posed is None:
                break
            own, pulling = prior.rows(point, names)
            rows, right = np.vstack([posed[0], pulling]) * unit, np.concatenate([posed[1], own])
            steps = -np.linalg.lstsq(rows, right, rcond=None)[0] * unit
            each = zip(names, here.tolist(), steps.tolist(), strict=True)
            there = np.clip([space[name].moved(value, step) for name, value, step in each], lower, upper)
            point.update(zip(names, there.tolist(), strict=True))
            if np.max(np.abs(there - here) / span) <= ENOUGH:
                break
        return point

    return leap if names else None


def _equations(
    found: Comparison, values: Mapping[str, float], names: list[str]
) -> tuple[np.ndarray, np.ndarray] | None:
    """What measured shapes leave of their equations of motion at named values, and its derivatives.

    With ``psi`` the model's undamped modes of unit modal mass, in which a measured shape has the coefficients c (by
    least squares at the sensors, of unit length), it is ``psi^T (K - lambda M) psi c / sqrt(lambda lambda_psi)``.

    Returns
    -------
    matrix : ndarray (n_equations, n_params)
        Per unit of each parameter.
    left : ndarray (n_equations,)
        None of both where modes are damped, or sensors are too few.
    """
    if found.modes.is_complex:
        return None
    known = np.isfinite(found.measured.shapes).all(axis=1)
    count = min(found.modes.n_modes, int(known.sum()) // SENSORS)
    if not count:
        return None
    model: Any = found.model
    psi, rows = found.modes.shapes[:, :count], found.sensor_shapes[known, :count].real
    mass = np.sqrt(np.einsum("ij,ij->j", psi, model.matrices(values)[2] @ psi))
    psi, rows = psi / mass, rows / mass
    shapes = np.stack([most_real(one[known]).real for one in found.measured.shapes.T], axis=1)
    part = np.linalg.lstsq(rows, shapes, rcond=None)[0]
    share = 1 - np.sum((shapes - rows @ part) ** 2, axis=0) / np.sum(shapes**2, axis=0)
    used = share >= EXPLAINED
    if not used.any():
        return None
    spread = np.sqrt(np.sum((shapes - rows @ part) ** 2, axis=0) / max(len(rows) - count, 1))
    unsure = np.sqrt(np.diag(np.linalg.pinv(rows.T @ rows)))[:, None] * spread
    length = np.linalg.norm(part, axis=0)[used]
    part, unsure = part[:, used] / length, unsure[:, used] / length
    measured = (2 * np.pi * found.measured.natural_freq[used]) ** 2
    own = (2 * np.pi * found.modes.natural_freq[:count, None]) ** 2
    size = np.sqrt(own * measured)
    error = size * np.hypot(EQUATION_ERROR, unsure * np.abs(own - measured) / size)
    expanded, columns = psi @ part, []
    for name in names:
        stiffness, _, masses = model.matrix_derivatives(values, name)
        columns.append((psi.T @ (stiffness @ expanded - (masses @ expanded) * measured) / error).ravel())
    return np.stack(columns, axis=1), ((own - measured) / error * part).ravel()
