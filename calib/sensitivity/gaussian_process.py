"""Gaussian process of few inputs, of scikit-learn (extra ``metamodel``), with closed-form cross-validation."""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Any

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from calib.sensitivity.rules import PROGNOSIS


def is_installed() -> bool:
    """Whether scikit-learn is there."""
    return find_spec("sklearn") is not None


@dataclass(frozen=True, eq=False)
class GaussianProcess:
    """Mean of a Gaussian process (Rasmussen and Williams 2006).

    Attributes
    ----------
    inputs : tuple of int
    points : ndarray (n, n_inputs)
        All inputs of the designs, between -1 and 1.
    covariance : callable
        Kernel of the process, without noise.
    weights : ndarray (n,) or (n, n_processes)
    constant : float
    """

    inputs: tuple[int, ...]
    points: np.ndarray
    covariance: Any
    weights: np.ndarray
    constant: float

    kind = "Gaussian process"

    def __call__(self, z: np.ndarray) -> np.ndarray:
        """Mean (n,), or of each process, at points (n, n_inputs)."""
        own = list(self.inputs)
        return self.constant + np.asarray(self.covariance(z[:, own], self.points[:, own])) @ self.weights


def fitted_process(
    z: np.ndarray, y: np.ndarray, inputs: Sequence[int], folds: Sequence[np.ndarray]
) -> tuple[GaussianProcess, list[GaussianProcess], np.ndarray]:
    """A process of some inputs, those without each fold, and each design as predicted without its fold.

    The length scales, one an input (Matern 5/2), and the noise maximize the marginal likelihood of some designs and
    hold in all folds.

    Parameters
    ----------
    z : ndarray (n, n_inputs)
        Between -1 and 1.
    y : ndarray (n,)
    inputs : sequence of int
    folds : sequence of ndarray of int
        Rows of each.

    Returns
    -------
    tuple
        The process, those of the folds, and the predicted values (n,).
    """
    from sklearn.gaussian_process import GaussianProcessRegressor
    from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

    own, mean, size = list(inputs), float(y.mean()), float(y.std())
    x, scaled = z[:, own], (y - mean) / size
    start = ConstantKernel(1.0, (1e-2, 1e3)) * Matern(np.full(len(own), 2.0), (0.05, 50.0), nu=2.5)
    tuned = GaussianProcessRegressor(start + WhiteKernel(1e-3, (1e-8, 1.0)))
    some = np.unique(np.linspace(0, len(x) - 1, PROGNOSIS.process_tuned).astype(int))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a scale at its bound is an input that does nothing, and no fault
        kernel = tuned.fit(x[some], scaled[some]).kernel_
    whole = np.asarray(kernel(x))

    def without(rows: np.ndarray) -> GaussianProcess:
        kept = np.setdiff1d(np.arange(len(x)), rows)
        weights = np.zeros(len(x))
        weights[kept] = cho_solve(cho_factor(whole[np.ix_(kept, kept)], lower=True), scaled[kept]) * size
        return GaussianProcess(tuple(own), z, kernel.k1, weights, mean)

    parts = [without(rows) for rows in folds]
    predicted, smooth = np.empty(len(x)), np.asarray(kernel.k1(x))
    for rows, part in zip(folds, parts, strict=True):
        predicted[rows] = mean + smooth[rows] @ part.weights
    return without(np.empty(0, dtype=int)), parts, predicted
