"""Systems that are singular at an eigenvalue, solved for many modes at once with the help of all known modes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np

Operator: TypeAlias = Callable[[np.ndarray, np.ndarray], np.ndarray]
"""Acts on a block (n_dof, m) whose columns stand at the places (m,) of the right-hand side."""

CONVERGED = 5e-7
"""Residual over the size of the forces at which a column is solved."""
_STEPS = 16
"""Steps after which a column counts as not solved."""
_FACTOR, _BORDERED, _COLUMN = 30.0, 220.0, 2.6
"""Times of a sparse factor, of one with a border, and of a column solved by that, over a step of `iterated` per column.

Measured on real modes of a grillage with 2,000 to 10,000 degrees of freedom: 19 to 33; 35 to 65 with one mode in the
border, 110 to 250 with 5 to 15; 1.3 to 2.8. With damping, on that and on a bogie: 6 to 13, 26 to 29, 1 to 2. They need
not be exact: 33, 62 and 1 change the time of derivatives by 15 % at most.
"""
_CLEAR = 1e-3
"""Least relative distance of two squared frequencies between which a matrix is factorised."""


def iterated(
    operate: Operator, approximate: Operator, right: np.ndarray, size: np.ndarray, steps: int = _STEPS
) -> tuple[np.ndarray, np.ndarray]:
    """Solutions of many symmetric systems with one approximate inverse, and which of them converged.

    Conjugate gradients without conjugation (van der Vorst and Melissen 1990), which for real systems are the usual
    ones, after one step with the approximate inverse. Converged columns are left out.

    Parameters
    ----------
    operate : Operator
        The matrices: symmetric, each in its column.
    approximate : Operator
        An approximate inverse, symmetric too.
    right : ndarray (n_dof, m)
    size : ndarray (m,)
        What a residual is compared with, see `CONVERGED`.
    steps : int

    Returns
    -------
    solution : ndarray (n_dof, m)
    converged : ndarray (m,), bool
        Whether the residual itself, not that of the recurrence which drifts from it, is within ten times `CONVERGED`.
    """
    every = np.arange(right.shape[1])
    out = np.array(approximate(right, every))
    rest = right - operate(out, every)
    waiting = every[np.linalg.norm(rest, axis=0) > CONVERGED * size]
    rest, along, before = rest[:, waiting], np.zeros((len(right), len(waiting)), dtype=out.dtype), np.ones(len(waiting))
    for _ in range(steps):
        if not len(waiting):
            break
        moved = approximate(rest, waiting)
        energy = np.einsum("ij,ij->j", rest, moved)
        along = moved + along * (energy / before)
        image = operate(along, waiting)
        with np.errstate(divide="ignore", invalid="ignore"):
            length = energy / np.einsum("ij,ij->j", along, image)
        out[:, waiting] += along * length
        rest = rest - image * length
        missing = np.linalg.norm(rest, axis=0)
        going = np.isfinite(missing) & (missing > CONVERGED * size[waiting])
        rest, along, before, waiting = rest[:, going], along[:, going], energy[going], waiting[going]
    good = np.linalg.norm(right - operate(out, every), axis=0) <= 10 * CONVERGED * size
    return out, np.isfinite(out).all(axis=0) & good


def steps_of(ratio: np.ndarray) -> np.ndarray:
    """Steps of `iterated` that systems take whose spectrum lies between a ratio and 1, or between 1 and a ratio."""
    with np.errstate(divide="ignore", invalid="ignore"):
        root = np.sqrt(np.maximum(ratio, 1 / ratio))
        rate = np.maximum((root - 1) / (root + 1), CONVERGED)
        return np.where((ratio > 0) & (rate < 1), 1 + np.log(CONVERGED / 2) / np.log(rate), np.inf)


def bands(
    known: np.ndarray, chosen: Sequence[int], columns: int, regular: bool, shifted: bool = True
) -> list[tuple[float, list[int]]]:
    """Which modes share a factor of ``K - shift M``, and the shift; a mode in no band is solved by itself.

    Between the known modes and the next one all is left that a shifted factor does not represent: a shift near a mode
    saves steps, and costs a factor. Bands of equally many modes are tried, and what costs least is taken.

    Parameters
    ----------
    known : ndarray (n_known,)
        Squared frequencies in ascending order, rad/s squared; all that there are up to the last.
    chosen : sequence of int
        Modes whose systems are solved.
    columns : int
        Right-hand sides of each.
    regular : bool
        Whether K itself can be factorised.
    shifted : bool
        Whether a shift other than 0 serves.
    """
    edge = known[-1]
    gaps = np.flatnonzero(np.diff(known) > _CLEAR * known[1:])
    shifts = 0.5 * (known[gaps] + known[gaps + 1]) if shifted else np.zeros(0)
    shifts = np.concatenate([[0.0 if regular else 0.5 * known[0]], shifts])
    if not (regular or shifted):
        return []
    order = sorted(chosen)
    with np.errstate(divide="ignore", invalid="ignore"):
        taken = steps_of((edge - known[order]) / (edge - shifts[:, None]))  # (n_shifts, n_chosen)
    taken = np.where(taken <= _STEPS, taken, np.inf)
    alone = _BORDERED + _COLUMN * columns
    best, least = list[tuple[float, list[int]]](), alone * len(order)
    count = 1
    while count <= len(order):
        found, cost = [], 0.0
        for part in np.array_split(np.arange(len(order)), count):
            each = np.minimum(columns * taken[:, part], alone)
            shift = int(np.argmin(each.sum(axis=1)))
            served = [order[j] for j in part[each[shift] < alone].tolist()]
            cost += _FACTOR * bool(served) + float(each[shift].sum())
            found += [(float(shifts[shift]), served)] if served else []
        if cost < least:
            best, least = found, cost
        count *= 2
    return best


def rigid_modes(solve: Callable[[np.ndarray], np.ndarray], mass: Any, count: int) -> np.ndarray:
    """Rigid-body motions and mechanisms, orthonormal in the mass, (n_dof, count).

    ``solve`` applies the inverse of ``K + s M`` with s far below the squared frequencies, so that few steps of
    inverse iteration leave nothing else.
    """
    motions = np.random.default_rng(20110713).standard_normal((mass.shape[0], count))
    for _ in range(4):
        motions = solve(mass @ np.linalg.qr(motions)[0])
    energies, turn = np.linalg.eigh(motions.T @ (mass @ motions))
    return np.asarray(motions @ (turn / np.sqrt(energies)))
