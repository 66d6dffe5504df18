"""Which model mode belongs to which measured mode."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import linear_sum_assignment

from calib.errors import InputError


@dataclass(frozen=True, eq=False)
class Pairing:
    """One model mode, or none, for every measured mode.

    Attributes
    ----------
    model_index : ndarray (n_measured,), int
        Index of the paired model mode, -1 for none; no model mode occurs twice.
    mac, emac : ndarray (n_measured,)
        Of the pair; NaN for an unpaired mode or without shapes.
    margin : ndarray (n_measured,)
        EMAC of the pair minus the best EMAC of that measured mode with any other model mode; small or negative marks a
        pairing in doubt. NaN for an unpaired mode or without shapes.
    """

    model_index: np.ndarray
    mac: np.ndarray
    emac: np.ndarray
    margin: np.ndarray

    @property
    def paired(self) -> np.ndarray:
        """Indices of the measured modes that have a model mode."""
        return np.flatnonzero(self.model_index >= 0)

    @property
    def unpaired_measured(self) -> np.ndarray:
        """Indices of the measured modes without a model mode."""
        return np.flatnonzero(self.model_index < 0)


def pair_by_shape(
    mac: np.ndarray,
    emac: np.ndarray,
    names: Sequence[str],
    *,
    threshold: float = 0.3,
    candidates: np.ndarray | None = None,
    override: Mapping[str, int] | None = None,
) -> Pairing:
    """Pair modes one to one so that the sum of their EMAC is largest.

    Pairs below the threshold, and model modes without strain energy (EMAC 0), are forbidden beforehand and so cannot
    take a partner away from another mode.

    Parameters
    ----------
    mac, emac : ndarray (n_measured, n_model)
    names : sequence of str
        Names of the measured modes.
    threshold : float
        Smallest EMAC of a pair.
    candidates : ndarray (n_model,), bool, optional
        Which model modes may be paired, other than by the user's choice; default all.
    override : mapping from str to int, optional
        The user's choice: measured mode to model mode, counted from 1. Set first, whatever its EMAC.

    Raises
    ------
    InputError
        When a choice names a mode that does not exist or one model mode twice.
    """
    n_measured, n_model = emac.shape
    forced = _forced(override, names, n_model)
    offered = np.ones(n_model, dtype=bool) if candidates is None else np.asarray(candidates, dtype=bool)
    index = np.full(n_measured, -1)
    for i, j in forced.items():
        index[i] = j
    rows = np.array([i for i in range(n_measured) if i not in forced], dtype=int)
    columns = np.array([j for j in np.flatnonzero(offered) if j not in forced.values()], dtype=int)
    block = emac[np.ix_(rows, columns)]
    allowed = (block >= threshold) & (block > 0)
    # A forbidden pair is worth nothing, so the best full assignment is the best partial one with such pairs dropped.
    best = linear_sum_assignment(np.where(allowed, block, 0.0), maximize=True)
    kept = allowed[best]
    index[rows[best[0][kept]]] = columns[best[1][kept]]
    pair_mac, pair_emac, margin = (np.full(n_measured, np.nan) for _ in range(3))
    for i in np.flatnonzero(index >= 0).tolist():
        rivals = offered.copy()
        rivals[index[i]] = False
        pair_mac[i], pair_emac[i] = mac[i, index[i]], emac[i, index[i]]
        margin[i] = pair_emac[i] - np.max(emac[i, rivals], initial=0.0)
    return Pairing(index, pair_mac, pair_emac, margin)


def pair_by_order(
    freq_measured: np.ndarray,
    freq_model: np.ndarray,
    names: Sequence[str],
    *,
    window: tuple[float, float] | None = None,
    override: Mapping[str, int] | None = None,
) -> Pairing:
    """Pair modes by ascending frequency, for a measurement without shapes.

    Nothing can tell whether the k-th measured mode is the k-th of the model: a mode missed by the measurement shifts
    all that follow. MAC, EMAC and margin are NaN.

    Parameters
    ----------
    freq_measured, freq_model : ndarray (n_measured,), (n_model,)
        Natural frequencies in Hz.
    names : sequence of str
        Names of the measured modes.
    window : (low, high), optional
        Model modes outside, in Hz, are no candidates.
    override : mapping from str to int, optional
        The user's choice, as in `pair_by_shape`; the others follow in order.
    """
    forced = _forced(override, names, len(freq_model))
    index = np.full(len(freq_measured), -1)
    for i, j in forced.items():
        index[i] = j
    inside = in_window(freq_model, window)
    rows = [i for i in np.argsort(freq_measured, kind="stable").tolist() if i not in forced]
    columns = [j for j in np.argsort(freq_model, kind="stable").tolist() if inside[j] and j not in forced.values()]
    for i, j in zip(rows, columns, strict=False):
        index[i] = j
    nothing = np.full(len(index), np.nan)
    return Pairing(index, nothing, nothing.copy(), nothing.copy())


def in_window(freq: np.ndarray, window: tuple[float, float] | None) -> np.ndarray:
    """Which frequencies lie inside a window (both ends included), shape of ``freq``, bool; all without a window."""
    freq = np.asarray(freq, dtype=float)
    return np.ones(freq.shape, dtype=bool) if window is None else (freq >= window[0]) & (freq <= window[1])


def check_override(override: Mapping[str, int], names: Sequence[str], n_model: int) -> None:
    """Raise InputError for a choice of an unknown measured mode, a model mode outside 1..n_model, or one used twice."""
    _forced(override, names, n_model)


def _forced(override: Mapping[str, int] | None, names: Sequence[str], n_model: int) -> dict[int, int]:
    """The user's choices as measured index to model index, both from 0."""
    out: dict[int, int] = {}
    order = list(names)
    for name, number in (override or {}).items():
        if name not in order:
            raise InputError(
                f"measured mode {name!r} does not exist",
                place="pairing",
                remedy=f"the measured modes are {', '.join(order) or 'none'}",
            )
        if number != int(number) or not 1 <= number <= n_model:
            raise InputError(
                f"measured mode {name!r} is paired with model mode {number}",
                place="pairing",
                remedy=f"choose a model mode from 1 to {n_model}",
            )
        if int(number) - 1 in out.values():
            raise InputError(f"model mode {number} is chosen for two measured modes", place="pairing")
        out[order.index(name)] = int(number) - 1
    return out
