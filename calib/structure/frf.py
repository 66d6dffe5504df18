"""Frequency response functions of a model with matrices, and their derivatives, line by line.

With ``Z(omega) = K + i omega C - omega^2 M`` the receptance between responses R and forces F (rows over the degrees of
freedom) is ``H = R Z^-1 F^T``, and since Z is symmetric ``dH = -(Z^-1 R^T)^T dZ (Z^-1 F^T)``: no line needs a second
factorisation. Mobility and accelerance are the receptance times ``i omega`` and ``-omega^2``.

A line costs a factorisation of Z. Of small dense matrices with few dampers C has a low rank: one transformation by the
undamped modes then serves all lines (Woodbury's identity).
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
import scipy.linalg as la
import scipy.sparse as sp
import scipy.sparse.linalg as spla
from scipy.linalg import lapack

from calib.errors.errors import EvaluationError
from calib.measurement.frf import Quantity
from calib.structure.eigenproblem.derivatives import DifferentiableModel, Matrix
from calib.structure.eigenproblem.symmetric_factor import SymmetricFactor, symmetric_factor

_ORDER = {"receptance": 0, "mobility": 1, "accelerance": 2}

_DENSE = 200
"""Degrees of freedom up to which a complex dense factorisation beats a sparse one with its many right-hand sides."""
_BLOCK = 250_000
"""Entries of the dense matrices of as many lines as are put together at once."""
_LOW_RANK = 4
"""Degrees of freedom per damper from which superposed undamped modes are faster than a factor for each line."""
_RANK = 1e-13
"""Eigenvalue of a damping matrix, over its largest, that is rounding."""
_NEAR_RESONANCE = 1e-6
"""Relative distance of a squared frequency from an undamped eigenvalue below which the superposition would lose more
than six digits."""
_SINGULAR = 1e-12
"""Smallest pivot over the largest, of the matrix scaled to a unit diagonal of K, below which a line is a resonance."""

_THRESHOLD = 0.01
"""Pivot on the diagonal over the largest of its column below which another one is taken."""
_BACKWARD = 1e-12
"""Largest backward error, entry by entry, of a solution whose pivots were taken near the diagonal."""


def motion_factor(quantity: Quantity, freq: np.ndarray) -> np.ndarray:
    """``(i omega)^n`` that turns a receptance into another quantity, (n_freq,), complex; frequencies in Hz."""
    return np.asarray((2j * np.pi * np.asarray(freq, dtype=float)) ** _ORDER[quantity])


def frf(
    model: DifferentiableModel,
    values: Mapping[str, float],
    freq: np.ndarray,
    responses: np.ndarray,
    references: np.ndarray,
    quantity: Quantity = "receptance",
) -> np.ndarray:
    """Frequency response functions at named values.

    Parameters
    ----------
    model : DifferentiableModel
        Full-order or reduced.
    values : mapping
        Each in its parameter's unit; missing ones are nominal.
    freq : ndarray (n_freq,)
        Hz.
    responses, references : ndarray (n_responses, n_dof), (n_references, n_dof)
        Motions at the response sensors and at the places of the forces, as `StructuralModel.sensor_rows` gives them.
    quantity : {"receptance", "mobility", "accelerance"}
        In m/N, m/s/N or m/s^2/N; rotations and moments accordingly.

    Returns
    -------
    ndarray (n_freq, n_responses, n_references), complex

    Raises
    ------
    EvaluationError
        When the matrices are not finite, or a line lies on a resonance without damping.
    """
    found = [responses @ x for (x,) in frf_solutions(model.matrices(values), freq, references)]
    return np.array(found).reshape(len(freq), len(responses), len(references)) * _per_line(quantity, freq)


class FRFDerivatives(NamedTuple):
    """What `frf_derivatives` returns, all complex.

    Attributes
    ----------
    functions : ndarray (n_freq, n_responses, n_references)
    derivatives : ndarray (n_params, n_freq, n_responses, n_references)
        Of an integer parameter zero.
    felt : ndarray (n_freq, n_felt, n_references)
        Functions of the further motions under the references.
    driven : ndarray (n_freq, n_responses, n_driven)
        Functions of the responses under the further forces.
    """

    functions: np.ndarray
    derivatives: np.ndarray
    felt: np.ndarray
    driven: np.ndarray


def frf_derivatives(
    model: DifferentiableModel,
    values: Mapping[str, float],
    freq: np.ndarray,
    responses: np.ndarray,
    references: np.ndarray,
    names: Sequence[str],
    quantity: Quantity = "receptance",
    beside: tuple[np.ndarray, np.ndarray] | None = None,
) -> FRFDerivatives:
    """Frequency response functions as in `frf`, and their derivatives per unit of each named parameter.

    Parameters
    ----------
    names : sequence of str
    beside : (ndarray (n_felt, n_dof), ndarray (n_driven, n_dof)), optional
        Further motions and forces, whose functions with the references and responses follow from the same solutions.

    Other parameters are those of `frf`.

    Raises
    ------
    EvaluationError
        As `frf`.
    """
    slopes = [model.matrix_derivatives(values, name) for name in names]
    functions = np.empty((len(freq), len(responses), len(references)), dtype=complex)
    derivatives = np.empty((len(names), *functions.shape), dtype=complex)
    solved = list(frf_solutions(model.matrices(values), freq, references, responses))
    forced, felt = (np.array([pair[k] for pair in solved]) for k in (0, 1))  # (n_freq, n_dof, ...)
    functions[:] = responses @ forced
    omega = 2 * np.pi * np.asarray(freq, dtype=float)[:, None, None]
    motions = [np.moveaxis(forced * factor, 1, 0) for factor in (1.0, 1j * omega, -(omega**2))]
    for p, terms in enumerate(slopes):
        # One product for all lines: single ones are mostly overhead.
        changed = sum(d @ motion.reshape(len(motion), -1) for d, motion in zip(terms, motions, strict=True))
        derivatives[p] = -np.einsum("knr,nkq->krq", felt, np.reshape(changed, motions[0].shape), optimize=True)
    factor = _per_line(quantity, freq)
    further_felt, further_driven = (np.zeros((0, responses.shape[1])),) * 2 if beside is None else beside
    return FRFDerivatives(
        functions * factor,
        derivatives * factor,
        (further_felt @ forced) * factor,
        np.swapaxes(further_driven @ felt, 1, 2) * factor,  # Z is symmetric
    )


def _per_line(quantity: Quantity, freq: np.ndarray) -> np.ndarray:
    return motion_factor(quantity, freq)[:, None, None]


def frf_solutions(
    matrices: tuple[Matrix, Matrix, Matrix], freq: np.ndarray, *rows: np.ndarray
) -> Iterator[tuple[np.ndarray, ...]]:
    """``Z^-1 r^T`` of each set of rows r, (n_dof, n_rows), line by line; EvaluationError as `frf`."""
    loads, lines = np.vstack(rows).T, np.asarray(freq, dtype=float)
    ends = np.cumsum([0, *(len(r) for r in rows)]).tolist()
    diagonal = np.abs(matrices[0].diagonal())
    scale = 1 / np.sqrt(np.where(diagonal > 0, diagonal, 1.0))
    solutions = _dense_solutions if len(scale) <= _DENSE or not _is_sparse(matrices[0]) else _sparse_solutions
    for solution in solutions(matrices, lines, scale, loads):
        yield tuple(solution[:, first:end] for first, end in itertools.pairwise(ends))


def _sparse_solutions(
    matrices: tuple[Matrix, Matrix, Matrix], freq: np.ndarray, scale: np.ndarray, loads: np.ndarray
) -> Iterator[np.ndarray]:
    """Solution at each line, (n_dof, n_loads), of the system scaled by ``scale`` on both sides."""
    stiffness, damping, mass = matrices
    scaled_loads = scale[:, None] * loads.astype(complex)
    for line in freq:
        omega = 2 * np.pi * line
        dynamic = stiffness + 1j * omega * damping - omega**2 * mass
        scaled = sp.csc_matrix(dynamic.multiply(scale[:, None]).multiply(scale))
        _check_finite(np.all(np.isfinite(scaled.data)), line)
        yield scale[:, None] * _sparse_solution(scaled, scaled_loads, line)


def _dense_solutions(
    matrices: tuple[Matrix, Matrix, Matrix], freq: np.ndarray, scale: np.ndarray, loads: np.ndarray
) -> Iterator[np.ndarray]:
    """The same of dense matrices, by undamped modes where that is faster and holds."""
    stiffness, damping, mass = (_dense(matrix) for matrix in matrices)
    known = _superposed(stiffness, damping, mass, freq, loads)
    holds, found = (np.zeros(len(freq), dtype=bool), np.empty(0)) if known is None else known
    both = scale[:, None] * scale
    factored = _factored((both * stiffness, both * damping, both * mass), freq[~holds], scale[:, None] * loads)
    for k, held in enumerate(holds):
        yield found[k] if held else scale[:, None] * next(factored)


def _factored(
    scaled: tuple[np.ndarray, np.ndarray, np.ndarray], freq: np.ndarray, loads: np.ndarray
) -> Iterator[np.ndarray]:
    """Solution of a scaled dense system at each line by a factor of its own, in blocks of lines.

    Of small matrices the products and checks of a line cost more than its factor.
    """
    stiffness, damping, mass = scaled
    size, complex_loads = max(_BLOCK // stiffness.size, 1), loads.astype(complex)
    for start in range(0, len(freq), size):
        lines = freq[start : start + size]
        omega = 2 * np.pi * lines[:, None, None]
        dynamic = stiffness + 1j * omega * damping - omega**2 * mass
        _check_finite(np.all(np.isfinite(dynamic), axis=(1, 2)), lines)
        solved = [lapack.zgesv(one, complex_loads) for one in dynamic]
        _check_pivots(np.abs([lu.diagonal() for lu, *_ in solved]), lines)
        yield from (solution for _, _, solution, _ in solved)


def _superposed(
    stiffness: np.ndarray, damping: np.ndarray, mass: np.ndarray, freq: np.ndarray, loads: np.ndarray
) -> tuple[np.ndarray, np.ndarray] | None:
    """Solutions by undamped modes: at which lines they hold, and (n_freq, n_dof, n_loads), complex.

    None where the damping has no low rank or the stiffness is not positive definite. With ``P^T K P = I``, ``P^T M P =
    diag(mu)``, ``C = B diag(s) B^T`` and ``D = 1 - omega^2 mu`` the solution is
    ``P [y - D^-1 B~ (1 + i omega s B~^T D^-1 B~)^-1 i omega s B~^T y]`` with ``B~ = P^T B`` and ``y = D^-1 P^T loads``.
    Where D nearly vanishes the difference cancels: such lines do not hold.
    """
    if not all(np.all(np.isfinite(matrix)) for matrix in (stiffness, damping, mass)):
        return None
    sizes, turn = la.eigh(damping)
    kept = np.abs(sizes) > _RANK * np.abs(sizes).max(initial=0.0)
    if _LOW_RANK * np.count_nonzero(kept) > len(sizes):
        return None
    try:
        mu, modes = la.eigh(mass, stiffness)
    except la.LinAlgError:
        return None
    omega = 2 * np.pi * freq
    gap = 1 - omega[:, None] ** 2 * mu
    holds = np.abs(gap).min(axis=1) > _NEAR_RESONANCE
    gap[~holds] = 1.0
    carried = modes.T @ turn[:, kept]
    over = carried / gap[:, :, None]
    moved = ((modes.T @ loads) / gap[:, :, None]).astype(complex)
    force = 1j * omega[:, None, None] * sizes[kept][:, None]
    inner = np.eye(kept.sum()) + force * (carried.T @ over)
    moved -= over @ np.linalg.solve(inner, force * (carried.T @ moved))
    flat = np.ascontiguousarray(np.moveaxis(moved, 0, 1)).reshape(len(modes), -1)
    solution = (modes @ flat.view(float)).view(complex)  # real times real: half the work of a complex product
    return holds, np.moveaxis(solution.reshape(len(modes), len(freq), -1), 0, 1)


def _dense(matrix: Matrix) -> np.ndarray:
    return np.asarray(matrix.toarray() if hasattr(matrix, "toarray") else matrix)


def _check_finite(finite: np.ndarray | np.bool, freq: np.ndarray | float) -> None:
    """EvaluationError at the first line whose matrix is not finite, both (n_freq,) or of one line."""
    if not np.all(finite):
        line = np.ravel(freq)[np.argmin(finite)]
        raise EvaluationError(f"the dynamic stiffness at {line:.6g} Hz holds entries that are not finite")


def _sparse_solution(scaled: sp.csc_matrix, loads: np.ndarray, freq: float) -> np.ndarray:
    """Pivots stay near the diagonal, which keeps the factor sparse; where that is too inaccurate, the largest ones.

    The order of elimination is chosen for a symmetric pattern: with the largest pivots of each column the factor of a
    vehicle of 9,700 degrees of freedom takes 70 times longer.
    """
    size = abs(scaled)
    for near_diagonal in True, False:
        try:
            factor = symmetric_factor(scaled, _THRESHOLD) if near_diagonal else SymmetricFactor(spla.splu(scaled))
            _check_pivots(np.abs(factor.pivots), freq)
        except (RuntimeError, EvaluationError):
            if not near_diagonal:
                raise _resonance(freq) from None
            continue
        found = factor.solve(loads)
        found = found + factor.solve(loads - scaled @ found)
        left = np.abs(loads - scaled @ found)
        if np.all(left <= _BACKWARD * (size @ np.abs(found) + np.abs(loads))):
            break
    return np.asarray(found)


def _check_pivots(pivots: np.ndarray, freq: np.ndarray | float) -> None:
    """EvaluationError at the first singular line; pivots (n_freq, n_dof) and lines (n_freq,), or of one line."""
    regular = pivots.min(axis=-1) > _SINGULAR * pivots.max(axis=-1)
    if not np.all(regular):
        raise _resonance(float(np.ravel(freq)[np.argmin(regular)]))


def _is_sparse(matrix: Matrix) -> bool:
    return bool(sp.issparse(matrix))


def _resonance(freq: float) -> EvaluationError:
    return EvaluationError(
        f"the dynamic stiffness is singular at {freq:.6g} Hz, which is a resonance without damping: "
        "leave the line out, or give the model damping"
    )
