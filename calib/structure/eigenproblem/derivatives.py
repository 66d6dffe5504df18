"""Analytic derivatives of eigenvalues, frequencies, damping ratios and shapes with respect to named parameters."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Protocol, Self, TypeAlias

import numpy as np
import scipy.sparse as sp

from calib.errors.errors import InputError
from calib.execution.tasks import each
from calib.problem.space import ParameterSpace
from calib.structure.eigenproblem.mode_systems import Damped, Matrix, Undamped, eigenvalues, has_entries
from calib.structure.eigenproblem.solve import DENSE_LIMIT
from calib.structure.modes import Modes

_ENTRIES = 200_000
"""Entries of a block of right-hand sides: several such blocks are in memory at a time."""

_FEW = 0.1
"""Part of the entries of output rows up to which their product with shapes is sparse."""

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

    @property
    def is_damped(self) -> bool:
        """Whether there is a damping matrix."""
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

    def of(self, modes: Sequence[int], rows: Sequence[int]) -> ModeDerivatives:
        """Those of some modes, at some of the rows of shapes, by their indices; rows may be none."""
        some = replace(self, shapes=self.shapes[:, list(rows)][:, :, list(modes)], regular=self.regular[list(modes)])
        columns = ("eigenvalue", "natural_freq", "damped_freq", "damping_ratio")
        return replace(some, **{name: getattr(self, name)[:, list(modes)] for name in columns})


class Analytic:
    """The part of `calib.structure.modal_model.ModalModel` that follows from matrices and their derivatives."""

    @cached_property
    def dissipates(self: DifferentiableModel) -> bool:
        """Whether its modes are damped at the nominal or other parameter values."""
        if not self.is_damped:
            return False
        values = self.space.values
        # Derivatives are evaluated only where needed: some matrices have none at 0.
        slopes = (self.matrix_derivatives(values, name) for name in self.space.names)
        return has_entries(self.matrices(values)[1]) or any(has_entries(damping) for _, damping, _ in slopes)

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
    ``dlambda = -psi^T F``. The shape's derivative solves a system in Z with all parameters as right-hand sides (Nelson
    1976). In sparse models those of many modes are iterated together, with one factor and what all solved modes add to
    it (`calib.structure.eigenproblem.known_modes`), to a residual of 5e-7 of the force, which leaves an error of up to
    about 2e-5 of the largest entry of a shape's derivative. A mode without a gap to the modes that were not solved
    takes one bordered factorisation (after Friswell and Adhikari 2000). The border holds all solved eigenvalues within
    10 % of the mode's own, conjugates included, so that close modes do not spoil the solution; their contribution is
    added as ``-psi_j (psi_j^T F)/(lambda_i - lambda_j)``. Eigenvalues closer than 1e-7 count as repeated: if a
    parameter couples them, the shapes have no derivative and the mode is flagged. Modes that were turned inside a
    subspace (`Modes.groups`) have the derivatives of their Rayleigh quotients, and of their shapes the part that leaves
    the subspace.

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
    solver = Damped if modes.is_complex else Undamped
    stiffness, damping, mass = (_small_as_dense(matrix) for matrix in (stiffness, damping, mass))
    asked = list(dict.fromkeys(chosen.tolist()))
    group = solver(stiffness, damping, mass, [tuple(map(_small_as_dense, slope)) for slope in slopes], modes, asked)
    wanted = None if rows is None else np.asarray(rows)
    without_shapes = wanted is not None and not len(wanted)
    n_rows = stiffness.shape[0] if wanted is None else len(wanted)
    eigenvalue = np.zeros((len(names), len(chosen)), dtype=complex)
    shapes = np.zeros((len(names), n_rows, len(chosen)), dtype=group.shape_type)
    regular = np.ones(len(chosen), dtype=bool)
    worth = wanted is not None and not without_shapes  # to be sent to other processes
    alone = without_shapes or not sp.issparse(stiffness)
    tasks = _tasks(group, asked, len(slopes), alone) if slopes else []
    if tasks:
        group.prepare()
    shared = group, without_shapes, _few_as_sparse(wanted)
    function = _of_modes if sp.issparse(stiffness) else _of_dense_modes
    found = each(function, shared, tasks) if worth else (_of_modes(shared, task) for task in tasks)
    for (_, some), answers in zip(tasks, found, strict=True):
        for j, (own, shape, good) in zip(some, answers, strict=True):
            i = np.flatnonzero(chosen == j)
            eigenvalue[:, i] = own[:, None]
            shapes[:, :, i], regular[i] = shape.T[:, :, None] if good else np.nan, good
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


Task: TypeAlias = tuple[float | None, list[int]]
"""A shift at which a factor serves some modes, or None where a mode is solved by a factor with a border."""
Answer: TypeAlias = tuple[np.ndarray, np.ndarray, bool]
"""Derivatives of one mode: of its eigenvalue (n_params,), of its shape (n_rows, n_params), and if they exist."""


def _tasks(group: Undamped | Damped, chosen: list[int], n_params: int, alone: bool) -> list[Task]:
    """Which modes are solved together, in portions of a limited size; ``alone`` where none are."""
    tasks: list[Task] = []
    most = max(1, _ENTRIES // (group.all.shape[0] * n_params))
    for shift, some in [] if alone else group.bands(chosen, n_params):
        tasks += [(shift, some[k : k + most]) for k in range(0, len(some), most)]
    together = {j for _, some in tasks for j in some}
    return [*tasks, *((None, [j]) for j in chosen if j not in together)]


def _of_modes(shared: tuple[Undamped | Damped, bool, Matrix | None], task: Task) -> list[Answer]:
    """Derivatives of some modes."""
    group, without_shapes, wanted = shared
    shift, some = task
    systems = [group.system(j) for j in some]
    solved = [one for one in systems if one.regular and not without_shapes]
    rests = group.together(shift, solved) if shift is not None and solved else [None] * len(solved)
    shapes, good = {one.mode: np.zeros_like(one.force) for one in systems}, {one.mode: one.regular for one in systems}
    for one, known in zip(solved, rests, strict=True):
        rest, good[one.mode] = group.alone(one) if known is None else (known, True)
        shapes[one.mode] = group.normalised(one, rest)
    if wanted is not None:
        shapes = {j: wanted @ shape for j, shape in shapes.items()}
    return [(one.slope, shapes[one.mode], good[one.mode]) for one in systems]


def _of_dense_modes(shared: tuple[Undamped | Damped, bool, Matrix | None], task: Task) -> list[Answer]:
    """As `_of_modes`; a function of its own, since whoever shares tasks notes how long those of each function take."""
    return _of_modes(shared, task)


def _few_as_sparse(rows: np.ndarray | None) -> Matrix | None:
    """Output rows as a sparse matrix where few entries differ from 0, as those of sensors at nodes."""
    if rows is None or np.count_nonzero(rows) >= _FEW * rows.size:
        return rows
    return sp.csr_array(rows)


def _small_as_dense(matrix: Matrix) -> Matrix:
    """A small sparse matrix as a dense array, whose products and factors are many times cheaper."""
    sparse: Any = matrix if sp.issparse(matrix) else None
    return matrix if sparse is None or sparse.shape[0] > DENSE_LIMIT else sparse.toarray()
