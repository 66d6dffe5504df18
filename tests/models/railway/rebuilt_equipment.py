"""The vehicle's equipment with each of its effects modelled as bodies on mounts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import product

import numpy as np

from calib import StructuralModel
from calib.structure import GRAVITY
from models.fem.discrete import PointMass, Spring
from models.fem.member import Particle, Point, Suppression
from models.fem.rbe3 import Rbe3
from models.railway.bogie import RX, RY, RZ, UY
from models.railway.equipment import UNDER_FLOOR
from models.railway.vehicle import Assembly
from models.railway.vehicle_effects_equipment import SEAT_RATIO
from tests.models.railway.rebuilding import (
    RIGID,
    Values,
    rebuilt,
    with_springs,
)

UNIT_BOXES = {"traction converter": (2.4, 0.7, 1.8), "front roof unit": (2.4, 0.3, 1.8)}
"""Sides along x, y and z in m of hung units, even boxes."""


def hung(
    v: Values, refine: int, name: str, item: str, box: Sequence[float] | None = None, distributed: bool = False
) -> StructuralModel:
    """A unit as a rigid body that shifts and turns, each of its feet on a spring and a damper in every direction.

    Mounts stand on what carries them foot by foot, so that they also hold it against warping.
    """
    omega = float(np.sqrt(GRAVITY / (v[name] * 1e-3)))
    # An even box turns as eight corners do of one that is smaller by the root of 3.
    corners = np.array(list(product((0.5, -0.5), repeat=3))) * (box or UNIT_BOXES[item]) / np.sqrt(3)

    def change(whole: Assembly) -> Assembly:
        (old,) = (m for m in whole.masses if m.name == item)
        (rbe3,) = (s for s in whole.structure.rbe3s if s.name == item)
        centre = (old.at[1][0], old.at[1][1] - v[f"{name}_drop"], old.at[1][2])
        mass = PointMass(("unit", centre), old.mass, spread=tuple(map(tuple, corners.tolist())), name=item)
        springs, dampers = [], []
        for foot in rbe3.feet:
            for d, unit in enumerate(np.eye(3).tolist()):
                part = old.mass / len(rbe3.feet) * (1.0 if d == UY else v[f"{name}_sideways"])
                mount = Spring(("unit", foot), (rbe3.on, foot), tuple(unit))
                springs.append(replace(mount, weight=omega**2 * part))
                dampers.append(replace(mount, weight=2 * v[f"{name}_damping"] * omega * part))
        structure = replace(whole.structure, particles=(*whole.structure.particles, Particle("unit", "unit", centre)))
        masses = tuple(mass if m is old else m for m in whole.masses)
        return with_springs(replace(whole, structure=structure, masses=masses), springs, dampers)

    return rebuilt(change, refine, distributed)


def sprung_seats(v: Values, refine: int) -> StructuralModel:
    """Sixty oscillators: bodies of their own on mounts that give upright."""
    omega, units = float(np.sqrt(GRAVITY / (v["soft_seats"] * 1e-3))), np.eye(3).tolist()

    def change(whole: Assembly) -> Assembly:
        bodies, masses, springs, dampers = [], [], [], []
        for k, m in enumerate(whole.masses):
            if not m.name.startswith("seats"):
                masses.append(m)
                continue
            body = f"seat_{k}"
            bodies.append(Particle(body, "let go", m.at[1]))
            masses.append(replace(m, at=(body, m.at[1])))
            for d, unit in enumerate(units):
                mount = Spring((body, m.at[1]), m.at, tuple(unit))
                springs.append(replace(mount, weight=omega**2 * m.mass if d == UY else RIGID))
                dampers += [replace(mount, weight=2 * SEAT_RATIO * omega * m.mass)] if d == UY else []
        structure = replace(
            whole.structure,
            particles=(*whole.structure.particles, *bodies),
            suppressions=(*whole.structure.suppressions, Suppression((RX, RY, RZ), groups=("let go",))),
        )
        return with_springs(replace(whole, structure=structure, masses=tuple(masses)), springs, dampers)

    return rebuilt(change, refine)


def moved_equipment(v: Values, refine: int) -> StructuralModel:
    """Everything under the floor on feet elsewhere on the cross-beams."""
    shift, under = v["equipment_offset"] * 1e-3, {item.name for item in UNDER_FLOOR}

    def aside(p: Point) -> Point:
        return (p[0], p[1], p[2] + shift)

    def change(whole: Assembly) -> Assembly:
        rbe3s = tuple(
            Rbe3(s.name, "floor_beam", tuple(aside(f) for f in s.feet)) if s.name in under else s
            for s in whole.structure.rbe3s
        )
        masses = tuple(replace(m, at=(m.at[0], aside(m.at[1]))) if m.name in under else m for m in whole.masses)
        return replace(whole, structure=replace(whole.structure, rbe3s=rbe3s), masses=masses)

    return rebuilt(change, refine)
