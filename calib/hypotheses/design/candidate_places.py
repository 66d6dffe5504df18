"""Places where a further measurement may be taken: spread over the structure, and where effects act."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Protocol

import numpy as np

from calib.errors.errors import InputError
from calib.hypotheses.rules import RULES
from calib.measurement.modal import DIRECTIONS, Sensor
from calib.missing.competing import at_effect
from calib.problem.effect import Effect
from calib.structure.effect_places import effect_places
from calib.structure.geometry import Mesh
from calib.structure.model import StructuralModel


class _Placed(Protocol):
    """What is asked of a model; see `calib.structure.modal_model.ModalModel`."""

    @property
    def mesh(self) -> Mesh: ...
    def sensor_rows(self, sensors: Sequence[Sensor]) -> np.ndarray: ...


def spread_places(model: _Placed, there: Iterable[Sensor], places: int) -> tuple[Sensor, ...]:
    """Sensors in three directions, each place at the node farthest from all earlier ones and from those there.

    Their nodes are numbered after the sensors that are there; directions that the model suppresses are left out.
    """
    there, points = tuple(there), model.mesh.points
    known = np.array([s.point for s in there if s.point is not None]).reshape(-1, 3)
    distance = np.linalg.norm(points[:, None] - known[None], axis=2).min(axis=1) if len(known) else np.inf
    distance = np.broadcast_to(distance, (len(points),)).copy()
    first = max((s.node for s in there), default=0) + 1
    out: list[Sensor] = []
    for k in range(min(places, len(points))):
        n = int(np.argmax(distance))
        if distance[n] <= 1e-6:
            break
        distance = np.minimum(distance, np.linalg.norm(points - points[n], axis=1))
        x, y, z = (round(float(c), 4) for c in points[n])
        out += [s for d in DIRECTIONS[:3] if moves(model, s := Sensor(first + k, d, (x, y, z)))]
    return tuple(out)


def where_acting(model: _Placed, effects: Sequence[Effect], label: int) -> dict[str, tuple[Sensor, ...]]:
    """Sensors in three directions at the nodes nearest to where each effect acts, by the measurement in words.

    ``label`` is the first number of their nodes. Empty for a model without matrices.
    """
    out: dict[str, tuple[Sensor, ...]] = {}
    for effect in effects if isinstance(model, StructuralModel) else ():
        own: list[Sensor] = []
        assert isinstance(model, StructuralModel)
        points = np.where(model.mesh.placed[:, None], model.mesh.points, np.inf)
        for place in effect_places(model, effect)[: RULES.together]:
            node = points[np.argmin(np.linalg.norm(points - np.array(place), axis=1))]
            x, y, z = (round(float(c), 4) for c in node)
            own += [s for d in DIRECTIONS[:3] if moves(model, s := Sensor(label, d, (x, y, z)))]
            label += 1
        if own:
            places = ", ".join(dict.fromkeys(point_words(s) for s in own))
            out[f"{at_effect(effect.name)}, {places}"] = tuple(own)
    return out


def moves(model: _Placed, sensor: Sensor) -> bool:
    """Whether the model has the motion of a sensor."""
    try:
        model.sensor_rows([sensor])
    except InputError:
        return False
    return True


def motion_words(sensor: Sensor) -> str:
    """Such as ``(0.00, 0.50, 1.20) y``."""
    return f"{point_words(sensor)} {sensor.direction}"


def point_words(sensor: Sensor) -> str:
    """Such as ``(0.00, 0.50, 1.20)``, m."""
    assert sensor.point is not None
    return f"({', '.join(f'{c:.2f}' for c in sensor.point)})"
