"""Model modes that are closer in frequency than the measurement can tell, turned to the measured shapes.

Of a repeated eigenvalue the subspace is determined and no single shape is; of nearly repeated ones a perturbation as
small as the uncertainty of the frequencies turns the shapes as far (Friswell and Mottershead 1995, ch. 3). Which
directions the measured structure has is then a nuisance: the modes are turned inside their subspace to the measured
shapes, and the frequencies, MAC, residual rows and derivatives of a pair are those of the modes so turned.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import sqrtm

from calib.correlation.rules import RULES
from calib.correlation.standard_deviations import known_std
from calib.errors.errors import EvaluationError
from calib.measurement.mac import mac
from calib.structure.eigenproblem.mode_systems import REPEATED, eigenvalues
from calib.structure.modes import Modes

if TYPE_CHECKING:
    from calib.correlation.modal.problem import ModalProblem

Group = tuple[int, ...]


def close_groups(
    freq_model: np.ndarray, freq_measured: np.ndarray, freq_std: np.ndarray, within: float
) -> tuple[Group, ...]:
    """Groups of model modes that are all closer than so many standard deviations of a difference.

    Parameters
    ----------
    freq_model : ndarray (n_model,)
        Natural frequencies in ascending order, Hz.
    freq_measured, freq_std : ndarray (n_measured,)
        Hz, and relative standard deviations, NaN where unknown; the measured mode next to a model mode holds for it.
    within : float

    Returns
    -------
    tuple of tuple of int
        Of two modes or more each; a rigid-body mode is in none.
    """
    out, group = list[Group](), list[int]()
    reach = np.maximum(within * math.sqrt(2.0) * np.nan_to_num(freq_std), REPEATED)
    for j in np.flatnonzero(freq_model > 0).tolist():
        near = int(np.argmin(np.abs(np.log(freq_measured / freq_model[j]))))
        if group and math.log(freq_model[j] / freq_model[group[0]]) <= reach[near]:
            group.append(j)
            continue
        out += [tuple(group)] if len(group) > 1 else []
        group = [j]
    return (*out, tuple(group)) if len(group) > 1 else tuple(out)


def close_modes(problem: ModalProblem, modes: Modes, within: float) -> tuple[Group, ...]:
    """The same of a problem's model modes and measurement."""
    measured = problem.measured
    return close_groups(modes.natural_freq, measured.natural_freq, known_std(measured).freq, within)


def has_equal_modes(problem: ModalProblem) -> bool:
    """See `equal_at_nominal`; a large model whose effects are absent at its nominal values is its base model there."""
    base = problem.base
    if base is not None and problem.reducible is not None and _is_nominally(problem, base):
        return base.has_equal_modes
    return equal_at_nominal(problem)


def _is_nominally(problem: ModalProblem, base: ModalProblem) -> bool:
    """Whether both compare the same at their nominal values, but for effects."""
    given = ("freq_window", "override", "threshold", "mode_clusters")
    alike = base.measured is problem.measured and all(getattr(base, one) == getattr(problem, one) for one in given)
    here, there = problem.space.values, base.space.values
    return alike and all(here.get(name) == there[name] for name in there)


def equal_at_nominal(problem: ModalProblem) -> bool:
    """Whether measured modes are paired with modes of equal frequency of the nominal model.

    Square and axisymmetric structures have such modes; equal modes of parts that no measured mode moves do not count.
    """
    values = problem.space.values
    try:
        modes = problem.solve(values)
        groups = close_modes(problem, modes, RULES.subspace_equal)
        if not groups:
            return False
        index = _paired(problem, values, modes, groups)[2]
    except EvaluationError:
        return False
    return bool(np.isin(index, np.concatenate([np.array(group) for group in groups])).any())


def subspace_mac(shapes: np.ndarray, sensor_shapes: np.ndarray) -> np.ndarray:
    """MAC of measured shapes with the motion that model shapes span, (n_measured,), corrected for their number.

    ``1 - |u_left|^2/|u|^2 (n - 1)/(n - d)``: a random shape at n sensors then has the same expectation as with one
    model shape; 0 for as many model shapes as sensors.
    """
    out = np.zeros(shapes.shape[1])
    for i, shape in enumerate(shapes.T):
        known = np.isfinite(shape)
        n, d, size = int(known.sum()), sensor_shapes.shape[1], float(np.sum(np.abs(shape[known]) ** 2))
        if n > d and size > 0:
            left = _real(shape[known]) - _real(sensor_shapes[known]) @ _mixture(shape, sensor_shapes)
            out[i] = max(0.0, 1.0 - float(left @ left) / size * (n - 1) / (n - d))
    return out


def turned_to_measured(
    problem: ModalProblem, values: Mapping[str, float], modes: Modes, sensor_shapes: np.ndarray
) -> tuple[Modes, np.ndarray]:
    """Modes of a problem at some values, turned to the measured shapes where they are close, and their sensor shapes.

    Measured modes are paired with the subspaces first, by `subspace_mac`. ``sensor_shapes`` is (n_sensors, n_model).
    """
    groups = close_modes(problem, modes, RULES.subspace_reach)
    if groups and not problem.has_equal_modes:
        groups = close_modes(problem, modes, RULES.subspace_equal)
    if not groups:
        return modes, sensor_shapes
    bases, sensor_shapes, index = _paired(problem, values, modes, groups)
    found = turned_modes(modes, bases, sensor_shapes, problem.measured.shapes, groups, index)
    return found, problem.sensor_rows @ found.shapes


def _paired(
    problem: ModalProblem, values: Mapping[str, float], modes: Modes, groups: Sequence[Group]
) -> tuple[Modes, np.ndarray, np.ndarray]:
    """The modes with each group in a real basis, their sensor shapes, and the model mode of every measured one."""
    shapes = problem.measured.shapes
    bases = _real_bases(problem, values, modes, groups)
    sensor_shapes = problem.sensor_rows @ bases.shapes
    alike = mac(shapes, sensor_shapes)
    for group in map(list, groups):
        alike[:, group] = subspace_mac(shapes, sensor_shapes[:, group])[:, None]
    shares = problem.energy_shares(values, bases)
    return bases, sensor_shapes, problem.pair(shapes, sensor_shapes, shares, modes, known=alike)[0].model_index


def turned_modes(
    modes: Modes,
    bases: Modes,
    sensor_shapes: np.ndarray,
    shapes: np.ndarray,
    groups: Sequence[Group],
    index: np.ndarray,
) -> Modes:
    """Modes turned inside their groups to measured shapes, still orthonormal in the mass matrix.

    Parameters
    ----------
    modes : Modes
    bases : Modes
        The same, each group in a real basis of its subspace.
    sensor_shapes : ndarray (n_sensors, n_model)
        Their motion at the sensors.
    shapes : ndarray (n_sensors, n_measured)
        Measured; NaN where not measured.
    groups : sequence of tuple of int
    index : ndarray (n_measured,), int
        Model mode of every measured mode, -1 for none; the mode is turned to it.

    Returns
    -------
    Modes
        The eigenvalue of a turned mode is its Rayleigh quotient, the mean of those that it mixes by their shares. A
        group in which no measured mode lies stays as it is.
    """
    undamped = not modes.is_complex
    out, value = modes.shapes.copy(), eigenvalues(modes) ** (2 if undamped else 1)
    kept = []
    for group in groups:
        columns, own = list(group), np.flatnonzero(np.isin(index, group))
        mixtures = np.array([_mixture(shapes[:, i], sensor_shapes[:, columns]) for i in own])
        size = np.linalg.norm(mixtures, axis=-1)
        if not len(own) or not np.all(size > 0):
            continue
        left, _, right = np.linalg.svd((mixtures / size[:, None]).T)
        places = [columns.index(j) for j in index[own]]
        order = [*places, *(k for k in range(len(columns)) if k not in places)]
        turn = np.empty((len(columns), len(columns)))
        turn[:, order] = np.hstack([left[:, : len(own)] @ right, left[:, len(own) :]])
        out[:, columns] = bases.shapes[:, columns] @ turn
        parts = np.abs(np.linalg.lstsq(modes.shapes[:, columns], out[:, columns], rcond=None)[0]) ** 2
        value[columns] = value[columns] @ (parts / parts.sum(axis=0))
        kept.append(group)
    if not kept:
        return modes
    value = np.sqrt(value + 0j) if undamped else value
    moved = np.unique(np.concatenate([np.array(group) for group in kept]))
    size = np.abs(value[moved])
    natural, damped, ratio = modes.natural_freq.copy(), modes.damped_freq.copy(), modes.damping_ratio.copy()
    natural[moved] = size / (2 * np.pi)
    damped[moved] = natural[moved] if undamped else value[moved].imag / (2 * np.pi)
    ratio[moved] = 0.0 if undamped else -value[moved].real / size
    return replace(modes, natural_freq=natural, damped_freq=damped, damping_ratio=ratio, shapes=out, groups=tuple(kept))


def _real_bases(problem: ModalProblem, values: Mapping[str, float], modes: Modes, groups: Sequence[Group]) -> Modes:
    """Complex modes with each group in a real basis, orthonormal in the mass matrix; those of an undamped model as is.

    Shapes of a repeated complex eigenvalue are any mixtures, of whatever phases. With ``Q R`` the shapes of a group and
    ``A = Q^T Q``, the columns of ``Q A^(-1/2)`` are real where the subspace has a real basis. They are scaled as
    complex shapes of proportional damping, of which ``psi^T (2 lambda M + C) psi = 2j Im(lambda) psi^T M psi = 1``.
    """
    if not modes.is_complex:
        return modes
    out = modes.shapes.copy()
    for group in map(list, groups):
        basis = np.linalg.qr(modes.shapes[:, group])[0]
        basis = basis @ np.linalg.inv(sqrtm(basis.T @ basis))
        weighted = problem.model.weighted(values, basis)
        gram = np.eye(len(group)) if weighted is None else np.real(basis.conj().T @ weighted)
        omega = 2 * np.pi * float(np.mean(modes.damped_freq[group]))
        out[:, group] = basis @ np.linalg.inv(np.real(sqrtm(gram))) / np.sqrt(2j * omega)
    return replace(modes, shapes=out)


def _mixture(shape: np.ndarray, sensor_shapes: np.ndarray) -> np.ndarray:
    """Real shares (d,) in which model shapes (n_sensors, d) make up a measured one; 0 for what sensors hardly see."""
    known = np.isfinite(shape)
    motion = _real(sensor_shapes[known])
    return np.asarray(np.linalg.lstsq(motion, _real(shape[known]), rcond=RULES.subspace_seen)[0])


def _real(shapes: np.ndarray) -> np.ndarray:
    """Real part in the most real phase, common to all shapes: modes of one group share it."""
    return np.asarray(np.real(shapes * np.exp(-0.5j * np.angle(np.sum(np.asarray(shapes, dtype=complex) ** 2)))))
