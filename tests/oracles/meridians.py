"""Meridians by formulas, without the error of a spline."""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Torus:
    """Circular section of a radius about a centre at a radius, m, to an angle on both sides of the crown, rad.

    With its centre on the axis it is the zone of a sphere.
    """

    centre: float = 0.3
    a: float = 0.09
    reach: float = float(np.radians(130.0))

    @property
    def length(self) -> float:
        return 2 * self.reach * self.a

    def phi(self, s):
        return np.asarray(s) / self.a - self.reach

    def r(self, s):
        return self.centre + self.a * np.cos(self.phi(s))

    def z(self, s):
        return self.a * np.sin(self.phi(s))

    def dr(self, s):
        return -np.sin(self.phi(s))

    def dz(self, s):
        return np.cos(self.phi(s))

    def k1(self, s):
        return np.full(np.shape(s), 1 / self.a)

    def k2(self, s):
        return self.dz(s) / self.r(s)

    def k1_slopes(self, s):
        return np.zeros((3, *np.shape(s)))


@dataclass(frozen=True)
class Cylinder:
    """Radius and length, m."""

    radius: float
    length: float

    def r(self, s):
        return np.full(np.shape(s), self.radius)

    def z(self, s):
        return np.asarray(s)

    def dr(self, s):
        return np.zeros(np.shape(s))

    def dz(self, s):
        return np.ones(np.shape(s))

    def k1(self, s):
        return np.zeros(np.shape(s))

    def k2(self, s):
        return np.full(np.shape(s), 1 / self.radius)

    def k1_slopes(self, s):
        return np.zeros((3, *np.shape(s)))
