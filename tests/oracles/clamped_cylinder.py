"""Exact frequencies of a clamped cylinder under membrane forces and pressure, by the roots of its equations.

Coefficients are constant along a cylinder, so that displacements are sums of exponentials with eight exponents for each
hoop order and frequency (Forsberg 1964, here with the operators of Sanders); the clamped ends leave a determinant.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from meridians import Cylinder
from scipy.optimize import brentq
from shell_of_revolution import coefficients


@dataclass(frozen=True)
class ClampedCylinder:
    """A cylinder without extension-shear coupling; its laminate (6, 6), N/m, N and N m; kg/m2, N/m, N/m and Pa."""

    surface: Cylinder
    laminate: np.ndarray
    areal_density: float
    n1: float
    n2: float
    pressure: float

    def frequency(self, order: int, low: float, high: float, even: bool) -> float:
        """Hz, the only one between two frequencies at which w is even (or odd) about the middle of the length."""
        return brentq(lambda f: self._misfit(order, f, even), low, high, xtol=1e-7 * high)

    @cached_property
    def _factors(self) -> tuple[np.ndarray, np.ndarray]:
        """Load, field and orders of each derivative, (4, n), and its factor, (n,)."""
        found = coefficients(self.surface, np.zeros(1), self.laminate)
        return np.array(list(found)).T, np.array(list(found.values()))[:, 0]

    def _matrix(self, order: int, frequency: float, exponent: complex) -> np.ndarray:
        """Loads over displacements, both exp(exponent s + i order theta)."""
        out = np.zeros((3, 3), complex)
        (m, f, a, b), factor = self._factors
        np.add.at(out, (m, f), factor * exponent**a * (1j * order) ** b)
        k, around, n2, p = 1 / self.surface.radius, 1j * order / self.surface.radius, self.n2, self.pressure
        out[1, 1] += (n2 * k - p) * k
        out[1, 2] -= (n2 * k - p) * around
        out[2, 1] += (n2 * k - p) * around
        out[2, 2] -= self.n1 * exponent**2 + n2 * around**2 + p * k
        out[0, 2] += p * exponent
        out[2, 0] -= p * exponent
        return out - self.areal_density * (2 * np.pi * frequency) ** 2 * np.eye(3)

    def _misfit(self, order: int, frequency: float, even: bool) -> float:
        # The determinant is a polynomial of degree 4 in the square of the exponent: five values give it.
        scale = (10 / self.surface.radius) ** 2
        at = np.exp(2j * np.pi * np.arange(5) / 5)
        values = [np.linalg.det(self._matrix(order, frequency, np.sqrt(scale * x))) for x in at]
        squares = np.roots(np.fft.fft(values)[::-1]) * scale
        columns = []
        for exponent in np.sqrt(squares):
            shape = np.linalg.svd(self._matrix(order, frequency, exponent))[2][-1].conj()
            u, v, _ = shape / shape[2]
            arm = exponent * self.surface.length / 2
            less = np.exp(-abs(arm.real))
            cosh, sinh = np.cosh(arm) * less, np.sinh(arm) * less
            one, other = (cosh, sinh) if even else (sinh / exponent, cosh / exponent)
            columns.append([u * other, v * one, one, exponent * other])
        # Over the differences of the squares the determinant does not depend on their order, as all columns are even in
        # the exponents; it then is smooth and changes sign at a mode only.
        i, j = np.triu_indices(4, 1)
        value = np.linalg.det(np.array(columns).T) / np.prod((squares[i] - squares[j]) / scale)
        return float((1j * value).real if order else value.real)
