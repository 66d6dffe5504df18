"""Standard deviations of identified modes by the jackknife over repeated measurements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from calib.measurement.mac import align
from calib.measurement.matching import match_modes


@dataclass(frozen=True, eq=False)
class Spread:
    """Standard deviations of natural frequencies (Hz), damping ratios (n_modes,) and shapes (n_sensors, n_modes)."""

    freq: np.ndarray
    damping: np.ndarray
    shapes: np.ndarray


class ModeEstimates(Protocol):
    """Modes of one identification: frequencies (Hz) and ratios (n_modes,), shapes (n_sensors, n_modes)."""

    @property
    def natural_freq(self) -> np.ndarray: ...  # noqa: D102
    @property
    def damping_ratio(self) -> np.ndarray: ...  # noqa: D102
    @property
    def shapes(self) -> np.ndarray: ...  # noqa: D102


def jackknife(
    whole: ModeEstimates, without: Sequence[ModeEstimates], sources: Sequence[str]
) -> tuple[Spread, set[int]]:
    """Standard deviations from the modes found without each repeat in turn, and the modes that some of these lack.

    The estimated bias is added in quadrature (Efron and Stein 1981).

    Raises
    ------
    InputError
        When modes cannot be matched; see `match_modes`.
    """
    n, n_modes = len(without), len(whole.natural_freq)
    every = [whole, *without]
    names = ["all repeats", *(f"all repeats but {one}" for one in sources)]
    index = match_modes(names, [one.natural_freq for one in every], [one.shapes for one in every]).index
    freq, damping, shapes = np.zeros(n_modes), np.zeros(n_modes), np.zeros(whole.shapes.shape)
    lacking = set()
    for k in range(n_modes):
        there = [(one, int(m)) for one, m in zip(without, index[1:, k], strict=True) if m >= 0]
        if len(there) < n:
            lacking.add(k)
        if len(there) < 2:
            freq[k], damping[k], shapes[:, k] = np.nan, np.nan, np.nan
            continue
        freq[k] = jackknifed(np.array([one.natural_freq[m] for one, m in there]), whole.natural_freq[k])
        damping[k] = jackknifed(np.array([one.damping_ratio[m] for one, m in there]), whole.damping_ratio[k])
        own = np.array([aligned(whole.shapes[:, k], one.shapes[:, m]) for one, m in there])
        shapes[:, k] = both_parts(own) * (len(own) - 1) / np.sqrt(len(own))
    return Spread(freq, damping, shapes), lacking


def jackknifed(values: np.ndarray, estimate: float) -> float:
    """Standard deviation of an estimate from those without each repeat in turn, its bias included."""
    n = len(values)
    return float(np.hypot(np.std(values, ddof=1) * (n - 1) / np.sqrt(n), (n - 1) * (values.mean() - estimate)))


def aligned(reference: np.ndarray, shape: np.ndarray) -> np.ndarray:
    """A shape scaled and rotated to a reference, (n_sensors,)."""
    return np.asarray(shape * align(reference, shape))


def both_parts(every: np.ndarray) -> np.ndarray:
    """Standard deviation (n_sensors,) of the real and of the imaginary part each, of shapes (n, n_sensors)."""
    return np.asarray(np.sqrt((every.real.var(axis=0, ddof=1) + every.imag.var(axis=0, ddof=1)) / 2))
