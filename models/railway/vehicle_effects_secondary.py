"""Effects of the vehicle's secondary suspension and of the pads between bolsters and floor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib import Effect, Parameter, StructuralModel
from calib.structure import (
    Addition,
    Assumption,
    between,
    elongation,
    maxwell_branches,
    outer_term,
    parameter,
    scaled_part,
    soft_mounts,
)
from models.fem.discrete import Spring
from models.railway.bogie import ENDS, SIDES, UY
from models.railway.bolsters import LOAD_BOLSTER_TIP, LOAD_BOLSTER_Y
from models.railway.running_gear import RunningGear, running_gear
from models.railway.vehicle import BOGIES
from models.railway.vehicle_effects_richer import surging_spring


def secondary_effects() -> tuple[Effect, ...]:
    """Effects of secondary springs and dampers, yaw dampers and floor pads."""
    air_spring = Effect(
        name="air_spring",
        title="Air springs beside the secondary springs",
        phrase="air springs beside the secondary springs",
        lacks="The secondary suspension has springs with dampers beside them, but none in series.",
        look_for="Air bellows with a reservoir behind an orifice or a long pipe at the secondary springs.",
        magnitude=Parameter(
            "air_spring", 0.0, 0.0, 3000.0, "kN/m", prior_sd=150.0,
            description="stiffness added to each side of a bogie when the orifice is blocked",
        ),
        build=_air_spring,
        nuisance=(
            Parameter(
                "air_spring_freq", 1.5, 0.2, 10.0, "Hz", prior_sd=1.5,
                description="frequency at which the orifice is as stiff as the added stiffness",
            ),
        ),
        grid=tuple({"air_spring": 150.0, "air_spring_freq": f} for f in (0.4, 1.5, 5.0)),
    )  # fmt: skip
    return (
        Effect(
            name="anti_roll_bar",
            title="Anti-roll bars between frames and bolsters",
            phrase="anti-roll bars between frames and bolsters",
            lacks="Frame and load bolster roll against each other on the secondary springs alone.",
            look_for="A torsion bar with levers and links between each bogie frame and its bolster.",
            magnitude=Parameter(
                "anti_roll_bar", 0.0, 0.0, 20.0, "MNm/rad", prior_sd=0.4,
                description="stiffness of one bar against roll, one in each bogie",
            ),
            build=_anti_roll_bar,
        ),
        Effect(
            name="damper_asymmetry",
            title="Secondary dampers uneven left and right",
            phrase="secondary dampers that are uneven left and right",
            lacks="All secondary dampers work alike.",
            look_for="Leaking or wrong dampers on one side of the car; oil on a body, a stroke without resistance.",
            magnitude=Parameter(
                "damper_asymmetry", 0.0, -1.0, 1.0, "-", prior_sd=0.3,
                description="relative gain of the secondary dampers on the left, and loss of those on the right",
            ),
            build=_damper_asymmetry,
        ),
        Effect(
            name="secondary_asymmetry",
            title="Secondary springs of the front bogie uneven left and right",
            phrase="secondary springs of the front bogie that are uneven left and right",
            lacks="The secondary springs of a bogie are alike.",
            look_for="Wrong, broken or shimmed springs; unequal heights of the load bolster left and right.",
            magnitude=Parameter(
                "secondary_asymmetry", 0.0, -0.9, 0.9, "-", prior_sd=0.1,
                description="relative gain of the front bogie's left springs, and loss of its right ones",
            ),
            build=_secondary_asymmetry,
        ),
        replace(air_spring, richer=surging_spring(air_spring, _bellows)),
        Effect(
            name="yaw_damper_mount",
            title="Soft mounts of the yaw dampers",
            phrase="soft mounts of the yaw dampers",
            lacks="The yaw dampers are fixed rigidly to bracket and floor.",
            look_for="Soft or worn rubber bushes at the eyes of the yaw dampers.",
            magnitude=Parameter(
                "yaw_damper_mount", 0.2, 0.2, 2000.0, "mm/MN", prior_sd=60.0,
                description="flexibility in series with each yaw damper",
            ),
            build=_yaw_damper_mount,
            grid=tuple({"yaw_damper_mount": s} for s in (30.0, 60.0, 150.0)),
        ),
        Effect(
            name="soft_pads",
            title="Floor pads on the left softer",
            phrase="softer floor pads on the left",
            lacks="All pads between tilting bolsters and floor are alike.",
            look_for="Aged, oil-soaked or wrong rubber pads on the left of the car.",
            magnitude=Parameter(
                "soft_pads", 0.0, 0.0, 0.95, "-", prior_sd=0.25,
                description="share of the stiffness that the pads on the left have lost",
            ),
            build=_soft_pads,
        ),
        Effect(
            name="pad_damping",
            title="Floor pads dissipate",
            phrase="damping in the floor pads",
            lacks="The pads between tilting bolsters and floor are elastic without loss.",
            look_for="Loss angle of the pads' rubber from the supplier; pads that are warm after running.",
            magnitude=Parameter(
                "pad_damping", 0.0, 0.0, 200.0, "kNs/m", prior_sd=5.0, description="vertical damping of one pad"
            ),
            build=_pad_damping,
        ),
    )  # fmt: skip


def _anti_roll_bar(model: StructuralModel) -> Addition:
    rows = []
    for bogie, x in BOGIES:
        left, right = _sides(model, bogie, x)
        rows.append((left - right) / (2 * LOAD_BOLSTER_TIP))
    return Addition(stiffness=(outer_term("anti_roll_bar", rows, parameter("anti_roll_bar")),))


def _bellows(model: StructuralModel) -> list[np.ndarray]:
    """Elongations of all air springs."""
    return [side for bogie, x in BOGIES for side in _sides(model, bogie, x)]


def _air_spring(model: StructuralModel) -> Addition:
    branches = maxwell_branches(_bellows(model), "air_spring", "air_spring_freq")
    assumed = (Assumption("air springs: one a side, between frame and load bolster", "at their middle", "-", "usual"),)
    return Addition(branches.stiffness, branches.damping, branches.mass, branches.selected, branches.n_added, assumed)


def _sides(model: StructuralModel, bogie: str, x: float) -> list[np.ndarray]:
    """Vertical motion of a bogie's load bolster relative to the frame, left and right."""
    places = [(x, LOAD_BOLSTER_Y, s * LOAD_BOLSTER_TIP) for _, s in SIDES]
    return [between(model, (f"{bogie}_load_bolster", p), (f"{bogie}_frame", p), UY) for p in places]


def _damper_asymmetry(model: StructuralModel) -> Addition:
    return Addition(
        damping=tuple(
            scaled_part(model, "damping", f"{bogie} bogie, secondary damper {end} {side}", "damper_asymmetry", sign)
            for bogie, _ in BOGIES
            for end, _ in ENDS
            for side, sign in SIDES
        )
    )


def _secondary_asymmetry(model: StructuralModel) -> Addition:
    return Addition(
        stiffness=tuple(
            scaled_part(model, "stiffness", f"front bogie, secondary spring {end} {side}", "secondary_asymmetry", sign)
            for end, _ in ENDS
            for side, sign in SIDES
        )
    )


def _yaw_damper_mount(model: StructuralModel) -> Addition:
    return soft_mounts(
        [_stretch(model, damper) for gear in _gears() for damper in gear.dampers["yaw"]], "c_yaw", "yaw_damper_mount"
    )


def _soft_pads(model: StructuralModel) -> Addition:
    return Addition(
        stiffness=tuple(
            scaled_part(model, "stiffness", f"{bogie} bogie, floor pad {end} left", "soft_pads", -1.0)
            for bogie, _ in BOGIES
            for end, _ in ENDS
        )
    )


def _pad_damping(model: StructuralModel) -> Addition:
    pads = [s for gear in _gears() for s in gear.springs["floor_fixed"] if "floor pad" in s.name]
    rows = [_stretch(model, pad) for pad in pads]
    return Addition(damping=(outer_term("pad_damping", rows, parameter("pad_damping")),))


def _gears() -> list[RunningGear]:
    return [running_gear(name, x, 1.0) for name, x in BOGIES]


def _stretch(model: StructuralModel, spring: Spring) -> np.ndarray:
    """Elongation of a spring or damper between two parts."""
    assert spring.other is not None
    return elongation(model, spring.end, spring.other)
