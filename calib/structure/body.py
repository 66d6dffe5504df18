"""Rigid bodies of unknown mass beside a point of a model: fixed off that point, or on mounts that give every way.

The base model has no mass there. Each is a richer form of a point mass or of
`calib.structure.effects.attach.hung_masses`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from itertools import combinations_with_replacement

import numpy as np
import scipy.sparse as sp

from calib.structure.affine import Monomial, Term
from calib.structure.effects.extend import Addition
from calib.structure.mounted import cross_matrix, mount_stiffness, require_restrained

Moves = Sequence[tuple[Mapping[str, float], np.ndarray, np.ndarray]]
"""Summands of a body's velocity: powers of parameters, and matrices of the carrier's and of its own motions."""


def fixed_body(carrier: np.ndarray, up: int, mass: str, lower: str, radius: str) -> Addition:
    """A rigid body fixed to a model, its centre off the point.

    With b and w the translations and rotations of the carrier at the point and d the distance of the centre below it,
    the kinetic energy is ``m (b - d w x up)'^2/2 + m r^2 w'^2/2``.

    Parameters
    ----------
    carrier : ndarray (6, n_dof)
        Translations and rotations of the carrier at the point.
    up : int
        Index of the vertical direction.
    mass, lower, radius : str
        Names of the parameters: mass, distance of the centre below the point, radius of gyration r, the same about all
        axes.
    """
    return Addition(mass=tuple(_mass(mass, _body(carrier, up, lower, radius, 0), 0)))


def mounted_mass(
    shifts: np.ndarray, up: int, mass: str, freq: str, sideways: str, damping_ratio: str
) -> Addition:  # fmt: skip
    """A point mass on mounts that give in three directions: three added degrees of freedom.

    With b the translations of the carrier and t those relative to it, times the root of the mass, the kinetic energy is
    ``m b'^2/2 + sqrt(m) b' t' + t'^2/2`` and the strain energy ``(2 pi f)^2 (t_up^2 + s^2 t_side^2)/2``: regular at
    mass 0, where t is decoupled. The damping is proportional to the stiffness.

    Parameters
    ----------
    shifts : ndarray (3, n_dof)
        Translations of the carrier at the point.
    up : int
        Index of the vertical direction.
    mass, freq, sideways : str
        Names of the parameters: mass, natural frequency f of its upright motion on a fixed base, lateral natural
        frequency over that.
    damping_ratio : float
        Of the upright motion on a fixed base.
    """
    upright = np.diag(np.eye(3)[up])
    blocks = [("upright", upright, {}), ("sideways", np.eye(3) - upright, {sideways: 2.0})]
    return _hung(mass, [[({}, np.asarray(shifts, dtype=float), np.eye(3))]], blocks, freq, damping_ratio)


def mounted_body(
    carrier: np.ndarray, up: int, mounts: np.ndarray, mass: str, freq: str, sideways: str, lower: str, radius: str,
    damping_ratio: str,
) -> Addition:  # fmt: skip
    """A rigid body on equal mounts, on which it also rocks: six added degrees of freedom.

    As `mounted_mass`, with the rotations relative to the carrier beside the translations, a centre below the point and
    the stiffness of mounts that `calib.structure.mounted.MountedBody` has.

    Parameters
    ----------
    carrier : ndarray (6, n_dof)
        Translations and rotations of the carrier at the point.
    up : int
        Index of the vertical direction.
    mounts : ndarray (n_mounts, 3)
        Positions of the mounts relative to the point, m; at least three, not on a line.
    mass, freq, sideways, lower, radius, damping_ratio : str
        Names of the parameters, as of `fixed_body` and `mounted_mass`: of one mount the lateral stiffness is the square
        of ``sideways`` times the vertical one. The radius of gyration must not be 0.
    damping_ratio : float
        Of the upright motion on a fixed base.

    Raises
    ------
    InputError
        When the mounts do not restrain the body.
    """
    require_restrained(mounts, up)
    blocks = [
        (name, block, {key: power * (2.0 if key == sideways else 1.0) for key, power in powers.items()})
        for name, block, powers, _ in mount_stiffness(mounts, up, lower, sideways)
    ]
    return _hung(mass, _body(carrier, up, lower, radius, 6), blocks, freq, damping_ratio)


def _body(carrier: np.ndarray, up: int, lower: str, radius: str, added: int) -> list[Moves]:
    """Motions of a body's centre, and its rotations times the radius of gyration.

    ``added`` are its own motions: none, or six, which are those of its centre relative to the carrier.
    """
    shifts, turns = np.asarray(carrier, dtype=float).reshape(2, 3, -1)
    shift, turn = np.eye(6, added)[:3], np.eye(6, added)[3:]
    lowered = cross_matrix(np.eye(3)[up])
    return [
        [({}, shifts, shift), ({lower: 1.0}, lowered @ turns, np.zeros_like(shift))],
        [({radius: 1.0}, turns, turn)],
    ]


def _hung(
    mass: str,
    velocities: Iterable[Moves],
    blocks: Sequence[tuple[str, np.ndarray, Mapping[str, float]]],
    freq: str,
    damping_ratio: str,
) -> Addition:
    """Addition of a body that moves relative to its carrier; ``blocks`` are parts of its stiffness over the upright."""
    velocities = list(velocities)
    n, added = velocities[0][0][1].shape[1], len(blocks[0][1])
    none = np.zeros(0, dtype=int)

    def parts(kind: str, factor: float, own: Mapping[str, float]) -> tuple[Term, ...]:
        return tuple(
            Term(f"{mass}: {kind} {name}", _blocks(n, none, own=block), _monomial(factor, powers, own))
            for name, block, powers in blocks
        )

    return Addition(
        stiffness=parts("mounts", (2 * math.pi) ** 2, {freq: 2.0}),
        damping=parts("dampers", 4 * math.pi, {freq: 1.0, damping_ratio: 1.0}),
        mass=tuple(_mass(mass, velocities, added)),
        n_added=added,
    )


def _mass(mass: str, velocities: Iterable[Moves], added: int) -> Iterable[Term]:
    """Terms of the kinetic energy ``sum |sum p (sqrt(m) C b' + O t')|^2/2`` over the squared sums."""
    for k, moves in enumerate(velocities):
        n = moves[0][1].shape[1]
        at = np.flatnonzero(np.any([np.any(c != 0, axis=0) for _, c, _ in moves], axis=0))
        for one, other in combinations_with_replacement(range(len(moves)), 2):
            (p, c, o), (q, d, t) = moves[one], moves[other]
            c, d, label = c[:, at], d[:, at], f"{mass}: inertia {k}{one}{other}"
            twice = 0.5 if one == other else 1.0  # a product counts with its mirror image
            corner = twice * (c.T @ d + d.T @ c)
            cross, own = twice * (c.T @ t + d.T @ o), twice * (o.T @ t + t.T @ o)
            yield Term(
                f"{label}, carried along", _blocks(n, at, corner, added=added), _monomial(1.0, p, q, {mass: 1.0})
            )
            if cross.any():
                yield Term(f"{label}, coupling", _blocks(n, at, cross=cross), _monomial(1.0, p, q, {mass: 0.5}))
            if own.any():
                yield Term(f"{label}, own", _blocks(n, at, own=own), _monomial(1.0, p, q))


def _monomial(factor: float, *powers: Mapping[str, float]) -> Monomial:
    total: dict[str, float] = {}
    for one in powers:
        for name, power in one.items():
            total[name] = total.get(name, 0.0) + power
    return Monomial(factor, tuple(total.items()))


def _blocks(
    n: int, at: np.ndarray, corner: np.ndarray | None = None, cross: np.ndarray | None = None,
    own: np.ndarray | None = None, added: int = 0,
) -> sp.csr_array:  # fmt: skip
    """Matrix over the model's degrees of freedom and those of the body, of which one block is not 0.

    Rows of the first two blocks are those of the model's degrees of freedom ``at``, in ascending order.
    """
    m = added if own is None else len(own)
    m = m if cross is None else cross.shape[1]
    filled = np.zeros((len(at) + m, len(at) + m))
    if corner is not None:
        filled[: len(at), : len(at)] = corner
    if own is not None:
        filled[len(at) :, len(at) :] = own
    if cross is not None:
        filled[: len(at), len(at) :], filled[len(at) :, : len(at)] = cross, cross.T
    few, places = sp.coo_array(filled), np.concatenate([at, n + np.arange(m)])
    return sp.csr_array((few.data, (places[few.row], places[few.col])), shape=(n + m, n + m))
