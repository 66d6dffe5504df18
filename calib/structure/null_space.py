"""Rows and motions that have neither stiffness nor mass, as exports of fixed rows and of hourglass motions have."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
import scipy.linalg as la
import scipy.sparse as sp

from calib.errors.errors import InputError
from calib.structure.affine import AffineMatrix, Term
from calib.structure.dof_table import DofTable
from calib.structure.eigenproblem.krylov import start_vector
from calib.structure.eigenproblem.symmetric_factor import symmetric_factor
from calib.structure.rules import RULES

_SHIFT, _MORE = 1e-13, 10.0
"""Added to the diagonal of 1: keeps the factor of a singular matrix regular; and a larger shift, over it."""
_NAMED = 3
"""Rows that are named in one sentence."""


def empty_rows(matrices: Sequence[AffineMatrix]) -> np.ndarray:
    """Rows without an entry in any term, (n_dof,), bool."""
    touched = np.zeros(matrices[0].n_dof)
    for matrix in matrices:
        for term in matrix.terms:
            touched += np.asarray(abs(sp.csr_array(term.matrix)).sum(axis=1)).ravel()
    return touched == 0


def common_null_space(stiffness: sp.csc_array, mass: sp.csc_array) -> tuple[np.ndarray, np.ndarray]:
    """Motions that have neither stiffness nor mass.

    The sum of the matrices, with the mass scaled to the largest local eigenvalue and the diagonal to 1, is well
    conditioned but for these: each leaves one vanishing pivot, and setting the motion of its row to zero takes it away
    and leaves all frequencies as they are (a mode plus such a motion is the same mode).

    Parameters
    ----------
    stiffness, mass : csc_array (n_dof, n_dof)
        Symmetric, positive semidefinite; SI.

    Returns
    -------
    rows : ndarray (n_motions,), int
        A row for each motion, of which the others are independent.
    motions : ndarray (n_dof, n_motions)
        Each is 1 in its row and 0 in those of the others. Both are empty for matrices that are not positive
        semidefinite, such as those with Lagrange multipliers.
    """
    n = stiffness.shape[0]
    none = np.zeros(0, dtype=int), np.zeros((n, 0))
    k, m = stiffness.diagonal(), mass.diagonal()
    heavy = m > 0
    if not heavy.any():
        return none
    if np.all(2 * m > np.asarray(abs(mass).sum(axis=1)).ravel()):
        return none  # a mass matrix with a dominant diagonal is positive definite
    local = np.abs(k[heavy]) / m[heavy]
    whole = sp.csc_array(stiffness + (float(local.max()) or 1.0) * mass)
    diagonal = whole.diagonal()
    if not np.all(diagonal > 0):
        return none
    scale = sp.diags_array(1 / np.sqrt(diagonal))
    scaled = sp.csc_array(scale @ whole @ scale)
    rows = _vanishing(scaled)
    if not len(rows):
        return none
    others = np.setdiff1d(np.arange(n), rows)
    motions = np.zeros((n, len(rows)))
    motions[rows, np.arange(len(rows))] = 1.0
    if len(others):
        inner = symmetric_factor(sp.csc_array(scaled[others][:, others]))
        motions[others] = -inner.solve(scaled[others][:, rows].toarray())
    motions = np.asarray(scale @ motions)
    # rows that move most, so that fixing them leaves no motion that is nearly null
    rows = np.sort(la.qr(motions.T, mode="r", pivoting=True)[1][: len(rows)])
    motions = np.linalg.solve(motions[rows].T, motions.T).T
    null = [_vanishes(stiffness, v) and _vanishes(mass, v) for v in motions.T]
    return rows[null], motions[:, null]


def answers_with_null_motion(
    solve: Callable[[np.ndarray], np.ndarray], stiffness: sp.csc_array, mass: sp.csc_array
) -> bool:
    """Whether a factor of both matrices answers a load by a motion with neither stiffness nor mass, but for rounding.

    Such a motion vanishes from every pivot only up to rounding, so that the factor and the modes may be computed all
    the same: frequencies are then right, and shapes hold the motion at random. Rigid-body motions have mass.

    Parameters
    ----------
    solve : callable
        Solves ``(K + s C + s^2 M) x = b`` of a small shift s for b (n_dof,).
    stiffness, mass : csc_array (n_dof, n_dof)
        Symmetric; SI.
    """
    with np.errstate(all="ignore"):
        motion = solve(start_vector(stiffness.shape[0]))
        size = float(np.abs(motion).max(initial=0.0))
    if not np.isfinite(size):
        return True
    return size > 0 and _vanishes(stiffness, motion / size) and _vanishes(mass, motion / size)


def _vanishing(scaled: sp.csc_array) -> np.ndarray:
    """Rows whose pivot vanishes with a shift of the diagonal of 1: others hardly depend on it."""
    found = []
    for shift in (_SHIFT, _MORE * _SHIFT):
        try:
            # Which rows vanish depends on the order; those that are fixed are told.
            lu = symmetric_factor(sp.csc_array(scaled + shift * sp.eye_array(scaled.shape[0])), dissected=False)
        except RuntimeError:
            return np.zeros(0, dtype=int)
        pivots = lu.pivots
        if not lu.on_diagonal or pivots.min() < 0:
            return np.zeros(0, dtype=int)
        found.append(pivots)
        if pivots.min() > RULES.null_pivot:
            break
    return np.flatnonzero(found[-1] > np.sqrt(_MORE) * found[0])


def _vanishes(matrix: sp.csc_array, motion: np.ndarray) -> bool:
    """Whether a matrix has no force on a motion, but for rounding."""
    size = float((abs(matrix) @ np.abs(motion)).max(initial=0.0))
    return float(np.abs(matrix @ motion).max(initial=0.0)) <= RULES.null_force * size or size == 0


def without_null(
    matrices: Mapping[str, AffineMatrix], values: Mapping[str, float], table: DofTable, name: str
) -> tuple[dict[str, AffineMatrix], DofTable, tuple[tuple[str, str, str], ...]]:
    """Matrices and rows without those that have neither stiffness nor mass.

    Parameters
    ----------
    matrices : mapping from kind (``stiffness``, ``damping``, ``mass``) to AffineMatrix
    values : mapping from str to float
        Nominal values, SI.
    table : DofTable
    name : str
        Of the model.

    Returns
    -------
    matrices : dict from kind to AffineMatrix
    table : DofTable
    dropped : tuple of (item, value, reason)
        What was dropped and why, in words.

    Raises
    ------
    InputError
        When no row is left, or a motion without stiffness and mass is damped.
    """
    dropped = []
    empty = empty_rows(list(matrices.values()))
    if empty.all():
        raise InputError("no row has stiffness or mass", place=f"model {name}", remedy="give the matrices of the model")
    if empty.any():
        rows = np.flatnonzero(empty)
        what = "1 empty row" if len(rows) == 1 else f"{len(rows)} empty rows"
        dropped.append((f"{what}: {_listed(table, rows)}", "fixed", "neither stiffness nor mass, as exports of fixed "
                        "rows have"))  # fmt: skip
        matrices, table = _kept(matrices, ~empty), _rows_of(table, ~empty)
    stiffness, mass = matrices["stiffness"](values), matrices["mass"](values)
    rows, motions = common_null_space(stiffness, mass)
    if len(rows):
        terms = [term for kind in ("stiffness", "mass") for term in matrices[kind].terms]
        null = [all(_vanishes(sp.csc_array(term.matrix), v) for term in terms) for v in motions.T]
        rows, motions = rows[null], motions[:, null]
    if len(rows):
        words = f"common null space: {motions_in_words(len(rows))}"
        damped = [term.name for term in matrices["damping"].terms if not _all_vanish(term, motions)]
        if damped:
            raise InputError(
                f"{words} without stiffness and mass, but with damping ({damped[0]!r}), at {_listed(table, rows)}",
                place=f"model {name}", remedy="give it mass or stiffness, or take it out of the damping",
            )  # fmt: skip
        reason = "neither stiffness nor mass, as hourglass motions have: the frequencies do not depend on it"
        dropped.append((words, f"fixed at {_listed(table, rows)}", reason))
        kept = np.ones(table.n_dof, dtype=bool)
        kept[rows] = False
        matrices, table = _kept(matrices, kept), _rows_of(table, kept)
    return dict(matrices), table, tuple(dropped)


def motions_in_words(count: int) -> str:
    """Number of motions."""
    return "1 motion" if count == 1 else f"{count} motions"


def _all_vanish(term: Term, motions: np.ndarray) -> bool:
    return all(_vanishes(sp.csc_array(term.matrix), v) for v in motions.T)


def _listed(table: DofTable, rows: np.ndarray) -> str:
    more = f" and {len(rows) - _NAMED} more" if len(rows) > _NAMED else ""
    return ", ".join(table.words(int(k)) for k in rows[:_NAMED]) + more


def _rows_of(table: DofTable, kept: np.ndarray) -> DofTable:
    return DofTable(table.node[kept], table.direction[kept], table.labels, table.points)


def _kept(matrices: Mapping[str, AffineMatrix], kept: np.ndarray) -> dict[str, AffineMatrix]:
    rows = np.flatnonzero(kept)
    return {
        kind: AffineMatrix(
            len(rows),
            tuple(Term(t.name, sp.csr_array(t.matrix)[rows][:, rows], t.coefficient) for t in matrix.terms),
        )
        for kind, matrix in matrices.items()
    }
