"""Functions of uniform inputs between -1 and 1 whose total shares of the variance (Sobol) are known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pandas as pd
from scipy.stats import qmc

from calib.problem.parameter import Parameter
from calib.problem.space import ParameterSpace


@dataclass(frozen=True, eq=False)
class Known:
    """A function of points (n, count), and the total share of each input, (count,)."""

    function: Callable[[np.ndarray], np.ndarray]
    total: np.ndarray

    @property
    def space(self) -> ParameterSpace:
        return ParameterSpace(tuple(Parameter(f"x{i}", 0.0, -1.0, 1.0) for i in range(len(self.total))))

    def designs(self, count: int, seed: int) -> tuple[pd.DataFrame, pd.DataFrame]:
        """Points of a Latin hypercube, and the response ``y``."""
        rng = np.random.default_rng(seed)
        points = 2.0 * qmc.LatinHypercube(len(self.total), rng=rng).random(count) - 1.0
        return pd.DataFrame(points, columns=list(self.space.free_names)), pd.DataFrame({"y": self.function(points)})


def ishigami(inputs: int) -> Known:
    """Ishigami and Homma (1990), a = 7, b = 0.1; further inputs do nothing."""
    v1, v2 = 0.5 * (1.0 + 0.1 * np.pi**4 / 5.0) ** 2, 49.0 / 8.0
    v13 = 0.01 * np.pi**8 * 8.0 / 225.0

    def function(z: np.ndarray) -> np.ndarray:
        x = np.pi * z
        return np.sin(x[:, 0]) + 7.0 * np.sin(x[:, 1]) ** 2 + 0.1 * x[:, 2] ** 4 * np.sin(x[:, 0])

    return Known(function, np.array([v1 + v13, v2, v13, *[0.0] * (inputs - 3)]) / (v1 + v2 + v13))


def smooth_g(inputs: int) -> Known:
    """The product of (3 z^2 + a) / (1 + a), the smooth g-function of Saltelli et al. (2010) with exponent 2."""
    a = np.array([0.5, 1.0, 2.0, 4.0, 9.0, 9.0, 99.0, 99.0])
    part = 0.8 / (1.0 + a) ** 2

    def function(z: np.ndarray) -> np.ndarray:
        return np.prod((3.0 * z[:, : len(a)] ** 2 + a) / (1.0 + a), axis=1)

    whole = np.prod(1.0 + part)
    return Known(function, np.array([*(part * whole / (1.0 + part) / (whole - 1.0)), *[0.0] * (inputs - len(a))]))


def coupled_quadratic(inputs: int) -> Known:
    """A quadratic of five inputs with two products; further inputs do nothing."""

    def function(z: np.ndarray) -> np.ndarray:
        return z[:, 0] + 0.8 * z[:, 1] * z[:, 2] + 1.2 * z[:, 3] ** 2 + 0.7 * z[:, 4] + 0.9 * z[:, 0] * z[:, 4]

    one, pair, square, other, product = 1.0 / 3.0, 0.64 / 9.0, 1.44 * 4.0 / 45.0, 0.49 / 3.0, 0.81 / 9.0
    total = np.array([one + product, pair, pair, square, other + product, *[0.0] * (inputs - 5)])
    return Known(function, total / (one + pair + square + other + product))


KNOWN = {
    "Ishigami": ishigami(3),
    "Ishigami, 10 inputs": ishigami(10),
    "smooth g": smooth_g(8),
    "smooth g, 12 inputs": smooth_g(12),
    "coupled quadratic": coupled_quadratic(20),
}
"""By name."""
