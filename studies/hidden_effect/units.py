"""Hung units of the twin: held against rotation, as stiff laterally as vertically.

The library's units rock and are softer laterally, so that the hidden effect differs from its candidate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from calib import Effect, StructuralModel
from calib.structure import Addition, loosened_masses, motion
from models.railway.bogie import UX, UY, UZ
from models.railway.equipment import equipment
from models.railway.vehicle_effects_equipment import UNIT_RATIO

ITEMS = {"hung_converter": "traction converter", "hung_roof_unit": "front roof unit"}


def of_the_twin(library: Sequence[Effect]) -> tuple[Effect, ...]:
    """The library with these units instead of its own."""
    return tuple(_held(effect) if effect.name in ITEMS else effect for effect in library)


def _held(effect: Effect) -> Effect:
    build = partial(_unit, name=effect.name, item=ITEMS[effect.name])
    return replace(
        effect, build=build, nuisance=(), grid=tuple({effect.name: point[effect.name]} for point in effect.grid)
    )


def _unit(model: StructuralModel, name: str, item: str) -> Addition:
    (unit,) = (m for m in equipment().masses if m.name == item)
    rows = [np.sqrt(unit.mass) * motion(model, unit.at, direction) for direction in (UX, UY, UZ)]
    return loosened_masses(rows, name, UNIT_RATIO)
