"""Stabilisation of poles over model orders: which of them count as modes, by a stated rule."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pandas as pd

from calib.measurement.frf import MeasuredFRFs
from calib.measurement.mac import mac
from calib.modal_analysis.model import fit_residues
from calib.modal_analysis.poles import poles_by_order
from calib.modal_analysis.rules import RULES


@dataclass(frozen=True, eq=False)
class Chain:
    """A pole followed over ascending orders.

    Attributes
    ----------
    orders : tuple of int
        Where it was found, ascending.
    poles : ndarray (n_orders,), complex
        rad/s.
    residues : ndarray (n_orders, n_functions), complex
        Of receptances, in the order of `MeasuredFRFs.functions`.
    """

    orders: tuple[int, ...]
    poles: np.ndarray
    residues: np.ndarray

    @property
    def natural_freq(self) -> np.ndarray:
        """Hz, (n_orders,)."""
        return np.asarray(np.abs(self.poles) / (2 * np.pi))

    @property
    def damping_ratio(self) -> np.ndarray:
        """(n_orders,)."""
        return np.asarray(-self.poles.real / np.abs(self.poles))

    @property
    def pole(self) -> complex:
        """Of the median natural frequency and damping ratio, rad/s."""
        size, ratio = 2 * np.pi * float(np.median(self.natural_freq)), float(np.median(self.damping_ratio))
        return complex(-ratio * size, size * np.sqrt(1 - ratio**2))

    @property
    def spread(self) -> tuple[float, float]:
        """Standard deviations over the orders of natural frequency (Hz) and damping ratio."""
        return float(np.std(self.natural_freq, ddof=1)), float(np.std(self.damping_ratio, ddof=1))


def pole_chains(frfs: MeasuredFRFs, poles: Sequence[np.ndarray]) -> tuple[Chain, ...]:
    """Chains of poles that stay within the limits of this module from one order to the next, of any length.

    Residues are fitted anew at every order. A pole continues the chain of largest MAC among those within the limits;
    each chain gains at most one pole an order.

    Parameters
    ----------
    frfs : MeasuredFRFs
    poles : sequence of ndarray (n_poles,), complex
        rad/s, by order from 1; see `calib.modal_analysis.poles.poles_by_order`.
    """
    chains: list[Chain] = []
    finest = RULES.damping_lines * 2 * np.pi * float(np.min(np.diff(frfs.freq)))
    for order, found in enumerate(poles, start=1):
        own = found[-found.real < RULES.overdamped * np.abs(found)]
        if not len(own):
            continue
        residues = fit_residues(frfs, own).residues
        flat = np.array([residues[:, one.i, one.j] for one in frfs.functions])
        open_ones = [k for k, chain in enumerate(chains) if chain.orders[-1] >= order - 1 - RULES.skipped]
        score = _scores(own, flat, [chains[k] for k in open_ones], finest)
        while score.size and (best := np.unravel_index(np.argmax(score), score.shape)) and score[best] > 0:
            i, c = int(best[0]), open_ones[int(best[1])]
            chain = chains[c]
            chains[c] = Chain(
                (*chain.orders, order), np.append(chain.poles, own[i]), np.vstack([chain.residues, flat[:, i]])
            )
            score[best[0]], score[:, best[1]] = 0.0, 0.0
            own[i] = np.nan
        chains += [Chain((order,), own[[i]], flat[:, [i]].T) for i in np.flatnonzero(np.isfinite(own)).tolist()]
    return tuple(chains)


def _scores(poles: np.ndarray, residues: np.ndarray, chains: Sequence[Chain], finest: float) -> np.ndarray:
    """MAC of poles with the last members of chains, (n_poles, n_chains); 0 beyond the limits.

    Real parts that differ by less than ``finest``, rad/s, count as equal: lines do not tell them apart.
    """
    if not chains:
        return np.zeros((len(poles), 0))
    last = np.array([chain.poles[-1] for chain in chains])
    agreement = mac(residues, np.stack([chain.residues[-1] for chain in chains], axis=1))
    ratio = [-p.real / np.abs(p) for p in (poles, last)]
    near = np.abs(np.abs(poles)[:, None] / np.abs(last) - 1) <= RULES.freq_change
    near &= (np.abs(ratio[0][:, None] / ratio[1] - 1) <= RULES.damping_change) | (
        np.abs(poles.real[:, None] - last.real) <= finest
    )
    return np.where(near & (agreement >= RULES.stable_mac), agreement, 0.0)


def orders_needed(n_orders: int) -> float:
    """At how many of all orders a chain counts as a mode."""
    return max(RULES.orders_least, RULES.orders_share * n_orders)


def stable(chains: Sequence[Chain], n_orders: int) -> tuple[Chain, ...]:
    """Chains that count as modes, in ascending frequency.

    A chain counts when it is stable at `RULES.orders_least` orders and at a share `RULES.orders_share` of all. Of two
    within a half-power width of each other with residues of a MAC of `RULES.stable_mac` the longer one counts: the
    other is the same mode again.
    """
    least = orders_needed(n_orders)
    long = sorted((c for c in chains if len(c.orders) >= least), key=lambda c: -len(c.orders))
    kept: list[Chain] = []
    for one in long:
        if not any(_same(one, other) for other in kept):
            kept.append(one)
    return tuple(sorted(kept, key=lambda c: abs(c.pole)))


def stable_in_parts(frfs: MeasuredFRFs, counted: Sequence[Chain]) -> tuple[Chain, ...]:
    """Further chains that count as modes in a part of the band: weak ones, for which all orders of the band are few.

    The band is cut into `RULES.band_parts` parts, or fewer where a part would have too few lines for the highest order,
    and as many between them that overlap by half. A part answers for its middle half, and at an end of the band up to
    it: poles at its other ends stand for modes beyond. One within half of a half-power width of another is that one
    again, or of a mode that moves between functions.

    Parameters
    ----------
    frfs : MeasuredFRFs
        Without a line at 0 Hz.
    counted : sequence of Chain
        Those of the whole band, which are not returned again.
    """
    n = len(frfs.freq)
    parts = min(RULES.band_parts, n // (RULES.frf_order_most * RULES.lines_per_order))
    if parts < 2:
        return ()
    ends = np.linspace(0, n - 1, 2 * parts + 1).round().astype(int)
    found: list[Chain] = []
    for k in range(2 * parts - 1):
        first, last = (float(frfs.freq[own]) for own in ends[[k, k + 2]])
        margin = (last - first) / 4
        low = first + margin * (k > 0)
        high = last - margin * (k < 2 * parts - 2)
        part = frfs.in_band(first, last)
        poles = poles_by_order(part)
        found += [one for one in stable(pole_chains(part, poles), len(poles)) if low <= _freq(one) <= high]
    further: list[Chain] = []
    for one in sorted(found, key=lambda c: -len(c.orders)):
        if not any(_same(one, other) or _beside(one, other) for other in (*counted, *further)):
            further.append(one)
    return tuple(further)


def with_accepted(chains: Sequence[Chain], counted: Sequence[Chain], accept: Sequence[float]) -> tuple[Chain, ...]:
    """Chains that count, and the longest one near each accepted frequency, Hz, where none of these lies.

    Near is within a half-power width, or `RULES.accepted_reach`.
    """
    kept = list(counted)
    for wanted in accept:
        near = [c for c in chains if len(c.orders) > 1 and abs(_freq(c) - wanted) <= reach_of(c.pole)]
        if near and not any(abs(_freq(c) - wanted) <= reach_of(c.pole) for c in kept):
            kept.append(max(near, key=lambda c: len(c.orders)))
    return tuple(sorted(kept, key=lambda c: abs(c.pole)))


def reach_of(pole: complex) -> float:
    """How far from a pole, rad/s, an accepted frequency may be, Hz."""
    size = abs(pole) / (2 * np.pi)
    return float(max(-pole.real / np.pi, RULES.accepted_reach * size))


def _freq(chain: Chain) -> float:
    return float(abs(chain.pole) / (2 * np.pi))


def _same(one: Chain, other: Chain) -> bool:
    close = abs(abs(one.pole) - abs(other.pole)) <= 2 * max(-one.pole.real, -other.pole.real)
    return close and bool(mac(one.residues[-1][:, None], other.residues[-1][:, None])[0, 0] >= RULES.stable_mac)


def _beside(one: Chain, other: Chain) -> bool:
    """Whether two poles are closer than half of a half-power width, of the narrower."""
    return bool(abs(abs(one.pole) - abs(other.pole)) <= min(-one.pole.real, -other.pole.real))


def pole_table(chains: Sequence[Chain], modes: Sequence[Chain], window_rate: float = 0.0) -> pd.DataFrame:
    """Every pole with its order, for the stabilisation diagram, without the damping of a window of this rate, rad/s.

    Returns
    -------
    DataFrame
        Columns ``order, freq`` (Hz), ``damping`` (ratio), ``stable`` (bool: within the limits from the order before or
        to the next) and ``mode`` (number from 1 of the chain that counts as a mode, else 0).
    """
    rows = []
    for chain in chains:
        mode = next((k for k, one in enumerate(modes, start=1) if one is chain), 0)
        own = chain.poles + window_rate
        size = np.abs(own)
        rows += [
            {"order": order, "freq": f, "damping": d, "stable": len(chain.orders) > 1, "mode": mode}
            for order, f, d in zip(chain.orders, size / (2 * np.pi), -own.real / size, strict=True)
        ]
    columns = ["order", "freq", "damping", "stable", "mode"]
    return pd.DataFrame(rows, columns=columns).sort_values(["order", "freq"], ignore_index=True)
