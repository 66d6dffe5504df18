"""Masses of accelerometers as one fault of a test: the model moves without them, the structure with them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import scipy.sparse as sp

from calib.measurement.modal import DIRECTIONS, Sensor
from calib.problem.effect import Effect
from calib.problem.space import Parameter
from calib.structure.affine import Monomial
from calib.structure.effects.attach import outer_term
from calib.structure.effects.extend import Addition
from calib.structure.effects.perturbations import Perturbation
from calib.structure.model import StructuralModel
from calib.structure.rules import RULES


def accelerometers(
    model: StructuralModel, sensors: Sequence[Sensor], values: Mapping[str, float], of: str = ""
) -> tuple[Perturbation, ...]:
    """One mass for every node with a sensor of a translation, which acts in all three; empty without such a sensor.

    Parameters
    ----------
    model : StructuralModel
    sensors : sequence of Sensor
        Sensors located on the model.
    values : mapping
        Reference values, for the plausible size: all together `RULES.heavy` of what moves.
    of : str
        Appended to the name, where several models are tested.
    """
    nodes = {sensor.point: sensor for sensor in sensors if sensor.direction in DIRECTIONS[:3]}
    if not nodes:
        return ()
    rows = np.vstack([model.translations(sensor) for sensor in nodes.values()])
    mass = sp.csc_array(model.matrices(values)[2])
    moved = [np.flatnonzero(model.dofs.direction == k) for k in range(3)]
    total = max(float(mass[own][:, own].sum()) for own in moved)
    name, size = f"mass of the accelerometers{f' ({of})' if of else ''}", RULES.heavy * total / len(nodes)

    def build(model: StructuralModel) -> Addition:
        own = [row for row in rows if row.any()]
        return Addition(mass=(outer_term(name, own, Monomial(1.0, ((name, 1.0),)), model.n_dof - rows.shape[1]),))

    effect = Effect(
        name, name, "The accelerometers weigh nothing.",
        "Weigh one with its mount and cable, and add it to the model of the test.",
        Parameter(name, 0.0, 0.0, RULES.added_most * size, "kg", prior_sd=size), build, of_measurement=True,
        told=lambda by: f"accelerometers of {by:.2g} kg each weigh on the structure",
    )  # fmt: skip
    return (Perturbation(effect, "mass", (np.nan, np.nan, np.nan)),)
