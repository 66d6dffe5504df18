"""Static reduction of a model to master degrees of freedom: Guyan, IRS, the iterated IRS (SAR) and SEREP.

The motion of all degrees of freedom is ``x = T x_m``, with rows of the identity for the masters. With slaves s, static
condensation (Guyan 1965) gives ``t = -K_ss^-1 K_sm``. The improved reduced system (O'Callahan 1989) adds the inertia of
the slaves once; its iteration (Friswell, Garvey and Penny 1995; the successive approximate reduction of Zhang and Li
1995 as reconstructed from the slave rows of the eigenproblem) repeats it with the matrices of the level before. Levels
count from Guyan: 0 is Guyan, 1 the improved reduced system. With all modes kept apart by the masters the levels tend to
SEREP (O'Callahan, Avitabile and Riemer 1989) of the lowest ones.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.linalg as la
import scipy.sparse as sp

from calib.errors.errors import EvaluationError, InputError
from calib.structure.eigenproblem.symmetric_factor import SymmetricFactor, symmetric_factor

_SINGULAR = 1e-13
"""Smallest pivot over the largest below which slaves are taken to move without strain; also of the reduced mass."""

_ALIKE = 1e-8
"""Smallest singular value over the largest of shapes at the masters below which two of them look alike there."""


@dataclass(frozen=True, eq=False)
class StaticReduction:
    """A model at its master degrees of freedom.

    Attributes
    ----------
    masters : ndarray (n_masters,), int
        Indices of the master degrees of freedom.
    transformation : ndarray (n_dof, n_masters)
        T; its master rows are the identity, except for `serep` with fewer shapes than masters.
    stiffness, mass : ndarray (n_masters, n_masters)
        ``T^T K T`` and ``T^T M T``; SI.
    """

    masters: np.ndarray
    transformation: np.ndarray
    stiffness: np.ndarray
    mass: np.ndarray

    @property
    def natural_freq(self) -> np.ndarray:
        """Natural frequencies in Hz, ascending; upper bounds of the model's (Rayleigh-Ritz).

        As many as masters, or as the shapes of `serep`.
        """
        size, directions = la.eigh(self.mass)
        heavy = size > _SINGULAR * size[-1]
        whitened = directions[:, heavy] / np.sqrt(size[heavy])
        eigenvalues = la.eigvalsh(whitened.T @ self.stiffness @ whitened)
        return np.sqrt(np.maximum(eigenvalues, 0.0)) / (2 * np.pi)

    def expand(self, shapes: np.ndarray) -> np.ndarray:
        """Shapes at the masters (n_masters, n_modes) over all degrees of freedom, (n_dof, n_modes)."""
        return self.transformation @ shapes


def reduction_levels(
    stiffness: sp.csc_array, mass: sp.csc_array, masters: Sequence[int] | np.ndarray
) -> Iterator[StaticReduction]:
    """Successive reductions: Guyan, IRS, and the iterated IRS from level 2 on, without end.

    The slaves' stiffness is factorised once. The frequency of mode r converges by about
    ``(freq_r / lowest frequency with the masters held)^2`` per level.

    Parameters
    ----------
    stiffness, mass : csc_array (n_dof, n_dof)
        Symmetric; SI.
    masters : sequence of int
        Indices of the master degrees of freedom.

    Raises
    ------
    InputError
        For no masters, an index out of range or given twice.
    EvaluationError
        When slaves move without strain while the masters are held, or no mass moves with a master.
    """
    n = stiffness.shape[0]
    chosen = _checked(masters, n)
    slaves = np.setdiff1d(np.arange(n), chosen)
    k, m = sp.csc_array(stiffness), sp.csc_array(mass)
    if not len(slaves):
        yield from _whole(k, m, chosen)
    factor = _factor(sp.csc_array(k[slaves][:, slaves]), slaves)
    static = -factor.solve(k[slaves][:, chosen].toarray())
    m_ss, m_sm = m[slaves][:, slaves], m[slaves][:, chosen].toarray()
    t = static
    while True:
        transformation = np.zeros((n, len(chosen)))
        transformation[chosen], transformation[slaves] = np.eye(len(chosen)), t
        reduced = reduction_by(k, m, chosen, transformation)
        yield reduced
        t = static + factor.solve((m_sm + m_ss @ t) @ _per_mass(reduced))


def static_reduction(
    stiffness: sp.csc_array, mass: sp.csc_array, masters: Sequence[int] | np.ndarray, level: int = 0
) -> StaticReduction:
    """The reduction at one level: 0 is Guyan, 1 the improved reduced system; see `reduction_levels`.

    Raises
    ------
    InputError
        Also when the level is negative.
    """
    if level < 0:
        raise InputError(f"level {level} is asked for", place="static reduction", remedy="0 (Guyan) or more")
    found = reduction_levels(stiffness, mass, masters)
    for _ in range(level):
        next(found)
    return next(found)


def serep(
    stiffness: sp.csc_array, mass: sp.csc_array, masters: Sequence[int] | np.ndarray, shapes: np.ndarray
) -> StaticReduction:
    """System equivalent reduction: ``T = Phi Phi_m^+``, exact for the modes whose shapes are given.

    Parameters
    ----------
    stiffness, mass : csc_array (n_dof, n_dof)
    masters : sequence of int
    shapes : ndarray (n_dof, n_modes)
        Real shapes, at most as many as masters. With fewer, the master rows of T are a projection on the shapes.

    Raises
    ------
    EvaluationError
        When the masters cannot tell the shapes apart.
    """
    chosen = _checked(masters, stiffness.shape[0])
    wanted = np.asarray(shapes)
    values = la.svdvals(wanted[chosen])
    apart = int(np.count_nonzero(values > _ALIKE * values[0]))
    if apart < wanted.shape[1]:
        raise EvaluationError(
            f"{len(chosen)} masters tell {apart} of {wanted.shape[1]} shapes apart; give fewer shapes or more masters"
        )
    return reduction_by(stiffness, mass, chosen, wanted @ la.pinv(wanted[chosen]))


def reduction_by(
    stiffness: sp.csc_array, mass: sp.csc_array, masters: np.ndarray, transformation: np.ndarray
) -> StaticReduction:
    """The reduction that a transformation (n_dof, n_masters) gives."""
    k, m = (transformation.T @ (matrix @ transformation) for matrix in (stiffness, mass))
    return StaticReduction(masters, transformation, (k + k.T) / 2, (m + m.T) / 2)


def _whole(k: sp.csc_array, m: sp.csc_array, masters: np.ndarray) -> Iterator[StaticReduction]:
    """Every degree of freedom is a master."""
    transformation = np.eye(k.shape[0])[:, masters]
    while True:
        yield reduction_by(k, m, masters, transformation)


def _checked(masters: Sequence[int] | np.ndarray, n_dof: int) -> np.ndarray:
    chosen = np.asarray(masters, dtype=int)
    if not len(chosen) or len(set(chosen.tolist())) < len(chosen) or not np.all((chosen >= 0) & (chosen < n_dof)):
        raise InputError(
            f"masters are {chosen.tolist()}",
            place="static reduction",
            remedy=f"give different degrees of freedom between 0 and {n_dof - 1}",
        )
    return chosen


def _factor(k_ss: sp.csc_array, slaves: np.ndarray) -> SymmetricFactor:
    try:
        factor = symmetric_factor(k_ss)
    except RuntimeError as fault:
        raise _loose(k_ss, slaves) from fault
    pivots = np.abs(factor.pivots)
    if not pivots.min() > _SINGULAR * pivots.max():
        raise _loose(k_ss, slaves)
    return factor


def _loose(k_ss: sp.csc_array, slaves: np.ndarray) -> EvaluationError:
    """The error for a singular stiffness of the slaves; names the one that moves most under a load on all."""
    held = sp.csc_array(k_ss + 1e-9 * abs(k_ss).max() * sp.eye_array(len(slaves)))
    moved = symmetric_factor(held).solve(np.random.default_rng(0).standard_normal(len(slaves)))
    return EvaluationError(
        "slaves move without strain while the masters are held: a part without a master is free, "
        f"with degree of freedom {slaves[np.argmax(np.abs(moved))]} (counted from 0)"
    )


def _per_mass(reduced: StaticReduction) -> np.ndarray:
    try:
        return np.asarray(la.solve(reduced.mass, reduced.stiffness, assume_a="pos"))
    except la.LinAlgError as fault:
        raise EvaluationError("no mass moves with some combination of masters") from fault
