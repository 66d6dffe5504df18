"""Cross-section and material of a beam."""

from __future__ import annotations

from dataclasses import dataclass

from calib import InputError


@dataclass(frozen=True)
class Section:
    """Constant cross-section with its material.

    Local axes: x along the beam, y in the plane of the member's reference direction ("up"), z completing the triad.

    Attributes
    ----------
    area : float
        m2.
    i_y, i_z : float
        Second moments in m4; ``i_z`` governs bending in the local x-y plane, ``i_y`` in the x-z plane.
    torsion : float
        Saint-Venant torsion constant J in m4.
    shear_coefficient : float
        Shear area over area, for both planes.
    young_modulus, density : float
        Pa, kg/m3.
    poisson_ratio : float
    """

    area: float
    i_y: float
    i_z: float
    torsion: float
    young_modulus: float = 210e9
    poisson_ratio: float = 0.3
    density: float = 7850.0
    shear_coefficient: float = 5.0 / 6.0

    def __post_init__(self) -> None:
        for name in ("area", "i_y", "i_z", "torsion", "young_modulus", "shear_coefficient"):
            if not getattr(self, name) > 0:
                raise InputError(f"{name} is {getattr(self, name)}", place="section", remedy="give a positive number")
        if not self.density >= 0:
            raise InputError(f"density is {self.density}", place="section", remedy="give zero or a positive number")

    @property
    def shear_modulus(self) -> float:
        """Shear modulus G in Pa."""
        return self.young_modulus / (2 * (1 + self.poisson_ratio))
