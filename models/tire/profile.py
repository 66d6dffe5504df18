"""Profile of a tire's wall: a meridian from bead to bead, with its curvatures."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import CubicSpline

from calib import InputError

CODAZZI = 1e-3
"""Allowed defect of the Codazzi equation, over the mean curvature. 61 points of a wall of 0.34 m with errors of 0.1 mm
reach 2e-3, while their curvatures are off by their own size; 15 exact points reach 3e-4."""


@dataclass(frozen=True, eq=False)
class Profile:
    """Meridian of a surface of revolution over its arc length s in [0, length], as a spline with two derivatives.

    It runs towards larger axial positions, so that the normal (z', -r') points outward.

    Attributes
    ----------
    s : (n_points,) ndarray
        Arc length of the points, m.
    points : (n_points, 2) ndarray
        Radius and axial position, m.
    """

    s: np.ndarray
    points: np.ndarray

    @classmethod
    def from_points(cls, r: np.ndarray, z: np.ndarray) -> Profile:
        """Profile through points from bead to bead.

        Parameters
        ----------
        r, z : (n_points,) array
            Radius and axial position, m.

        Raises
        ------
        InputError
            For radii that are not as many as axial positions, fewer than 7 points, a point that is not finite or on the
            axis, a point given twice, beads at different radii, a profile that crosses itself, or points too rough for
            the curvatures of a shell.
        """
        try:
            r, z = np.asarray(r, float), np.asarray(z, float)
        except (TypeError, ValueError):
            raise InputError("the points of the profile are not numbers") from None
        if r.ndim != 1 or r.shape != z.shape:
            raise InputError(
                f"radii of shape {r.shape} and axial positions of shape {z.shape} make no profile",
                remedy="give one of each for a point",
            )
        given = np.column_stack([r, z])
        if len(given) < 7:
            raise InputError(f"a profile of {len(given)} points is too coarse", remedy="give at least 7, bead to bead")
        wrong = np.flatnonzero(~np.isfinite(given).all(axis=1) | (given[:, 0] <= 0.0))
        if wrong.size:
            raise InputError(f"point {wrong[0] + 1} of the profile is not finite or has no positive radius")
        chords = np.hypot(*np.diff(given, axis=0).T)
        if chords.min() <= 1e-9 * chords.sum():
            raise InputError(f"points {chords.argmin() + 1} and {chords.argmin() + 2} of the profile are the same")
        crossing = _crossing(given)
        if crossing is not None:
            raise InputError(f"the profile crosses itself between points {crossing[0] + 1} and {crossing[1] + 1}")
        section = np.ptp(given[:, 0])
        if abs(given[0, 0] - given[-1, 0]) > 0.1 * section:
            raise InputError(
                f"the profile does not meet both beads: its ends have radii of {given[0, 0]:g} and {given[-1, 0]:g} m",
                remedy="give points from one bead to the other",
            )
        if given[0, 1] > given[-1, 1]:
            given = given[::-1]
        profile = _by_arc_length(given)
        defect = profile.codazzi_defect()
        if defect > CODAZZI:
            raise InputError(
                f"the points of the profile are too rough for a shell: its curvatures miss the Codazzi equation by "
                f"{defect:.2%}",
                remedy="smooth the points or give more of them",
            )
        return profile

    @property
    def length(self) -> float:
        """Arc length from bead to bead, m."""
        return float(self.s[-1])

    @cached_property
    def _spline(self) -> CubicSpline:
        return CubicSpline(self.s, self.points, bc_type="not-a-knot")

    def r(self, s: np.ndarray) -> np.ndarray:
        """Radius, m, at arc lengths of any shape, m."""
        return self._spline(s)[..., 0]

    def z(self, s: np.ndarray) -> np.ndarray:
        """Axial position, m."""
        return self._spline(s)[..., 1]

    def dr(self, s: np.ndarray) -> np.ndarray:
        """Slope r' of the radius, the tangent's radial component."""
        return self._tangent(s)[..., 0]

    def dz(self, s: np.ndarray) -> np.ndarray:
        """Slope z' of the axial position; the outward normal is (z', -r')."""
        return self._tangent(s)[..., 1]

    def k1(self, s: np.ndarray) -> np.ndarray:
        """Curvature of the meridian, 1/m: -(r'' z' - z'' r')."""
        first, second = self._spline(s, 1), self._spline(s, 2)
        speed = np.hypot(first[..., 0], first[..., 1])
        return -(second[..., 0] * first[..., 1] - second[..., 1] * first[..., 0]) / speed**3

    def k2(self, s: np.ndarray) -> np.ndarray:
        """Curvature of the hoop, 1/m: z'/r."""
        return self.dz(s) / self.r(s)

    def codazzi_defect(self) -> float:
        """Root mean square of (r k2)' - k1 r' over that of k1, between the points.

        It vanishes for a curve by its true arc length (do Carmo 1976); what is left is the error of the points.
        """
        s = np.linspace(0.02, 0.98, 400) * self.length
        step = 1e-4 * self.length
        change = (self.dz(s + step) - self.dz(s - step)) / (2 * step)
        k1 = self.k1(s)
        return float(np.sqrt(np.mean((change - k1 * self.dr(s)) ** 2)) / np.sqrt(np.mean(k1**2)))

    def _tangent(self, s: np.ndarray) -> np.ndarray:
        first = self._spline(s, 1)
        return first / np.linalg.norm(first, axis=-1, keepdims=True)


@lru_cache(maxsize=8)
def netting_profile(
    crown_radius: float, widest_radius: float, bead_radius: float, crown_angle: float, samples: int = 400
) -> Profile:
    """Inflated profile of inextensible cords without rubber (Hofferberth 1956; Purdy 1963).

    The sine of the meridian's tilt is (r^2 - rm^2)/(r0^2 - rm^2) sin(alpha)/sin(alpha0), and the cord angle follows the
    pantograph cos(alpha)/r = cos(alpha0)/r0.

    Parameters
    ----------
    crown_radius, widest_radius, bead_radius : float
        r0, rm where the section is widest, and rb, m; rb < rm < r0.
    crown_angle : float
        alpha0 of the cords from the circumference, rad.
    samples : int
        Points of half the profile.

    Raises
    ------
    InputError
        For radii out of order, an angle outside 0 to 90 degrees, or beads so deep that no such profile reaches them.
    """
    r0, rm, rb = crown_radius, widest_radius, bead_radius
    if not 0.0 < rb < rm < r0:
        raise InputError(f"radii of bead, widest place and crown are {rb:g}, {rm:g}, {r0:g} m, but must ascend")
    if not 0.0 < crown_angle <= np.pi / 2:
        raise InputError(f"the crown angle is {np.degrees(crown_angle):g} degrees, allowed is above 0 to 90")
    # r = r0 - d x^2 takes the square root out of the crown, where the meridian is level.
    x = np.linspace(0.0, 1.0, 40 * samples + 1)
    r = r0 - (r0 - rb) * x**2
    sine = np.sqrt(1 - (r * np.cos(crown_angle) / r0) ** 2) / np.sin(crown_angle)
    tilt = (r**2 - rm**2) / (r0**2 - rm**2) * sine
    if tilt[-1] <= -1.0:
        raise InputError(
            f"no netting profile reaches beads at {rb:g} m from a crown at {r0:g} m and {rm:g} m at its widest",
            remedy="raise the radius of the beads",
        )
    # ds = dr/sqrt(1 - t^2); at the crown both vanish, with the ratio's limit from the slope of t there.
    slope = 2 * r0 / (r0**2 - rm**2) - np.cos(crown_angle) ** 2 / (r0 * np.sin(crown_angle) ** 2)
    with np.errstate(invalid="ignore", divide="ignore"):
        speed = 2 * (r0 - rb) * x / np.sqrt(1 - tilt**2)
    speed[0] = np.sqrt(2 * (r0 - rb) / slope)
    s = cumulative_trapezoid(speed, x, initial=0.0)
    z = cumulative_trapezoid(speed * tilt, x, initial=0.0)
    even = np.linspace(0.0, s[-1], samples + 1)
    r_half = r0 - (r0 - rb) * CubicSpline(s, x)(even) ** 2
    z_half = CubicSpline(s, z)(even)
    # z' is positive at the crown: the profile runs from negative to positive axial positions.
    r_all = np.concatenate([r_half[::-1], r_half[1:]])
    z_all = np.concatenate([-z_half[::-1], z_half[1:]])
    return _by_arc_length(np.column_stack([r_all, z_all]))


def _by_arc_length(points: np.ndarray) -> Profile:
    """Spline over true arc length: chords first, then the length of the spline itself."""
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    nodes, weights = np.polynomial.legendre.leggauss(5)
    for _ in range(8):
        spline = CubicSpline(s, points, bc_type="not-a-knot")
        step = np.diff(s)
        at = s[:-1, None] + step[:, None] * (nodes + 1) / 2
        length = (np.linalg.norm(spline(at, 1), axis=-1) @ weights) * step / 2
        s = np.concatenate([[0.0], np.cumsum(length)])
    return Profile(s, points)


def _crossing(points: np.ndarray) -> tuple[int, int] | None:
    """The first two chords that cross, by number."""
    a, b = points[:-1], points[1:]

    def side(p: np.ndarray, q: np.ndarray, x: np.ndarray) -> np.ndarray:
        return (q[..., 0] - p[..., 0]) * (x[..., 1] - p[..., 1]) - (q[..., 1] - p[..., 1]) * (x[..., 0] - p[..., 0])

    p, q, u, v = a[:, None], b[:, None], a[None], b[None]
    crosses = (side(p, q, u) * side(p, q, v) < 0) & (side(u, v, p) * side(u, v, q) < 0)
    found = np.argwhere(np.triu(crosses, 2))
    return None if found.size == 0 else (int(found[0, 0]), int(found[0, 1]))
