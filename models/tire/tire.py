"""A tire: profile, plies, belt and tread, and the wall that follows from them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, lru_cache

import numpy as np

from calib import InputError
from calib.structure import ScaledPart
from models.tire.contact import Ground
from models.tire.grid import Grid
from models.tire.inflated import Inflated, Wall, inflate
from models.tire.laminate import Ply, abd, pantograph
from models.tire.micromechanics import RULES, CordRubber, Orthotropic, isotropic
from models.tire.parts import MASS_OF_ZONE, N_PLIES, STIFFNESS_OF_PLY, STIFFNESS_OF_ZONE, zone
from models.tire.profile import Profile, netting_profile

RUBBER_DENSITY = 1150.0
"""Of cords and rubber alike, kg/m3 (assumed): 4.8 mm weigh 5.52 kg/m2."""
TREAD_WIDTH = 0.35
"""Share of the meridian that belt and tread cover (assumed)."""

_POSITIVE = "above 0", lambda value: value > 0.0
_NOT_NEGATIVE = "0 and above", lambda value: value >= 0.0
_SHARE = "below 1", lambda value: value < 1.0
_PART = "0 to 1", lambda value: 0.0 <= value <= 1.0
_FINITE = "any finite number", lambda value: True
_ALLOWED = {
    "ply_thickness": _POSITIVE,
    "belt_thickness": _NOT_NEGATIVE,
    "belt_modulus": _POSITIVE,
    "tread_thickness": _NOT_NEGATIVE,
    "tread_modulus": _POSITIVE,
    "tread_compliance": _NOT_NEGATIVE,
    "tread_width": ("above 0 to 1", lambda value: 0.0 < value <= 1.0),
    "density": _POSITIVE,
    "soft_bead": _SHARE,
    "thin_sidewall": _SHARE,
    "halpin_tsai": _FINITE,
    "crown_mass": _FINITE,
    "uncoupled": _PART,
    "dead_pressure": _PART,
}


@dataclass(frozen=True)
class Tire:
    """A bias tire with clamped beads.

    Attributes
    ----------
    profile : Profile
        Of the wall's middle, not inflated.
    plies : CordRubber
    crown_angle : float
        Of the cords from the circumference, rad; over the section it follows the pantograph.
    n_plies : int
        Even; their angles alternate.
    ply_thickness : float
        m.
    rule : str
        Of micromechanics, see `RULES`.
    belt_thickness : float
        Of each of two belt plies, m; 0 is none.
    belt_modulus, belt_angle : float
        Of the belt's cords, Pa; from the circumference, rad.
    tread_thickness, tread_modulus : float
        Of a layer of rubber outside, m, Pa; 0 is none.
    tread_compliance : float
        Of the tread under the contact pressure, m/Pa; 0 is rigid.
    tread_width : float
        Share of the meridian that belt and tread cover, about the crown.
    density : float
        kg/m3.
    soft_bead : float
        Share of the bending stiffness that the wall lacks within `BEAD` of the meridian beside each bead.
    thin_sidewall : float
        Share of the carcass that the wall lacks between beads and tread.
    halpin_tsai : float
        Share of the way, in logarithms, from the constants of `rule` to those of Halpin and Tsai.
    crown_mass : float
        Further mass under the tread, kg/m2.
    uncoupled : float
        Share of the plies' coupling between stretching and bending that the carcass lacks.
    dead_pressure : float
        Share of the pressure that keeps direction and size as the wall turns and stretches.
    changes : mapping from str to float
        Relative change of stiffness or mass of `models.tire.parts.PARTS`, by parameter.

    Raises
    ------
    InputError
        For an odd number of plies, an unknown rule, angles beyond a right angle, a thickness, modulus or density that
        is not positive, a share of 1 and more, or a mass that is taken from where there is none.
    """

    profile: Profile
    plies: CordRubber
    crown_angle: float
    n_plies: int = 4
    ply_thickness: float = 1.2e-3
    rule: str = RULES[0]
    belt_thickness: float = 0.0
    belt_modulus: float = 2e9
    belt_angle: float = field(default=np.radians(20.0))
    tread_thickness: float = 0.0
    tread_modulus: float = 5e6
    tread_compliance: float = 0.0
    tread_width: float = TREAD_WIDTH
    density: float = RUBBER_DENSITY
    soft_bead: float = 0.0
    thin_sidewall: float = 0.0
    halpin_tsai: float = 0.0
    crown_mass: float = 0.0
    uncoupled: float = 0.0
    dead_pressure: float = 0.0
    changes: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if not self.n_plies >= 2 or self.n_plies % 2:
            raise InputError(f"{self.n_plies} plies cannot alternate their angles in pairs", remedy="take 2, 4, 6, ...")
        if self.rule not in RULES:
            raise InputError(f"unknown rule of micromechanics '{self.rule}'", remedy=f"take one of {', '.join(RULES)}")
        for name, (kind, allowed) in _ALLOWED.items():
            value = getattr(self, name)
            if not (np.isfinite(value) and allowed(value)):
                raise InputError(f"{name} of a tire is {value:g}, allowed is {kind}")
        if not 0.0 < self.crown_angle < np.pi / 2:
            raise InputError(
                f"the crown angle is {np.degrees(self.crown_angle):g} degrees, allowed is above 0 to below 90",
                remedy="give it in radians, from the circumference",
            )
        if not abs(self.belt_angle) <= np.pi / 2:
            raise InputError(
                f"the belt angle is {np.degrees(self.belt_angle):g} degrees, allowed is -90 to 90",
                remedy="give it in radians, from the circumference",
            )
        if not np.all(self.areal_density(np.array([0.5 * self.profile.length])) > 0.0):
            raise InputError(f"crown_mass of a tire is {self.crown_mass:g} kg/m2 and takes more than the tread weighs")

    @cached_property
    def crown_radius(self) -> float:
        """Radius of the crown, not inflated, m."""
        s = np.linspace(0.0, self.profile.length, 2001)
        return float(self.profile.r(s).max())

    def stiffness(self, s: np.ndarray) -> np.ndarray:
        """Laminate stiffness at arc lengths s (n,), m: (n, 6, 6) in N/m, N and N m."""
        wall = self._carcass(s)
        out = abd(wall)
        out[:, :3, 3:] *= 1 - self.uncoupled
        out[:, 3:, :3] *= 1 - self.uncoupled
        covered = self._covered(s)
        bare = ~covered & (self.thin_sidewall != 0.0)
        out[bare] = out[bare] * (1 - self.thin_sidewall)
        zones = zone(s, self.profile.length, self.tread_width)
        beside = zones == 0
        out[np.ix_(beside, range(3, 6), range(3, 6))] *= 1 - self.soft_bead
        extra = self._cover()
        if extra and covered.any():
            # The reference stays the carcass' middle: what lies outside it brings coupling of its own.
            out = out + np.where(covered[:, None, None], self._outside(extra), 0.0)
        return out * self._scale(STIFFNESS_OF_ZONE)[zones][:, None, None]

    def areal_density(self, s: np.ndarray) -> np.ndarray:
        """Mass over area at arc lengths s (n,), m: (n,) in kg/m2."""
        carcass = self.density * self.n_plies * self.ply_thickness
        cover = self.density * sum(ply.thickness for ply in self._cover()) + self.crown_mass
        zones = zone(s, self.profile.length, self.tread_width)
        plain = np.where(self._covered(s), carcass + cover, carcass * (1 - self.thin_sidewall))
        return plain * self._scale(MASS_OF_ZONE)[zones]

    def _scale(self, parts: Sequence[ScaledPart]) -> np.ndarray:
        """Factor of each part, (n_parts,)."""
        return np.array([1 + self.changes.get(part.parameter, 0.0) for part in parts])

    def wall(self, n_meridian: int, n_hoop: int, grading: float = 0.8) -> Wall:
        """Wall on a grid of so many cells along meridian and hoop."""
        grid = _grid(self.profile, n_meridian, n_hoop, grading)
        stiffness, mass = self.stiffness(grid.s_quarter), self.areal_density(grid.s_quarter)
        return Wall.build(grid, stiffness, mass, 1 - self.dead_pressure)

    def inflate(self, pressure: float, n_meridian: int = 41, n_hoop: int = 24) -> Inflated:
        """Equilibrium at a pressure, Pa, free of the ground."""
        return inflate(self.wall(n_meridian, n_hoop), self.wall(n_meridian, 1), pressure)

    def on_ground(self, pressure: float, n_meridian: int = 41, n_hoop: int = 24) -> Ground:
        """Inflated tire above flat ground."""
        return Ground(self.inflate(pressure, n_meridian, n_hoop), self.tread_compliance)

    def _carcass(self, s: np.ndarray) -> Sequence[Ply]:
        angle = pantograph(self.crown_angle, self.crown_radius, np.minimum(self.profile.r(s), self.crown_radius))
        one, other = np.array(self.plies.ply(self.rule)), np.array(self.plies.ply("halpin_tsai"))
        e1, e2, g12, nu12 = one ** (1 - self.halpin_tsai) * other**self.halpin_tsai
        scale = np.append(self._scale(STIFFNESS_OF_PLY), np.ones(max(self.n_plies - N_PLIES, 0)))
        return [
            Ply(self.ply_thickness, angle if k % 2 == 0 else -angle, Orthotropic(f * e1, f * e2, f * g12, nu12))
            for k, f in enumerate(scale[: self.n_plies])
        ]

    def _cover(self) -> list[Ply]:
        out = []
        if self.belt_thickness > 0.0:
            cords = CordRubber(self.belt_modulus, self.plies.rubber_modulus, self.plies.cord_fraction)
            out += [Ply(self.belt_thickness, sign * self.belt_angle, cords.ply(self.rule)) for sign in (1, -1)]
        if self.tread_thickness > 0.0:
            out.append(Ply(self.tread_thickness, 0.0, isotropic(self.tread_modulus, self.plies.rubber_poisson)))
        return out

    def _outside(self, cover: Sequence[Ply]) -> np.ndarray:
        """Stiffness of layers on the carcass about its middle, (6, 6)."""
        thickness = sum(ply.thickness for ply in cover)
        offset = (self.n_plies * self.ply_thickness + thickness) / 2
        own = abd(cover)
        a, b, d = own[:3, :3], own[:3, 3:], own[3:, 3:]
        return np.block([[a, b + offset * a], [b + offset * a, d + 2 * offset * b + offset**2 * a]])

    def _covered(self, s: np.ndarray) -> np.ndarray:
        return np.abs(np.asarray(s) / self.profile.length - 0.5) <= self.tread_width / 2


@lru_cache(maxsize=40)
def _grid(profile: Profile, n_meridian: int, n_hoop: int, grading: float) -> Grid:
    """The same grid for all tires of a shape: its operators are made once."""
    return Grid(profile, n_meridian, n_hoop, grading)


def base_tire() -> Tire:
    """A generic small bias tire; chosen here, not a measured one (assumed throughout).

    Netting profile with a crown at 0.33 m, widest at 0.265 m and beads at 0.215 m, cords of 38 degrees at the crown;
    four plies of 1.2 mm.
    """
    angle = np.radians(38.0)
    return Tire(netting_profile(0.33, 0.265, 0.215, angle), CordRubber(2e9, 5e6, 0.3), angle)
