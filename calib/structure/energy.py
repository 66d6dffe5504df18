"""Strain energy of modes and its shares in clusters of degrees of freedom."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import scipy.sparse as sp

from calib.errors.errors import InputError

_ZERO_ENERGY = 1e-13
"""Strain energy below this part of the sum of its contributions' sizes is rounding error and counts as 0."""


def strain_energy(stiffness: sp.csc_array | np.ndarray, shapes: np.ndarray) -> np.ndarray:
    """Strain energy ``phi^H K phi / 2`` of each mode in the scale of its shape, (n_modes,).

    Exactly 0 for a rigid-body motion or mechanism; rounding error is removed.

    Parameters
    ----------
    stiffness : array (n_dof, n_dof)
        Symmetric, sparse or dense; SI.
    shapes : ndarray (n_dof, n_modes)
        Real or complex.
    """
    return _without_rounding(stiffness, shapes, np.real(np.conj(shapes) * (stiffness @ shapes)).sum(axis=0))


def strain_energy_shares(
    stiffness: sp.csc_array, shapes: np.ndarray, clusters: Mapping[str, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Share of each mode's strain energy in each cluster of degrees of freedom.

    ``Pi_k = Re(phi_k^H sum_l K_kl phi_l) / (phi^H K phi)``, phi_k being the part of the shape in cluster k and the sum
    over all degrees of freedom. For real shapes this is eq. 12 of Brehm, Zabel and Bucher 2010; the form for complex
    shapes is an assumption of this project. The shares do not depend on scale and phase and add up to 1 over a
    partition; a single share may be negative or exceed 1.

    Parameters
    ----------
    stiffness : csc_array (n_dof, n_dof)
        Symmetric; SI.
    shapes : ndarray (n_dof, n_modes)
        Real or complex.
    clusters : mapping from str to ndarray of int
        Indices of the degrees of freedom of each cluster.

    Returns
    -------
    shares : ndarray (n_clusters, n_modes)
        In the order of ``clusters``; 0 for a mode without strain energy (rigid body or mechanism).
    total : ndarray (n_modes,)
        Strain energy ``phi^H K phi / 2`` in the scale of the shapes, 0 for such a mode.

    Raises
    ------
    InputError
        When a cluster names a degree of freedom that does not exist.
    """
    n = shapes.shape[0]
    for name, members in clusters.items():
        if len(members) and not (np.min(members) >= 0 and np.max(members) < n):
            raise InputError(f"cluster {name!r} names a degree of freedom outside 0..{n - 1}", place="clusters")
    local = np.real(np.conj(shapes) * (stiffness @ shapes))
    parts = [local[np.unique(np.asarray(members, dtype=int))].sum(axis=0) for members in clusters.values()]
    total = _without_rounding(stiffness, shapes, local.sum(axis=0))
    return shares_of(np.reshape(parts, (len(clusters), shapes.shape[1])), total), total


def shares_of(parts: np.ndarray, total: np.ndarray) -> np.ndarray:
    """Shares (n_clusters, n_modes) from ``Re(phi_k^H (K phi)_k)`` and `strain_energy`; 0 without strain energy."""
    return np.divide(parts, 2 * total, out=np.zeros(parts.shape), where=total > 0)


def _without_rounding(stiffness: sp.csc_array | np.ndarray, shapes: np.ndarray, doubled: np.ndarray) -> np.ndarray:
    """Half of ``phi^H K phi``, 0 where it is rounding error."""
    sizes = np.abs(shapes)
    contributions = np.sum(sizes * (abs(stiffness) @ sizes), axis=0)
    return np.where(doubled > _ZERO_ENERGY * contributions, 0.5 * doubled, 0.0)
