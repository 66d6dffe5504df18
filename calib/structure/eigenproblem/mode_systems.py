"""Systems whose solutions are derivatives of modes: by one factor for each mode, or for many with all known modes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
import scipy.sparse as sp

from calib.structure.eigenproblem.damped_problem import real_times
from calib.structure.eigenproblem.inertia import bordered
from calib.structure.eigenproblem.known_modes import bands, iterated, rigid_modes
from calib.structure.eigenproblem.symmetric_factor import SymmetricFactor, symmetric_factor
from calib.structure.modes import Modes

Matrix = Any
"""A dense ndarray or a SciPy sparse array, shape (n_dof, n_dof), symmetric; a derivative need only be multiplied."""

NEIGHBOUR = 0.1
"""Eigenvalues closer than this fraction of their modulus form one group: the bordered matrix then stays regular."""

REPEATED = 1e-7
"""Eigenvalues closer than this fraction of their modulus count as repeated; single shapes have no derivative."""

_AT_ONCE = 4_000_000
"""Largest number of entries, of all parameters, degrees of freedom and modes, that are multiplied together: 64 MB."""

_FREE = 1e-4
"""Shift of the factor that finds rigid-body motions, over the lowest squared frequency."""


def eigenvalues(modes: Modes) -> np.ndarray:
    """Lambda of every mode in 1/s, upper half-plane, shape (n_modes,), complex."""
    size = 2 * np.pi * modes.natural_freq
    return -modes.damping_ratio * size + 2j * np.pi * modes.damped_freq


@dataclass(frozen=True, eq=False)
class ModeSystem:
    """The system of one mode: its force (n_dof, n_params), and the modes close to it, itself first.

    ``near`` are indices of the close modes (n_near,) and ``group`` their shapes (n_dof, n_near); ``same`` marks those
    that share its eigenvalue or subspace, and ``part`` are the forces on these modes, (n_near, n_params). ``slope`` is
    the derivative of its eigenvalue, (n_params,).
    """

    mode: int
    eigenvalue: complex
    shape: np.ndarray
    force: np.ndarray
    near: np.ndarray
    group: np.ndarray
    same: np.ndarray
    part: np.ndarray
    slope: np.ndarray
    regular: bool
    scale: complex = 1.0


class _Modes:
    """What real and complex modes have in common.

    ``all`` are shapes (n_dof, n_known), ``squares`` squared natural frequencies (n_modes,), ``rigid`` is how many
    motions have no stiffness, ``shifted`` whether a factor may have a shift, and ``asked`` are the modes whose systems
    are asked for.
    """

    k: Matrix
    m: Matrix
    slopes: list[Any]
    all: np.ndarray
    asked: list[int]
    squares: np.ndarray
    rigid: int
    shape_type: type
    shifted: bool

    def __getstate__(self) -> dict[str, Any]:
        # A factor cannot be pickled; it is made again where it is needed.
        return {name: value for name, value in self.__dict__.items() if name != "_factors"}

    def bands(self, chosen: Sequence[int], n_params: int) -> list[tuple[float, list[int]]]:
        """Which modes share a factor, and its shift; see `calib.structure.eigenproblem.known_modes.bands`."""
        order = np.argsort(self.squares)
        place = np.argsort(order)[list(chosen)].tolist()
        found = bands(self.squares[order], place, n_params, not self.rigid, self.shifted)
        return [(shift, order[some].tolist()) for shift, some in found]

    def _pushed(self, i: int, combine: Callable[..., np.ndarray], *kinds: int) -> Iterable[np.ndarray]:
        """Of each parameter what is combined of derivatives of K, C and M (0, 1, 2) times a mode's shape, (n_dof,)."""
        if not self._at_once:
            return (combine(*(times(slope[kind], self.all[:, i]) for kind in kinds)) for slope in self.slopes)
        return combine(*(self.products[kind, :, :, self.asked.index(i)] for kind in kinds))

    @property
    def _at_once(self) -> bool:
        """Whether all derivatives are multiplied with all shapes that are asked for at once."""
        entries = 3 * len(self.slopes) * len(self.all) * len(self.asked)
        return not sp.issparse(self.k) and entries <= _AT_ONCE

    @cached_property
    def products(self) -> np.ndarray:
        """Derivatives of K, C and M by each parameter times these shapes, (3, n_params, n_dof, n_asked)."""
        shapes = self.all[:, self.asked]
        products = np.zeros((3, len(self.slopes), *shapes.shape), dtype=shapes.dtype)
        for q, slope in enumerate(self.slopes):
            for kind, matrix in enumerate(slope):
                if getattr(matrix, "nnz", 1):
                    products[kind, q] = real_times(matrix, shapes)
        return products

    def prepare(self) -> None:
        """Compute what all systems need, before they are solved one by one."""
        if self._at_once:
            _ = self.products

    def _factor(self, shift: float) -> SymmetricFactor:
        """At a shift, a squared frequency; the last one is kept."""
        kept: dict[float, SymmetricFactor] = self.__dict__.setdefault("_factors", {})
        if shift not in kept:
            kept.clear()
            kept[shift] = symmetric_factor(sp.csc_array(self._at(shift)) if shift else self.k)
        return kept[shift]

    def _at(self, shift: float) -> Matrix:
        """The matrix that is factorised at a shift."""
        return self.k - shift * self.m


class Damped(_Modes):
    """State-space modes: groups of close eigenvalues among the modes and their conjugates."""

    def __init__(
        self, stiffness: Matrix, damping: Matrix, mass: Matrix, slopes: list[Any], modes: Modes, asked: list[int]
    ):
        self.k, self.c, self.m, self.slopes, self.asked = stiffness, damping, mass, slopes, asked
        upper = eigenvalues(modes)
        self.eigenvalues = np.concatenate([upper, upper.conj()])
        self.all = np.hstack([modes.shapes, modes.shapes.conj()])
        self.shape_type, self.groups = complex, modes.groups
        self.squares = np.abs(upper) ** 2
        self.rigid = sum(one.kind != "overdamped" for one in modes.excluded)
        self.shifted = not self.rigid

    def system(self, i: int) -> ModeSystem:
        """The system of a mode."""
        lam, psi = self.eigenvalues[i], self.all[:, i]
        force = np.column_stack([*self._pushed(i, lambda dk, dc, dm: lam * (lam * dm + dc) + dk, 0, 1, 2)])
        gap = np.abs(self.eigenvalues - lam)
        near = np.flatnonzero(gap <= NEIGHBOUR * abs(lam))
        near = np.concatenate([[i], near[near != i]])
        group = self.all[:, near]
        turned, scale = np.isin(near, _group_of(self.groups, i)), 1.0 + 0j
        if turned.any():  # a turned shape has its unit norm to first order in the damping only
            scale = np.sqrt(psi @ (2 * lam * (self.m @ psi) + self.c @ psi))
            psi, force, group[:, 0] = psi / scale, force / scale, psi / scale
        same = turned | (gap[near] <= REPEATED * abs(lam))
        group[:, same] = _orthogonal(group[:, same], 2 * lam * self.m + self.c)
        part = group.T @ force
        free = same & ~(turned & (near != i))
        regular = not _coupled(part[free], group[:, free], force)
        slope = -part[0] if regular else _mean_slope(group[:, same], self.slopes, lam)
        return ModeSystem(i, lam, psi, force, near, group, same, part, slope, regular, scale)

    def alone(self, system: ModeSystem) -> tuple[np.ndarray, bool]:
        """The shape's derivative but for its normalisation, by a factor with a border, and whether it is accurate."""
        lam, group, part, others = system.eigenvalue, system.group, system.part, self.eigenvalues[system.near]
        inertia = self.m @ group
        border = (lam + others) * inertia + self.c @ group
        matrix = lam * (lam * self.m + self.c) + self.k
        rest, good = bordered(matrix, border, -(system.force - border @ part), (group.T @ inertia) @ part)
        for j in range(1, len(system.near)):
            if not system.same[j]:
                rest -= np.outer(group[:, j], part[j] / (lam - others[j]))
        return rest, good

    def together(self, shift: float, systems: Sequence[ModeSystem]) -> list[np.ndarray | None]:
        """The same of several modes, by one factor of Z and all modes; None where it does not converge.

        The inverse of ``Z(lambda)`` is approximated by that of ``Z(i omega)``, omega being the root of the shift, with
        what all known modes add to the difference. A complex solution costs no more than two real ones.
        """
        factor, s = self._factor(shift), 1j * np.sqrt(shift)
        shapes, known = self.all, self.eigenvalues
        columns = np.repeat(np.arange(len(systems)), len(self.slopes))
        lam = np.array([one.eigenvalue for one in systems])
        with np.errstate(divide="ignore", invalid="ignore"):
            beside = 1 / (lam - known[:, None])
        for k, one in enumerate(systems):
            beside[one.near[one.same], k] = 0.0
        added = beside - 1 / (s - known[:, None])

        def operate(block: np.ndarray, at: np.ndarray) -> np.ndarray:
            by = lam[columns[at]]
            return by * real_times(self.c, block) + by**2 * real_times(self.m, block) + real_times(self.k, block)

        def approximate(block: np.ndarray, at: np.ndarray) -> np.ndarray:
            if shift:
                own = factor.solve(block)
            else:
                both = factor.solve(np.hstack([block.real, block.imag]))
                own = both[:, : len(at)] + 1j * both[:, len(at) :]
            return np.asarray(own + shapes @ (added[:, columns[at]] * (shapes.T @ block)))

        right, targets, borders = [], [], []
        for one in systems:
            own = one.group[:, one.same]
            inertia = self.m @ own
            borders.append((one.eigenvalue + known[one.near[one.same]]) * inertia + self.c @ own)
            right.append(-(one.force - borders[-1] @ one.part[one.same]))
            targets.append((own.T @ inertia) @ one.part[one.same])
        whole = np.hstack(right)
        rest, good = iterated(operate, approximate, whole, _sizes(systems))
        every = np.arange(len(columns))
        rest += shapes @ (beside[:, columns] * (shapes.T @ (whole - operate(rest, every))))  # of the closest ones
        return _in_scale(systems, rest, good, borders, targets)

    def _at(self, shift: float) -> Matrix:
        return self.k + 1j * np.sqrt(shift) * self.c - shift * self.m

    def normalised(self, system: ModeSystem, rest: np.ndarray) -> np.ndarray:
        """The shape's derivative in the scale of `Modes`."""
        lam, psi = system.eigenvalue, system.shape
        inertia = self.m @ psi
        pushed = self._pushed(system.mode, lambda dc, dm: 2 * lam * dm + dc, 1, 2)
        norm = np.array([psi @ one for one in pushed]) / system.scale
        own = -0.5 * (2 * system.slope * (psi @ inertia) + norm) - (2 * lam * inertia + self.c @ psi) @ rest
        return np.asarray((rest + np.outer(psi, own)) * system.scale)


class Undamped(_Modes):
    """Classical modes: groups of close squared frequencies."""

    def __init__(
        self, stiffness: Matrix, damping: Matrix, mass: Matrix, slopes: list[Any], modes: Modes, asked: list[int]
    ):
        self.k, self.m, self.slopes, self.all, self.asked = stiffness, mass, slopes, modes.shapes, asked
        self.omega = 2 * np.pi * modes.natural_freq
        self.groups, self.squares, self.shifted = modes.groups, self.omega**2, True
        self.shape_type = complex if any(has_entries(dc) for _, dc, _ in slopes) else float
        self.rigid = len(modes.excluded)

    def system(self, i: int) -> ModeSystem:
        """The system of a mode."""
        omega, phi = self.omega[i], self.all[:, i]
        columns = self._pushed(i, lambda dk, dm: dk - omega**2 * dm, 0, 2)
        force: np.ndarray = np.column_stack([*columns]).astype(self.shape_type)
        if self.shape_type is complex:
            force += 1j * omega * np.column_stack([*self._pushed(i, lambda dc: dc, 1)])
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
        slope = 0.5j * part[0] / omega if regular else _mean_slope(group[:, same], self.slopes, 1j * omega)
        return ModeSystem(i, omega, phi, force, near, group, same, part, slope, regular)

    def alone(self, system: ModeSystem) -> tuple[np.ndarray, bool]:
        """The shape's derivative but for its normalisation, by a factor with a border, and whether it is accurate."""
        square, group, part = system.eigenvalue**2, system.group, system.part
        border = self.m @ group
        rest, good = bordered(self.k - square * self.m, border, -(system.force - border @ part), np.zeros_like(part))
        for j in range(1, len(system.near)):
            if not system.same[j]:
                rest += np.outer(group[:, j], part[j] / (square - self.omega[system.near[j]] ** 2))
        return rest, good

    def together(self, shift: float, systems: Sequence[ModeSystem]) -> list[np.ndarray | None]:
        """The same of several modes, by one factor of ``K - shift M`` and all modes; None where it does not converge.

        What the known modes leave has higher frequencies, where ``K - shift M`` is nearly ``K - omega^2 M``.
        """
        known, shapes = self.squares, self.all
        if self.rigid:
            motions = rigid_modes(self._factor(-_FREE * float(known.min())).solve, self.m, self.rigid)
            known, shapes = np.concatenate([known, np.zeros(self.rigid)]), np.hstack([shapes, motions])
        factor = self._factor(shift)
        parts = 2 if self.shape_type is complex else 1
        columns = np.tile(np.repeat(np.arange(len(systems)), len(self.slopes)), parts)
        square = np.array([one.eigenvalue**2 for one in systems])
        with np.errstate(divide="ignore", invalid="ignore"):
            beside = 1 / (known[:, None] - square)
        for k, one in enumerate(systems):
            beside[one.near[one.same], k] = 0.0
        added = beside - 1 / (known[:, None] - shift)

        def operate(block: np.ndarray, at: np.ndarray) -> np.ndarray:
            return np.asarray(self.k @ block - (self.m @ block) * square[columns[at]])

        def approximate(block: np.ndarray, at: np.ndarray) -> np.ndarray:
            return np.asarray(factor.solve(block) + shapes @ (added[:, columns[at]] * (shapes.T @ block)))

        borders = [self.m @ one.group[:, one.same] for one in systems]
        right = np.hstack([-(one.force - b @ one.part[one.same]) for one, b in zip(systems, borders, strict=True)])
        both = np.hstack([right.real, right.imag]) if parts == 2 else right
        rest, good = iterated(operate, approximate, both, np.tile(_sizes(systems), parts))
        if parts == 2:
            half = len(columns) // 2
            rest, good = rest[:, :half] + 1j * rest[:, half:], good[:half] & good[half:]
        targets = [np.zeros((b.shape[1], len(self.slopes))) for b in borders]
        return _in_scale(systems, rest, good, borders, targets)

    def normalised(self, system: ModeSystem, rest: np.ndarray) -> np.ndarray:
        """The shape's derivative in the scale of `Modes`."""
        phi = system.shape
        masses = np.array([phi @ one for one in self._pushed(system.mode, lambda dm: dm, 2)])
        own = -0.5 * masses - (self.m @ phi) @ rest
        return np.asarray(rest + np.outer(phi, own))


def _sizes(systems: Sequence[ModeSystem]) -> np.ndarray:
    """Norms of all forces, (n_modes * n_params,)."""
    return np.concatenate([np.linalg.norm(one.force, axis=0) for one in systems])


def _in_scale(
    systems: Sequence[ModeSystem],
    rest: np.ndarray,
    good: np.ndarray,
    borders: Sequence[np.ndarray],
    targets: Sequence[np.ndarray],
) -> list[np.ndarray | None]:
    """Solutions mode by mode, with their part in modes of the same eigenvalue set to a target."""
    out: list[np.ndarray | None] = []
    for k, (one, border, target) in enumerate(zip(systems, borders, targets, strict=True)):
        own = slice(k * one.force.shape[1], (k + 1) * one.force.shape[1])
        column, same = rest[:, own], one.group[:, one.same]
        held = np.linalg.solve(border.T @ same, target - border.T @ column)
        out.append(column + same @ held if good[own].all() else None)
    return out


def _group_of(groups: Sequence[tuple[int, ...]], i: int) -> list[int]:
    """All modes of the subspace in which a mode was turned; none for a single one."""
    return next((list(group) for group in groups if i in group), [])


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


def times(matrix: Matrix, column: np.ndarray) -> np.ndarray:
    """A matrix, often one without entries, times a column (n_dof,)."""
    return np.zeros_like(column) if getattr(matrix, "nnz", 1) == 0 else np.asarray(matrix @ column)


def has_entries(matrix: Matrix) -> bool:
    """Whether a matrix differs from 0."""
    return bool(abs(matrix).max() > 0)
