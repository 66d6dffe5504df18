"""Means over repeats, ignoring missing values."""

from __future__ import annotations

import numpy as np


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
