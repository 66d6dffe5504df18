"""Sensors with their places from the universal files and the sensor table; the table takes precedence."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from calib.errors.errors import InputError
from calib.measurement.modal import Sensor
from calib.measurement.places import Misplaced, Point, place_conflicts

NAMED_MOST = 3
"""Largest number of nodes named in one sentence."""


@dataclass(frozen=True)
class PlacedSensors:
    """Sensors with their places.

    Attributes
    ----------
    sensors : tuple of Sensor
    misplaced : tuple of Misplaced
        Nodes whose place in the table contradicts the universal files.
    notes : tuple of str
    """

    sensors: tuple[Sensor, ...]
    misplaced: tuple[Misplaced, ...]
    notes: tuple[str, ...]


def place_sensors(
    measured: Sequence[tuple[int, str]],
    points: Mapping[int, Point] | None,
    table: Mapping[int, tuple[Point, str | None]],
    path: Path,
    table_path: Path | None,
) -> PlacedSensors:
    """Sensors with their places; notes name contradictions of the table and nodes without a place.

    Parameters
    ----------
    measured : sequence of (int, str)
        Nodes and directions with shape values.
    points : mapping from node to place in m, or None
        Of the universal files; None when they hold none.
    table : mapping from node to (place in m, part)
        The sensor table; empty without one.
    path, table_path : Path
        For messages.

    Raises
    ------
    InputError
        When no node of the table was measured, or a measured node has no place although others have.
    """
    nodes = list(dict.fromkeys(node for node, _ in measured))
    if table and measured and not any(node in table for node in nodes):
        raise InputError(
            f"none of its {len(table)} nodes ({_few(list(table))}) was measured: measured are nodes {_few(nodes)}",
            place=table_path,
            remedy="give the nodes the labels of the measurement, or leave the table out",
        )
    sensors = []
    for node, direction in measured:
        if node in table:
            point, on = table[node]
            sensors.append(Sensor(node, direction, point, on))
        elif points is not None:
            if node not in points:
                raise InputError(
                    f"node {node} was measured but has no coordinates (dataset 15)",
                    place=path,
                    remedy="add it there or to the sensor table",
                )
            sensors.append(Sensor(node, direction, points[node]))
        else:
            sensors.append(Sensor(node, direction))
    given = {node: table[node][0] for node in nodes if node in table}
    misplaced, factor = place_conflicts(points or {}, given)
    notes = _notes(misplaced, factor, len(given), table_path)
    lost = list(dict.fromkeys(str(s.node) for s in sensors if s.point is None))
    if lost:
        notes.append(f"no place is known for nodes {', '.join(lost)}")
    return PlacedSensors(tuple(sensors), misplaced, tuple(notes))


def _notes(misplaced: Sequence[Misplaced], factor: float | None, compared: int, table: Path | None) -> list[str]:
    if not misplaced:
        return []
    if factor is not None:
        units = "looks like millimetres" if factor > 1 else "is in metres if the universal file is in millimetres"
        return [
            f"{table}: its places are {factor:g} times those of the universal file: it {units}; places are in metres, "
            "those of the table are used"
        ]
    named = [
        f"node {one.node} by {one.distance:.3g} m (table {_point(one.table)}, file {_point(one.file)})"
        for one in misplaced[:NAMED_MOST]
    ]
    more = f" and {len(misplaced) - NAMED_MOST} more" if len(misplaced) > NAMED_MOST else ""
    return [
        f"{table}: {len(misplaced)} of {compared} places contradict the universal file: {'; '.join(named)}{more}; "
        "those of the table are used"
    ]


def _point(point: Point) -> str:
    return "(" + ", ".join(f"{x:.4g}" for x in point) + ")"


def _few(nodes: Sequence[int]) -> str:
    return ", ".join(map(str, nodes[:NAMED_MOST])) + (", ..." if len(nodes) > NAMED_MOST else "")
