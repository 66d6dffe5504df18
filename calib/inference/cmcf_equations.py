"""The cross-model cross-FRF equations of one model and one measurement; see `calib.inference.cmcf`."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import scipy.linalg as la
import scipy.sparse as sp

from calib.errors.errors import EvaluationError, InputError

Kind = Literal["stiffness", "mass", "structural", "viscous"]
Weighting = Literal["none", "block", "white"]
Iteration = Literal["proposed", "traditional", "traditional_total"]
Reduce = Callable[[sp.csc_array, sp.csc_array], np.ndarray]
"""Transformation T (n_dof, n_masters) of a stiffness and a mass matrix (n_dof, n_dof)."""

RESONANT = 1e-5
"""Relative distance of an evaluation frequency from a resonance below which its receptance is rounding error."""

_RANK = 1e-10
"""Smallest singular value over the largest, columns scaled, below which changes are not determined."""


@dataclass(frozen=True, eq=False)
class Change:
    """One unknown: the factor theta by which a matrix is added to the model.

    Attributes
    ----------
    name : str
    kind : {"stiffness", "mass", "structural", "viscous"}
        The matrix of the dynamic stiffness it adds to.
    matrix : csc_array (n_dof, n_dof)
        Of linked elements their sum. With the nominal contribution, theta is the relative change; for ``structural``
        damping with a stiffness matrix it is the loss factor times the updated stiffness over the nominal one.
    more : tuple of (kind, matrix)
        Further matrices that the same theta adds, as of a parameter in stiffness and mass.
    is_factor : bool
        Whether 1 + theta is a factor of a stiffness or mass and must stay positive.
    """

    name: str
    kind: Kind
    matrix: sp.csc_array
    more: tuple[tuple[Kind, sp.csc_array], ...] = ()
    is_factor: bool = True

    @property
    def parts(self) -> tuple[tuple[Kind, sp.csc_array], ...]:
        """All its matrices."""
        return ((self.kind, self.matrix), *self.more)


@dataclass(frozen=True, eq=False)
class InitialModel:
    """The model to update.

    Attributes
    ----------
    stiffness, mass : csc_array (n_dof, n_dof)
        Symmetric; SI.
    changes : tuple of Change
    masters : ndarray (n_masters,), int
        Degrees of freedom at which the receptance was measured.
    reduce : callable, optional
        `Reduce`; None where every degree of freedom is a master.
    viscous, structural : csc_array (n_dof, n_dof), optional
        C and D of the initial model.
    """

    stiffness: sp.csc_array
    mass: sp.csc_array
    changes: tuple[Change, ...]
    masters: np.ndarray
    reduce: Reduce | None = None
    viscous: sp.csc_array | None = None
    structural: sp.csc_array | None = None

    def __post_init__(self) -> None:
        if self.reduce is None and len(self.masters) != self.stiffness.shape[0]:
            raise InputError(
                f"{len(self.masters)} of {self.stiffness.shape[0]} degrees of freedom are measured",
                place="cross-model equations",
                remedy="give a reduction to these",
            )
        if not self.changes:
            raise InputError("nothing may change", place="cross-model equations", remedy="name a parameter")


@dataclass(frozen=True, eq=False)
class MeasuredReceptance:
    """Receptance at the masters.

    Attributes
    ----------
    freq : ndarray (n_lines,)
        Hz.
    receptance : ndarray (n_lines, n_masters, n_references)
        m/N (complex where damped), all masters of each reference.
    references : ndarray (n_references,), int
        Index of each among the masters.
    """

    freq: np.ndarray
    receptance: np.ndarray
    references: np.ndarray

    def __post_init__(self) -> None:
        shape = (len(self.freq), np.shape(self.receptance)[1], len(self.references))
        if np.shape(self.receptance) != shape or not np.all(np.isfinite(self.receptance)):
            raise InputError(
                f"the receptance has shape {np.shape(self.receptance)} or entries that are not finite",
                place="cross-model equations",
                remedy=f"give finite ones of shape {shape}: lines, masters, references",
            )


@dataclass(frozen=True)
class CmcfSettings:
    """Settings of the iteration.

    Attributes
    ----------
    orders : int
        Model frequencies at which the left factors are evaluated.
    offset : float
        Relative distance of these from the model's resonances; never 0 without damping.
    weighting : {"white", "block", "none"}
        Of the equations of lines i and j. ``white`` divides by the standard deviation that multiplicative noise of H*
        gives them, ``|W_i Z_s(omega*_j)| |H*_j|``; ``block`` by ``|W_i| |H*_j|``, which lets noise shrink the changes.
    iteration : {"proposed", "traditional", "traditional_total"}
        ``traditional`` takes the updated model as the next base; ``traditional_total`` the initial one with the
        transformation of the updated one.
    steps : int
        At most.
    tolerance : float
        It stops when no frequency changes by more, relative.
    """

    orders: int = 8
    offset: float = 0.02
    weighting: Weighting = "white"
    iteration: Iteration = "proposed"
    steps: int = 15
    tolerance: float = 1e-4


DEFAULT = CmcfSettings()


@dataclass(frozen=True, eq=False)
class Reduced:
    """The model with changes theta, reduced by a transformation.

    Attributes
    ----------
    theta : ndarray (n_changes,)
    stiffness, mass, structural, viscous : ndarray (n_masters, n_masters)
        Of the initial model.
    blocks : ndarray (n_blocks, n_masters, n_masters)
        Matrices of the changes.
    kinds : tuple of str
        Of the blocks.
    owner : ndarray (n_blocks,), int
        The change that each block belongs to.
    """

    theta: np.ndarray
    stiffness: np.ndarray
    mass: np.ndarray
    structural: np.ndarray
    viscous: np.ndarray
    blocks: np.ndarray
    kinds: tuple[Kind, ...]
    owner: np.ndarray

    @staticmethod
    def of(model: InitialModel, theta: np.ndarray) -> Reduced:
        """The model at theta, reduced there."""
        n = len(model.masters)
        if model.reduce is None:
            transformation = np.eye(n)[:, model.masters]
        else:
            changed = {"stiffness": model.stiffness, "mass": model.mass}
            for change, value in zip(model.changes, theta, strict=True):
                for kind, matrix in change.parts:
                    if kind in changed:
                        changed[kind] = changed[kind] + value * matrix
            transformation = model.reduce(sp.csc_array(changed["stiffness"]), sp.csc_array(changed["mass"]))

        def small(matrix: sp.csc_array | None) -> np.ndarray:
            return np.zeros((n, n)) if matrix is None else np.asarray(transformation.T @ (matrix @ transformation))

        return Reduced(
            theta, small(model.stiffness), small(model.mass), small(model.structural), small(model.viscous),
            np.array([small(matrix) for c in model.changes for _, matrix in c.parts]),
            tuple(kind for c in model.changes for kind, _ in c.parts),
            np.repeat(np.arange(len(model.changes)), [len(c.parts) for c in model.changes]),
        )  # fmt: skip

    @property
    def is_damped(self) -> bool:
        """Whether the initial model is damped or a change of damping is among the unknowns."""
        return bool(np.any(self.structural) or np.any(self.viscous) or {"structural", "viscous"} & set(self.kinds))

    def with_changes(self, theta: np.ndarray) -> Reduced:
        """Other changes with the same transformation."""
        return replace(self, theta=theta)

    def total(self, kind: Kind) -> np.ndarray:
        """K, M, D or C with the changes, (n_masters, n_masters)."""
        own: np.ndarray = getattr(self, kind)
        chosen = np.array([k == kind for k in self.kinds])
        return np.asarray(own + np.tensordot(self.theta[self.owner[chosen]], self.blocks[chosen], axes=1))

    def freq(self, orders: int) -> np.ndarray:
        """Lowest undamped natural frequencies, Hz."""
        try:
            eigenvalues = la.eigh(self.total("stiffness"), self.total("mass"), eigvals_only=True)[:orders]
        except la.LinAlgError as fault:
            raise EvaluationError("the mass of the updated model is not positive") from fault
        return np.asarray(np.sqrt(np.maximum(eigenvalues, 0.0)) / (2 * np.pi))

    def dynamic(self, freq: np.ndarray) -> np.ndarray:
        """Dynamic stiffness at frequencies in Hz, (n_freq, n_masters, n_masters), real where undamped."""
        omega = 2 * np.pi * np.asarray(freq)[:, None, None]
        real = self.total("stiffness") - omega**2 * self.total("mass")
        return real + 1j * (omega * self.total("viscous") + self.total("structural")) if self.is_damped else real

    def slopes(self, freq: np.ndarray) -> np.ndarray:
        """Derivatives of the dynamic stiffness, (n_freq, n_changes, n_masters, n_masters)."""
        omega = 2 * np.pi * np.asarray(freq)[:, None]
        factor = {
            "stiffness": 1.0 + 0 * omega,
            "mass": -(omega**2),
            "structural": 1j + 0 * omega,
            "viscous": 1j * omega,
        }
        each = np.hstack([factor[kind] for kind in self.kinds])[:, :, None, None] * self.blocks
        owned = self.owner == np.arange(len(self.theta))[:, None]
        return np.asarray(np.einsum("cb,jbmn->jcmn", owned.astype(float), each))

    def imbalance(self, measured: MeasuredReceptance) -> np.ndarray:
        """``I_Q - Z_s H*``, (n_lines, n_masters, n_references): zero where model and measurement agree."""
        return np.asarray(
            np.eye(len(self.stiffness))[:, measured.references] - self.dynamic(measured.freq) @ measured.receptance
        )


@dataclass(frozen=True, eq=False)
class Equations:
    """Left factors and the least-squares solution of the equations, at one model.

    Attributes
    ----------
    left : ndarray (orders, n_masters, n_masters)
        W.
    weight : ndarray (orders, n_lines)
    inverse : ndarray (n_changes, n_rows + n_prior)
        Pseudo-inverse of A and of the rows of the prior below it, where there is one; rows are real.
    is_complex : bool
        Whether real and imaginary parts of the equations are rows of their own.
    prior : ndarray (n_prior, n_changes)
        Rows of the prior; none without it.
    """

    left: np.ndarray
    weight: np.ndarray
    inverse: np.ndarray
    is_complex: bool
    prior: np.ndarray

    @staticmethod
    def at(
        base: Reduced, measured: MeasuredReceptance, settings: CmcfSettings, prior_sd: np.ndarray | None = None
    ) -> Equations:
        """The equations whose A and W belong to a model; see `cmcf`."""
        left = _left_factors(base, settings)
        weight = _weights(left, base, measured, settings.weighting)
        right = base.slopes(measured.freq) @ measured.receptance[:, None]  # (lines, changes, masters, references)
        rows = np.einsum("ipm,jnmq,ij->nijpq", left, right, weight, optimize=True).reshape(len(base.theta), -1)
        is_complex = complex_with(base, measured)
        prior = np.zeros((0, len(base.theta))) if prior_sd is None else np.diag(1 / np.asarray(prior_sd))
        whole = np.vstack([_real(rows, is_complex).T, prior])
        return Equations(left, weight, _pseudo_inverse(whole), is_complex, prior)

    def solve(self, imbalance: np.ndarray, off: np.ndarray) -> np.ndarray:
        """Change of theta that removes an imbalance (n_lines, n_masters, n_references).

        ``off`` (n_changes,) is the distance of theta from the mean of the prior, which it weighs against.
        """
        rows = np.einsum("ipm,jmq,ij->ijpq", self.left, imbalance, self.weight, optimize=True).reshape(1, -1)
        return np.asarray(self.inverse @ np.concatenate([_real(rows, self.is_complex)[0], -self.prior @ off]))

    @property
    def prior_slope(self) -> np.ndarray:
        """Derivative of the solution by the mean of the prior, (n_changes, n_prior)."""
        return np.asarray(self.inverse[:, self.inverse.shape[1] - len(self.prior) :] @ self.prior)

    def slope(self, dynamic: np.ndarray, n_references: int) -> np.ndarray:
        """Derivative S of the solution by the receptance, (n_changes, n_lines, n_masters, n_references), complex.

        An error dH* changes theta by ``Re sum(S dH*)``: the residual ``W_i (I_Q - Z_s H*)`` by ``-W_i Z_s dH*``. Where
        the equations have no imaginary part dH* has none either. ``dynamic`` (n_lines, n_masters, n_masters) is Z_s of
        the solution.
        """
        shape = (len(self.inverse), len(self.left), len(dynamic), self.left.shape[1], n_references)
        count = int(np.prod(shape[1:]))
        inverse = self.inverse[:, :count].astype(complex)
        if self.is_complex:
            inverse -= 1j * self.inverse[:, count : 2 * count]
        weighed = np.einsum("nijpq,ij,ipm->njmq", inverse.reshape(shape), self.weight, self.left, optimize=True)
        return np.asarray(-np.einsum("njmq,jmk->njkq", weighed, dynamic, optimize=True))


def complex_with(base: Reduced, measured: MeasuredReceptance) -> bool:
    """Whether the equations have an imaginary part: the model or a change of it is damped, or the receptance."""
    return base.is_damped or np.iscomplexobj(measured.receptance)


def _left_factors(base: Reduced, settings: CmcfSettings) -> np.ndarray:
    """``H_s(omega_i)^T`` of the undamped model near its resonances, (orders, n_masters, n_masters)."""
    own = base.freq(len(base.stiffness))
    at = own[: settings.orders] * (1 + settings.offset)
    omega = 2 * np.pi * at[:, None, None]
    dynamic = base.total("stiffness") - omega**2 * base.total("mass")
    nearest = np.min(np.abs(at[:, None] - own) / np.maximum(own, 1e-300), axis=1)
    for freq, gap in zip(at, nearest, strict=True):
        if gap < RESONANT:
            raise EvaluationError(
                f"the model's receptance at {freq:.6g} Hz is taken {gap:.1e} from a resonance, where it is rounding "
                "error; choose another offset, such as 0.02"
            )
    return np.asarray(np.linalg.inv(dynamic).transpose(0, 2, 1))


def _weights(left: np.ndarray, base: Reduced, measured: MeasuredReceptance, weighting: Weighting) -> np.ndarray:
    """Weight of the equations of each left factor and line, (orders, n_lines)."""
    size = np.linalg.norm(measured.receptance, axis=(1, 2))
    if weighting == "none":
        return np.ones((len(left), len(size)))
    if weighting == "block":
        return np.asarray(1 / (np.linalg.norm(left, axis=(1, 2))[:, None] * size))
    spread = np.linalg.norm(left[:, None] @ base.dynamic(measured.freq), axis=(2, 3))
    return np.asarray(1 / (spread * size))


def _real(rows: np.ndarray, is_complex: bool) -> np.ndarray:
    """Real rows (n, m), or of complex equations real and imaginary parts side by side, (n, 2 m)."""
    return np.hstack([rows.real, rows.imag]) if is_complex else rows.real


def _pseudo_inverse(matrix: np.ndarray) -> np.ndarray:
    """Pseudo-inverse of A (n_rows, n_changes), columns scaled; InputError when it has not full rank."""
    scale = np.linalg.norm(matrix, axis=0)
    if not np.all(scale > 0):
        raise InputError(
            f"{np.count_nonzero(scale == 0)} of the changes move no measured place",
            place="cross-model equations",
            remedy="free fewer parameters or measure elsewhere",
        )
    left, values, right = la.svd(matrix / scale, full_matrices=False)
    rank = int(np.count_nonzero(values > _RANK * values[0]))
    if rank < len(scale):
        raise InputError(
            f"the equations determine {rank} of {len(scale)} changes",
            place="cross-model equations",
            remedy="free fewer parameters, or measure more lines or places",
        )
    return np.asarray((right.T / values) @ left.T / scale[:, None])
