"""Damped modes of a reduced model from a smaller problem, corrected until their residuals vanish."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.linalg as la

from calib.structure.eigenproblem.damped_problem import DampedProblem, Eigenpairs, real_times
from calib.structure.eigenproblem.eigenvalues import is_zero, vibrates

_BESIDE = 5, 10
"""Least and most undamped modes kept beyond as many as damped ones are wanted; the widest gap decides."""
_COUPLED = 0.05
"""Responses of the other modes to damping forces smaller than this are left to the corrections."""
_NEAREST = 0.05
"""Least ``1 - (omega/omega_j)^2`` in the response of an undamped mode at omega_j."""
_STRONG = 0.3
"""Damping force over stiffness above which a direction of the modes left out is added where they are not regular."""
_WORTHWHILE = 0.55
"""Largest size of the smaller problem over that of the whole one."""
_START = 0.2
"""Largest error by the residual from which corrections are tried."""
_STEPS = 12
_ROOTS = 0.02
"""Largest error of overdamped roots: their number matters, and is compared by its changes of sign."""
_ABOVE = 1.25
"""Modes up to this multiple of the highest wanted one are corrected where their error may hide a lower one."""
_SAME = 1e-5
"""Relative distance of eigenvalues below which a correction leaves their shapes alone."""
_REACH = 2.5
"""Undamped modes up to this multiple of the highest wanted frequency are kept where static corrections must suffice."""
_NEGLIGIBLE = 1e-10
"""Relative size of a static correction that is dropped."""
_PARALLEL = 1e-6
"""Least eigenvalue of the states' Gram matrix: smaller where two corrections led to one mode."""


def corrected_eigenpairs(problem: DampedProblem, count: int, accuracy: float) -> tuple[np.ndarray, np.ndarray] | None:
    """The lowest eigenpairs of a damped problem in undamped modal coordinates, or None where they are not certain.

    The lowest undamped modes and the responses of the others to damping forces span a smaller problem (modal
    truncation with static correction, MacNeal 1971, here also with the response at the highest frequency). All of its
    eigenpairs are solved. Those wanted are then corrected in the whole space with an approximate inverse of
    ``Z(lambda)``: that of the smaller problem by its eigenpairs, and for the rest that of the undamped modes, each with
    its own damping; each step leads along all directions so far to the least residual (Davidson's method for one
    eigenpair at a time, Saad 2011, section 8.2).

    They are returned only if

    - no field of values of the left-out part holds zero up to the highest wanted modulus, so that no mode lies in it
      alone;
    - the whole problem has as many overdamped roots there as the smaller one, by Sylvester's law of inertia;
    - every wanted eigenvalue has an estimated error below ``accuracy``, no other one up to 1.25 times the highest
      may lie among them, and their states are independent.

    The first two are exact, the second by changes of sign. The last rests on residuals, as error estimates of reduced
    models do.

    Parameters
    ----------
    problem : DampedProblem
        With a diagonal mass of descending entries, and a positive semidefinite damping.
    count : int
        Vibration modes wanted.
    accuracy : float
        Largest relative error of an eigenvalue by its residual; that of shapes is about its square root.

    Returns
    -------
    eigenvalues : ndarray (m,), complex
        The ``count`` lowest damped modes, the overdamped roots below the last of them, and zeros.
    motions : ndarray (n, m), complex
    """
    space = _space(problem, count)
    if space is None:
        return None
    lam, shapes = space.eigenpairs()
    damped = np.flatnonzero(vibrates(lam, problem.shift))
    damped = damped[np.argsort(np.abs(lam[damped]), kind="stable")]
    if len(damped) < count:
        return None
    last = float(np.abs(lam[damped[count - 1]]))
    upper = damped[np.abs(lam[damped]) <= _ABOVE * last]
    start = space.lifted(lam, shapes, upper)
    error = start.errors
    # Eigenvalues of a projected problem are mostly too high: those beyond the last one may come down by their error.
    top = last * (1 + 2 * float(np.max(error[:count])))
    near = np.abs(start.values) * (1 - 2 * error) <= top
    near[:count] = True
    if not np.max(error[near]) < _START or not _is_regular(problem, space.low, space.responses, top):
        return None
    if problem.overdamped(last) != space.problem.overdamped(last):
        return None
    aperiodic = np.flatnonzero(~vibrates(lam, problem.shift) & ~vibrates(lam.conj(), problem.shift))
    size = np.abs(lam[aperiodic])
    rigid = is_zero(size**2, problem.shift)
    zero, real = aperiodic[rigid], aperiodic[~rigid & (size <= last)]
    modes = _corrected(space, lam, shapes, upper[near], count, accuracy)
    if modes is None or not np.all(vibrates(modes.values, problem.shift)) or not _independent(modes):
        return None
    values, motions = modes.values, modes.motions
    if len(zero):
        still = space.lifted(lam, shapes, zero)
        values, motions = np.concatenate([values, still.values]), np.hstack([motions, still.motions])
    if len(real):
        roots = _corrected(space, lam, shapes, real, len(real), _ROOTS)
        if roots is None:
            return None
        values, motions = np.concatenate([values, roots.values.real]), np.hstack([motions, roots.motions])
    return values, motions


def static_eigenpairs(problem: DampedProblem, count: int, accuracy: float) -> tuple[np.ndarray, np.ndarray] | None:
    """The lowest eigenpairs by modal truncation with static corrections, for problems too small for the above.

    All undamped modes up to `_REACH` times the highest wanted frequency are kept. The others follow
    ``(I + lambda C + lambda^2 M) z = -lambda C_hl z_low``: a power series in lambda gives the static response and its
    corrections by mass and damping (quasi-static correction as by MacNeal 1971, carried one term further). None where
    an eigenvalue's error by its residual is not below ``accuracy``, the whole problem has more or fewer overdamped
    roots up to the highest wanted modulus, or nothing is left out.

    Parameters and results are those of `corrected_eigenpairs`.
    """
    mass, damping, n = problem.mass, problem.damping, problem.size
    squares = 1.0 / np.maximum(mass, 1e-300) - problem.shift**2
    first = int(np.count_nonzero(is_zero(squares, problem.shift)))
    highest = squares[min(first + count + 1, n - 1)]
    low = max(int(np.count_nonzero(squares <= _REACH**2 * highest)), min(first + count + 4, n))
    if low == n:
        return None
    across, among = damping[low:, :low], damping[low:, low:]
    largest = max(float(np.abs(np.diag(damping)).max()), 1e-300)
    static = _span(across, largest, np.zeros((n - low, 0)))
    more = _span(np.hstack([mass[low:, None] * static / mass[low], among @ static / largest]), 1.0, static)
    responses = np.hstack([static, more])
    size = low + responses.shape[1]
    if size == n:
        return None
    kept = np.zeros((n, size))
    kept[np.arange(low), np.arange(low)] = 1.0
    kept[low:, low:] = responses
    smaller = DampedProblem(kept.T @ (mass[:, None] * kept), kept.T @ damping @ kept, problem.shift)
    inverses, states = la.eig(smaller.inverse_matrix(), overwrite_a=True, check_finite=False)
    values = problem.shift + 1.0 / np.where(inverses == 0, 1e-300, inverses)
    found = np.flatnonzero(vibrates(values, problem.shift))
    found = found[np.argsort(np.abs(values[found]))[:count]]
    if len(found) < count:
        return None
    motions = real_times(kept, states[:size, found])
    if not np.max(Eigenpairs(problem, values[found], motions, real_times(damping, motions)).errors) < accuracy:
        return None
    last = float(np.abs(values[found[-1]]))
    if problem.overdamped(last) != smaller.overdamped(last):
        return None
    others = np.abs(values) <= last
    others &= ~vibrates(values, problem.shift) & ~vibrates(values.conj(), problem.shift)
    if not np.any(others):
        return values[found], motions
    return np.concatenate([values[found], values[others]]), np.hstack(
        [motions, real_times(kept, states[:size, others])]
    )


def _span(vectors: np.ndarray, size: float, beside: np.ndarray) -> np.ndarray:
    """Orthonormal directions of vectors, others projected out and negligible ones dropped."""
    rest = vectors - beside @ (beside.T @ vectors)
    rest = rest - beside @ (beside.T @ rest)
    left, sizes, _ = la.svd(rest, full_matrices=False, check_finite=False)
    return np.asarray(left[:, sizes > _NEGLIGIBLE * size])


@dataclass(frozen=True, eq=False)
class _Space:
    """The smaller problem: the lowest undamped modes, and orthonormal responses of the others.

    Attributes
    ----------
    whole, problem : DampedProblem
        In all coordinates and in those of the space.
    low : int
        Number of undamped modes that it holds, the first coordinates.
    responses : ndarray (n - low, m)
    dissipation : ndarray (n, p)
        The damping times the space.
    own_damping : ndarray (n - low,)
        Of each mode left out, the responses projected out.
    """

    whole: DampedProblem
    problem: DampedProblem
    low: int
    responses: np.ndarray
    dissipation: np.ndarray
    own_damping: np.ndarray

    def eigenpairs(self) -> tuple[np.ndarray, np.ndarray]:
        """All finite eigenvalues of the smaller problem, and motions (p, m) scaled as in `Modes`."""
        inverses, states = la.eig(self.problem.inverse_matrix(), overwrite_a=True, check_finite=False)
        finite = np.abs(inverses) > 1e-14 * np.abs(inverses).max()
        lam, motions = self.problem.shift + 1.0 / inverses[finite], states[: self.problem.size, finite]
        weights = Eigenpairs(self.problem, lam, motions, real_times(self.problem.damping, motions)).weights
        return lam, motions / np.sqrt(np.where(weights == 0, 1.0, weights))

    def lifted(self, lam: np.ndarray, shapes: np.ndarray, which: np.ndarray) -> Eigenpairs:
        """Some eigenpairs of the smaller problem as approximate ones of the whole."""
        chosen = shapes[:, which]
        return Eigenpairs(self.whole, lam[which], self.expanded(chosen), real_times(self.dissipation, chosen))

    def expanded(self, motions: np.ndarray) -> np.ndarray:
        """Motions (n, m) of the whole problem from those of the smaller one."""
        return np.concatenate([motions[: self.low], real_times(self.responses, motions[self.low :])])

    def projected(self, forces: np.ndarray) -> np.ndarray:
        """Forces (p, m) on the smaller problem from those on the whole one."""
        return np.concatenate([forces[: self.low], real_times(self.responses.T, forces[self.low :])])

    def outside(self, motions: np.ndarray) -> np.ndarray:
        """Motions of the left-out modes (n - low, m) with the responses projected out."""
        return motions - real_times(self.responses, real_times(self.responses.T, motions))


def _left_out(matrix: np.ndarray, responses: np.ndarray) -> np.ndarray:
    """A matrix of the left-out modes with the responses projected out of both sides."""
    across = matrix @ responses
    return matrix + responses @ ((responses.T @ across) @ responses.T) - across @ responses.T - responses @ across.T


def _is_regular(problem: DampedProblem, low: int, responses: np.ndarray, speed: float) -> bool:
    """Whether the left-out part of Z is regular at every ``|lambda| <= speed``: its field of values excludes zero.

    For any unit x, ``x^H Z(lambda) x = k + lambda c + lambda^2 m`` with ``k = 1 - shift^2 m``, c and m not negative.
    Its roots are a pair of modulus ``sqrt(k/m)``, or real and negative, of that geometric mean. All lie beyond
    ``speed`` exactly where ``k > speed^2 m`` and ``k - speed c + speed^2 m > 0`` for every x: where two Cholesky
    factors exist.
    """
    inertia, square = problem.mass[low:], problem.shift**2
    dissipation = -speed * problem.damping[low:, low:]
    return all(
        _is_positive_with_one(_left_out(matrix, responses))
        for matrix in (np.diag(-(square + speed**2) * inertia), dissipation + np.diag((speed**2 - square) * inertia))
    )


def _is_positive_with_one(matrix: np.ndarray) -> bool:
    """Whether a symmetric matrix plus the identity is positive definite."""
    matrix[np.diag_indices_from(matrix)] += 1.0
    return bool(la.lapack.dpotrf(matrix, lower=1)[1] == 0)


def _space(problem: DampedProblem, count: int) -> _Space | None:
    """The smaller problem; None where it would be nearly as large as the whole one."""
    mass, damping, n = problem.mass, problem.damping, problem.size
    squares = 1.0 / np.maximum(mass, 1e-300) - problem.shift**2
    least = int(np.count_nonzero(is_zero(squares, problem.shift))) + count + _BESIDE[0]
    most = least + _BESIDE[1] - _BESIDE[0]
    if most > _WORTHWHILE * n:
        return None
    low = least + int(np.argmax(squares[least : most + 1] / squares[least - 1 : most]))
    speed = float(np.sqrt(squares[low - 1]))
    static = speed * damping[low:, :low]
    dynamic = static / np.maximum(1 - speed**2 * mass[low:], _NEAREST)[:, None]
    basis, triangle, _ = la.qr(np.hstack([static, dynamic]), mode="economic", pivoting=True, check_finite=False)
    responses = np.ascontiguousarray(basis[:, np.abs(np.diag(triangle)) > _COUPLED])
    # The wanted modes mostly reach as high as equally many undamped ones.
    speed = float(np.sqrt(squares[least - _BESIDE[0] - 1]))
    if not _is_regular(problem, low, responses, speed):
        heavy = _left_out(damping[low:, low:], responses)
        strong = la.eigh(heavy, subset_by_value=(_STRONG / speed, np.inf), check_finite=False)[1]
        responses = np.hstack([responses, strong])
    size = low + responses.shape[1]
    if size > _WORTHWHILE * n:
        return None
    dissipation = np.hstack([damping[:, :low], damping[:, low:] @ responses])
    small_mass = np.zeros((size, size))
    small_mass[np.arange(low), np.arange(low)] = mass[:low]
    small_mass[low:, low:] = responses.T @ (mass[low:, None] * responses)
    small_damping = np.concatenate([dissipation[:low], responses.T @ dissipation[low:]])
    own_damping = np.diag(_left_out(damping[low:, low:], responses))
    return _Space(
        problem, DampedProblem(small_mass, small_damping, problem.shift), low, responses, dissipation, own_damping
    )


def _corrected(
    space: _Space, lam: np.ndarray, shapes: np.ndarray, which: np.ndarray, count: int, accuracy: float
) -> Eigenpairs | None:
    """The ``count`` lowest of some eigenpairs, corrected in the whole space; None where `_STEPS` do not suffice.

    The others need only be accurate enough to lie above those.
    """
    whole, low, found, known = space.whole, space.low, space.lifted(lam, shapes, which), lam.copy()
    directions: list[tuple[np.ndarray, np.ndarray]] = []
    for step in range(_STEPS + 1):
        size = np.abs(found.values)
        last = np.partition(size, count - 1)[count - 1]
        if not np.any((found.errors >= accuracy) & (size * (1 - 2 * found.errors) <= last)):
            return found.subset(np.argsort(size, kind="stable")[:count])
        if step == _STEPS:
            break
        squares = found.values**2 - whole.shift**2
        flexibility = 1.0 / (1.0 + found.values * space.own_damping[:, None] + squares * whole.mass[low:, None])
        change = np.zeros_like(found.motions)
        change[low:] = -space.outside(flexibility * space.outside(found.residual[low:]))
        dissipation = real_times(whole.damping[:, low:], change[low:])
        rest = space.projected(found.residual + found.forces(change, dissipation))
        # Z^-1 = sum over all eigenpairs of psi psi^T/(lambda - lambda_k); the mode's own gives no new direction.
        known[which] = found.values
        gap = found.values - known[:, None]
        own = np.abs(gap) <= _SAME * np.abs(found.values)
        parts = shapes @ np.where(own, 0.0, (shapes.T @ rest) / np.where(own, 1.0, gap))
        directions.append((change - space.expanded(parts), dissipation - real_times(space.dissipation, parts)))
        found = found.moved(directions)
    return None


def _independent(pairs: Eigenpairs) -> bool:
    """Whether the states of eigenpairs are linearly independent."""
    states = np.concatenate([pairs.motions, pairs.motions * (pairs.values / np.max(np.abs(pairs.values)))])
    gram = states.conj().T @ states
    size = np.sqrt(np.diag(gram).real)
    gram = gram / size / size[:, None]
    gram[np.diag_indices_from(gram)] -= _PARALLEL
    return bool(la.lapack.zpotrf(gram, lower=1)[1] == 0)
