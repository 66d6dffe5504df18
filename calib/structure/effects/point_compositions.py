"""Effects composed at points of a model: masses, springs and dampers at sensors, masses between them too."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from calib.measurement.modal import DIRECTIONS, Sensor
from calib.problem.effect import Effect
from calib.problem.space import Parameter
from calib.results.answer import names_in_words
from calib.structure.effects.attach import Place, motion
from calib.structure.effects.composed import Connection, HungMass, PointMass
from calib.structure.effects.composition import Composition, Names, Point, dynamic_factor
from calib.structure.model import StructuralModel
from calib.structure.rules import RULES

_ROUNDED = 1e-9
"""Rounding of a squared distance: in a square, what is across counts as held by the other corners."""
_SAME = 1e-3
"""Distance of two places that count as one, over the size of the model."""
_KINDS: Mapping[str, tuple[str, str, str]] = {
    "added mass": ("A mass", "kg", "Equipment, ballast or cables"),
    "hung mass": ("A mass on a spring", "kg", "A unit on rubber mounts"),
    "spring to ground": ("A spring to the ground", "N/m", "A stop, a hose or a cable that holds it"),
    "damper to ground": ("A damper to the ground", "Ns/m", "Friction against something that stands still"),
    "spring between": ("A spring", "N/m", "A brace, a link or a joint"),
    "damper between": ("A damper", "Ns/m", "Friction, rubber or a damper"),
}


@dataclass(frozen=True)
class Spot:
    """A place where something may act.

    Attributes
    ----------
    place : Place
    at, label : str
        In words, such as ``node 104``, and as a part of a name.
    """

    place: Place
    at: str
    label: str

    @property
    def point(self) -> Point:
        """M."""
        return self.place[1]


def of_sensors(
    model: StructuralModel, sensors: Sequence[Sensor], values: Mapping[str, float], names: Names, middle: float
) -> Iterator[Composition]:
    """Masses, springs and dampers at sensors, and springs and dampers between neighbouring ones.

    Each alone, and where the model has two places that mirror each other, both together. Masses also act between the
    sensors (`further_spots`). Plausible sizes are those of `calib.structure.effects.perturbations`; a damper has the
    dynamic stiffness of the spring at the middle of the measured band.

    Parameters
    ----------
    model : StructuralModel
    sensors : sequence of Sensor
        With places on the model; none of a model without coordinates, on which no place can be named.
    values : mapping
        Reference values.
    names : Names
    middle : float
        Hz.
    """
    sensors = _placed(model, sensors)
    if not sensors:
        return
    rows = model.sensor_rows(sensors)
    added = heavy(model, model.matrices(values)[2])
    flexibility = rows @ dynamic_factor(model, values, middle).solve(np.ascontiguousarray(rows.T))
    diagonal = np.diag(flexibility)
    own = diagonal.tolist()
    apart = (diagonal[:, None] + diagonal - flexibility - flexibility.T).tolist()  # of two sensors against each other

    spots = [spot for own in _by_place(sensors).values() if moving(model, (spot := at_node(model, own[0])).place)]
    spots += further_spots(model, sensors)
    points = [spot.point for spot in spots]
    free = [str(moving(model, spot.place)) for spot in spots]
    for group in (*((k,) for k in range(len(spots))), *mirrored(model, [(p,) for p in points], free)):
        yield _masses(model, [spots[k] for k in group], names, added)
    kinds = {"spring": 1.0, "damper": 1 / (2 * np.pi * middle)}
    ground = [(s.point,) for s in sensors if s.point is not None]
    directions = [s.direction for s in sensors]
    for group in (*((k,) for k in range(len(sensors))), *mirrored(model, ground, directions)):
        for kind, weight in kinds.items():
            held = [(sensors[k], None) for k in group]
            yield _connection(f"{kind} to ground", held, names, weight * RULES.local / min(own[k] for k in group))
    pairs = [pair for pair in _pairs(sensors) if np.abs(rows[pair[0]] - rows[pair[1]]).max() > 1e-9]
    ends = [tuple(p for p in (sensors[k].point, sensors[j].point) if p is not None) for k, j in pairs]
    directions = [sensors[k].direction for k, _ in pairs]
    for group in (*((k,) for k in range(len(pairs))), *mirrored(model, ends, directions)):
        for kind, weight in kinds.items():
            joined = [(sensors[pairs[k][0]], sensors[pairs[k][1]]) for k in group]
            least = min(apart[pairs[k][0]][pairs[k][1]] for k in group)
            yield _connection(f"{kind} between", joined, names, weight * RULES.local / least)


def springs_between(
    model: StructuralModel, sensors: Sequence[Sensor], values: Mapping[str, float], names: Names, middle: float
) -> Iterator[Composition]:
    """Springs to the ground at the `further_spots`, in the directions of the sensors; arguments as in `of_sensors`."""
    spots, measured = further_spots(model, sensors), {s.direction for s in _placed(model, sensors)}
    acting = [(s, d) for s in spots for d in moving(model, s.place) if DIRECTIONS[d] in measured]
    if not acting:
        return
    rows = np.array([motion(model, spot.place, d) for spot, d in acting])
    flexible = np.einsum("ij,ji->i", rows, dynamic_factor(model, values, middle).solve(np.ascontiguousarray(rows.T)))
    what, unit, look_for = _KINDS["spring to ground"]
    for (spot, direction), f in zip(acting, flexible.tolist(), strict=True):
        at, size = f"{spot.at} along {DIRECTIONS[direction]}", RULES.local / f
        name = names.free(f"spring to ground {spot.label} {DIRECTIONS[direction]}")
        magnitude = Parameter(
            name, 0.0, 0.0, RULES.added_most * size, unit, prior_sd=size, description=f"{what.lower()} at {at}"
        )
        build = Connection(name, "stiffness", ((spot.place, None),), direction)
        effect = Effect(
            name, f"{what} at {at}", f"Nothing acts there: {at}.", f"{look_for} near {at}.", magnitude, build,
            phrase=f"{what.lower()} at {at}",
        )  # fmt: skip
        yield Composition(effect, "spring to ground", at, (spot.point,))


def further_spots(model: StructuralModel, sensors: Sequence[Sensor]) -> list[Spot]:
    """Nodes of a model between its sensors that can move, each as far as possible from all known before it."""
    sensors = _placed(model, sensors)
    if not sensors:
        return []
    points, known = model.mesh.points, np.array([s.point for s in sensors])
    size = float(np.ptp(points, axis=0).max(initial=0.0))
    distance = np.linalg.norm(points[:, None] - known[None], axis=2).min(axis=1)
    out: list[Spot] = []
    while len(out) < RULES.further_places and distance.max() > RULES.further_apart * size:
        n = int(distance.argmax())
        x, y, z = (round(float(c), 4) + 0.0 for c in points[n])
        distance = np.minimum(distance, np.linalg.norm(points - points[n], axis=1))
        at = f"the point ({x:.2f}, {y:.2f}, {z:.2f})" + (f", node {model.labels[n]}" if model.labels else "")
        spot = Spot((None, (x, y, z)), at, f"point {len(out) + 1}")
        out += [spot] if moving(model, spot.place) else []
    return out


def hung_at(
    model: StructuralModel,
    spot: Sensor | Spot,
    direction: int,
    values: Mapping[str, float],
    names: Names,
    band: tuple[float, float],
) -> Composition:
    """A mass on a spring that gives in a direction; its natural frequency lies in or near the measured band, Hz."""
    if isinstance(spot, Sensor):
        spot = Spot(_place(spot), f"sensor {spot.name}", spot.name)
    else:
        axis = DIRECTIONS[direction]
        spot = Spot(spot.place, f"{spot.at}, {axis}", f"{spot.label} {axis}")
    what, unit, look_for = _KINDS["hung mass"]
    size = heavy(model, model.matrices(values)[2])
    name = names.free(f"hung mass {spot.label}", "_freq")
    least = 1e-3 * size  # the oscillator's matrices have a root of the mass
    magnitude = Parameter(
        name, least, least, RULES.added_most * size, unit, prior_sd=size, description=f"{what.lower()} at {spot.at}"
    )
    low, high, freq = 0.5 * band[0], 1.5 * band[1], f"{name}_freq"
    words = "natural frequency on a fixed base"
    nuisance = Parameter(freq, math.sqrt(low * high), low, high, "Hz", prior_sd=(high - low) / 2, description=words)
    grid = tuple({name: size, freq: float(f)} for f in np.geomspace(*band, RULES.hung_points).round(3))
    others = tuple(d for d in moving(model, spot.place) if d != direction)
    build = HungMass(name, freq, spot.place, direction, others)
    effect = Effect(
        name, f"{what} at {spot.at}", f"Nothing more is mounted at {spot.at}.", f"{look_for} near {spot.at}.",
        magnitude, build, (nuisance,), grid, phrase=f"{what.lower()} at {spot.at}",
    )  # fmt: skip
    return Composition(effect, "hung mass", spot.at, (spot.point,))


def held_at(model: StructuralModel, spot: Spot, direction: int, mass: float, names: Names) -> Effect:
    """A mass at a place in one direction only: what one on a spring is when held fast."""
    name = names.free(f"held mass {spot.label} {DIRECTIONS[direction]}")
    magnitude = Parameter(name, 0.0, 0.0, RULES.added_most * mass, "kg", prior_sd=mass)
    build = PointMass(name, (spot.place,), (direction,))
    return Effect(name, name, "Nothing more is mounted there.", "What is mounted there.", magnitude, build)


def heavy(model: StructuralModel, mass: sp.csc_array) -> float:
    """A plausible added mass: `RULES.heavy` of all that moves in a direction, kg."""
    moved = [np.flatnonzero(model.dofs.direction == k) for k in range(3)]
    return RULES.heavy * max(float(sp.csc_array(mass)[own][:, own].sum()) for own in moved)


def moving(model: StructuralModel, place: Place) -> tuple[int, ...]:
    """Directions in which a place moves."""
    return tuple(d for d in range(3) if np.abs(motion(model, place, d)).max(initial=0.0) > 1e-9)


def mirrored(
    model: StructuralModel, ends: Sequence[tuple[Point, ...]], directions: Sequence[str] | None = None
) -> Iterator[tuple[int, int]]:
    """Pairs of which one mirrors the other at a middle plane of the model, of the same directions where they are given.

    Parameters
    ----------
    ends : sequence of tuple of (3,) float
        Points of each, m.
    """
    points = model.mesh.points[model.mesh.placed]
    size = float(np.ptp(points, axis=0).max(initial=0.0))
    middle = (points.min(axis=0) + points.max(axis=0)) / 2
    seen: set[tuple[int, int]] = set()
    for axis in range(3):
        turned = np.ones(3)
        turned[axis] = -1.0
        images = [sorted((turned * (np.array(p) - middle)).round(6).tolist() for p in own) for own in ends]
        own = [sorted((np.array(p) - middle).round(6).tolist() for p in one) for one in ends]
        for k, image in enumerate(images):
            for j in range(k + 1, len(own)):
                same = directions is None or directions[j] == directions[k]
                if same and (k, j) not in seen and _near(image, own[j], _SAME * size):
                    seen.add((k, j))
                    yield k, j


def _near(one: list[list[float]], other: list[list[float]], within: float) -> bool:
    return all(min(math.dist(p, q) for q in other) <= within for p in one)


def _masses(model: StructuralModel, spots: Sequence[Spot], names: Names, size: float) -> Composition:
    what, unit, look_for = _KINDS["added mass"]
    at = _all_at([spot.at for spot in spots])
    name = names.free(f"added mass {' '.join(spot.label for spot in spots)}")
    magnitude = Parameter(
        name, 0.0, 0.0, RULES.added_most * size, unit, prior_sd=size, description=f"{what.lower()} at {at}"
    )
    build = PointMass(name, tuple(spot.place for spot in spots), moving(model, spots[0].place))
    each = "" if len(spots) == 1 else " each"
    effect = Effect(
        name, f"{what}{each} at {at}", f"Nothing more is mounted at {at}.", f"{look_for} near {at}.", magnitude, build,
        phrase=f"{what.lower()}{each} at {at}",
    )  # fmt: skip
    return Composition(effect, "added mass", at, tuple(spot.point for spot in spots), len(spots))


def _connection(kind: str, ends: Sequence[tuple[Sensor, Sensor | None]], names: Names, size: float) -> Composition:
    what, unit, look_for = _KINDS[kind]
    grounded = ends[0][1] is None
    text = [f"sensor {one.name}" if other is None else f"sensors {one.name} and {other.name}" for one, other in ends]
    at = _all_at(text) if grounded else " and between ".join(text)
    label = " ".join(s.name for pair in ends for s in pair if s is not None)
    name, each = names.free(f"{kind} {label}"), "" if len(ends) == 1 else " each"
    words = f"{what}{each} at {at}" if grounded else f"{what}{each} between {at}"
    magnitude = Parameter(
        name, 0.0, 0.0, RULES.added_most * size, unit, prior_sd=size, description=f"{what.lower()}{each} at {at}"
    )
    matrix = "stiffness" if kind.startswith("spring") else "damping"
    direction = DIRECTIONS.index(ends[0][0].direction)
    places = tuple((_place(one), None if other is None else _place(other)) for one, other in ends)
    effect = Effect(
        name, words, f"Nothing acts there: {at}.", f"{look_for} near {at}.", magnitude,
        Connection(name, matrix, places, direction), phrase=words[:1].lower() + words[1:],
    )  # fmt: skip
    middles = [np.mean([_place(s)[1] for s in pair if s is not None], axis=0).tolist() for pair in ends]
    return Composition(effect, kind, at, tuple(dict.fromkeys((x, y, z) for x, y, z in middles)), len(ends))


def _all_at(texts: Sequence[str]) -> str:
    """Such as ``nodes 3 and 4`` from ``node 3`` and ``node 4``."""
    first = texts[0].split(" ")[0]
    if len(texts) > 1 and first in ("node", "sensor") and all(text.startswith(f"{first} ") for text in texts):
        return f"{first}s {names_in_words([text.partition(' ')[2] for text in texts])}"
    return names_in_words(texts)


def _placed(model: StructuralModel, sensors: Sequence[Sensor]) -> list[Sensor]:
    """Sensors of translations with a place; none on a model without coordinates."""
    if not np.all(np.isfinite(model.mesh.points)):
        return []
    return [s for s in sensors if s.point is not None and s.direction in DIRECTIONS[:3]]


def at_node(model: StructuralModel, sensor: Sensor) -> Spot:
    """The place of a sensor, by the label of the model's node there where it has labels, else by the measured node."""
    if not model.labels:
        return Spot(_place(sensor), f"node {sensor.node}", str(sensor.node))
    nearest = int(np.linalg.norm(model.mesh.points - np.array(_place(sensor)[1]), axis=1).argmin())
    label = model.labels[nearest]
    measured = "" if label == sensor.node else f" ({sensor.node} in the test)"
    return Spot(_place(sensor), f"node {label}{measured}", str(label))


def _place(sensor: Sensor) -> Place:
    assert sensor.point is not None
    return sensor.on, sensor.point


def _by_place(sensors: Sequence[Sensor]) -> dict[Place, list[Sensor]]:
    out: dict[Place, list[Sensor]] = {}
    for sensor in sensors:
        out.setdefault(_place(sensor), []).append(sensor)
    return out


def _pairs(sensors: Sequence[Sensor]) -> list[tuple[int, int]]:
    """Pairs of sensors of one direction: each with its nearest `RULES.neighbours` in other places, and what faces it.

    Two face each other where no third lies in the sphere whose diameter they span (Gabriel and Sokal 1969): all that
    are nearest to a sensor on a column may be on the same column, where a brace leads to another one.
    """
    found: dict[tuple[int, int], None] = {}
    for axis in dict.fromkeys(s.direction for s in sensors):
        own = [k for k, s in enumerate(sensors) if s.direction == axis]
        points = np.array([sensors[k].point or _NOWHERE for k in own])
        far = np.linalg.norm(points[:, None] - points, axis=2)
        for i, k in enumerate(own):
            apart = [j for j in range(len(own)) if _place(sensors[own[j]]) != _place(sensors[k])]
            nearest = [apart[n] for n in np.argsort(far[i, apart], kind="stable")[: RULES.neighbours]]
            for j in dict.fromkeys([*nearest, *_facing(far, i, apart)]):
                found[min(k, own[j]), max(k, own[j])] = None
    return list(found)


def _facing(far: np.ndarray, i: int, others: Sequence[int]) -> list[int]:
    """Those of the others with which point ``i`` spans a sphere that holds no third one, from all distances (n, n)."""
    within = (far[i] ** 2 + far[others] ** 2) <= (1 + _ROUNDED) * far[i, others, None] ** 2
    within[np.arange(len(others)), others] = False
    within[:, i] = False
    within &= far[i] > 0  # another sensor at the same place
    within &= far[others] > 0
    return [j for j, held in zip(others, within.any(axis=1).tolist(), strict=True) if not held]


_NOWHERE = (math.nan, math.nan, math.nan)
