"""Richer members of effects of the bogie: units that give in every direction, masses of some size off their axis."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from calib import Effect, Parameter, StructuralModel
from calib.structure import Addition, Assumption, Place, fixed_body, motion, mounted_body, mounted_mass
from models.railway.bogie import UY

UNIT_MOUNTS = np.array([(x, 0.0, z) for x in (0.1, -0.1) for z in (0.15, -0.15)])
"""Mounts of the brake unit relative to where it hangs, m: four on a plate of 0.2 m by 0.3 m."""


_SIDEWAYS, _RATIO = "brake_unit_sideways", "brake_unit_ratio"


def _mass(name: str, lower: float, upper: float, prior_sd: float, description: str) -> Parameter:
    return Parameter(name, lower, lower, upper, "kg", prior_sd=prior_sd, description=description)


def _sideways(name: str) -> Parameter:
    return Parameter(
        name, 3.0, 0.5, 30.0, "-", prior_sd=5.0,
        description="lateral over upright natural frequency; 0.8 for bare rubber, far more for a guided unit",
    )  # fmt: skip


def _ratio(name: str, nominal: float) -> Parameter:
    return Parameter(
        name, nominal, 0.002, 0.4, "-", prior_sd=nominal,
        description="damping ratio of the unit on its mounts; 0.02 for natural rubber, 0.1 for a lossy one",
    )  # fmt: skip


def _lower(name: str, what: str, sd: float) -> Parameter:
    return Parameter(name, 0.0, -4 * sd, 4 * sd, "m", prior_sd=sd, description=f"its centre below {what}")


def _radius(name: str, sd: float) -> Parameter:
    return Parameter(name, sd, 0.1 * sd, 5 * sd, "m", prior_sd=sd, description="its radius of gyration about any axis")


def brake_unit_on_mounts(place: Place, freq: Parameter, damping_ratio: float) -> Effect:
    """The brake unit as a mass that gives in three directions; richer still, as a body that rocks on its mounts.

    ``freq`` is the parameter of its upright natural frequency, which means the same in both.
    """
    body, mounts = "brake_unit_body", "brake_unit_mounts"
    shared = (freq, _sideways(_SIDEWAYS), _ratio(_RATIO, damping_ratio))
    own = {freq.name: freq.value, _RATIO: damping_ratio}
    rocking = Effect(
        name=body,
        title="Brake unit that rocks on its mounts on the front crossbar",
        phrase="a brake unit that moves and rocks on its mounts on the front crossbar",
        lacks="Everything on the crossbars moves rigidly with them.",
        look_for="A brake unit on rubber mounts at the left of the front crossbar: its centre, how it rocks.",
        magnitude=_mass(body, 0.1, 500.0, 80.0, "mass of the unit"),
        build=partial(_rocking, place, body, freq.name),
        nuisance=(*shared, _lower(f"{body}_lower", "its mounts", 0.1),
                  _radius(f"{body}_radius", 0.12)),
        grid=tuple(
            {**own, body: 80.0, _SIDEWAYS: side, f"{body}_lower": low,
             f"{body}_radius": 0.12}
            for side, low in ((0.8, 0.1), (3.0, 0.1), (10.0, 0.1), (3.0, -0.1))
        ),
    )  # fmt: skip
    return Effect(
        name=mounts,
        title="Brake unit that gives in three directions on the front crossbar",
        phrase="a brake unit that gives in three directions on its mounts on the front crossbar",
        lacks="Everything on the crossbars moves rigidly with them.",
        look_for="A brake unit on rubber mounts at the left of the front crossbar: tap it along and across, with an "
        "accelerometer on it.",
        magnitude=_mass(mounts, 0.1, 500.0, 80.0, "mass of the unit"),
        build=partial(_on_mounts, place, mounts, freq.name),
        nuisance=shared,
        grid=tuple({**own, mounts: 80.0, _SIDEWAYS: side} for side in (0.8, 1.5, 3.0, 10.0)),
        richer=rocking,
    )


def crossbar_body(place: Place) -> Effect:
    """The unmodelled mass of the crossbar as a body of some size, its centre off the crossbar's axis."""
    name = "crossbar_body"
    return Effect(
        name=name,
        title="Unmodelled body off the axis of the front crossbar",
        phrase="a body off the axis at the middle of the front crossbar",
        lacks="The additional mass of the crossbars is spread evenly along their axes.",
        look_for="Brackets, ballast or test equipment on top of the middle of the front crossbar or below it.",
        magnitude=Parameter(name, 0.0, 0.0, 600.0, "kg", prior_sd=100.0, description="mass of it"),
        build=partial(_fixed, place, name),
        nuisance=(_lower(f"{name}_lower", "the axis", 0.2), _radius(f"{name}_radius", 0.15)),
        grid=tuple({name: 100.0, f"{name}_lower": low, f"{name}_radius": 0.15} for low in (-0.2, 0.2)),
    )


def gear_case_body(offset: Parameter, build: Callable[[StructuralModel, str, str], Addition]) -> Effect:
    """The gear case off the middle of its axle, and its centre ahead of the axle.

    Parameters
    ----------
    offset : Parameter
        The magnitude of the listed effect: the place across the bogie, which means the same in both.
    build : callable
        Gives the addition of a model and the names of the offset and of the distance ahead.
    """
    name, ahead = "gear_case_body", "gear_case_ahead"
    return Effect(
        name=name,
        title="Gear case off the middle of the front axle, its centre ahead of it",
        phrase="a gear case off the middle of the front axle whose centre lies ahead of the axle",
        lacks="The gear case sits in the middle of the axle, its centre on the axle.",
        look_for="Where the gear case really sits, and how far the pinion and its housing reach ahead of the axle.",
        magnitude=replace(offset, name=name),
        build=partial(build, offset=name, ahead=ahead),
        nuisance=(
            Parameter(
                ahead, 0.0, -0.5, 0.5, "m", prior_sd=0.15,
                description="its centre ahead of the axle, away from the crossbar; behind it negative",
            ),
        ),
        grid=tuple({name: s * offset.prior_width, ahead: a} for s in (1.0, -1.0) for a in (-0.15, 0.15)),
    )  # fmt: skip


def _carrier(model: StructuralModel, place: Place) -> np.ndarray:
    return np.array([motion(model, place, direction) for direction in range(6)])


def _assuming(addition: Addition, place: Place, *more: Assumption) -> Addition:
    x, y, z = place[1]
    here = Assumption("brake unit: x, y, z", f"{x}, {y}, {z}", "m", "where such parts usually sit")
    return replace(addition, assumptions=(*addition.assumptions, here, *more))


def _on_mounts(place: Place, name: str, freq: str, model: StructuralModel) -> Addition:
    return _assuming(mounted_mass(_carrier(model, place)[:3], UY, name, freq, _SIDEWAYS, _RATIO), place)


def _rocking(place: Place, name: str, freq: str, model: StructuralModel) -> Addition:
    hung = mounted_body(
        _carrier(model, place), UY, UNIT_MOUNTS, name, freq, _SIDEWAYS, f"{name}_lower", f"{name}_radius", _RATIO
    )
    along, _, across = np.ptp(UNIT_MOUNTS, axis=0)
    size = Assumption("brake unit: mounts along and across", f"{along:g}, {across:g}", "m", "size of such units")
    return _assuming(hung, place, size)


def _fixed(place: Place, name: str, model: StructuralModel) -> Addition:
    return fixed_body(_carrier(model, place), UY, name, f"{name}_lower", f"{name}_radius")
