"""Energy-weighted MAC."""

from __future__ import annotations

import numpy as np


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
