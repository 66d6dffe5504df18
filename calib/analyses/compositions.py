"""Compositions for the tests of a model, and the search for the one that explains best."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from calib.effect import Effect
from calib.function import FunctionModel
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.modal import MeasuredModes, Sensor
from calib.missing.proposal import HungBy
from calib.structure.compositions import Composition, Names, hung_at, of_function, of_parts, of_sensors
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
    hung : tuple of HungBy
        Hung masses.
    freqs : mapping from str to float
        Measured frequency of each mode, Hz.
    """

    plain: tuple[Composition, ...]
    hung: tuple[HungBy, ...] = ()
    freqs: Mapping[str, float] = field(default_factory=dict)

    @property
    def effects(self) -> tuple[Effect, ...]:
        """All of them."""
        hung = (one.composed.effect for one in self.hung)
        return (*(c.effect for c in self.plain), *(effect for effect in hung if isinstance(effect, Effect)))


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
    plain = (*of_parts(model, names, middle), *of_sensors(model, sensors, values, names, middle))
    modal = [one for one in measured if isinstance(one, MeasuredModes)]
    if len(modal) != 1 or len(measured) != 1:
        return Compositions(plain)
    placed = {c.at for c in plain if c.kind == "added mass"}
    hung = tuple(
        HungBy(hung_at(model, sensor, values, names, band), f"added mass at sensor {sensor.name}")
        for sensor in sensors
        if f"node {sensor.node}" in placed and sensor.direction in "xyz"
    )
    (one,) = modal
    return Compositions(plain, hung, dict(zip(one.names, one.natural_freq.tolist(), strict=True)))


def _band(model: StructuralModel, measured: Sequence[Measured], values: Mapping[str, float]) -> tuple[float, float]:
    """Lowest and highest measured frequency above 0, Hz; of the model's lowest modes where no sensor measured any."""
    if measured:
        freqs = np.concatenate([one.frequencies for one in measured])
        return float(freqs[freqs > 0].min()), float(freqs.max())
    freqs = model.modes(values, min(MODES, model.n_modes)).natural_freq
    return float(freqs[freqs > RIGID * freqs.max()].min()), float(freqs.max())


def _sensors(measured: Sequence[Measured]) -> list[Sensor]:
    return list({s.name: s for one in measured for s in one.sensors if s.point is not None}.values())
