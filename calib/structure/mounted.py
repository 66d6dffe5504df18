"""A rigid body on elastic mounts in place of a point mass."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
import scipy.sparse as sp

from calib.errors.errors import InputError
from calib.structure.affine import Coefficient, Grown, Monomial, Term
from calib.structure.effects.attach import GRAVITY
from calib.structure.effects.extend import Addition

GROWN_SAG = 1e-4
"""Sag in m (50 Hz vertically) at which a body has half of its offset and a quarter of its moments of inertia."""
_AT_POINT = 1e-6
"""Distance of a mount from the point along x, over that of the farthest, that is rounding."""

_Part: TypeAlias = tuple[str, np.ndarray, Mapping[str, float], int]
"""Name, matrix (6, 6), powers of parameters, and power of the growing distance of the centre below the point."""


@dataclass(frozen=True)
class MountedBody:
    """A rigid body on elastic mounts, which the base model carries as a point mass: six added degrees of freedom.

    With b and w the translations and rotations of the carrier at the point, m the mass, G the moments of inertia over
    m, and ``s = sag/gravity``, the body moves relative to its carrier by t and theta, ``(t, theta) = sqrt(s/m) g``.
    Each of n mounts has the vertical stiffness ``m/(n s)``, so that its static deflection under the weight is the sag,
    and a fraction rho of that laterally. At r from the centre it deflects by ``t + theta x r``: with ``A = [I,
    -cross(r)]`` and ``kappa = sum A^T diag(rho, 1, rho) A/n`` the strain energy is ``g^T kappa g/2``, the damping
    matrix ``2 zeta sqrt(s) kappa``. The centre is lower than the point by d, ``b_d = b - d w x up``, and the kinetic
    energy is ``m (b_d' + t')^2/2 + m (w' + theta')^T G (w' + theta')/2``, of which the base model has ``m b'^2/2``.

    At sag 0 g is 0, and the extended model must equal the base model: there the body is the point mass. With the sag it
    grows to its own size and position, d as ``a = sag^2/(sag^2 + GROWN_SAG^2)``, G as ``a^2``. The body is physical at
    every sag, so that the mass is nowhere negative; with mounts soft enough to vibrate within a test's frequency range
    it has nearly its own size.

    Attributes
    ----------
    mass : float
        kg.
    mounts : ndarray (n_mounts, 3)
        Positions of the mounts relative to the point, m; at least three, not on a line.
    up : int
        Index of the vertical direction.
    gyration : tuple of three float
        Moments of inertia about axes along x, y and z through the centre, over the mass, m2.

    Raises
    ------
    InputError
        When the mounts do not restrain the body.
    """

    mass: float
    mounts: np.ndarray
    up: int
    gyration: tuple[float, float, float]

    def __post_init__(self) -> None:
        require_restrained(self.mounts, self.up)

    def let_go(
        self, carrier: np.ndarray, sag: str, lower: str, sideways: str, damping_ratio: str, inertia: str = "",
        uneven: str = "",
    ) -> Addition:  # fmt: skip
        """Addition of the elastically mounted body to a model.

        Parameters
        ----------
        carrier : ndarray (6, n_dof)
            Translations and rotations of the carrier at the point.
        sag, lower, sideways, damping_ratio : str
            Names of the parameters: static deflection of the mounts under the weight, distance of the centre below the
            point, lateral over vertical stiffness of the mounts, damping ratio of the vertical motion on a fixed base
            (damping of all mounts is proportional to stiffness).
        inertia, uneven : str
            Names of further parameters, where there are any: the moments of inertia over `gyration`; the stiffness of
            the mounts that lie beyond the point along x, over the mean of all, less 1, lost by those before it.
        """
        n, root = carrier.shape[1], 1 / math.sqrt(GRAVITY)
        shifts, turns = np.asarray(carrier, dtype=float).reshape(2, 3, n) * math.sqrt(self.mass)
        lowered, gyration = cross_matrix(np.eye(3)[self.up]) @ turns, np.diag(self.gyration)
        shift, turn = np.eye(6)[:3], np.eye(6)[3:]

        def term(name: str, matrix: np.ndarray | sp.csr_array, coefficient: Coefficient) -> Term:
            return Term(f"{sag}: {name}", sp.csr_array(matrix), coefficient)

        def on_carrier(one: np.ndarray, other: np.ndarray) -> sp.csr_array:
            block = sp.csr_array(one).T @ sp.csr_array(other)
            return sp.csr_array(sp.block_diag([block, sp.csr_array((6, 6))]))

        def coupling(one: np.ndarray, own: np.ndarray) -> sp.csr_array:
            block = sp.csr_array(sp.csr_array(one).T @ sp.csr_array(own))
            upper = sp.hstack([sp.csr_array((n, n)), block])
            return sp.csr_array(sp.vstack([upper, sp.hstack([block.T, sp.csr_array((6, 6))])]))

        def on_body(block: np.ndarray) -> sp.csr_array:
            return sp.csr_array(sp.block_diag([sp.csr_array((n, n)), sp.csr_array(block)]))

        def grown(power: int, factor: float = 1.0, **powers: float) -> Grown:
            return Grown(Monomial(factor, tuple(powers.items())), sag, GROWN_SAG, power)

        size = {inertia: 1.0} if inertia else {}
        blocks = list(mount_stiffness(self.mounts, self.up, lower, sideways, uneven))
        mixed = on_carrier(shifts, lowered)
        return Addition(
            stiffness=tuple(
                term(f"mounts {name}", on_body(block), _scaled(1.0, powers, sag, grow))
                for name, block, powers, grow in blocks
            ),
            damping=tuple(
                term(
                    f"dampers {name}",
                    on_body(block),
                    _scaled(2 * root, {damping_ratio: 1.0, sag: 0.5, **powers}, sag, grow),
                )
                for name, block, powers, grow in blocks
            ),
            mass=(
                term("lower", mixed + mixed.T, grown(1, **{lower: 1.0})),
                term("lower, squared", on_carrier(lowered, lowered), grown(2, **{lower: 2.0})),
                term("turning", on_carrier(turns, gyration @ turns), grown(2, **size)),
                term("coupling of shifts", coupling(shifts, shift), Monomial(root, ((sag, 0.5),))),
                term("coupling of shifts, lower", coupling(lowered, shift), grown(1, root, **{sag: 0.5, lower: 1.0})),
                term("coupling of turns", coupling(turns, gyration @ turn), grown(2, root, **{sag: 0.5, **size})),
                term("own shifts", on_body(shift.T @ shift), Monomial(1 / GRAVITY, ((sag, 1.0),))),
                term("own turns", on_body(turn.T @ gyration @ turn), grown(2, 1 / GRAVITY, **{sag: 1.0, **size})),
            ),
            n_added=6,
        )


def require_restrained(mounts: np.ndarray, up: int) -> None:
    """InputError where mounts, (n_mounts, 3), do not restrain a body: fewer than three, or on a line from above."""
    level = np.delete(np.asarray(mounts, dtype=float), up, axis=1)
    if len(level) < 3 or np.linalg.matrix_rank(level - level.mean(axis=0), tol=1e-6) < 2:
        raise InputError("its mounts lie on one line", place="body", remedy="give at least three that do not")


def mount_stiffness(mounts: np.ndarray, up: int, lower: str, sideways: str, uneven: str = "") -> Iterator[_Part]:
    """Parts of kappa, the stiffness of equal mounts of a body over the vertical one of all; see `MountedBody`.

    Yields the name, the matrix (6, 6), the powers of the parameters, and that of the distance of the centre below the
    point, with which it grows. ``uneven`` names a parameter by which mounts beyond the point along x are stiffer than
    the mean, and those before it softer; the mean stays.
    """
    upright = np.eye(3)[up]

    # A mount deflects by ``(flat + lower * tilt) (t, theta)``, both (n_mounts, 3, 6).
    flat = np.array([np.hstack([np.eye(3), -cross_matrix(place)]) for place in np.asarray(mounts, dtype=float)])
    tilt = np.broadcast_to(np.hstack([np.zeros((3, 3)), -cross_matrix(upright)]), flat.shape)
    along = np.outer(upright, upright)

    across = np.eye(3) - along

    def product(one: np.ndarray, weight: np.ndarray, other: np.ndarray) -> np.ndarray:
        return np.asarray(np.einsum("fia,ij,fjb->ab", one, weight, other) / len(flat))

    def parts(named: str, own: Mapping[str, float], one: np.ndarray, other: np.ndarray) -> Iterator[_Part]:
        mixed = product(one, across, tilt)
        yield f"upright{named}", product(one, along, flat), own, 0
        yield f"sideways{named}", product(one, across, flat), {sideways: 1.0, **own}, 0
        yield f"sideways, lower{named}", mixed + mixed.T, {sideways: 1.0, lower: 1.0, **own}, 1
        yield f"sideways, lower, squared{named}", product(other, across, tilt), {sideways: 1.0, lower: 2.0, **own}, 2

    yield from parts("", {}, flat, tilt)
    if uneven:
        beyond = _sides(np.asarray(mounts, dtype=float)[:, 0])[:, None, None]
        yield from parts(", uneven", {uneven: 1.0}, beyond * flat, beyond * tilt)


def _sides(along: np.ndarray) -> np.ndarray:
    """Gain of each mount per unevenness, (n_mounts,), from its distance beyond the point: 1 or -1, 0 at the point.

    The mean of all is 0. Where one side has more mounts than the other, those of the side with fewer have 1 or -1, and
    the others less.
    """
    side = np.where(np.abs(along) > _AT_POINT * np.abs(along).max(), np.sign(along), 0.0)
    side = side - side.mean()
    return np.asarray(side / (np.abs(side).max() or 1.0))


def _scaled(factor: float, powers: Mapping[str, float], sag: str, grow: int) -> Coefficient:
    monomial = Monomial(factor, tuple(powers.items()))
    return Grown(monomial, sag, GROWN_SAG, grow) if grow else monomial


def cross_matrix(place: np.ndarray) -> np.ndarray:
    """Matrix of ``place x v``."""
    return np.cross(place, np.eye(3)).T
