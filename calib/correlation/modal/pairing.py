"""Pairing of measured and model modes, by shape or by order."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calib.correlation.modal.order import Costs, align_in_order
from calib.correlation.rules import RULES
from calib.errors.errors import InputError
from calib.measurement.mac import best_pairs


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
        EMAC of the pair minus the best EMAC of that measured mode with any other model mode; a small or negative one
        marks an uncertain pair. NaN for an unpaired mode or without shapes.
    lost : tuple of int
        Indices of measured modes without shapes whose tracked model mode lost its successor.
    """

    model_index: np.ndarray
    mac: np.ndarray
    emac: np.ndarray
    margin: np.ndarray
    lost: tuple[int, ...] = ()

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
    log_ratio: np.ndarray | None = None,
) -> Pairing:
    """Pair modes one to one so that the sum of their EMAC, weighted by frequency, is largest.

    Pairs below the threshold, and model modes without strain energy (EMAC 0), are excluded first, so that they cannot
    take a partner from another mode. With few sensors a mode may resemble one of a much higher frequency (spatial
    aliasing): `frequency_weight` excludes such a pair or favours a nearer one.

    Parameters
    ----------
    mac, emac : ndarray (n_measured, n_model)
    names : sequence of str
        Names of the measured modes.
    threshold : float
        Smallest EMAC of a pair.
    candidates : ndarray (n_model,), bool, optional
        Model modes available for pairing, apart from the user's choice; default all.
    override : mapping from str to int, optional
        The user's choice: measured mode to model mode, counted from 1. Set first, whatever its EMAC.
    log_ratio : ndarray (n_measured, n_model), optional
        ln(model/measured) of the natural frequencies; default: frequencies are ignored.

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
    # An excluded pair has weight 0, so dropping such pairs from the best full assignment gives the best partial one.
    best = best_pairs(np.where(allowed, block, 0.0))
    if log_ratio is not None:
        ratio = log_ratio[np.ix_(rows, columns)]
        weight = frequency_weight(ratio, ratio[best][allowed[best]])
        allowed &= weight > 0
        best = best_pairs(np.where(allowed, block * weight, 0.0))
    kept = allowed[best]
    index[rows[best[0][kept]]] = columns[best[1][kept]]
    pair_mac, pair_emac, margin = (np.full(n_measured, np.nan) for _ in range(3))
    for i in np.flatnonzero(index >= 0).tolist():
        competing = offered.copy()
        competing[index[i]] = False
        pair_mac[i], pair_emac[i] = mac[i, index[i]], emac[i, index[i]]
        margin[i] = pair_emac[i] - np.max(emac[i, competing], initial=0.0)
    return Pairing(index, pair_mac, pair_emac, margin)


def pair_by_order(
    freq_measured: np.ndarray,
    freq_model: np.ndarray,
    names: Sequence[str],
    *,
    window: tuple[float, float] | None = None,
    override: Mapping[str, int] | None = None,
    followed: Mapping[int, int] | None = None,
    costs: Costs | None = None,
) -> tuple[Pairing, Costs]:
    """Pair modes by ascending frequency, for a measurement without shapes.

    Gaps on both sides are allowed, see `calib.correlation.modal.order.align_in_order`; only frequencies identify the
    modes. MAC, EMAC and margin are NaN.

    Parameters
    ----------
    freq_measured, freq_model : ndarray (n_measured,), (n_model,)
        Natural frequencies in Hz.
    names : sequence of str
        Names of the measured modes.
    window : (low, high), optional
        Model modes outside, in Hz, are not candidates.
    override : mapping from str to int, optional
        The user's choice, as in `pair_by_shape`; the others follow in order.
    followed : mapping from int to int, optional
        Measured to model modes, both from 0 (-1 for none), known by mode tracking; the user's choice has precedence.
    costs : Costs, optional
        As in `align_in_order`.
    """
    forced = _forced(override, names, len(freq_model))
    taken = set(forced.values())
    forced = {**{i: -1 if j in taken else j for i, j in (followed or {}).items()}, **forced}
    index = np.full(len(freq_measured), -1)
    for i, j in forced.items():
        index[i] = j
    inside = in_window(freq_model, window)
    rows = np.array([i for i in range(len(freq_measured)) if i not in forced], dtype=int)
    columns = np.array([j for j in range(len(freq_model)) if inside[j] and j not in forced.values()], dtype=int)
    found = align_in_order(np.asarray(freq_measured)[rows], np.asarray(freq_model)[columns], costs)
    paired = found.partners >= 0
    index[rows[paired]] = columns[found.partners[paired]]
    return by_order(index), found.costs


def by_order(index: np.ndarray) -> Pairing:
    """A pairing without shapes: ``index`` (n_measured,) of the model modes, -1 for none."""
    nothing = np.full(len(index), np.nan)
    return Pairing(index, nothing, nothing.copy(), nothing.copy())


def frequency_weight(log_ratio: np.ndarray, of_pairs: np.ndarray) -> np.ndarray:
    """Weight of a pair by its frequencies: 1 up to a factor near 1, then falling with its logarithm to 0.

    The factors are `RULES.pair_near` and `RULES.pair_far`.

    Parameters
    ----------
    log_ratio : ndarray
        ln(model/measured).
    of_pairs : ndarray (n_pairs,)
        Those of the pairs found by shape alone. Where more than half of at least three agree within `RULES.pair_agree`
        on a factor that is not near 1, units differ or the whole model is far off, and ratios are taken relative to
        that factor.
    """
    common = float(np.median(of_pairs)) if len(of_pairs) >= 3 else 0.0
    agreeing = np.sum(np.abs(of_pairs - common) <= math.log(RULES.pair_agree))
    if abs(common) <= math.log(RULES.pair_near) or 2 * agreeing <= len(of_pairs):
        common = 0.0
    off, far = np.abs(log_ratio - common), RULES.pair_far
    return np.clip((math.log(far) - off) / math.log(far / RULES.pair_near), 0.0, 1.0)


def in_window(freq: np.ndarray, window: tuple[float, float] | None) -> np.ndarray:
    """Which frequencies lie inside a window (both ends included), shape of ``freq``, bool; all without a window."""
    freq = np.asarray(freq, dtype=float)
    return np.ones(freq.shape, dtype=bool) if window is None else (freq >= window[0]) & (freq <= window[1])


def check_clusters(
    mode_clusters: Mapping[str, Sequence[str]], measured: Sequence[str], known: Collection[str], name: str
) -> None:
    """InputError for clusters of a mode that was not measured, or that are none of a model of that name."""
    listed = ", ".join(known) or "none"
    for mode, clusters in mode_clusters.items():
        if mode not in measured:
            raise InputError(
                f"clusters are given for mode {mode!r}, which was not measured",
                place="pairing",
                remedy=f"the measured modes are {', '.join(measured) or 'none'}",
            )
        if not clusters:
            raise InputError(f"no cluster is named for mode {mode!r}", place="pairing", remedy="leave the mode out")
        for cluster in clusters:
            if cluster not in known:
                raise InputError(
                    f"mode {mode!r} names cluster {cluster!r}, which the model {name} lacks",
                    place="pairing",
                    remedy=f"its clusters are {listed}",
                )


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
