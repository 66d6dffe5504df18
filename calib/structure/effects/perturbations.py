"""Local perturbations of stiffness, mass and damping, for deviations that no named effect explains."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import scipy.sparse as sp

from calib.measurement.modal import DIRECTIONS, Sensor
from calib.problem.effect import Effect
from calib.problem.space import Parameter
from calib.structure.affine import Monomial, Term
from calib.structure.effects.attach import outer_term, parts_of
from calib.structure.effects.extend import Addition
from calib.structure.eigenproblem.symmetric_factor import symmetric_factor
from calib.structure.function_parts import ScaledPart
from calib.structure.model import Part, StructuralModel
from calib.structure.rules import RULES

LEAST = {"stiffness": RULES.less, "damping": RULES.damper_less, "mass": RULES.less}
"""Smallest relative change of a part, by its kind."""


@dataclass(frozen=True)
class Perturbation:
    """One local perturbation, as an effect without a physical name.

    Attributes
    ----------
    effect : Effect
        Its magnitude is relative and of either sign for a part; in N/m or kg at a sensor, where it can only be added.
    kind : {"stiffness", "damping", "mass"}
    place : (3,) float
        m.
    sensor : str
        Name of the sensor it acts at, empty for a part.
    """

    effect: Effect
    kind: str
    place: tuple[float, float, float]
    sensor: str = ""


def perturbations(
    model: StructuralModel, sensors: Sequence[Sensor], values: Mapping[str, float], freq: float, of: str = ""
) -> tuple[Perturbation, ...]:
    """Local perturbations: every part of a model scaled, a grounded spring and an added mass at every sensor.

    Parameters
    ----------
    model : StructuralModel
        Without parts its affine terms are scaled instead.
    sensors : sequence of Sensor
        Sensors located on the model.
    values : mapping
        Reference values, for the plausible size of springs and masses at sensors.
    freq : float
        Hz, such as the lowest measured one: a spring is scaled by the local dynamic stiffness ``K + (2 pi freq)^2 M``,
        which is regular for free structures too.
    of : str
        Appended to every name, where several models have parts of the same name.
    """
    suffix = f" ({of})" if of else ""
    found = [_scaled(part, suffix) for part in parts_of(model)]
    if sensors:
        rows = model.sensor_rows(sensors)
        stiffness, _, mass = model.matrices(values)
        dynamic = sp.csc_array(stiffness + (2 * np.pi * freq) ** 2 * mass)
        flexible = np.einsum("ij,ji->i", rows, symmetric_factor(dynamic).solve(rows.T))
        for sensor, row, flexibility in zip(sensors, rows, flexible, strict=True):
            assert sensor.point is not None
            moved = np.flatnonzero(model.dofs.direction == DIRECTIONS.index(sensor.direction))
            total = float(sp.csc_array(mass)[moved][:, moved].sum())
            found += [
                _at_sensor(sensor, row, "stiffness", RULES.local / float(flexibility), suffix),
                _at_sensor(sensor, row, "mass", RULES.heavy * total, suffix),
            ]
    return tuple(found)


def _scaled(part: Part, suffix: str) -> Perturbation:
    changed = ScaledPart(f"{part.name}{suffix}", part.kind)
    name = changed.parameter
    coefficient = replace(part.coefficient, powers=(*part.coefficient.powers, (name, 1.0)))

    def build(model: StructuralModel) -> Addition:
        term = (Term(name, _wider(part.matrix, model.n_dof), coefficient, part.name),)
        if part.kind == "stiffness":
            return Addition(stiffness=term)
        return Addition(damping=term) if part.kind == "damping" else Addition(mass=term)

    return Perturbation(scaling(changed, build), part.kind, part.place)


def relative_change(part: ScaledPart) -> Parameter:
    """Relative change of a part, with its limits and a large but plausible size."""
    return Parameter(part.parameter, 0.0, LEAST[part.kind], RULES.more, "-", prior_sd=RULES.relative)


def scaling(part: ScaledPart, build: Callable[[Any], Any]) -> Effect:
    """The effect that scales a part of a model by one plus its magnitude."""
    effect = _effect(part.parameter, relative_change(part), build, "scales it by one more than this")
    return replace(effect, part=part.parameter)


def scaling_by_function(part: ScaledPart) -> Effect:
    """The same for a part that the model's function scales itself."""
    return scaling(part, _by_itself)


def _by_itself(model: Any) -> None:
    """Nothing to build."""


def _at_sensor(sensor: Sensor, row: np.ndarray, kind: str, size: float, suffix: str) -> Perturbation:
    words = "grounded spring" if kind == "stiffness" else "added mass"
    name, unit = f"{words} at sensor {sensor.name}{suffix}", "N/m" if kind == "stiffness" else "kg"

    def build(model: StructuralModel) -> Addition:
        term = (outer_term(name, [row], Monomial(1.0, ((name, 1.0),)), model.n_dof - len(row)),)
        return Addition(stiffness=term) if kind == "stiffness" else Addition(mass=term)

    magnitude = Parameter(name, 0.0, 0.0, RULES.added_most * size, unit, prior_sd=size)
    assert sensor.point is not None
    return Perturbation(_effect(name, magnitude, build, f"{words} of this size"), kind, sensor.point, sensor.name)


def _effect(name: str, magnitude: Parameter, build: Callable[[Any], Any], lacks: str) -> Effect:
    return Effect(name, name, lacks, "what differs there from the drawings", magnitude, build)


def _wider(matrix: sp.csr_array, size: int) -> sp.csr_array:
    """A matrix of the base model, padded to a model with degrees of freedom added by other effects."""
    if matrix.shape == (size, size):
        return matrix
    coo = sp.coo_array(matrix)
    return sp.csr_array(sp.coo_array((coo.data, (coo.row, coo.col)), shape=(size, size)))


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
        told=_weight_words,
    )  # fmt: skip
    return (Perturbation(effect, "mass", (np.nan, np.nan, np.nan)),)


def _weight_words(by: float) -> str:
    return f"accelerometers of {by:.2g} kg each weigh on the structure"
