"""Ranks of the values in a column."""

from __future__ import annotations

import numpy as np


def mean_ranks(a: np.ndarray) -> np.ndarray:
    """Ranks from 1 of each column (n_rows, n_columns), ties by mean rank; shape as given."""
    from scipy.stats import rankdata  # slow to import, and not every command ranks

    return np.asarray(rankdata(a, axis=0)) if a.size else a
