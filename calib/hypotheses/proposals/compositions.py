"""Compositions for the tests of a model, and the search for the one that explains best."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calib.hypotheses.proposals.composition import Composition, Names
from calib.hypotheses.proposals.part_compositions import of_function, of_joints, of_mounts, of_parts, of_supports
from calib.hypotheses.proposals.point_compositions import further_spots, heavy, held_at, hung_at, moving, of_sensors
from calib.hypotheses.proposals.proposal import HungBy
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.modal import DIRECTIONS, MeasuredModes, Sensor
from calib.problem.effect import Effect
from calib.structure.function_model import FunctionModel
from calib.structure.modal_function import ModalFunctionModel
from calib.structure.model import StructuralModel

Measured = MeasuredModes | MeasuredFRFs

MODES = 10
"""Modes of the model whose frequencies stand for measured ones."""
RIGID = 1e-3
"""Frequency, over the highest of these, below which a mode is one of a rigid body."""


@dataclass(frozen=True, eq=False)
class Compositions:
    """What may be proposed for a model.

    Attributes
    ----------
    plain : tuple of Composition
        Without degrees of freedom of their own.
    mounts : tuple of Composition
        Soft mounts of dampers.
    hung : tuple of HungBy
        Hung masses.
    held : tuple of Effect
        Masses held fast, from which the hung ones between the sensors follow.
    """

    plain: tuple[Composition, ...]
    mounts: tuple[Composition, ...] = ()
    hung: tuple[HungBy, ...] = ()
    held: tuple[Effect, ...] = ()

    @property
    def effects(self) -> tuple[Effect, ...]:
        """All that a search evaluates."""
        hung = (one.composed.effect for one in self.hung)
        composed = (*(c.effect for c in (*self.plain, *self.mounts)), *(e for e in hung if isinstance(e, Effect)))
        return (*composed, *self.held)


def compositions(
    model: StructuralModel | ModalFunctionModel | FunctionModel,
    measured: Sequence[Measured],
    values: Mapping[str, float],
    taken: Collection[str] = (),
) -> Compositions:
    """Everything that may be composed for a model and the tests of it.

    Parameters
    ----------
    model : StructuralModel, ModalFunctionModel or FunctionModel
        Of a function only the parts that it scales itself are known.
    measured : sequence of MeasuredModes or MeasuredFRFs
        The fitted data of each test.
    values : mapping
        Reference values of its parameters.
    taken : collection of str
        Names that are used otherwise, such as those of the library.
    """
    names = Names({*taken, *model.space.names})
    if not isinstance(model, StructuralModel):
        return Compositions(tuple(of_function(model.parts, names)))
    values = {name: value for name, value in values.items() if name in model.space}
    sensors = _sensors(measured)
    band = _band(model, measured, values)
    middle = float(np.sqrt(band[0] * band[1]))
    plain = (
        *of_parts(model, names, middle), *of_supports(model, names), *of_joints(model, values, names, middle),
        *of_sensors(model, sensors, values, names, middle),
    )  # fmt: skip
    mounts = tuple(of_mounts(model, names, middle))
    placed = {c.at for c in plain if c.kind == "added mass"}
    hung = [
        HungBy(
            hung_at(model, sensor, DIRECTIONS.index(sensor.direction), values, names, band),
            f"added mass at sensor {sensor.name}",
        )
        for sensor in sensors
        if f"node {sensor.node}" in placed and sensor.direction in DIRECTIONS[:3]
    ]
    held, mass = [], heavy(model, model.matrices(values)[2])
    for spot in further_spots(model, sensors):
        for direction in moving(model, spot.place):
            held.append(held_at(model, spot, direction, mass, names))
            hung.append(HungBy(hung_at(model, spot, direction, values, names, band), held[-1].name))
    return Compositions(plain, mounts, tuple(hung), tuple(held))


def _band(model: StructuralModel, measured: Sequence[Measured], values: Mapping[str, float]) -> tuple[float, float]:
    """Lowest and highest measured frequency above 0, Hz; of the model's lowest modes where no sensor measured any."""
    if measured:
        freqs = np.concatenate([one.frequencies for one in measured])
        return float(freqs[freqs > 0].min()), float(freqs.max())
    freqs = model.modes(values, min(MODES, model.n_modes)).natural_freq
    return float(freqs[freqs > RIGID * freqs.max()].min()), float(freqs.max())


def _sensors(measured: Sequence[Measured]) -> list[Sensor]:
    return list({s.name: s for one in measured for s in one.sensors if s.point is not None}.values())
