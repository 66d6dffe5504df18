"""Where a mode keeps its strain energy, and the MAC weighted with it."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import scipy.sparse as sp

from calib.errors import InputError

_ZERO_ENERGY = 1e-13
"""Strain energy below this part of the sum of its contributions' sizes is rounding: the mode strains nothing."""


def strain_energy_shares(
    stiffness: sp.csc_array, shapes: np.ndarray, clusters: Mapping[str, np.ndarray]
) -> tuple[np.ndarray, np.ndarray]:
    """Share of each mode's strain energy in each cluster of degrees of freedom.

    ``Pi_k = Re(phi_k^H sum_l K_kl phi_l) / (phi^H K phi)``, phi_k being the part of the shape in cluster k and the sum
    over all degrees of freedom. For real shapes this is eq. 12 of Brehm, Zabel and Bucher 2010; the form for complex
    shapes is an assumption of this project, since a published one was not available. It does not depend on scale and
    phase, and the shares of a partition add up to 1; a single one may be negative or exceed 1.

    Parameters
    ----------
    stiffness : csc_array (n_dof, n_dof)
        Symmetric; N/m and alike.
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
    total = local.sum(axis=0)
    sizes = np.abs(shapes)
    contributions = np.sum(sizes * (abs(stiffness) @ sizes), axis=0)
    strained = total > _ZERO_ENERGY * contributions
    shares = np.zeros((len(clusters), shapes.shape[1]))
    for i, members in enumerate(clusters.values()):
        part = local[np.unique(np.asarray(members, dtype=int))].sum(axis=0)
        shares[i] = np.divide(part, total, out=np.zeros_like(part), where=strained)
    return shares, np.where(strained, 0.5 * total, 0.0)


def emac(mac: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Energy-weighted MAC: the MAC times the share of strain energy in the clusters that carry the sensors.

    "EMAC" also names another quantity, the Extended Modal Amplitude Coherence of the eigensystem realisation algorithm;
    the two have nothing in common. This one follows Brehm, Zabel and Bucher 2010.

    Parameters
    ----------
    mac : ndarray (n_measured, n_model)
    share : ndarray (n_measured, n_model) or (n_model,)
        Share of each model mode in the clusters of each measured mode, summed over them; clipped to [0, 1].

    Returns
    -------
    ndarray (n_measured, n_model)
    """
    return mac * np.clip(share, 0.0, 1.0)
