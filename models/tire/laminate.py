"""Stiffness of a laminate of plies, and how the cord angle varies over the section."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib import InputError
from models.tire.micromechanics import Orthotropic


@dataclass(frozen=True)
class Ply:
    """One ply.

    Attributes
    ----------
    thickness : float
        m.
    angle : float or (n,) ndarray
        Of the cords from the circumference, rad, at one or several places.
    elastic : Orthotropic
    """

    thickness: float
    angle: float | np.ndarray
    elastic: Orthotropic

    def __post_init__(self) -> None:
        if not 0.0 < self.thickness < np.inf:
            raise InputError(f"the thickness of a ply is {self.thickness:g} m, but must be positive")
        angle = np.asarray(self.angle, float)
        wrong = angle[~(np.abs(angle) <= np.pi)]
        if wrong.size:
            raise InputError(
                f"the cord angle of a ply is {wrong[0]:g} rad, allowed is half a turn to both sides",
                remedy="give it in radians",
            )

    @property
    def reduced(self) -> np.ndarray:
        """Stiffness in plane stress, (n, 3, 3) or (3, 3), Pa, in the order meridian, hoop, shear.

        Strains turn, not stresses, with engineering shear: Qb = T^T Q T (Jones 1999).
        """
        e1, e2, g12, nu12 = self.elastic
        nu21 = nu12 * e2 / e1
        if nu12 * nu21 >= 1.0:
            raise InputError(f"the ply is unstable: Poisson's ratio of {nu12:g} is too large for its moduli")
        along, across, mixed = e1 / (1 - nu12 * nu21), e2 / (1 - nu12 * nu21), nu12 * e2 / (1 - nu12 * nu21)
        q = np.array([[along, mixed, 0.0], [mixed, across, 0.0], [0.0, 0.0, g12]])
        turn = np.pi / 2 - np.asarray(self.angle, float)  # from the meridian
        c, s = np.cos(turn), np.sin(turn)
        t = np.moveaxis(
            np.array([[c**2, s**2, s * c], [s**2, c**2, -s * c], [-2 * s * c, 2 * s * c, c**2 - s**2]]),
            (0, 1),
            (-2, -1),
        )
        return np.swapaxes(t, -1, -2) @ q @ t


def abd(plies: Sequence[Ply]) -> np.ndarray:
    """Stiffness of a laminate by classical lamination theory (Jones 1999), (n, 6, 6) or (6, 6).

    Relates N (N/m) and M (N) to strains and curvature changes (1/m) of the middle of the thickness, in the order
    meridian, hoop, shear.

    Parameters
    ----------
    plies : sequence of Ply
        From inside to outside.
    """
    if not plies:
        raise InputError("a laminate needs a ply")
    top = -sum(ply.thickness for ply in plies) / 2
    parts = []
    for ply in plies:
        low, top = top, top + ply.thickness
        q = ply.reduced
        a, b, d = q * (top - low), q * (top**2 - low**2) / 2, q * (top**3 - low**3) / 3
        parts.append(np.concatenate([np.concatenate([a, b], axis=-1), np.concatenate([b, d], axis=-1)], axis=-2))
    return np.asarray(sum(np.broadcast_arrays(*parts)))


def pantograph(crown_angle: float, crown_radius: float, r: np.ndarray) -> np.ndarray:
    """Cord angle from the circumference, rad, where the radius is r, m: cos(alpha)/r = cos(alpha0)/r0 (Purdy 1963).

    Raises
    ------
    InputError
        For an angle outside 0 to 90 degrees, or where cords of this angle do not reach so far out.
    """
    if not 0.0 < crown_angle < np.pi / 2:
        raise InputError(f"the crown angle is {np.degrees(crown_angle):g} degrees, allowed is above 0 to below 90")
    cosine = np.asarray(r, float) * np.cos(crown_angle) / crown_radius
    if (cosine >= 1.0).any():
        raise InputError(f"cords of {np.degrees(crown_angle):g} degrees do not reach a radius of {np.max(r):g} m")
    return np.arccos(cosine)
