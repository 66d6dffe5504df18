"""Effects built into a tire by changing its construction, not by the terms of the library.

Each design takes the magnitude of the library's effect and gives it as a maker would: a belt whose two plies differ in
width, a tread that thins out towards its edges, plies of another thickness. Three further designs are in no library.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy import sparse

from models.tire.contact import Ground
from models.tire.inflated import Wall
from models.tire.laminate import Ply, abd, pantograph
from models.tire.micromechanics import CordRubber, Orthotropic, isotropic
from models.tire.tire import Tire

OUTSIDE = ("apex", "one_sidewall", "wandering_cords")
"""Designs that no effect of the library describes."""
WIDTHS = (0.38, 0.32)
"""Of the two belt plies, over the meridian."""


def edge(s: np.ndarray, length: float, width: float, ramp: float = 0.04) -> np.ndarray:
    """1 within ``width`` (over the meridian) about the crown, falling smoothly to 0 over ``ramp`` at both edges."""
    outside = (np.abs(s / length - 0.5) - width / 2) / ramp + 0.5
    return 0.5 * (1 + np.cos(np.pi * np.clip(outside, 0.0, 1.0)))


def beside_beads(s: np.ndarray, length: float, reach: float) -> np.ndarray:
    """1 at the beads, falling smoothly to 0 at ``reach`` (over the meridian) from them."""
    return 0.5 * (1 + np.cos(np.pi * np.clip(np.minimum(s, length - s) / (reach * length), 0.0, 1.0)))


@dataclass(frozen=True)
class BuiltTire(Tire):
    """A tire with designs by name and size, in the units of the library's effects.

    Attributes
    ----------
    designs : mapping from str to float
    """

    designs: Mapping[str, float] = field(default_factory=dict)

    def stiffness(self, s: np.ndarray) -> np.ndarray:
        """See `Tire`."""
        length, get = self.profile.length, self.designs.get
        thin = self._thinning(s)
        own = abd(self._carcass(s))
        # A thinner wall by thinner plies: its bending stiffness falls with the cube.
        scale = np.ones((len(s), 6, 6))
        scale[:, :3, :3] = (1 - thin)[:, None, None]
        scale[:, :3, 3:] = scale[:, 3:, :3] = ((1 - thin) ** 2)[:, None, None]
        scale[:, 3:, 3:] = ((1 - thin) ** 3)[:, None, None]
        out = own * scale
        # The share that the wall lacks within 8 % of the meridian, spread over a longer way beside the bead.
        out[:, 3:, 3:] *= (1 - get("soft_bead", 0.0) * beside_beads(s, length, 0.16))[:, None, None]
        if filler := get("apex", 0.0):
            layer = _outside(Ply(filler * 1e-3, 0.0, isotropic(40e6, 0.49)), self.n_plies * self.ply_thickness)
            out = out + beside_beads(s, length, 0.24)[:, None, None] * layer
        for ply, width in zip(self._belt(), WIDTHS, strict=True):
            out = out + edge(s, length, width)[:, None, None] * _outside(ply, self.n_plies * self.ply_thickness)
        if get("tread_layer", 0.0):
            out = out + self._tread(s)
        return out

    def areal_density(self, s: np.ndarray) -> np.ndarray:
        """See `Tire`."""
        length, get = self.profile.length, self.designs.get
        out = self.density * self.n_plies * self.ply_thickness * (1 - self._thinning(s))
        for ply, width in zip(self._belt(), WIDTHS, strict=True):
            out = out + self.density * ply.thickness * edge(s, length, width)
        out = out + self.density * self._tread_thickness(s)
        out = out + self.density * get("apex", 0.0) * 1e-3 * beside_beads(s, length, 0.24)
        # The mass of the tread, more of it in the middle.
        middle = np.abs(s / length - 0.5) / 0.2
        return out + get("crown_mass", 0.0) * 1.3 * np.clip(1 - middle**2, 0.0, None)

    def on_ground(self, pressure: float, n_meridian: int = 41, n_hoop: int = 24) -> Ground:
        """See `Tire`; a grooved tread gives way more at its shoulders than under its centre rib."""
        ground = super().on_ground(pressure, n_meridian, n_hoop)
        size = self.designs.get("tread_compliance", 0.0) * 1e-9
        if not size:
            return ground
        grid = ground.inflated.wall.grid
        across = np.abs(grid.s_node[ground.nodes // grid.n_hoop] / self.profile.length - 0.5) / 0.175
        return replace(ground, compliance=size * (0.85 + 0.4 * np.clip(across, 0.0, 1.0) ** 2))

    def _thinning(self, s: np.ndarray) -> np.ndarray:
        """Share by which the plies are thinner, (n,)."""
        length = self.profile.length
        both = self.designs.get("thin_sidewall", 0.0) * (1 - edge(s, length, 0.37))
        return both + self.designs.get("one_sidewall", 0.0) * (1 - edge(s, length, 0.37)) * (s < length / 2)

    def wall(self, n_meridian: int, n_hoop: int, grading: float = 0.8) -> Wall:
        """See `Tire`; where the pressure is a dead load it is so most beside the beads and least at the crown."""
        wall, size = super().wall(n_meridian, n_hoop, grading), self.designs.get("dead_pressure", 0.0)
        if not size:
            return wall
        grid, curvature = wall.grid, wall.volume.curvature
        # The square root of the share on both sides keeps the potential.
        root = sum(
            take.T
            @ sparse.diags_array(np.repeat(np.sqrt(1 + 0.15 * np.cos(2 * np.pi * s / s[-1])), grid.n_hoop))
            @ take
            for take, s in zip(grid.take, (grid.s_half, grid.s_node, grid.s_node), strict=True)
        )
        return replace(
            wall, volume=replace(wall.volume, curvature=(curvature - size * root @ curvature @ root).tocsr())
        )

    def _carcass(self, s: np.ndarray) -> list[Ply]:
        length, get = self.profile.length, self.designs.get
        angle = pantograph(self.crown_angle, self.crown_radius, np.minimum(self.profile.r(s), self.crown_radius))
        # In the mould cords wander from the pantograph, most where the section is widest.
        angle = angle + np.radians(get("wandering_cords", 0.0)) * np.sin(2 * np.pi * s / length) ** 2
        plies = [self._carcass_ply(k, angle) for k in range(self.n_plies)]
        # Part of the innermost ply lies outermost: of four plies that alternate, half of it leaves no coupling.
        moved = get("uncoupled", 0.0) * self.ply_thickness / 2
        if moved:
            plies = [replace(plies[0], thickness=self.ply_thickness - moved), *plies[1:]]
            plies.append(replace(plies[0], thickness=moved))
        return plies

    def _carcass_ply(self, number: int, angle: np.ndarray) -> Ply:
        one = self.plies.ply(self.rule)
        share = self.designs.get("halpin_tsai", 0.0)
        # Rubber bonded between cords is stiffer across them and in shear, more in shear than the rule says.
        stiffer = CordRubber(
            self.plies.cord_modulus, self.plies.rubber_modulus * (1 + 1.3 * share), self.plies.cord_fraction
        )
        own = stiffer.ply(self.rule) if share else one
        elastic = Orthotropic(one.e1, own.e2, own.g12 * (1 + 0.4 * share), one.nu12)
        return Ply(self.ply_thickness, angle if number % 2 == 0 else -angle, elastic)

    def _belt(self) -> list[Ply]:
        """The two plies of a belt, the outer one narrower; thin ones where there is none."""
        size = max(self.designs.get("belt", 0.0), 1e-9) * 1e-3
        angle = np.radians(self.designs.get("belt_angle", 20.0))
        cords = CordRubber(self.plies.cord_modulus, self.plies.rubber_modulus, self.plies.cord_fraction)
        return [Ply(size, sign * angle, cords.ply(self.rule)) for sign in (1, -1)]

    def _tread_thickness(self, s: np.ndarray) -> np.ndarray:
        """Thinner towards its edges, the mean over its width being the magnitude, m."""
        size, length = self.designs.get("tread_layer", 0.0) * 1e-3, self.profile.length
        return size * 1.2 * edge(s, length, 0.33, 0.08) * (1 - 0.5 * (np.abs(s / length - 0.5) / 0.175) ** 2).clip(0.0)

    def _tread(self, s: np.ndarray) -> np.ndarray:
        """Stiffness of the tread's rubber, which is as stiff as that of the carcass."""
        modulus, base = self.plies.rubber_modulus, self.n_plies * self.ply_thickness
        each = [
            _outside(Ply(t, 0.0, isotropic(modulus, self.plies.rubber_poisson)), base) if t > 1e-6 else np.zeros((6, 6))
            for t in self._tread_thickness(s)
        ]
        return np.stack(each)


def _outside(ply: Ply, carcass: float) -> np.ndarray:
    """Stiffness of a layer outside the carcass about the middle of it, (6, 6)."""
    q, low, high = ply.reduced, carcass / 2, carcass / 2 + ply.thickness
    a, b, d = q * (high - low), q * (high**2 - low**2) / 2, q * (high**3 - low**3) / 3
    return np.block([[a, b], [b, d]])
