"""Effects of equipment and seats of the vehicle: soft mounts, and places off the middle of the car."""

from __future__ import annotations

from dataclasses import replace
from functools import partial

import numpy as np

from calib import Effect, InputError, Parameter, StructuralModel
from calib.structure import Addition, Assumption, MountedBody, loosened_masses, motion, moved_masses
from models.railway.bogie import RX, RY, RZ, UX, UY, UZ
from models.railway.equipment import SEAT_X, SEAT_Z, UNDER_FLOOR, equipment, passenger_seats
from models.railway.vehicle_effects_richer import loosened_two_ways, swaying_seats, uneven_unit

UNIT_RATIO, SEAT_RATIO = 0.03, 0.07
SIDEWAYS = 0.7
"""Lateral over vertical stiffness of rubber mounts."""
RATIO_SD, SIDEWAYS_SD, DROP_SD = 0.015, 0.2, 0.15
"""Prior standard deviations: damping ratio, lateral over vertical stiffness, height of the centre in m."""
BOXES = {"traction converter": (2.4, 0.7, 1.8), "front roof unit": (2.4, 0.3, 1.8)}
"""Sides along x, y and z in m of boxes of uniform density with the rotary inertia of the units."""
OFFSET_REACH, CARRYING = 0.4, "floor_beam"
SEAT_WAVES = 4
"""Largest degree of the polynomials along the car in which seats move; across it, in phase or antiphase."""

_BOX = "just beyond its feet, as high as there is room"
_SAG = "static deflection of its mounts under its own weight; 1 mm is 15.8 Hz, 4 mm 7.9 Hz"


_SEATS = Parameter(
    "soft_seats", 0.005, 0.005, 8.0, "mm", prior_sd=0.8,
    description="static deflection of a seat's frame under its own weight; 0.5 mm is 22 Hz, 4 mm 7.9 Hz",
)  # fmt: skip


def equipment_effects() -> tuple[Effect, ...]:
    """Effects of equipment and seats."""
    return (
        _hung(
            "hung_converter", "traction converter", (-0.4, 0.4),
            title="Traction converter hung elastically",
            phrase="a traction converter hung elastically",
            lacks="The traction converter under the floor moves rigidly with its feet.",
            look_for="Rubber mounts between the traction converter and the floor; a gap that closes when it is lifted.",
        ),
        _hung(
            "hung_roof_unit", "front roof unit", (-0.2, 0.3),
            title="Front roof unit on soft mounts",
            phrase="soft mounts of the front roof unit",
            lacks="The roof units move rigidly with their feet.",
            look_for="Rubber mounts under the front roof unit, usually an air conditioner with its compressor.",
        ),
        Effect(
            name="soft_seats",
            title="Passenger seats bounce on the floor",
            phrase="passenger seats that bounce on the floor",
            lacks="The seats move rigidly with the floor.",
            look_for="Light seat frames on few fixings: push a seat down, let go and watch it.",
            magnitude=_SEATS,
            build=_soft_seats,
            richer=swaying_seats(_SEATS, SEAT_RATIO, _swaying_seats),
            grid=tuple({"soft_seats": sag} for sag in (0.1, 0.3, 0.5, 1.0, 1.7, 3.1, 5.9)),
        ),
        Effect(
            name="equipment_offset",
            title="Under-floor equipment off the middle",
            phrase="an offset of the under-floor equipment from the middle",
            lacks="Everything under the floor sits in the middle of the car.",
            look_for="Where the heavy units really hang, to the left positive; unequal wheel loads left and right.",
            magnitude=Parameter(
                "equipment_offset", 0.0, -1e3 * OFFSET_REACH, 1e3 * OFFSET_REACH, "mm", prior_sd=100.0,
                description="place across the car of everything that hangs under its floor",
            ),
            build=_equipment_offset,
        ),
    )  # fmt: skip


def _hung(
    name: str, item: str, drop: tuple[float, float], title: str, phrase: str, lacks: str, look_for: str
) -> Effect:
    """A unit on elastic mounts at its feet; its centre may be lower than in the model, within ``drop`` in m."""
    told = {"title": title, "phrase": phrase, "lacks": lacks, "look_for": look_for}
    magnitude = Parameter(name, 0.01, 0.01, 16.0, "mm", prior_sd=1.5, description=_SAG)
    nuisance = (
        Parameter(
            f"{name}_drop",
            0.0,
            *drop,
            "m",
            prior_sd=DROP_SD,
            description="height by which its centre is lower than in the model",
        ),
        Parameter(
            f"{name}_sideways",
            SIDEWAYS,
            0.3,
            1.5,
            "-",
            prior_sd=SIDEWAYS_SD,
            description="lateral over vertical stiffness of its mounts",
        ),
        Parameter(
            f"{name}_damping",
            UNIT_RATIO,
            0.005,
            0.15,
            "-",
            prior_sd=RATIO_SD,
            description="vertical damping ratio of its mounts",
        ),
    )
    return Effect(
        name=name,
        magnitude=magnitude,
        build=partial(_unit, name=name, item=item, mounts=name),
        nuisance=nuisance,
        grid=tuple(
            {name: sag, f"{name}_drop": 0.0, f"{name}_sideways": SIDEWAYS, f"{name}_damping": UNIT_RATIO}
            for sag in (0.1, 0.3, 0.8, 1.7, 3.9, 7.9)
        ),
        richer=uneven_unit(
            told, name.replace("hung", "uneven"), magnitude, nuisance, partial(_unit, item=item, mounts=name)
        ),
        **told,
    )  # fmt: skip


def _unit(
    model: StructuralModel, name: str, item: str, mounts: str, inertia: str = "", uneven: str = ""
) -> Addition:  # fmt: skip
    """The unit of that name; ``mounts`` starts the names of the parameters that all members of its family have."""
    fitted = equipment()
    (unit,) = (m for m in fitted.masses if m.name == item)
    (rbe3,) = (s for s in fitted.rbe3s if s.name == item)
    box = BOXES[item]
    x, y, z = ((np.sum(np.square(box)) - np.square(box)) / 12).tolist()
    body = MountedBody(unit.mass, np.subtract(rbe3.feet, unit.at[1]), UY, (x, y, z))
    carrier = np.array([motion(model, unit.at, direction) for direction in (UX, UY, UZ, RX, RY, RZ)])
    shared = (f"{mounts}_drop", f"{mounts}_sideways", f"{mounts}_damping")
    loose = body.let_go(carrier, name, *shared, inertia, uneven)
    assumed = (
        Assumption(f"{item}: damping ratio on its mounts", f"{UNIT_RATIO} +- {RATIO_SD}", "-", "rubber"),
        Assumption(f"{item}: mounts", "at its feet", "-", "as in the model"),
        Assumption(f"{item}: sides of a box of its rotary inertia", ", ".join(f"{c:g}" for c in box), "m", _BOX),
        Assumption(
            f"{item}: its centre lower than in the model", f"0 +- {DROP_SD}", "m", "its mass distribution is unknown"
        ),
        Assumption(
            f"{item}: mounts, lateral over vertical stiffness", f"{SIDEWAYS} +- {SIDEWAYS_SD}", "-", "rubber blocks"
        ),
    )
    return replace(loose, assumptions=assumed)


def _soft_seats(model: StructuralModel) -> Addition:
    loose = loosened_masses(list(_seats(model, UY)), "soft_seats", SEAT_RATIO)
    assumed = (Assumption("seats: damping ratio on the floor", f"{SEAT_RATIO}", "-", "as seats that are sprung"),)
    return Addition(loose.stiffness, loose.damping, loose.mass, loose.selected, loose.n_added, assumed)


def _swaying_seats(model: StructuralModel, name: str, sideways: str, ratio: str) -> Addition:
    return loosened_two_ways(_seats(model, UY), _seats(model, UZ), name, sideways, ratio)


def _seats(model: StructuralModel, direction: int) -> np.ndarray:
    """All seats together in a few smooth patterns: separately they would add 60 modes at one frequency."""
    if "seats.y" in model.clusters:
        raise InputError(
            "the model's seats are sprung already", place="seats", remedy='set seats = "rigid" in model_options'
        )
    along, across = (np.array(c) / max(c) for c in (SEAT_X, SEAT_Z))
    patterns = np.kron(np.polynomial.legendre.legvander(along, SEAT_WAVES), np.vander(across, 2))
    masses = passenger_seats(sprung=False).masses
    seats = np.array([np.sqrt(m.mass) * motion(model, m.at, direction) for m in masses])
    return np.asarray(np.linalg.qr(patterns)[0].T @ seats)


def _equipment_offset(model: StructuralModel) -> Addition:
    """All feet are shifted across the car, along the cross-beams that they stand on."""
    under, fitted = {item.name for item in UNDER_FLOOR}, equipment()
    rbe3s = {rbe3.name: rbe3 for rbe3 in fitted.rbe3s}

    def carried(shift: float) -> np.ndarray:
        rows: list[np.ndarray] = []
        for unit in fitted.masses:
            if unit.name in under:
                old = rbe3s[unit.name]
                moved = replace(old, feet=tuple((x, y, z + shift) for x, y, z in old.feet))
                feet = np.array([[motion(model, (CARRYING, foot), d) for d in (UX, UY, UZ)] for foot in moved.feet])
                centre = np.add(unit.at[1], (0.0, 0.0, shift))
                rows += list(np.sqrt(unit.mass) * moved.follow(feet, centre)[:3])
        return np.array(rows)

    return Addition(mass=moved_masses(carried, "equipment_offset", OFFSET_REACH, 5))
