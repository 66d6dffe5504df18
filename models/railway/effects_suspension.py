"""Effects of primary suspension, wheelsets and connecting rods."""

from __future__ import annotations

from functools import partial

import numpy as np

from calib import Effect, InputError, Parameter, StructuralModel
from calib.structure import (
    Addition,
    Assumption,
    Monomial,
    Place,
    between,
    elongation,
    leaning_masses,
    motion,
    moved_masses,
    outer_term,
    parameter,
    scaled_part,
    soft_mounts,
)
from models.fem.discrete import PointMass
from models.railway.bogie import AXLE_Y, CROSSBAR_X, GIRDER_Y, RY, RZ, SIDES, UX, UY, bogie
from models.railway.effects_richer import gear_case_body

GEAR_CASE, GEAR_CASE_REACH, GEAR_CASE_STRETCHES = "gear case", 0.6, 9
GEAR_CASE_OFF = 0.01
"""Offset in m at which the gear case of the richer effect has half of its distance ahead of the axle."""


_OFFSET = Parameter(
    "gear_case_offset", 0.0, -1e3 * GEAR_CASE_REACH, 1e3 * GEAR_CASE_REACH, "mm", prior_sd=150.0,
    description="place of the gear case across the bogie",
)  # fmt: skip


def suspension_effects() -> tuple[Effect, ...]:
    """Effects of primary springs and dampers, rods, wheelsets and the gear case."""
    return (
        Effect(
            name="primary_uneven",
            title="Primary springs of one corner stiffer or softer",
            phrase="a corner with stiffer or softer primary springs (front left)",
            lacks="All four corners have the same primary springs.",
            look_for="A wrong, broken or shimmed spring at the front left axle box; unequal heights of the corners.",
            magnitude=Parameter(
                "primary_uneven", 0.0, -0.9, 2.0, "-", prior_sd=0.15,
                description="relative change of the front left primary springs",
            ),
            build=_primary_uneven,
        ),
        Effect(
            name="weak_damper",
            title="One primary damper weak",
            phrase="a weak primary damper (front left)",
            lacks="All four primary dampers work alike.",
            look_for="A leaking front left damper: oil on its body, a stroke without resistance by hand.",
            magnitude=Parameter(
                "weak_damper", 0.0, 0.0, 1.0, "-", prior_sd=0.4,
                description="share of its damping that the front left damper has lost",
            ),
            build=_weak_damper,
        ),
        Effect(
            name="damper_mount",
            title="Soft mounts of the primary dampers",
            phrase="soft mounts of the primary dampers",
            lacks="The dampers are fixed rigidly at both ends, so that they dissipate at any frequency.",
            look_for="Soft or worn rubber bushes and thin brackets at the eyes of the primary dampers.",
            magnitude=Parameter(
                "damper_mount", 0.2, 0.2, 5000.0, "mm/MN", prior_sd=200.0,
                description="flexibility in series with each primary damper",
            ),
            build=_damper_mount,
            grid=tuple({"damper_mount": s} for s in (100.0, 200.0, 400.0)),
        ),
        Effect(
            name="wheel_contact",
            title="Unequal wheel-rail contact of the front axle",
            phrase="an unequal wheel-rail contact of the front axle",
            lacks="All wheels stand equally firmly on their rails.",
            look_for="Unequal wheel loads, a gap under a rail pad or dirt on the rail at the front axle.",
            magnitude=Parameter(
                "wheel_contact", 0.0, -0.95, 0.95, "-", prior_sd=0.3,
                description="relative stiffening of the front left contact, and softening of the front right one",
            ),
            build=_wheel_contact,
        ),
        Effect(
            name="rolling_wheels",
            title="Wheels roll as the axles move lengthwise",
            phrase="the rolling of the wheels as the axles move lengthwise",
            lacks="Axles move lengthwise without turning their wheels.",
            look_for="Whether the wheels are free to roll: brakes released, no wedges, clean rails.",
            magnitude=Parameter(
                "rolling_wheels", 0.0, 0.0, 1.3, "-", prior_sd=0.5,
                description="share of the wheels' polar inertia that turns with the lengthwise motion",
            ),
            build=_rolling_wheels,
        ),
        Effect(
            name="gear_case_offset",
            title="Gear case off the middle of the front axle",
            phrase="the offset of the gear case from the middle of the front axle",
            lacks="The gear case sits in the middle of the axle.",
            look_for="Where the gear case really sits: measure from either wheel, to the left positive.",
            magnitude=_OFFSET,
            build=_gear_case_offset,
            richer=gear_case_body(_OFFSET, _gear_case_body),
        ),
        Effect(
            name="torque_link",
            title="Torque link between gear case and front crossbar",
            phrase="a torque link between gear case and front crossbar",
            lacks="The gear case touches nothing but the axle.",
            look_for="A reaction link with rubber bushes between gear case and front crossbar.",
            magnitude=Parameter(
                "torque_link", 0.0, 0.0, 10_000.0, "kN/m", prior_sd=300.0, description="its vertical stiffness"
            ),
            build=_torque_link,
        ),
        Effect(
            name="rod_damping",
            title="Rubber bushes of the connecting rods dissipate",
            phrase="damping in the rubber bushes of the connecting rods",
            lacks="The connecting rods are elastic without loss.",
            look_for="Warm, cracked or oil-soaked rubber bushes at the ends of the connecting rods.",
            magnitude=Parameter(
                "rod_damping", 0.0, 0.0, 50.0, "kNs/m", prior_sd=2.0, description="damping along each rod"
            ),
            build=_rod_damping,
        ),
        Effect(
            name="stiff_bushes",
            title="Bushes of the connecting rods resist turning",
            phrase="the resistance to turning of the bushes of the connecting rods",
            lacks="The connecting rods carry force along their own line only, as between frictionless hinges.",
            look_for="Seized or over-tightened joints and wide rubber bushes at the ends of the connecting rods.",
            magnitude=Parameter(
                "stiff_bushes", 0.0, 0.0, 500.0, "kNm/rad", prior_sd=15.0,
                description="stiffness of each bush against turning about the transverse axis",
            ),
            build=_stiff_bushes,
        ),
    )  # fmt: skip


def _primary_uneven(model: StructuralModel) -> Addition:
    return Addition(stiffness=(scaled_part(model, "stiffness", "primary springs front left", "primary_uneven"),))


def _weak_damper(model: StructuralModel) -> Addition:
    return Addition(damping=(scaled_part(model, "damping", "primary damper front left", "weak_damper", -1.0),))


def _wheel_contact(model: StructuralModel) -> Addition:
    return Addition(
        stiffness=tuple(
            scaled_part(model, "stiffness", f"wheel-rail contact front {side}", "wheel_contact", sign)
            for side, sign in SIDES
        )
    )


def _damper_mount(model: StructuralModel) -> Addition:
    rows = [elongation(model, d.end, d.other) for d in bogie(1.0).dampers if d.other is not None]
    return soft_mounts(rows, "c_primary", "damper_mount")


def _rolling_wheels(model: StructuralModel) -> Addition:
    """Rolling couples a wheel's rotation to its motion, ``ux = r rz``: its polar inertia acts as a mass ``J/r^2``."""
    wheels = [m for m in bogie(1.0).masses if m.name.startswith("wheel ")]
    rows = [np.sqrt(m.inertia[2]) / AXLE_Y * motion(model, m.at, UX) for m in wheels]
    return Addition(mass=(outer_term("rolling_wheels", rows, parameter("rolling_wheels")),))


def _gear_case_offset(model: StructuralModel) -> Addition:
    case = _gear_case(model)
    return Addition(
        mass=moved_masses(partial(_carried, model, case), "gear_case_offset", GEAR_CASE_REACH, GEAR_CASE_STRETCHES)
    )


def _gear_case_body(model: StructuralModel, offset: str, ahead: str) -> Addition:
    case = _gear_case(model)
    return Addition(
        mass=leaning_masses(
            partial(_carried, model, case), partial(_ahead, model, case), offset, ahead, GEAR_CASE_REACH,
            GEAR_CASE_STRETCHES, GEAR_CASE_OFF,
        )
    )  # fmt: skip


def _gear_case(model: StructuralModel) -> PointMass:
    """The gear case of this model: at one point or distributed along the axle."""
    (part,) = (p for p in model.parts if p.name == GEAR_CASE)
    for distributed in (False, True):
        (case,) = (m for m in bogie(1.0, distributed).masses if m.name == GEAR_CASE)
        gap = outer_term(GEAR_CASE, list(_carried(model, case, 0.0)), Monomial()).matrix - part.matrix
        if abs(gap).max() <= 1e-9 * abs(part.matrix).max():
            return case
    raise InputError("the model's gear case is not the bogie's", place="effect gear_case_offset")


def _carried(model: StructuralModel, case: PointMass, shift: float) -> np.ndarray:
    """Motions of the gear case when it is shifted across the bogie, each times the root of its inertia."""
    return np.array(
        [
            np.sqrt(weight / len(case.spread)) * motion(model, (case.at[0], (x, y, z + shift)), direction)
            for x, y, z in (np.array(case.at[1]) + case.spread).tolist()
            for direction, weight in enumerate((case.mass,) * 3 + case.inertia)
        ]
    )


def _ahead(model: StructuralModel, case: PointMass, shift: float) -> np.ndarray:
    """Motions of `_carried` per metre that the gear case's centre lies ahead of the axle: rotations move it."""
    per_piece = [
        [np.zeros(model.n_dof), motion(model, place, RZ), -motion(model, place, RY), *np.zeros((3, model.n_dof))]
        for place in ((case.at[0], (x, y, z + shift)) for x, y, z in (np.array(case.at[1]) + case.spread).tolist())
    ]
    return float(np.sqrt(case.mass / len(case.spread))) * np.array([row for piece in per_piece for row in piece])


def _torque_link(model: StructuralModel) -> Addition:
    end, other = (CROSSBAR_X, AXLE_Y, 0.0), (CROSSBAR_X, GIRDER_Y, 0.0)
    row = elongation(model, ("axle_front", end), ("crossbar", other))
    return Addition(
        stiffness=(outer_term("torque_link", [row], parameter("torque_link")),),
        assumptions=(Assumption("torque link: x, z", f"{CROSSBAR_X}, 0", "m", "below the front crossbar"),),
    )


def _rod_damping(model: StructuralModel) -> Addition:
    rows = [elongation(model, box, bracket) for box, bracket in _rods()]
    return Addition(damping=(outer_term("rod_damping", rows, parameter("rod_damping")),))


def _stiff_bushes(model: StructuralModel) -> Addition:
    """Both ends of a rod rotate against its axis, whose slope is the relative transverse motion over its length."""
    rows = []
    for box, bracket in _rods():
        x, y, _ = np.subtract(bracket[1], box[1]).tolist()
        across = [between(model, bracket, box, direction) for direction in (UX, UY)]
        slope = (x * across[1] - y * across[0]) / (x**2 + y**2)
        rows += [slope - motion(model, end, RZ) for end in (box, bracket)]
    return Addition(stiffness=(outer_term("stiff_bushes", rows, parameter("stiff_bushes")),))


def _rods() -> list[tuple[Place, Place]]:
    """Ends of all connecting rods at the axle box and at the bracket on the girder."""
    springs = bogie(1.0).springs
    return [(s.end, s.other) for s in (*springs["rod_upper"], *springs["rod_lower"]) if s.other is not None]
