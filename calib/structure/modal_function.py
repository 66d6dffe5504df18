"""Modal model defined by a function from named parameters to modes at sensors, without matrices."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from calib.errors.arguments import integer, objects
from calib.errors.errors import EvaluationError, InputError, raised_anew
from calib.errors.own_code import defined_at
from calib.execution.outcome import named_responses
from calib.measurement.modal import DIRECTIONS, Sensor
from calib.problem.differences import STEP
from calib.problem.space import ParameterSpace
from calib.results.fingerprint import digest_of
from calib.results.in_short import Short
from calib.structure.eigenproblem.derivatives import ModeDerivatives
from calib.structure.eigenproblem.mode_tracking import Moved, followed_derivatives, of_kinds
from calib.structure.function_parts import ScaledPart, scaled_parts
from calib.structure.geometry import Mesh
from calib.structure.located import sensor_partners
from calib.structure.modal_result import Numbered, mode_numbers, modes_from_result
from calib.structure.model import Assumption
from calib.structure.modes import Modes
from calib.structure.places import ModelPlace

REMEMBERED = 1000
"""Points whose modes are cached."""

_SENSOR = re.compile(r"(\d+)(r?[xyz])")


class Memory:
    """Cache of the latest results of functions, so that a point needed by a derivative is solved once."""

    __slots__ = ("_found",)  # no state: what is cached is no part of a model's content

    def __init__(self) -> None:
        self._found: dict[tuple[int, tuple[tuple[str, float], ...]], tuple[Any, Modes | EvaluationError]] = {}

    def __reduce__(self) -> tuple[Any, ...]:
        return Memory, ()

    def ask(self, function: Any, values: Mapping[str, float], solve: Callable[[], Modes]) -> Modes:
        """The cached modes of a point, or the result of ``solve``; a cached failure is raised again."""
        key = (id(function), tuple(values.items()))
        if key not in self._found:
            outcome: Modes | EvaluationError
            try:
                outcome = solve()
            except EvaluationError as fault:
                outcome = fault
            while len(self._found) >= REMEMBERED:
                del self._found[next(iter(self._found))]
            self._found[key] = function, outcome  # keeps the function alive, so that its id is not reused
        known = self._found[key][1]
        if isinstance(known, EvaluationError):
            raise raised_anew(known)
        return known


@dataclass(frozen=True)
class ModalFunctionModel(Short):
    """Anything that maps named parameters to modes at sensors: a script, an external solver, a closed form.

    It is compared, paired, calibrated and explained like a model of matrices. It lacks what needs matrices: strain
    energies (modes are paired by MAC and frequency) and a reduced basis. Derivatives
    are central differences that track each mode by its MAC, with two function calls for each parameter, or one-sided
    ones with one; see `calib.structure.eigenproblem.mode_tracking.followed_derivatives`.

    Attributes
    ----------
    name : str
    space : ParameterSpace
    function : callable
        Takes ``{parameter: value}``, every value in its parameter's unit, and returns the vibration modes in ascending
        frequency, as an object or mapping with ``natural_freq`` (n_modes,) in Hz, ``damping_ratio`` (n_modes,) if
        `damped`, and ``shapes`` (n_sensors, n_modes), real or complex, in any scale; or as a tuple of these in that
        order. An exception marks a failed point.
    sensors : sequence of Sensor, of (node, direction), or of names like ``12y``
        Sensor of each row of the shapes. Where all have a position (`Sensor.point`), measured ones are found by it.
    n_modes : int
        Modes that the function returns at every point; of more the lowest are taken. A few more than were measured let
        the pairing consider close neighbours and leave room for modes that an effect adds.
    damped : bool
        Whether it returns damping ratios.
    step : float
        Half step of a difference, over the range between the limits; raise it for a solver with numerical noise.
    one_sided : bool
        Whether a derivative takes one call for each parameter, as for a costly solver that rounds its results: its
        error is in proportion to the step.
    assumptions : tuple of Assumption
    sensor_tolerance : float, optional
        Largest distance of a measured node from a declared one, as in `calib.StructuralModel`.
    lines : tuple of (int, int)
        Pairs of nodes with a sensor each that figures join by a line.
    parts : tuple of ScaledPart
        Parts that the function scales where it is asked to; an explanation asks whether one of them is wrong.
    identity : str
        Identifies the function where its code and the objects it holds are not enough.
    memory : Memory
        Cache of its latest results; copies with other parameters, limits or values share it.

    Raises
    ------
    InputError
        For an invalid or repeated sensor, or any other invalid attribute.

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
    sensor_tolerance: float | None = field(default=None, kw_only=True)
    one_sided: bool = field(default=False, kw_only=True)
    lines: tuple[tuple[int, int], ...] = field(default=(), kw_only=True, repr=False)
    parts: tuple[ScaledPart, ...] = ()
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
        object.__setattr__(self, "parts", scaled_parts(self.parts, f"{place}, parts"))
        object.__setattr__(self, "n_modes", integer(self.n_modes, 1, f"{place}, n_modes"))
        if not (isinstance(self.step, int | float) and 0 < self.step <= 0.1):
            raise InputError(f"its step is {self.step!r:.40}", place=place, remedy="give a part of the range, to 0.1")

    def __str__(self) -> str:
        return f"{self.name}: a function of {len(self.space.parameters)} parameters that returns {self.n_modes} modes"

    @property
    def fingerprint(self) -> str:
        """Hash over the function, the objects it holds, and the requested modes and sensors."""
        own = self.identity or digest_of(self.name, self.function)
        sensors = [(s.node, s.direction) for s in self.sensors]
        return digest_of(own, sensors, self.n_modes, self.damped)[:16]

    # -- solutions -----------------------------------------------------------------------------------------------------

    def modes(self, values: Mapping[str, float], count: int) -> Modes:
        """The ``count`` lowest modes, with shapes over the declared sensors; each point is solved once.

        Raises
        ------
        EvaluationError
            When the function fails or does not return modes at these sensors.
        """
        complete = self.space.complete(values)
        found = self.memory.ask(self.function, complete, lambda: self._solved(complete))
        return found if count >= found.n_modes else found.subset(range(count))

    def numbers(self, values: Mapping[str, float]) -> dict[str, float]:
        """All modes as named numbers (see `mode_numbers`), solved anew whatever is cached.

        Values of other names are passed on: the function may accept the parameters of effects.
        """
        own = {name: v for name, v in values.items() if name in self.space}
        return mode_numbers(self._solved({**self.space.complete(own), **values}), self.sensors)

    @property
    def numbers_function(self) -> Callable[[Mapping[str, float]], Mapping[str, float]]:
        """The function of these numbers, be it `numbers` or that of `with_function`."""
        return self.function.numbers if isinstance(self.function, Numbered) else self.numbers

    def with_function(self, numbers: Callable[[Mapping[str, float]], Mapping[str, float]]) -> ModalFunctionModel:
        """The model with another function, which returns the numbers of its modes."""
        return replace(self, function=Numbered(numbers, self.sensors, self.damped), memory=Memory())

    def _solved(self, values: dict[str, float]) -> Modes:
        found: list[Modes] = []

        def ask(point: Mapping[str, float]) -> dict[str, float]:
            result = self.function(point)
            try:
                found.append(modes_from_result(result, self.sensors, self.n_modes, self.damped))
            except EvaluationError as fault:
                raise EvaluationError(*fault.args, at=defined_at(self.function, point)) from None
            return {}

        named_responses(ask, values)
        return found[0]

    # -- protocol of `calib.structure.modal_model.ModalModel` ----------------------------------------------------------

    @property
    def by_differences(self) -> bool:
        """Yes: a derivative costs evaluations for each parameter."""
        return True

    @property
    def reducible(self) -> None:
        """None: there are no matrices to reduce."""
        return

    @property
    def clusters(self) -> tuple[str, ...]:
        """Empty: a function has no strain energy."""
        return ()

    @property
    def dissipates(self) -> bool:
        """Whether its modes are damped."""
        return self.damped

    @property
    def roots(self) -> frozenset[str]:
        """Empty: derivatives are differences."""
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
        """Differences that track each mode; see `followed_derivatives`.

        A function may tell by ``moving(values)`` of which parameters act on frequencies, damping or shapes alone as
        others act on all, with the ratio: these need no differences of their own.
        """

        def solved(there: Mapping[str, float]) -> Modes:
            return self.modes(there, self.n_modes)

        tells: Callable[[Mapping[str, float]], Mapping[str, Moved]] | None = getattr(self.function, "moving", None)
        known = {} if tells is None else tells(values)
        moved = {name: known[name] for name in names if name in known}
        own = list(dict.fromkeys(moved[name].parameter if name in moved else name for name in names))
        found = followed_derivatives(
            at or solved, self.space, values, modes, own, which, rows, self.step, self.one_sided
        )  # fmt: skip
        return of_kinds(found, modes.subset(which), names, moved) if moved else found

    def weighted(self, values: Mapping[str, float], shapes: np.ndarray) -> None:
        """None: there is no mass matrix."""
        return None

    def sensor_rows(self, sensors: Sequence[Sensor]) -> np.ndarray:
        """Declared sensor of each one, (n_sensors, n_declared): by the nearest place, else by node and direction.

        Raises InputError for a sensor off the declared ones or in a direction that they do not have.
        """
        partners = sensor_partners(self, sensors)
        nodes = {} if partners is None else partners.require(self.name).of
        named = {(s.node, s.direction): k for k, s in enumerate(self.sensors)}
        rows = np.zeros((len(sensors), len(self.sensors)))
        for i, sensor in enumerate(sensors):
            k = named.get((nodes.get(sensor.node, sensor.node), sensor.direction))
            if k is None:
                raise InputError(
                    f"the function of the model {self.name} gives no motion there", place=f"sensor {sensor.name}",
                    remedy="give it a row of the shapes and declare it, or take the sensor out of the measured shapes",
                )  # fmt: skip
            rows[i, k] = 1.0
        return rows

    def energy_shares(self, values: Mapping[str, float], shapes: np.ndarray, names: Sequence[str]) -> np.ndarray:
        """Empty, (0, n_modes): there are no clusters."""
        return np.zeros((len(names), shapes.shape[1]))

    def strain_energy(self, values: Mapping[str, float], shapes: np.ndarray) -> np.ndarray:
        """1 for every mode, (n_modes,): it is unknown, and any mode may be paired."""
        return np.ones(shapes.shape[1])

    @cached_property
    def _nodes(self) -> dict[int, int]:
        """Index in the mesh of every node with a sensor."""
        return {node: k for k, node in enumerate(dict.fromkeys(s.node for s in self.sensors))}

    @property
    def places(self) -> tuple[ModelPlace, ...]:
        """None: what a function does inside is not known."""
        return ()

    @property
    def labels(self) -> tuple[int, ...]:
        """Nodes of its sensors, in the order of the mesh."""
        return tuple(self._nodes)

    @property
    def mesh(self) -> Mesh:
        """Positions of its sensors, NaN where unknown, with its `lines`; without faces."""
        points = np.full((len(self._nodes), 3), np.nan)
        for sensor in self.sensors:
            if sensor.point is not None:
                points[self._nodes[sensor.node]] = sensor.point
        joined = [(self._nodes[a], self._nodes[b]) for a, b in self.lines]
        return Mesh(points, np.array(joined, dtype=int).reshape(-1, 2), ("model",) * len(joined))

    def displacement(self, shapes: np.ndarray) -> np.ndarray:
        """Translations of the nodes of its sensors, (n_nodes, 3, n_modes); 0 in directions without a sensor."""
        out = np.zeros((len(self._nodes), 6, shapes.shape[1]), dtype=shapes.dtype)
        for sensor, row in zip(self.sensors, shapes, strict=True):
            out[self._nodes[sensor.node], DIRECTIONS.index(sensor.direction)] = row
        return out[:, :3]


def _sensors(given: Any, place: str) -> tuple[Sensor, ...]:
    """Sensors from `Sensor` objects, pairs or names."""
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
            raise InputError(f"{one!r:.40} is not a sensor", place=place, remedy=remedy)
        found.append(one)
    if not found:
        raise InputError("there are none", place=place, remedy=remedy)
    for name, count in Counter(s.name for s in found).items():
        if count > 1:
            raise InputError(f"{name} is named twice", place=place, remedy="give each sensor one row of the shapes")
    return tuple(found)
