"""Every effect that local perturbations of a model may stand for: changed parts, masses, springs, dampers, joints."""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
import scipy.sparse as sp

from calib.effect import Effect
from calib.measurement.modal import DIRECTIONS, Sensor
from calib.space import Parameter
from calib.structure.attach import Place, parts_of
from calib.structure.composed import AddedMass, Builder, Connection, HungMass, ScaledByFunction, ScaledParts
from calib.structure.inertia import symmetric_factor
from calib.structure.model import Part, PartKind, StructuralModel
from calib.structure.perturbations import LEAST
from calib.structure.rules import RULES
from calib.structure.scaled_part import ScaledPart

_POSITION = re.compile(r"front|rear|left|right|upper|lower|top|bottom|inner|outer|middle|[xyz]|\d+")
"""Words of a part's name that tell its position: parts that differ in them alone may change together."""
_NOWHERE = (math.nan, math.nan, math.nan)


@dataclass(frozen=True)
class Composition:
    """An effect composed of local perturbations.

    Attributes
    ----------
    effect : Effect
        Built by a `calib.structure.composed.Builder`.
    kind : str
        ``stiffness``, ``damping``, ``mass`` of parts, ``section`` (stiffness and mass of a part), ``dissipation``
        (dampers in parallel to parts); ``added mass``, ``hung mass``, ``spring to ground``, ``damper to ground``,
        ``spring between``, ``damper between`` at sensors.
    at : str
        Parts or sensors, in words.
    place : (3,) float
        m; NaN where none is known.
    count : int
        Parts that change together, or 1.
    """

    effect: Effect
    kind: str
    at: str
    place: tuple[float, float, float]
    count: int = 1

    @property
    def builder(self) -> Builder:
        """What builds the effect."""
        builder: Builder = self.effect.build  # type: ignore[assignment]
        return builder

    @property
    def family(self) -> tuple[str, bool]:
        """Compositions among which it was chosen: of its kind, and of single parts or of several together."""
        return self.kind, self.count > 1


_PARTS: Mapping[str, tuple[str, str]] = {
    "stiffness": ("is as stiff as drawn", "Cracks, wrong or worn parts and play"),
    "damping": ("dissipates as drawn", "Leaks, wear, and a part that was exchanged"),
    "mass": ("weighs as much as drawn", "Equipment, filling, or parts that were left out"),
    "section": ("has the section of the drawing", "Corrosion, holes, or a profile of another size"),
    "dissipation": ("is elastic without loss", "Rubber, friction in joints, and whatever gets warm"),
}
_POINTS: Mapping[str, tuple[str, str, str]] = {
    "added mass": ("A mass", "kg", "Equipment, ballast or cables"),
    "hung mass": ("A mass on a spring", "kg", "A unit on rubber mounts"),
    "spring to ground": ("A spring to the ground", "N/m", "A stop, a hose or a cable that holds it"),
    "damper to ground": ("A damper to the ground", "Ns/m", "Friction against something that stands still"),
    "spring between": ("A spring", "N/m", "A brace, a link or a joint"),
    "damper between": ("A damper", "Ns/m", "Friction, rubber or a damper"),
}


def slug(text: str) -> str:
    """A name for Python and for files."""
    return re.sub(r"\W+", "_", text).strip("_").lower()


class Names:
    """Names that are not taken yet."""

    def __init__(self, taken: Collection[str]) -> None:
        self._taken = set(taken)

    def free(self, text: str, *ends: str) -> str:
        """A free name; with every end appended it is free too."""
        first, number = slug(text), 1
        first = first if first.isidentifier() else f"at_{first}"
        name = first
        while self._taken & {name + end for end in ("", *ends)}:
            number += 1
            name = f"{first}_{number}"
        self._taken |= {name + end for end in ("", *ends)}
        return name


# -- parts -------------------------------------------------------------------------------------------------------------


def of_parts(model: StructuralModel, names: Names, middle: float) -> Iterator[Composition]:
    """Changes of single parts, and of parts of one kind whose names differ in their position.

    Parameters
    ----------
    model : StructuralModel
    names : Names
    middle : float
        Of the measured band, Hz.
    """
    by_kind: dict[PartKind, list[Part]] = defaultdict(list)
    for part in parts_of(model):
        by_kind[part.kind].append(part)
    for kind, parts in by_kind.items():
        for group in (*((part,) for part in parts), *_alike(parts)):
            yield _changed(kind, [(kind, part) for part in group], names, middle)
            if kind == "stiffness":
                yield _changed("dissipation", [(kind, part) for part in group], names, middle)
    masses = {part.name: part for part in by_kind["mass"]}
    for part in by_kind["stiffness"]:
        if part.name in masses:
            yield _changed("section", [("stiffness", part), ("mass", masses[part.name])], names, middle)


def _alike(parts: Sequence[Part]) -> Iterator[tuple[Part, ...]]:
    """Groups of parts whose names differ in words of position only, such as all of one side; smaller groups first."""
    seen: set[tuple[str, ...]] = set()
    words = {part.name: re.split(r"[,\s]+", part.name) for part in parts}
    at = {name: [k for k, word in enumerate(own) if _POSITION.fullmatch(word)] for name, own in words.items()}
    for dropped in range(1, max(map(len, at.values()), default=0) + 1):
        found: dict[tuple[str, ...], list[Part]] = defaultdict(list)
        for part in parts:
            own = words[part.name]
            for gone in combinations(at[part.name], dropped) if dropped < len(own) else ():
                found[tuple("" if k in gone else word for k, word in enumerate(own))].append(part)
        for group in found.values():
            key = tuple(sorted(part.name for part in group))
            if len(group) > 1 and key not in seen:
                seen.add(key)
                yield tuple(group)


def _changed(kind: str, parts: Sequence[tuple[PartKind, Part]], names: Names, middle: float) -> Composition:
    own = list(dict.fromkeys(part.name for _, part in parts))
    at = in_words(own)
    name = names.free(f"{kind} {_common(own)}")
    unit, lower, upper, size = "-", LEAST.get(kind, LEAST["stiffness"]), RULES.more, RULES.relative
    words, (lacks, look_for) = f"relative change of {at}", _PARTS[kind]
    if kind == "dissipation":
        size = 1e3 * RULES.lossy / (2 * math.pi * middle)
        unit, lower, upper = "ms", 0.0, RULES.added_most * size
        words = "damping over stiffness: the loss factor is this times the angular frequency"
    magnitude = Parameter(name, 0.0, lower, upper, unit, prior_sd=size, description=words)
    build = ScaledParts(name, tuple((k, part.name) for k, part in parts), kind == "dissipation")
    effect = _part_effect(kind, at, magnitude, build, lacks, look_for)
    place = np.mean([part.place for _, part in parts], axis=0)
    return Composition(effect, kind, at, (float(place[0]), float(place[1]), float(place[2])), len(own))


def _part_effect(kind: str, at: str, magnitude: Parameter, build: Builder, lacks: str, look_for: str) -> Effect:
    title = f"{kind.capitalize()} of {at}"
    return Effect(
        magnitude.name, title, f"It {lacks}: {at}.", f"{look_for} at {at}.", magnitude, build,
        phrase=f"another {kind} of {at}" if kind != "dissipation" else f"dissipation in {at}",
    )  # fmt: skip


def _common(names: Sequence[str]) -> str:
    """The words that all names share; all of the first one where there are none."""
    first, *others = (name.split() for name in names)
    shared = [word for k, word in enumerate(first) if all(len(o) == len(first) and o[k] == word for o in others)]
    return " ".join(shared) or names[0]


def in_words(names: Sequence[str]) -> str:
    """Names in a sentence."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"


def of_function(parts: Sequence[ScaledPart], names: Names) -> Iterator[Composition]:
    """Changes of the parts that a function scales itself."""
    for part in parts:
        name = names.free(f"{part.kind} {part.name}")
        lacks, look_for = _PARTS[part.kind]
        magnitude = Parameter(
            name,
            0.0,
            LEAST[part.kind],
            RULES.more,
            "-",
            prior_sd=RULES.relative,
            description=f"relative change of {part.name}",
        )
        build = ScaledByFunction(name, part.parameter)
        yield Composition(
            _part_effect(part.kind, part.name, magnitude, build, lacks, look_for), part.kind, part.name, _NOWHERE
        )


# -- sensors -----------------------------------------------------------------------------------------------------------


def of_sensors(
    model: StructuralModel, sensors: Sequence[Sensor], values: Mapping[str, float], names: Names, middle: float
) -> Iterator[Composition]:
    """Masses, springs and dampers at sensors, and springs and dampers between neighbouring ones.

    Plausible sizes are those of `calib.structure.perturbations`; a damper has the dynamic stiffness of the spring at
    the middle of the measured band.

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
    sensors = [s for s in sensors if s.point is not None and s.direction in DIRECTIONS[:3]]
    if not sensors or not np.all(np.isfinite(model.mesh.points)):
        return
    rows = model.sensor_rows(sensors)
    stiffness, _, mass = model.matrices(values)
    factor = symmetric_factor(sp.csc_array(stiffness + (2 * np.pi * middle) ** 2 * mass))

    def size(row: np.ndarray) -> float:
        return RULES.local / float(row @ factor.solve(row))

    for place, own in _by_place(sensors).items():
        directions = tuple(k for k, row in enumerate(model.translations(own[0])) if np.abs(row).max(initial=0.0) > 1e-9)
        yield _at_point("added mass", own[0], place, directions, names, heavy(model, mass))
    for sensor, row in zip(sensors, rows, strict=True):
        for kind, weight in (("spring to ground", 1.0), ("damper to ground", 1 / (2 * np.pi * middle))):
            yield _connection(kind, sensor, None, names, weight * size(row))
    for k, other in _pairs(sensors):
        row = rows[k] - rows[other]
        if np.abs(row).max() > 1e-9:
            for kind, weight in (("spring between", 1.0), ("damper between", 1 / (2 * np.pi * middle))):
                yield _connection(kind, sensors[k], sensors[other], names, weight * size(row))


def hung_at(
    model: StructuralModel, sensor: Sensor, values: Mapping[str, float], names: Names, band: tuple[float, float]
) -> Composition:
    """A mass on a spring that gives in a sensor's direction; its frequency lies in or near the measured band, Hz."""
    directions = tuple(k for k, row in enumerate(model.translations(sensor)) if np.abs(row).max(initial=0.0) > 1e-9)
    size = heavy(model, model.matrices(values)[2])
    return _at_point("hung mass", sensor, _place(sensor), directions, names, size, band)


def heavy(model: StructuralModel, mass: sp.csc_array) -> float:
    """A plausible added mass: `RULES.heavy` of all that moves in a direction, kg."""
    moved = [np.flatnonzero(model.dofs.direction == k) for k in range(3)]
    return RULES.heavy * max(float(sp.csc_array(mass)[own][:, own].sum()) for own in moved)


def _at_point(
    kind: str,
    sensor: Sensor,
    place: Place,
    directions: tuple[int, ...],
    names: Names,
    size: float,
    band: tuple[float, float] = (0.0, 0.0),
) -> Composition:
    what, unit, look_for = _POINTS[kind]
    hung = kind == "hung mass"
    at = f"sensor {sensor.name}" if hung else f"node {sensor.node}"
    name = names.free(f"{kind} {sensor.name if hung else sensor.node}", *(("_freq",) if hung else ()))
    least = 1e-3 * size if hung else 0.0  # the oscillator's matrices have a root of the mass
    magnitude = Parameter(
        name, least, least, RULES.added_most * size, unit, prior_sd=size, description=f"{what.lower()} at {at}"
    )
    nuisance: tuple[Parameter, ...] = ()
    grid: tuple[Mapping[str, float], ...] = ()
    build: Builder = AddedMass(name, place, directions)
    if hung:
        low, high, freq = 0.5 * band[0], 1.5 * band[1], f"{name}_freq"
        words = "natural frequency on a fixed base"
        nuisance = (
            Parameter(freq, math.sqrt(low * high), low, high, "Hz", prior_sd=(high - low) / 2, description=words),
        )
        grid = tuple({name: size, freq: float(f)} for f in np.geomspace(*band, RULES.hung_points).round(3))
        direction = DIRECTIONS.index(sensor.direction)
        build = HungMass(name, freq, place, direction, tuple(d for d in directions if d != direction))
    effect = Effect(
        name, f"{what} at {at}", f"Nothing more is mounted at {at}.", f"{look_for} near {at}.", magnitude, build,
        nuisance, grid, phrase=f"{what.lower()} at {at}",
    )  # fmt: skip
    assert sensor.point is not None
    return Composition(effect, kind, at, sensor.point)


def _connection(kind: str, sensor: Sensor, other: Sensor | None, names: Names, size: float) -> Composition:
    what, unit, look_for = _POINTS[kind]
    at = f"sensor {sensor.name}" if other is None else f"sensors {sensor.name} and {other.name}"
    name = names.free(f"{kind} {sensor.name}" + ("" if other is None else f" {other.name}"))
    words = f"{what} at {at}" if other is None else f"{what} between {at}"
    magnitude = Parameter(
        name, 0.0, 0.0, RULES.added_most * size, unit, prior_sd=size, description=f"{what.lower()} at {at}"
    )
    matrix = "stiffness" if kind.startswith("spring") else "damping"
    direction = DIRECTIONS.index(sensor.direction)
    build = Connection(name, matrix, _place(sensor), None if other is None else _place(other), direction)
    effect = Effect(
        name, words, f"Nothing acts there: {at}.", f"{look_for} near {at}.", magnitude, build,
        phrase=words[:1].lower() + words[1:],
    )  # fmt: skip
    points = [s.point for s in (sensor, other) if s is not None and s.point is not None]
    x, y, z = np.mean(points, axis=0).tolist()
    return Composition(effect, kind, at, (x, y, z))


def _place(sensor: Sensor) -> Place:
    assert sensor.point is not None
    return sensor.on, sensor.point


def _by_place(sensors: Sequence[Sensor]) -> dict[Place, list[Sensor]]:
    out: dict[Place, list[Sensor]] = {}
    for sensor in sensors:
        out.setdefault(_place(sensor), []).append(sensor)
    return out


def _pairs(sensors: Sequence[Sensor]) -> list[tuple[int, int]]:
    """Pairs of sensors of one direction, each with its nearest `RULES.neighbours` in other places."""
    found: dict[tuple[int, int], None] = {}
    for k, sensor in enumerate(sensors):
        alike = [
            j for j, o in enumerate(sensors) if o.direction == sensor.direction and _place(o) != _place(sensor)
        ]  # fmt: skip
        far = [math.dist(sensors[j].point or _NOWHERE, sensor.point or _NOWHERE) for j in alike]
        for j in (alike[i] for i in np.argsort(far, kind="stable")[: RULES.neighbours]):
            found[min(k, j), max(k, j)] = None
    return list(found)
