"""A rigid body on mounts of its own in the place of a point mass."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from calib.errors import InputError
from calib.structure.affine import Coefficient, Grown, Monomial, Term
from calib.structure.attach import GRAVITY
from calib.structure.extend import Addition

GROWN_SAG = 1e-4
"""Sag in m, 50 Hz upright, at which a mounted body has half of its lowering and a quarter of its moments of inertia."""


@dataclass(frozen=True)
class MountedBody:
    """A rigid body that a model carries as a point mass, let go on mounts of its own: six degrees of freedom.

    With b and w the shifts and turns of what carries it at the point, m the mass, G the moments of inertia over m, and
    ``s = sag/gravity``, the body moves against its carrier by t and theta, ``(t, theta) = sqrt(s/m) g``. Each of n
    mounts is as stiff as ``m/(n s)`` upright, so that the weight presses it down by the sag, and has a share rho of
    that sideways. At r from the centre it gives by ``t + theta x r``: with ``A = [I, -cross(r)]`` and ``kappa = sum
    A^T diag(rho, 1, rho) A/n`` the strain energy is ``g^T kappa g/2``, the damping matrix ``2 zeta sqrt(s) kappa``.
    The centre is lower than the point by d, ``b_d = b - d w x up``, and the kinetic energy is ``m (b_d' + t')^2/2 + m
    (w' + theta')^T G (w' + theta')/2``, of which the model has ``m b'^2/2``.

    At sag 0 g is 0, and the model must be what it is: there the body is the point mass, and it grows to its own size
    and place with the sag, d as ``a = sag^2/(sag^2 + GROWN_SAG^2)``, G as ``a^2``. It is a body that can be at every
    sag, so that the mass is nowhere negative; with mounts that let it vibrate in any test it has all but its own size.

    Attributes
    ----------
    mass : float
        kg.
    mounts : ndarray (n_mounts, 3)
        Places of the mounts from the point, m; at least three, not on a line.
    up : int
        Which of the three directions is upright.
    gyration : tuple of three float
        Moments of inertia about axes along x, y and z through the centre, over the mass, m2.

    Raises
    ------
    InputError
        When the mounts do not hold a body.
    """

    mass: float
    mounts: np.ndarray
    up: int
    gyration: tuple[float, float, float]

    def __post_init__(self) -> None:
        level = np.delete(np.asarray(self.mounts, dtype=float), self.up, axis=1)
        if len(level) < 3 or np.linalg.matrix_rank(level - level.mean(axis=0), tol=1e-6) < 2:
            raise InputError("its mounts lie on one line", place="body", remedy="give at least three that do not")

    def let_go(self, carrier: np.ndarray, sag: str, lower: str, sideways: str, damping_ratio: str) -> Addition:
        """What the body adds to a model once its mounts give.

        Parameters
        ----------
        carrier : ndarray (6, n_dof)
            Shifts and turns of what carries it, at the point.
        sag, lower, sideways, damping_ratio : str
            Names of the parameters: by how much the weight presses the mounts down, by how much the centre is lower
            than the point, stiffness of the mounts sideways over that upright, damping ratio of the upright motion on
            a fixed base (all mounts dissipate in proportion to their stiffness).
        """
        n, root = carrier.shape[1], 1 / math.sqrt(GRAVITY)
        shifts, turns = np.asarray(carrier, dtype=float).reshape(2, 3, n) * math.sqrt(self.mass)
        lowered, turning = _cross(np.eye(3)[self.up]) @ turns, np.diag(self.gyration)
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

        mixed = on_carrier(shifts, lowered)
        return Addition(
            stiffness=tuple(
                term(f"mounts {name}", on_body(block), _scaled(1.0, powers, sag, grow))
                for name, block, powers, grow in self._gaps(lower, sideways)
            ),
            damping=tuple(
                term(
                    f"dampers {name}",
                    on_body(block),
                    _scaled(2 * root, {damping_ratio: 1.0, sag: 0.5, **powers}, sag, grow),
                )
                for name, block, powers, grow in self._gaps(lower, sideways)
            ),
            mass=(
                term("lower", mixed + mixed.T, grown(1, **{lower: 1.0})),
                term("lower, squared", on_carrier(lowered, lowered), grown(2, **{lower: 2.0})),
                term("turning", on_carrier(turns, turning @ turns), grown(2)),
                term("coupling of shifts", coupling(shifts, shift), Monomial(root, ((sag, 0.5),))),
                term("coupling of shifts, lower", coupling(lowered, shift), grown(1, root, **{sag: 0.5, lower: 1.0})),
                term("coupling of turns", coupling(turns, turning @ turn), grown(2, root, **{sag: 0.5})),
                term("own shifts", on_body(shift.T @ shift), Monomial(1 / GRAVITY, ((sag, 1.0),))),
                term("own turns", on_body(turn.T @ turning @ turn), grown(2, 1 / GRAVITY, **{sag: 1.0})),
            ),
            n_added=6,
        )

    def _gaps(self, lower: str, sideways: str) -> Iterator[tuple[str, np.ndarray, Mapping[str, float], int]]:
        """Parts of kappa: name, matrix (6, 6), powers of parameters, power with which it grows."""
        upright = np.eye(3)[self.up]
        # A mount gives by ``(flat + lower * tilt) (t, theta)``, both (n_mounts, 3, 6).
        flat = np.array([np.hstack([np.eye(3), -_cross(place)]) for place in np.asarray(self.mounts, dtype=float)])
        tilt = np.broadcast_to(np.hstack([np.zeros((3, 3)), -_cross(upright)]), flat.shape)
        along = np.outer(upright, upright)

        def product(one: np.ndarray, weight: np.ndarray, other: np.ndarray) -> np.ndarray:
            return np.asarray(np.einsum("fia,ij,fjb->ab", one, weight, other) / len(flat))

        across = np.eye(3) - along
        mixed = product(flat, across, tilt)
        yield "upright", product(flat, along, flat), {}, 0
        yield "sideways", product(flat, across, flat), {sideways: 1.0}, 0
        yield "sideways, lower", mixed + mixed.T, {sideways: 1.0, lower: 1.0}, 1
        yield "sideways, lower, squared", product(tilt, across, tilt), {sideways: 1.0, lower: 2.0}, 2


def _scaled(factor: float, powers: Mapping[str, float], sag: str, grow: int) -> Coefficient:
    monomial = Monomial(factor, tuple(powers.items()))
    return Grown(monomial, sag, GROWN_SAG, grow) if grow else monomial


def _cross(place: np.ndarray) -> np.ndarray:
    """Matrix of ``place x v``."""
    return np.cross(place, np.eye(3)).T
