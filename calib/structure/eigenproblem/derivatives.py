"""Analytic derivatives of eigenvalues, frequencies, damping ratios and shapes with respect to named parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, Self

import numpy as np
import scipy.sparse as sp

from calib.errors.errors import InputError
from calib.execution.tasks import each
from calib.problem.space import ParameterSpace
from calib.structure.bordered import bordered
from calib.structure.eigenproblem.solve import DENSE_LIMIT
from calib.structure.modes import Modes

Matrix = Any
"""A dense ndarray or a SciPy sparse array, shape (n_dof, n_dof), symmetric; a derivative need only be multiplied."""

NEIGHBOUR = 0.1
"""Eigenvalues closer than this fraction of their modulus form one group: the bordered matrix then stays regular."""

REPEATED = 1e-7
"""Eigenvalues closer than this fraction of their modulus count as repeated; single shapes have no derivative."""

_BESIDE = 1e-6
"""Offset from 0, over the limit, at which derivatives by a parameter under a square root are taken.

Modes and FRFs depend smoothly on the parameter: so close to 0 their derivative equals that at 0 to about 1e-6. It is a
difference of terms that grow with the inverse square root, here a thousandfold, which leaves twelve digits.
"""


class DifferentiableModel(Protocol):
    """A model with matrices and their derivatives at named values, sparse or dense."""

    @property
    def space(self) -> ParameterSpace:
        """Parameters, each with its own unit."""
        ...

    def matrices(self, values: Mapping[str, float]) -> tuple[Matrix, Matrix, Matrix]:
        """K, C, M."""
        ...

    def matrix_derivatives(self, values: Mapping[str, float], name: str) -> tuple[Matrix, Matrix, Matrix]:
        """dK, dC, dM per unit of the parameter."""
        ...


@dataclass(frozen=True, eq=False)
class ModeDerivatives:
    """Derivatives of chosen modes, per unit of each parameter.

    Attributes
    ----------
    names : tuple of str
        Parameters, length n_params; an integer parameter has derivatives of zero.
    eigenvalue : ndarray (n_params, n_modes), complex
        Of lambda, 1/s; an undamped mode has ``lambda = i omega``.
    shapes : ndarray (n_params, n_rows, n_modes)
        Of the shapes as they are normalised in `Modes`, at all degrees of freedom or at the requested sensors (no rows
        without any); the columns of irregular modes are NaN.
    natural_freq, damped_freq : ndarray (n_params, n_modes)
        Hz.
    damping_ratio : ndarray (n_params, n_modes)
    regular : ndarray (n_modes,), bool
        False for a repeated eigenvalue that the parameters split, or one too close to an eigenvalue that was not
        solved: the shape has no derivative, and the eigenvalue's is the mean over the group.
    """

    names: tuple[str, ...]
    eigenvalue: np.ndarray
    shapes: np.ndarray
    natural_freq: np.ndarray
    damped_freq: np.ndarray
    damping_ratio: np.ndarray
    regular: np.ndarray


class Analytic:
    """The part of `calib.structure.modal_model.ModalModel` that follows from matrices and their derivatives."""

    @property
    def dissipates(self: DifferentiableModel) -> bool:
        """Whether its modes are damped at the nominal or other parameter values."""
        values = self.space.values
        # Derivatives are evaluated only where needed: some matrices have none at 0.
        slopes = (self.matrix_derivatives(values, name) for name in self.space.names)
        return _has_entries(self.matrices(values)[1]) or any(_has_entries(damping) for _, damping, _ in slopes)

    @property
    def numbers_function(self) -> None:
        """None: a model of matrices runs no user code."""
        return

    def with_function(self, numbers: object) -> Self:
        """The model itself, which has no function."""
        return self

    def derivatives(
        self: DifferentiableModel,
        values: Mapping[str, float],
        modes: Modes,
        names: Sequence[str],
        which: Sequence[int] | np.ndarray,
        rows: np.ndarray,
        at: Callable[[Mapping[str, float]], Modes] | None = None,
    ) -> ModeDerivatives:
        """Analytic derivatives of some modes, without further solves; see `mode_derivatives`."""
        return mode_derivatives(self, values, modes, names, which, rows)

    def weighted(self: DifferentiableModel, values: Mapping[str, float], shapes: np.ndarray) -> np.ndarray:
        """Shapes times the mass matrix, (n_dof, n_modes), the weight of their orthogonality."""
        return np.asarray(self.matrices(values)[2] @ shapes)


def beside_roots(
    space: ParameterSpace, roots: frozenset[str], values: Mapping[str, float], names: Sequence[str]
) -> dict[str, float]:
    """Point at which derivatives by the named parameters are taken: offset from 0 for one under a square root.

    At 0 modes and FRFs have a derivative, but the matrices do not.
    """
    out = space.complete(values)
    for name in names:
        if name in roots and out[name] == 0:
            p = space[name]
            out[name] = _BESIDE * (p.upper if p.upper > 0 else p.lower)
    return out


def eigenvalues(modes: Modes) -> np.ndarray:
    """Lambda of every mode in 1/s, upper half-plane, shape (n_modes,), complex."""
    size = 2 * np.pi * modes.natural_freq
    return -modes.damping_ratio * size + 2j * np.pi * modes.damped_freq


def mode_derivatives(
    model: DifferentiableModel,
    values: Mapping[str, float],
    modes: Modes,
    names: Sequence[str],
    which: Sequence[int] | np.ndarray | None = None,
    rows: np.ndarray | None = None,
) -> ModeDerivatives:
    """Derivatives of a model's modes with respect to named parameters.

    Parameters
    ----------
    model : DifferentiableModel
    values : mapping
        Named values at which ``modes`` were solved.
    modes : Modes
        All modes solved there; more modes make more close neighbours known.
    names : sequence of str
    which : sequence of int, optional
        Indices of the modes wanted; default all.
    rows : ndarray (n_rows, n_dof), optional
        Output rows for the shapes, such as the sensors'; default all degrees of freedom. An array without rows skips
        the shapes and their solves.

    Raises
    ------
    InputError
        For an unknown parameter or mode.
    EvaluationError
        When a bordered matrix cannot be factorised.
    """
    for name in names:
        if name not in model.space:
            model.space[name]  # raises, naming the known parameters
    k, c, m = model.matrices(values)
    slopes = [model.matrix_derivatives(values, name) for name in names]
    return eigen_derivatives(k, c, m, slopes, modes, tuple(names), which, rows)


def eigen_derivatives(
    stiffness: Matrix,
    damping: Matrix,
    mass: Matrix,
    slopes: Sequence[tuple[Matrix, Matrix, Matrix]],
    modes: Modes,
    names: tuple[str, ...],
    which: Sequence[int] | np.ndarray | None = None,
    rows: np.ndarray | None = None,
) -> ModeDerivatives:
    """Derivatives of modes from matrices and their derivatives.

    With ``Z = lambda^2 M + lambda C + K``, ``psi^T (2 lambda M + C) psi = 1`` and ``F = dZ psi`` at fixed lambda,
    ``dlambda = -psi^T F``. The shape's derivative follows from one bordered factorisation per mode, with all parameters
    as right-hand sides (Nelson 1976; the bordered form after Friswell and Adhikari 2000). The border holds all solved
    eigenvalues within 10 % of the mode's own, conjugates included, so that close modes do not spoil the solution; their
    contribution is added as ``-psi_j (psi_j^T F)/(lambda_i - lambda_j)``. Eigenvalues closer than 1e-7 count as
    repeated: if a parameter couples them, the shapes have no derivative and the mode is flagged. Modes that were turned
    inside a subspace (`Modes.groups`) have the derivatives of their Rayleigh quotients, and of their shapes the part
    that leaves the subspace.

    Undamped modes use ``Z = K - omega^2 M`` and ``phi^T M phi = 1`` in real arithmetic; a damping matrix that is 0 but
    has a derivative adds an imaginary part.

    Parameters
    ----------
    stiffness, damping, mass : sparse or dense (n_dof, n_dof)
        Symmetric; SI.
    slopes : sequence of (dK, dC, dM)
        One for each parameter.
    modes, names, which, rows
        As in `mode_derivatives`.

    Returns
    -------
    ModeDerivatives
    """
    chosen = np.arange(modes.n_modes) if which is None else np.asarray(which, dtype=int)
    if len(chosen) and not (chosen.min() >= 0 and chosen.max() < modes.n_modes):
        raise InputError(f"a mode outside 0..{modes.n_modes - 1} is requested", place="mode derivatives")
    solver = _Damped if modes.is_complex else _Undamped
    stiffness, damping, mass = (_small_as_dense(matrix) for matrix in (stiffness, damping, mass))
    group = solver(stiffness, damping, mass, [tuple(map(_small_as_dense, slope)) for slope in slopes], modes)
    wanted = None if rows is None else np.asarray(rows)
    without_shapes = wanted is not None and not len(wanted)
    n_rows = stiffness.shape[0] if wanted is None else len(wanted)
    eigenvalue = np.zeros((len(names), len(chosen)), dtype=complex)
    shapes = np.zeros((len(names), n_rows, len(chosen)), dtype=group.shape_type)
    regular = np.ones(len(chosen), dtype=bool)
    shared, some = (group, without_shapes, wanted), chosen.tolist() if slopes else []
    worth = sp.issparse(stiffness) and wanted is not None and not without_shapes  # to be sent to other processes
    found = each(_of_mode, shared, some) if worth else (_of_mode(shared, j) for j in some)
    for i, (own, shape, good) in enumerate(found):
        eigenvalue[:, i], shapes[:, :, i], regular[i] = own, shape.T if good else np.nan, good
    lam = eigenvalues(modes)[chosen]
    size = np.abs(lam)
    grown = np.real(np.conj(lam) * eigenvalue) / size
    return ModeDerivatives(
        names=names,
        eigenvalue=eigenvalue,
        shapes=shapes,
        natural_freq=grown / (2 * np.pi),
        damped_freq=eigenvalue.imag / (2 * np.pi),
        damping_ratio=-eigenvalue.real / size + lam.real * grown / size**2,
        regular=regular,
    )


def _of_mode(shared: tuple[Any, bool, np.ndarray | None], j: int) -> tuple[np.ndarray, np.ndarray, bool]:
    """Derivatives of one mode: of its eigenvalue (n_params,), of its shape (n_rows, n_params), and if they exist."""
    group, without_shapes, wanted = shared
    own, shape, good = group.of(j, without_shapes)
    return own, shape if wanted is None else wanted @ shape, good


class _Damped:
    """State-space modes: groups of close eigenvalues among the modes and their conjugates."""

    def __init__(self, stiffness: Matrix, damping: Matrix, mass: Matrix, slopes: list[Any], modes: Modes):
        self.k, self.c, self.m, self.slopes = stiffness, damping, mass, slopes
        upper = eigenvalues(modes)
        self.eigenvalues = np.concatenate([upper, upper.conj()])
        self.all = np.hstack([modes.shapes, modes.shapes.conj()])
        self.shape_type, self.groups = complex, modes.groups

    def of(self, i: int, without_shape: bool) -> tuple[np.ndarray, np.ndarray, bool]:
        """Derivatives of lambda (n_params,) and psi (n_dof, n_params), and whether the mode is regular."""
        lam, psi = self.eigenvalues[i], self.all[:, i]
        force = np.column_stack([lam * (lam * (dm @ psi) + dc @ psi) + dk @ psi for dk, dc, dm in self.slopes])
        gap = np.abs(self.eigenvalues - lam)
        near = np.flatnonzero(gap <= NEIGHBOUR * abs(lam))
        near = np.concatenate([[i], near[near != i]])
        group, others = self.all[:, near], self.eigenvalues[near]
        turned, scale = np.isin(near, _group_of(self.groups, i)), 1.0 + 0j
        if turned.any():  # a turned shape has its unit norm to first order in the damping only
            scale = np.sqrt(psi @ (2 * lam * (self.m @ psi) + self.c @ psi))
            psi, force, group[:, 0] = psi / scale, force / scale, psi / scale
        same = turned | (gap[near] <= REPEATED * abs(lam))
        group[:, same] = _orthogonal(group[:, same], 2 * lam * self.m + self.c)
        part = group.T @ force
        free = same & ~(turned & (near != i))
        regular = not _coupled(part[free], group[:, free], force)
        slope = -part[0]
        if not regular:
            return _mean_slope(group[:, same], self.slopes, lam), np.zeros_like(force), False
        if without_shape:
            return slope, np.zeros_like(force), True
        inertia = self.m @ group
        border = (lam + others) * inertia + self.c @ group
        matrix = lam * (lam * self.m + self.c) + self.k
        rest, good = bordered(matrix, border, -(force - border @ part), (group.T @ inertia) @ part)
        for j in range(1, len(near)):
            if not same[j]:
                rest -= np.outer(group[:, j], part[j] / (lam - others[j]))
        norm = np.array([psi @ (2 * lam * (dm @ psi) + dc @ psi) for _, dc, dm in self.slopes])
        own = -0.5 * (2 * slope * (psi @ inertia[:, 0]) + norm) - border[:, 0] @ rest
        return slope, (rest + np.outer(psi, own)) * scale, good


class _Undamped:
    """Classical modes: groups of close squared frequencies."""

    def __init__(self, stiffness: Matrix, damping: Matrix, mass: Matrix, slopes: list[Any], modes: Modes):
        self.k, self.m, self.slopes, self.all = stiffness, mass, slopes, modes.shapes
        self.omega = 2 * np.pi * modes.natural_freq
        self.groups = modes.groups
        self.shape_type: type = complex if any(_has_entries(dc) for _, dc, _ in slopes) else float

    def of(self, i: int, without_shape: bool) -> tuple[np.ndarray, np.ndarray, bool]:
        """Derivatives of lambda (n_params,) and phi (n_dof, n_params), and whether the mode is regular."""
        omega, phi = self.omega[i], self.all[:, i]
        columns = [dk @ phi - omega**2 * (dm @ phi) for dk, _, dm in self.slopes]
        force: np.ndarray = np.column_stack(columns).astype(self.shape_type)
        if self.shape_type is complex:
            force += 1j * omega * np.column_stack([dc @ phi for _, dc, _ in self.slopes])
        gap = np.abs(self.omega - omega)
        near = np.flatnonzero(gap <= NEIGHBOUR * omega)
        near = np.concatenate([[i], near[near != i]])
        group = self.all[:, near]
        part = group.T @ force
        turned = np.isin(near, _group_of(self.groups, i))
        same = turned | (gap[near] <= REPEATED * omega)
        free = same & ~(turned & (near != i))
        regular = not _coupled(part[free], group[:, free], force)
        # d(omega^2) = phi^T F = -2 lambda dlambda
        slope = 0.5j * part[0] / omega
        if not regular:
            return _mean_slope(group[:, same], self.slopes, 1j * omega), np.zeros_like(force), False
        if without_shape:
            return slope, np.zeros_like(force), True
        border = self.m @ group
        rest, good = bordered(self.k - omega**2 * self.m, border, -(force - border @ part), np.zeros_like(part))
        for j in range(1, len(near)):
            if not same[j]:
                rest += np.outer(group[:, j], part[j] / (omega**2 - self.omega[near[j]] ** 2))
        own = -0.5 * np.array([phi @ (dm @ phi) for _, _, dm in self.slopes]) - border[:, 0] @ rest
        return slope, rest + np.outer(phi, own), good


def _group_of(groups: Sequence[tuple[int, ...]], i: int) -> list[int]:
    """All modes of the subspace in which a mode was turned; none for a single one."""
    return next((list(group) for group in groups if i in group), [])


def _small_as_dense(matrix: Matrix) -> Matrix:
    """A small sparse matrix as a dense array, whose products and factors are many times cheaper."""
    sparse: Any = matrix if sp.issparse(matrix) else None
    return matrix if sparse is None or sparse.shape[0] > DENSE_LIMIT else sparse.toarray()


def _orthogonal(group: np.ndarray, weight: Matrix) -> np.ndarray:
    """Shapes of a repeated eigenvalue, orthogonalised in the given weight; the first one stays."""
    out = group.copy()
    for j in range(1, group.shape[1]):
        for _ in range(2):  # the second pass removes rounding error
            out[:, j] -= out[:, :j] @ (out[:, :j].T @ (weight @ out[:, j]))
        out[:, j] /= np.sqrt(complex(out[:, j] @ (weight @ out[:, j])))
    return out


def _mean_slope(group: np.ndarray, slopes: list[Any], lam: complex) -> np.ndarray:
    """Mean derivative over a repeated eigenvalue, which does not depend on the choice of its shapes."""
    total = np.zeros(len(slopes), dtype=complex)
    for psi in group.T:
        for q, (dk, dc, dm) in enumerate(slopes):
            total[q] -= psi @ (lam * (lam * (dm @ psi) + dc @ psi) + dk @ psi)
    if not np.iscomplexobj(group):
        total /= 2 * lam  # phi^T M phi = 1 instead of psi^T (2 lambda M + C) psi = 1
    return total / group.shape[1]


def _coupled(part: np.ndarray, group: np.ndarray, force: np.ndarray) -> bool:
    """Whether some parameter couples the shapes of a repeated eigenvalue; the first one is the mode itself."""
    size = np.linalg.norm(group, axis=0)[:, None] * np.linalg.norm(force, axis=0)
    return bool(np.any(np.abs(part[1:]) > 1e-6 * size[1:]))


def _has_entries(matrix: Matrix) -> bool:
    return bool(abs(matrix).max() > 0)
