"""Wall and material of a shell."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib import InputError


@dataclass(frozen=True)
class Sheet:
    """Constant thickness with its orthotropic material.

    "Along" is the panel's reference direction projected on each element, "across" is square to it in the wall.

    Attributes
    ----------
    thickness : float
        m.
    young_modulus, density : float
        Pa (along), kg/m3.
    poisson_ratio : float
        Contraction across over extension along, for a load along.
    young_modulus_across : float or None
        Pa; None is the same as along.
    shear_modulus : float or None
        Of the wall's own plane, Pa; None is ``E / (2 (1 + nu))``.
    shear_modulus_through : (2,) float or None
        Through the thickness, of the planes along and across, Pa; None is the shear modulus of the wall's plane.
    rmi : float
        Ratio of moments of inertia, real over solid sheet: multiplies the bending terms D11, D22, D12 and D66 and
        neither membrane, transverse shear, drilling nor mass.
    shear_coefficient : float
        Reduces the transverse shear stiffness (Reissner 1945: 5/6).
    drilling_factor : float
        Times the in-plane shear modulus gives the penalty that ties rotations about the normal to the in-plane
        rotation of the membrane; 1 is the value of Hughes and Brezzi (1989). Finely meshed twisted walls become too
        soft by less than 0.1 % at 0.1, by 1.5 % at 0.01 and 16 % at 0.001. Coarse meshes become too stiff: a
        hemisphere of 8 x 8 elements by 10 % at 0.1 and 48 % at 1, a wall with windows and pillars one element wide
        by 1 % more at 0.1 than at 0.01 and 7 % more at 1; finer meshes are less affected.
    """

    thickness: float
    young_modulus: float = 210e9
    poisson_ratio: float = 0.3
    density: float = 7850.0
    young_modulus_across: float | None = None
    shear_modulus: float | None = None
    shear_modulus_through: tuple[float, float] | None = None
    rmi: float = 1.0
    shear_coefficient: float = 5.0 / 6.0
    drilling_factor: float = 0.1

    def __post_init__(self) -> None:
        given = {
            name: getattr(self, name)
            for name in ("thickness", "young_modulus", "rmi", "shear_coefficient", "drilling_factor")
        }
        given |= {
            name: value
            for name in ("young_modulus_across", "shear_modulus")
            if (value := getattr(self, name)) is not None
        }
        given |= {f"shear_modulus_through[{k}]": value for k, value in enumerate(self.shear_modulus_through or ())}
        for name, value in given.items():
            if not value > 0:
                raise InputError(f"{name} is {value}", place="sheet", remedy="give a positive number")
        if not self.density >= 0:
            raise InputError(f"density is {self.density}", place="sheet", remedy="give zero or a positive number")
        stiffer = self.young_modulus / self._across
        if not (self.poisson_ratio**2 < stiffer and (not self.is_isotropic or -1 < self.poisson_ratio <= 0.5)):
            raise InputError(
                f"poisson_ratio is {self.poisson_ratio}; no stable material has that",
                place="sheet",
                remedy="keep it within -1 and 0.5, or its square below E along / E across for an orthotropic sheet",
            )

    @property
    def is_isotropic(self) -> bool:
        """Whether the material is isotropic within the wall."""
        return self.young_modulus_across is None and self.shear_modulus is None and self.shear_modulus_through is None

    @property
    def _across(self) -> float:
        return self.young_modulus if self.young_modulus_across is None else self.young_modulus_across

    @property
    def in_plane_shear(self) -> float:
        """Shear modulus of the wall's plane, Pa."""
        if self.shear_modulus is not None:
            return self.shear_modulus
        return self.young_modulus / (2 * (1 + self.poisson_ratio))

    @property
    def through_shear(self) -> tuple[float, float]:
        """Shear moduli through the thickness, of the planes along and across, Pa."""
        return self.shear_modulus_through or (self.in_plane_shear, self.in_plane_shear)

    @property
    def membrane(self) -> np.ndarray:
        """Forces per length over membrane strains (xx, yy, xy), shape (3, 3), N/m."""
        return self.thickness * self._plane_stress

    @property
    def bending(self) -> np.ndarray:
        """Moments per length over curvatures (xx, yy, 2 xy), shape (3, 3), Nm."""
        return self.rmi * self.thickness**3 / 12 * self._plane_stress

    @property
    def shear(self) -> np.ndarray:
        """Transverse forces per length over shear angles (xz, yz), shape (2, 2), N/m."""
        return self.shear_coefficient * self.thickness * np.diag(self.through_shear)

    @property
    def drilling(self) -> float:
        """Couple per area over the drilling angle, N/m; twice the penalty of Hughes and Brezzi, whose norm differs."""
        return 2 * self.drilling_factor * self.in_plane_shear * self.thickness

    @property
    def _plane_stress(self) -> np.ndarray:
        along, across, nu = self.young_modulus, self._across, self.poisson_ratio
        scale = 1 / (1 - nu**2 * across / along)
        mixed = nu * across * scale
        return np.array([[along * scale, mixed, 0.0], [mixed, across * scale, 0.0], [0.0, 0.0, self.in_plane_shear]])
