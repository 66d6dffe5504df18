"""Resonances in measured FRFs, and the lines around them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from calib.measurement.rules import RULES

HALF_POWER = 10 * np.log10(2)
"""dB."""


class Resonance(NamedTuple):
    """A peak of the sum of squared moduli over all functions.

    Attributes
    ----------
    freq : float
        Line of the peak, Hz.
    width : float
        Half-power width, Hz, between lines interpolated in dB; at least the distance of two lines, which cannot show
        a sharper peak.
    """

    freq: float
    width: float


def resonances(
    freq: np.ndarray, power: np.ndarray, prominence: float = RULES.prominence, noise: np.ndarray | float = 0.0,
    mean_of: int = 1,
) -> tuple[Resonance, ...]:  # fmt: skip
    """Peaks with their half-power widths, in ascending order.

    Parameters
    ----------
    freq : ndarray (n_freq,)
        Hz, ascending.
    power : ndarray (n_freq,)
        Sum of squared moduli over all functions.
    prominence : float
        See `RULES.prominence`; at least 3 dB, below which a peak has no half-power width.
    noise : ndarray (n_freq,) or float
        Mean power of the noise; see `RULES.above_noise`.
    mean_of : int
        Lines, an odd number, over whose mean power peaks are sought; their places and widths are of single lines.
    """
    from scipy.ndimage import uniform_filter1d
    from scipy.signal import find_peaks  # slow to import, and not every command looks for resonances

    level, mean = 10 * np.log10(np.maximum(power, 1e-300)), uniform_filter1d(power, mean_of, mode="nearest")
    peaks, _ = find_peaks(10 * np.log10(np.maximum(mean, 1e-300)), prominence=max(prominence, HALF_POWER))
    loud = peaks[(mean >= RULES.above_noise * noise)[peaks]]
    firsts = np.clip(loud - mean_of // 2, 1, len(freq) - 2)
    highest = [first + int(np.argmax(level[first : min(first + mean_of, len(freq) - 1)])) for first in firsts.tolist()]
    return tuple(Resonance(float(freq[k]), _width(freq, level, k)) for k in highest)


def _width(freq: np.ndarray, level: np.ndarray, peak: int) -> float:
    distance = float(freq[peak + 1] - freq[peak - 1]) / 2
    return max(_crossing(freq, level, peak, 1) - _crossing(freq, level, peak, -1), distance)


def _crossing(freq: np.ndarray, level: np.ndarray, peak: int, step: int) -> float:
    """Frequency at which the level has fallen to half the power on one side of a peak."""
    wanted = level[peak] - HALF_POWER
    k = peak
    while level[k] > wanted:
        k += step
    before = k - step
    share = (level[before] - wanted) / (level[before] - level[k])
    return float(freq[before] + share * (freq[k] - freq[before]))


def in_bands(freq: np.ndarray, bands: Sequence[tuple[float, float]]) -> np.ndarray:
    """Which lines lie in one of the bands [low, high], Hz, (n_freq,), bool."""
    out = np.zeros(len(freq), dtype=bool)
    for low, high in bands:
        out |= (freq >= low) & (freq <= high)
    return out
