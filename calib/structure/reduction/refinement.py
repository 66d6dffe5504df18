"""Refinement: full-order modes by correction of reduced ones, a small part of the cost of an eigensolution."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence

import numpy as np
import scipy.linalg as la
import scipy.sparse as sp

from calib.errors.errors import EvaluationError
from calib.structure.eigenproblem.derivatives import eigenvalues
from calib.structure.eigenproblem.eigenvalues import is_zero
from calib.structure.eigenproblem.inertia import count_below
from calib.structure.eigenproblem.solve import rotational_share_of
from calib.structure.eigenproblem.solve_dense import solve_dense
from calib.structure.eigenproblem.symmetric_factor import symmetric_factor
from calib.structure.modes import Modes
from calib.structure.reduction.reduced import ReducedModel

_ORTHOGONAL = 1e-12
"""Largest product of an old direction with a new one: a thousand times that of rounding."""


class GrowingSpace:
    """A growing space and the matrices projected on it; each step multiplies only the directions that are new.

    Directions times ``scale`` are orthonormal, as K is nearly diagonal after division by it. Columns that depend on
    others become any further direction. Old directions are taken out of new ones twice, which suffices for independent
    columns (Giraud, Langou, Rozloznik and van den Eshof 2005); where it does not, all are made orthonormal anew.

    Parameters
    ----------
    matrices : sequence of sparse matrix (n_dof, n_dof)
        Symmetric.
    scale : ndarray (n_dof, 1)
        Positive.
    """

    def __init__(self, matrices: Sequence[sp.csc_array], scale: np.ndarray) -> None:
        self._matrices, self._scale = tuple(matrices), scale
        self.basis = np.zeros((len(scale), 0))
        """Directions, (n_dof, n)."""
        self.projected = tuple(np.zeros((0, 0)) for _ in matrices)
        """Symmetric, (n, n) each, in the order of the matrices."""

    def add(self, columns: np.ndarray) -> None:
        """Extend the space by columns, (n_dof, k)."""
        scaled = self._scale * columns
        old, new = self._scale * self.basis, scaled / np.maximum(np.linalg.norm(scaled, axis=0), 1e-300)
        every = np.hstack([old, new])
        for _ in range(2 if old.shape[1] else 1):
            new = _orthonormal(new - old @ (old.T @ new))
        if every.shape[1] > len(old) or np.max(np.abs(old.T @ new), initial=0.0) > _ORTHOGONAL:
            new = _orthonormal(every)
            self.basis, self.projected = self.basis[:, :0], tuple(one[:0, :0] for one in self.projected)
        more = new / self._scale
        self.projected = tuple(
            _bordered(inner, self.basis, more, matrix)
            for inner, matrix in zip(self.projected, self._matrices, strict=True)
        )
        self.basis = np.hstack([self.basis, more])


def _orthonormal(columns: np.ndarray) -> np.ndarray:
    directions: np.ndarray = la.qr(columns, mode="economic", check_finite=False)[0]
    return directions


def _bordered(inner: np.ndarray, old: np.ndarray, new: np.ndarray, matrix: sp.csc_array) -> np.ndarray:
    """A symmetric matrix projected on old and new directions, from that on the old ones."""
    image = matrix @ new
    beside, corner = old.T @ image, new.T @ image
    return np.block([[inner, beside], [beside.T, 0.5 * (corner + corner.T)]])


STEPS = 4
"""Corrections before refinement gives up."""
ACCURACY = 1e-8
"""Estimated relative eigenvalue error at which refinement ends, unless told otherwise."""
_CLEAR = 1e-3
"""Least relative distance of two undamped frequencies between which modes are counted."""
_ALONG = 0.1
"""Modes are corrected along with others while their estimated error is above this part of the one asked for."""
_SHIFT = 1e-10
"""Squared shift that keeps a factor regular, over the largest local eigenvalue."""


def refined_modes(
    reduced: ReducedModel, values: Mapping[str, float], count: int, accuracy: float = ACCURACY
) -> Modes | None:
    """The ``count`` lowest modes of the full model, from those of a reduced model.

    Each step solves for the correction ``d = -K^-1 R`` of every mode that is not accurate yet, with the residual
    ``R = (lambda^2 M + lambda C + K) psi`` and one real factor of K for all modes and steps, and projects the model on
    the shapes and all corrections together (block Rayleigh-Ritz; a Davidson method with the static inverse as
    preconditioner, Saad 2011, section 8.2). An eigenvalue's error is of second order in that of its shape.

    Modes that the reduced model lacks stay unknown: `undamped_count_agrees` or a solution at full order finds them.

    Parameters
    ----------
    reduced : ReducedModel
    values : mapping
    count : int
        Number of modes, at most those that the basis was trained for.
    accuracy : float
        Relative eigenvalue error: the steps end where its estimate is below, ``|R^H K^-1 R|/|lambda|`` before the last
        step of a mode times the square of the ratio by which its residual has shrunk since. It is no bound. Nearly
        critical modes, with a damping ratio above that of the basis, are corrected once.

    Returns
    -------
    Modes or None
        In the conventions of `calib.structure.eigenproblem.solve.solve_modes`; None where `STEPS` steps do not suffice.

    Raises
    ------
    EvaluationError
        When the factor is singular or the projected problem cannot be solved.
    """
    full = reduced.model
    found = reduced.modes(values, count)
    stiffness, damping, mass = full.matrices(values)
    rotational = full.dofs.direction >= 3
    try:
        factor = symmetric_factor(sp.csc_array(stiffness + reduced.basis.offset * mass))
    except RuntimeError as fault:
        raise EvaluationError(f"the eigenproblem could not be solved ({fault})") from fault
    scale = np.sqrt(np.maximum(stiffness.diagonal(), 1e-12 * stiffness.diagonal().max()))[:, None]
    share = rotational_share_of(mass, rotational)
    modes = Modes(
        found.natural_freq, found.damped_freq, found.damping_ratio, reduced.lift(found.shapes), found.excluded
    )
    rest = _residual(modes, stiffness, damping, mass)
    space = GrowingSpace((stiffness, damping, mass), scale)
    space.add(np.hstack([reduced.lift(_rigid(reduced, values)), real_columns(modes.shapes)]))
    error, waiting = np.full(count, np.inf), np.arange(count)
    for _ in range(STEPS):
        correction = factor.solve_by_parts(rest[:, waiting])
        error[waiting] = np.abs(np.einsum("ij,ij->j", rest[:, waiting].conj(), correction)) / _size(modes)[waiting]
        space.add(real_columns(correction))
        basis = space.basis

        def shared(shape: np.ndarray, basis: np.ndarray = basis) -> float:
            return share(basis @ shape)

        k, c, m = space.projected
        found = solve_dense(k, c if full.is_damped else None, m, count, shared)
        if found.n_modes < count or found.is_complex != modes.is_complex:
            return None
        modes = Modes(found.natural_freq, found.damped_freq, found.damping_ratio, basis @ found.shapes, found.excluded)
        old, rest = np.linalg.norm(rest / scale, axis=0), _residual(modes, stiffness, damping, mass)
        ratio = np.linalg.norm(rest / scale, axis=0) / np.maximum(old, 1e-300)
        ratio[waiting] = np.minimum(ratio[waiting], 1.0)
        error *= ratio**2  # also of those that were not corrected: where two have changed places, both are looked at
        asked = modes.damping_ratio < reduced.basis.damping_max
        if np.max(error[asked], initial=0.0) < accuracy:
            return modes
        waiting = np.flatnonzero(asked & (error >= _ALONG * accuracy))
    return None


def undamped_count_agrees(reduced: ReducedModel, values: Mapping[str, float], count: int) -> bool:
    """Whether the reduced model lacks no undamped mode up to its ``count``-th one; see `undamped_counts`.

    False also where modes cannot be counted.
    """
    known, there = undamped_counts(reduced, values, count) or (0, 1)
    return known == there


def undamped_counts(reduced: ReducedModel, values: Mapping[str, float], count: int) -> tuple[int, int] | None:
    """How many undamped modes a reduced model has up to its ``count``-th one or a little above, and how many there are.

    Sylvester's law of inertia counts those of the full model; rigid-body motions are among them. Undamped frequencies
    of a projected model are upper bounds (Courant-Fischer), so that equal numbers below a frequency prove that none is
    missed there. Of a damped model this counts the undamped modes that its damped ones consist of, which is evidence
    and no proof. None where modes cannot be counted.
    """
    full = reduced.model
    k, _, m = reduced.matrices(values)
    shift = _regular(k, m)
    # K and M are exchanged so that massless motions cause no infinite eigenvalues.
    inverse = la.eigvalsh(m, k + shift * m, check_finite=False)[::-1]
    squares = 1.0 / inverse[inverse > 1e-14 * inverse[0]] - shift
    first = int(np.count_nonzero(is_zero(squares, np.sqrt(shift))))
    freq = np.sqrt(np.maximum(squares, 0.0)) / (2 * np.pi)
    gaps = np.flatnonzero(freq[1:] > (1 + _CLEAR) * freq[:-1])
    gaps = gaps[gaps >= first + count - 1]
    if not len(gaps):
        return None
    below = int(gaps[0]) + 1
    edge = float(np.sqrt(freq[below - 1] * freq[below]))
    stiffness, _, mass = full.matrices(values)
    with contextlib.suppress(EvaluationError):
        return below, count_below(stiffness, mass, edge)
    return None


def modes_near(reduced: ReducedModel, values: Mapping[str, float], count: int, accuracy: float = ACCURACY) -> Modes:
    """Refined modes where their number is confirmed, else those of the full model; see `refined_modes`."""
    if count <= reduced.n_modes and undamped_count_agrees(reduced, values, count):
        refined = refined_modes(reduced, values, count, accuracy)
        if refined is not None:
            return refined
    return reduced.model.modes(values, count)


def _rigid(reduced: ReducedModel, values: Mapping[str, float]) -> np.ndarray:
    """Rigid-body motions and mechanisms over the basis, (size, n): a correction moves along them, and may not alone."""
    if not reduced.basis.offset:
        return np.zeros((reduced.n_dof, 0))
    k, _, m = reduced.matrices(values)
    shift = _regular(k, m)
    inverse, shapes = la.eigh(m, k + shift * m, check_finite=False)
    squares = 1.0 / np.maximum(inverse, 1e-300) - shift
    return np.asarray(shapes[:, is_zero(squares, float(np.sqrt(shift)))])


def _regular(k: np.ndarray, m: np.ndarray) -> float:
    """Square of a small shift that keeps a dense factor regular."""
    heavy = np.diag(m) > 0
    return _SHIFT * float(np.max(np.diag(k)[heavy] / np.diag(m)[heavy]))


def real_columns(columns: np.ndarray) -> np.ndarray:
    """Real and imaginary parts of complex columns side by side; real columns as they are."""
    return np.hstack([columns.real, columns.imag]) if np.iscomplexobj(columns) else columns


def _size(modes: Modes) -> np.ndarray:
    """What makes ``R^T K^-1 R`` of a scaled mode a relative eigenvalue error."""
    size = 2 * np.pi * modes.natural_freq
    return size if modes.is_complex else size**2


def _residual(modes: Modes, stiffness: sp.csc_array, damping: sp.csc_array, mass: sp.csc_array) -> np.ndarray:
    lam, shapes = eigenvalues(modes), modes.shapes
    if not modes.is_complex:
        return np.asarray(stiffness @ shapes - (2 * np.pi * modes.natural_freq) ** 2 * (mass @ shapes))
    return np.asarray(lam**2 * (mass @ shapes) + lam * (damping @ shapes) + stiffness @ shapes)
