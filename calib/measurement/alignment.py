"""Shapes of several repeats in a common scale and phase, whatever single channels do."""

from __future__ import annotations

import numpy as np

from calib.measurement.mac import mac
from calib.measurement.outliers import median_of_known


def mean_and_std(stack: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean of real values (n_repeats, ...) over the known ones, and its standard deviation (NaN for fewer than two)."""
    known = np.isfinite(stack)
    n = known.sum(axis=0)
    mean = np.where(n > 0, np.where(known, stack, 0.0).sum(axis=0) / np.maximum(n, 1), np.nan)
    square = (np.where(known, stack - mean, 0.0) ** 2).sum(axis=0)
    return mean, np.where(n > 1, np.sqrt(square / np.maximum(n - 1, 1) / np.maximum(n, 1)), np.nan)


def scaled(shapes: np.ndarray, std: np.ndarray | float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Columns divided by their largest modulus; columns without a value or of zeros stay as they are."""
    peak = np.max(np.where(np.isfinite(shapes), np.abs(shapes), 0.0), axis=0, initial=0.0)
    peak = np.where(peak > 0, peak, 1.0)
    return shapes / peak, np.asarray(std / peak)


def median_of_repeats(stack: np.ndarray) -> np.ndarray:
    """Median over the repeats of real and imaginary parts separately; NaN where no repeat has a value."""
    known = np.isfinite(stack).any(axis=0)
    filled = np.where(known, stack, 0.0)
    return np.where(known, median_of_known(filled.real) + 1j * median_of_known(filled.imag), np.nan)


def aligned_repeats(stack: np.ndarray, trusted: np.ndarray | None = None) -> np.ndarray:
    """Shapes (n_repeats, n_sensors, n_modes) of every mode in a common scale and phase, largest entry of the median 1.

    The factor of a repeat minimises the sum of absolute differences from the median of all, so that a wrong channel
    does not rotate the others. A mode that fewer than two repeats hold, or that does not move, stays as it is.

    Parameters
    ----------
    stack : ndarray (n_repeats, n_sensors, n_modes), complex
        Shapes of any scale and phase; NaN where unknown.
    trusted : ndarray (n_repeats, n_sensors, n_modes), bool, optional
        Entries to which the factors are fitted; all by default.
    """
    fitted = np.isfinite(stack) if trusted is None else trusted & np.isfinite(stack)
    out = stack.copy()
    for m in range(stack.shape[2]):
        held = np.flatnonzero(fitted[:, :, m].any(axis=1))
        if len(held) < 2:
            continue
        x, seen = stack[held, :, m], fitted[held, :, m]
        visible = np.where(seen, x, complex(np.nan, np.nan))
        target = visible[int(np.argmax(mac(visible.T, visible.T).sum(axis=1)))]
        factors = np.ones(len(held), dtype=complex)
        for _ in range(3):
            factors = _factors(target, visible)
            target = median_of_repeats(factors[:, None] * visible)
            peak = np.nanmax(np.abs(target), initial=0.0)
            if not peak > 0:
                break
            target, factors = target / peak, factors / peak
        out[held, :, m] = factors[:, None] * x
    return out


def _factors(target: np.ndarray, shapes: np.ndarray) -> np.ndarray:
    """Factor of every shape (n_repeats, n_sensors) with the least sum of absolute differences from the target.

    By iteratively reweighted least squares; 1 for a shape of zeros.
    """
    both = np.isfinite(target) & np.isfinite(shapes)
    t, x = np.where(both, target, 0.0), np.where(both, shapes, 0.0)
    least = 1e-3 * max(float(np.abs(t).max()), 1e-300)
    weight = both.astype(float)
    factors = np.ones(len(x), dtype=complex)
    for _ in range(20):
        size = (weight * np.abs(x) ** 2).sum(axis=1)
        found = (weight * x.conj() * t).sum(axis=1)
        factors = np.where(size > 0, found / np.where(size > 0, size, 1.0), 1.0)
        weight = both / np.maximum(np.abs(t - factors[:, None] * x), least)
    return factors
