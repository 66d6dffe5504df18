"""A model without matrices that still has modes: a function from named parameters to modes at sensors."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from calib.errors import EvaluationError, InputError, again
from calib.fingerprint import digest_of
from calib.given import objects, whole
from calib.measurement.modal import DIRECTIONS, Sensor
from calib.outcome import answered
from calib.space import ParameterSpace
from calib.structure.derivatives import ModeDerivatives
from calib.structure.followed import followed_derivatives
from calib.structure.geometry import Mesh
from calib.structure.modal_answer import modes_of, numbers_of
from calib.structure.model import Assumption
from calib.structure.modes import Modes

STEP = 1e-4
"""Half a difference, over the range between the limits of a parameter."""

REMEMBERED = 1000
"""Points whose modes are kept."""

_SENSOR = re.compile(r"(\d+)(r?[xyz])")


class Memory:
    """The last answers of functions: a solver is not asked twice for a point that a derivative has asked for."""

    def __init__(self) -> None:
        self._found: dict[tuple[int, tuple[tuple[str, float], ...]], tuple[Any, Modes | EvaluationError]] = {}

    def __reduce__(self) -> tuple[Any, ...]:
        return Memory, ()

    def ask(self, function: Any, values: Mapping[str, float], solve: Callable[[], Modes]) -> Modes:
        """What is known of a point, or what ``solve`` gives; a failure is raised again."""
        key = (id(function), tuple(values.items()))
        if key not in self._found:
            answer: Modes | EvaluationError
            try:
                answer = solve()
            except EvaluationError as fault:
                answer = fault
            while len(self._found) >= REMEMBERED:
                del self._found[next(iter(self._found))]
            self._found[key] = function, answer  # with the function, so that no other one gets its identity
        known = self._found[key][1]
        if isinstance(known, EvaluationError):
            raise again(known)
        return known


@dataclass(frozen=True)
class ModalFunctionModel:
    """Anything that maps named parameters to modes at sensors: a script, an external solver, a closed form.

    It is compared, paired, calibrated and explained like a model of matrices. What needs matrices it does not offer:
    strain energies (pairing goes by MAC and frequency), a reduced basis, unnamed local changes of parts. Derivatives
    are central differences that follow each mode by its MAC, two calls of the function a parameter; see
    `calib.structure.followed.followed_derivatives`.

    Attributes
    ----------
    name : str
    space : ParameterSpace
    function : callable
        Takes ``{parameter: value}``, every value in its parameter's unit, and returns the vibration modes in ascending
        frequency, as an object or mapping with ``natural_freq`` (n_modes,) in Hz, ``damping_ratio`` (n_modes,) if
        `damped`, and ``shapes`` (n_sensors, n_modes), real or complex, in any scale; or as a tuple of these in that
        order. What it raises is a failed point.
    sensors : sequence of Sensor, of (node, direction), or of names like ``12y``
        What each row of the shapes is. Places (`Sensor.point`) are for pictures.
    n_modes : int
        Modes that the function gives at every point; of more the lowest are taken. Some more than were measured let
        the pairing see close rivals, and leave room for what an effect adds.
    damped : bool
        Whether it gives damping ratios.
    step : float
        Half a difference, over the range between the limits; to be raised for a solver whose last digits are not exact.
    assumptions : tuple of Assumption
    identity : str
        What the function is told by, where something else than its code and what it holds is needed.
    memory : Memory
        Its last answers; a model with other parameters, limits or values shares them.

    Raises
    ------
    InputError
        For a sensor that is no sensor or is named twice, and for anything else that cannot be used.

    Examples
    --------
    A string under tension, seen at three of its points.

    >>> import numpy as np
    >>> import calib
    >>> def string(v):
    ...     number, place = np.arange(1, 4), np.array([[0.2], [0.5], [0.7]])
    ...     return {"natural_freq": number * np.sqrt(100.0 / v["line"]) / 2, "shapes": np.sin(np.pi * number * place)}
    >>> model = calib.ModalFunctionModel(
    ...     "string", calib.ParameterSpace([calib.Parameter("line", 0.02, 0.005, 0.05, "kg/m")]), string,
    ...     sensors=["1z", "2z", "3z"], n_modes=3,
    ... )
    >>> model.modes({"line": 0.01}, 2).natural_freq
    array([ 50., 100.])
    """

    name: str
    space: ParameterSpace
    function: Callable[[Mapping[str, float]], Any]
    sensors: tuple[Sensor, ...]
    n_modes: int
    damped: bool = False
    step: float = STEP
    assumptions: tuple[Assumption, ...] = ()
    identity: str = ""
    memory: Memory = field(default_factory=Memory, repr=False, compare=False)

    def __post_init__(self) -> None:
        place = f"model {self.name}"
        objects([self.space], ParameterSpace, f"{place}, space")
        if not callable(self.function):
            raise InputError(
                f"its function is {self.function!r:.40}", place=place, remedy="give a function of named values"
            )
        object.__setattr__(self, "sensors", _sensors(self.sensors, f"{place}, sensors"))
        object.__setattr__(self, "n_modes", whole(self.n_modes, 1, f"{place}, n_modes"))
        if not (isinstance(self.step, int | float) and 0 < self.step <= 0.1):
            raise InputError(f"its step is {self.step!r:.40}", place=place, remedy="give a part of the range, to 0.1")

    @property
    def fingerprint(self) -> str:
        """Hash over the function, all that it holds, and what is asked of it."""
        own = self.identity or digest_of(self.name, self.function)
        sensors = [(s.node, s.direction) for s in self.sensors]
        return digest_of(own, sensors, self.n_modes, self.damped, self.step)[:16]

    # -- what is asked of the function ---------------------------------------------------------------------------------

    def modes(self, values: Mapping[str, float], count: int) -> Modes:
        """The ``count`` lowest modes, with shapes over the declared sensors; each point is asked once.

        Raises
        ------
        EvaluationError
            When the function fails, or what it gives are no modes at these sensors.
        """
        complete = self.space.complete(values)
        found = self.memory.ask(self.function, complete, lambda: self._solved(complete))
        return found if count >= found.n_modes else found.subset(range(count))

    def numbers(self, values: Mapping[str, float]) -> dict[str, float]:
        """All modes as named numbers (see `numbers_of`), asked of the function whatever is remembered.

        Values that are none of its parameters are passed on: the function may know those of effects.
        """
        own = {name: v for name, v in values.items() if name in self.space}
        return numbers_of(self._solved({**self.space.complete(own), **values}), self.sensors)

    def _solved(self, values: dict[str, float]) -> Modes:
        found: list[Modes] = []

        def ask(point: Mapping[str, float]) -> dict[str, float]:
            found.append(modes_of(self.function(point), self.sensors, self.n_modes, self.damped))
            return {}

        answered(ask, values)
        return found[0]

    # -- what a comparison asks, see `calib.structure.modal_model.ModalModel` ------------------------------------------

    @property
    def clusters(self) -> tuple[str, ...]:
        """None: a function tells no strain energy."""
        return ()

    @property
    def dissipates(self) -> bool:
        """Whether its modes are damped."""
        return self.damped

    @property
    def roots(self) -> frozenset[str]:
        """None: it has no derivatives but differences."""
        return frozenset()

    def derivatives(
        self,
        values: Mapping[str, float],
        modes: Modes,
        names: Sequence[str],
        which: Sequence[int] | np.ndarray,
        rows: np.ndarray,
        at: Callable[[Mapping[str, float]], Modes] | None = None,
    ) -> ModeDerivatives:
        """Differences that follow each mode; see `followed_derivatives`."""

        def solved(there: Mapping[str, float]) -> Modes:
            return self.modes(there, self.n_modes)

        return followed_derivatives(at or solved, self.space, values, modes, names, which, rows, self.step)

    def weighted(self, values: Mapping[str, float], shapes: np.ndarray) -> np.ndarray:
        """The shapes themselves: without a mass every sensor weighs the same."""
        return shapes

    def sensor_rows(self, sensors: Sequence[Sensor]) -> np.ndarray:
        """Which declared sensor each one is, (n_sensors, n_declared): by node and direction, or by its place."""
        named = {(s.node, s.direction): k for k, s in enumerate(self.sensors)}
        placed = {(s.point, s.direction): k for k, s in enumerate(self.sensors) if s.point is not None}
        rows = np.zeros((len(sensors), len(self.sensors)))
        for i, sensor in enumerate(sensors):
            k = named.get((sensor.node, sensor.direction))
            if k is None and sensor.point is not None:
                k = placed.get((sensor.point, sensor.direction))
            if k is None:
                raise InputError(
                    f"the function of the model {self.name} gives no motion there", place=f"sensor {sensor.name}",
                    remedy="give it a row of the shapes and declare it, or take the sensor out of the measured shapes",
                )  # fmt: skip
            rows[i, k] = 1.0
        return rows

    def energy_shares(self, values: Mapping[str, float], shapes: np.ndarray, names: Sequence[str]) -> np.ndarray:
        """Of no cluster, (0, n_modes)."""
        return np.zeros((len(names), shapes.shape[1]))

    def strain_energy(self, values: Mapping[str, float], shapes: np.ndarray) -> np.ndarray:
        """1 for every mode, (n_modes,): it is unknown, and any may be paired."""
        return np.ones(shapes.shape[1])

    @cached_property
    def _nodes(self) -> dict[int, int]:
        """Number of every node of its sensors in the mesh."""
        return {node: k for k, node in enumerate(dict.fromkeys(s.node for s in self.sensors))}

    @property
    def mesh(self) -> Mesh:
        """The places of its sensors, NaN where they are unknown; nothing lies between them."""
        points = np.full((len(self._nodes), 3), np.nan)
        for sensor in self.sensors:
            if sensor.point is not None:
                points[self._nodes[sensor.node]] = sensor.point
        return Mesh(points, np.zeros((0, 2), dtype=int), ())

    def displacement(self, shapes: np.ndarray) -> np.ndarray:
        """Translations of the nodes of its sensors, (n_nodes, 3, n_modes); 0 in directions that it does not tell."""
        out = np.zeros((len(self._nodes), 6, shapes.shape[1]), dtype=shapes.dtype)
        for sensor, row in zip(self.sensors, shapes, strict=True):
            out[self._nodes[sensor.node], DIRECTIONS.index(sensor.direction)] = row
        return out[:, :3]


def _sensors(given: Any, place: str) -> tuple[Sensor, ...]:
    """Sensors from sensors, pairs or names."""
    remedy = 'give sensors such as ["1z", (2, "x"), calib.Sensor(3, "z", (0.5, 0.0, 0.0))]'
    if isinstance(given, str | bytes | Mapping) or not isinstance(given, Iterable):
        raise InputError(f"they are {given!r:.40}", place=place, remedy=remedy)
    found = []
    for one in given:
        if isinstance(one, str) and (match := _SENSOR.fullmatch(one.strip())):
            one = Sensor(int(match[1]), match[2])
        elif isinstance(one, tuple | list) and len(one) == 2 and isinstance(one[0], int | np.integer):
            one = Sensor(int(one[0]), one[1])
        if not isinstance(one, Sensor) or one.direction not in DIRECTIONS:
            raise InputError(f"{one!r:.40} is no sensor", place=place, remedy=remedy)
        found.append(one)
    if not found:
        raise InputError("there are none", place=place, remedy=remedy)
    names = [s.name for s in found]
    for name in names:
        if names.count(name) > 1:
            raise InputError(f"{name} is named twice", place=place, remedy="give each sensor one row of the shapes")
    return tuple(found)
