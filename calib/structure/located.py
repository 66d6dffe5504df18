"""Sensors on a model: their motions over its degrees of freedom, and their nodes' partners by distance."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from calib.errors.errors import InputError
from calib.measurement.frf_units import LENGTHS
from calib.measurement.modal import DIRECTIONS, Sensor
from calib.measurement.partners import NodePartners, node_partners, partner_table, require_limit, size_limit
from calib.measurement.places import Point
from calib.measurement.rules import RULES
from calib.structure.geometry import DofMap, Locator, Mesh, at_nodes


class _Located(Protocol):
    """What is asked of a model; see `calib.structure.model.StructuralModel`."""

    @property
    def name(self) -> str: ...
    @property
    def mesh(self) -> Mesh: ...
    @property
    def dofs(self) -> DofMap: ...
    @property
    def locator(self) -> Locator: ...
    @property
    def labels(self) -> tuple[int, ...]: ...
    @property
    def sensor_tolerance(self) -> float | None: ...


def sensor_rows(model: _Located, sensors: Sequence[Sensor]) -> np.ndarray:
    """Motion at the sensors over the free degrees of freedom, shape (n_sensors, n_dof).

    Raises InputError for a sensor without coordinates, off the model, or on a motion that the model suppresses.
    """
    rows = np.zeros((len(sensors), model.dofs.n_dof))
    least, near = nearest_limit(model), set[tuple[float, ...] | None]()
    for i, sensor in enumerate(sensors):
        row, distance = sensor_row(model, sensor)
        if distance > least and sensor.point not in near:
            partners = sensor_partners(model, (sensor, *sensors))  # of two places of one node this one counts
            if partners is not None:
                partners.require(model.name)
                near |= set(map(tuple, partners.table[["x", "y", "z"]].to_numpy().tolist()))
        if not np.abs(row).max(initial=0.0) > 1e-9:  # suppressed motions of an inclined member carry rounding error
            raise InputError(
                "the model suppresses this motion, so model and measurement can never agree",
                place=f"sensor {sensor.name}",
                remedy="take it out of the measured shapes",
            )
        rows[i] = row
    return rows


def nearest_limit(model: _Located) -> float:
    """Distance of a sensor that is allowed everywhere on a model, m."""
    require_limit(model.sensor_tolerance)
    if model.sensor_tolerance is not None:
        return model.sensor_tolerance
    return size_limit(model.mesh.points[model.mesh.placed])


def sensor_row(model: _Located, sensor: Sensor) -> tuple[np.ndarray, float]:
    """Motion at a sensor, (n_dof,), and its distance from the model in m, by coordinates or else by node label.

    Raises InputError for an unknown direction, and where neither finds the sensor.
    """
    if sensor.direction not in DIRECTIONS:
        raise InputError(
            f"its direction is {sensor.direction!r}", place=f"sensor {sensor.name}",
            remedy=f"one of {', '.join(DIRECTIONS)}",
        )  # fmt: skip
    direction = DIRECTIONS.index(sensor.direction)
    if sensor.point is not None and model.mesh.placed.all():
        return model.locator.row(sensor.point, direction, sensor.on)
    if sensor.node in model.labels:
        index = 6 * model.labels.index(sensor.node) + direction
        return model.dofs.expansion[[index]].toarray()[0], 0.0
    known = "no place is known for it" if sensor.point is None else "the model has no coordinates"
    if not model.labels:
        raise InputError(known, place=f"sensor {sensor.name}", remedy="add its node to the study's sensor table")
    raise InputError(
        f"{known}, and the model {model.name} has no node {sensor.node}",
        place=f"sensor {sensor.name}",
        remedy="give coordinates to both, or number its node as the model does",
    )


def placed_sensors(model: Any, sensors: Iterable[Sensor]) -> list[Sensor]:
    """Sensors whose place is known, by their coordinates or else by those of the model's node of that number."""
    nodes = {label: k for k, label in enumerate(model.labels)} if model.mesh.placed.all() else {}
    out = []
    for sensor in sensors:
        if sensor.point is None and sensor.node in nodes:
            x, y, z = model.mesh.points[nodes[sensor.node]].tolist()
            sensor = replace(sensor, point=(x, y, z))
        out += [] if sensor.point is None else [sensor]
    return out


def sensor_partners(model: Any, sensors: Iterable[Sensor]) -> NodePartners | None:
    """Partners of the nodes of some sensors on a model, see `calib.measurement.partners.node_partners`.

    A model that interpolates between its nodes has no partners, only distances. None where no sensor, or a node of the
    model, has no place: their numbers then decide.

    Parameters
    ----------
    model : StructuralModel, ModalFunctionModel, or reduced model
    sensors : iterable of Sensor
    """
    full = getattr(model, "whole", model)
    first = {one.node: one for one in reversed(tuple(sensors)) if one.point is not None}
    if not first or not full.mesh.placed.any() or not full.mesh.placed.all():
        return None
    points: dict[int, Point] = {node: one.point for node, one in sorted(first.items()) if one.point is not None}
    locator = getattr(full, "locator", None)
    if locator is None or at_nodes(locator):
        labels = getattr(full, "labels", ()) or range(len(full.mesh.points))
        places: dict[int, Point] = {
            label: (float(x), float(y), float(z)) for label, (x, y, z) in zip(labels, full.mesh.points, strict=True)
        }
        return node_partners(points, places, full.sensor_tolerance)
    return _between_nodes(full, [replace(first[node], point=point) for node, point in points.items()])


def _between_nodes(model: _Located, sensors: Sequence[Sensor]) -> NodePartners:
    """Distances of sensors, one a node, from a model that interpolates between its nodes."""
    points = np.array([sensor.point for sensor in sensors], dtype=float)
    limit = nearest_limit(model)

    def distances(metres: float) -> np.ndarray:
        moved = [replace(s, point=tuple((metres * p).tolist())) for s, p in zip(sensors, points, strict=True)]
        return np.array([sensor_row(model, sensor)[1] for sensor in moved])

    def extent(of: np.ndarray) -> float:
        return float(np.ptp(of, axis=0).max(initial=0.0)) or float(np.abs(of).max(initial=0.0)) or 1.0

    distance, found = distances(1.0), []
    if np.mean(distance <= limit) < RULES.partner_share:
        for unit, metres in LENGTHS.items():
            if unit != "m" and np.mean(distances(metres) <= limit) >= RULES.partner_share:
                unlike = abs(np.log(metres * extent(points) / extent(model.mesh.points)))
                words = {"inch": "inches", "ft": "feet"}.get(unit, unit)
                found.append((unlike, f"measured places in {words}"))
    table = partner_table(np.array([s.node for s in sensors]), points, distance, np.full(len(sensors), limit))
    table["remark"] = [
        f"{words} (part {sensor.on})" if words and sensor.on else words
        for sensor, words in zip(sensors, table["remark"], strict=True)
    ]
    return NodePartners(table, min(found)[1] if found else "")
