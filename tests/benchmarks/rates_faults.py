"""Blind modal tests whose measurement has a fault, as real ones do; faults of the test are candidates.

One in two has nothing hidden beside the fault, the other an effect of the library. Whatever effect is named that is not
there is a wrong name.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from rates_frame import FrameWorld
from rates_outcome import Measured
from rates_scenarios import ANY, Scenario
from rates_world import World

from calib.measurement.modal import MeasuredModes, Sensor
from calib.measurement.repeats import Repeat
from calib.missing.explanation import Explanation
from calib.problem.effect import Effect
from calib.structure.modes import Modes

FAULTS = (
    "gain", "place", "rotation", "cross-talk", "set-up factor", "odd repeat",
    "exchange", "axes", "far cross-talk", "mixed modes",
)  # fmt: skip
GAIN, FACTOR, SHARE, ANGLE, OFF = (0.10, 0.30), (0.05, 0.15), (0.05, 0.20), (10.0, 25.0), (0.15, 0.45)
"""Ranges: of a sensor's gain and a set-up's factor less 1, of the share of another channel, degrees, metres."""
MIXED, FAR = (0.15, 0.40), (0.20, 0.50)
"""Ranges of the share of a neighbouring mode in a shape, over its size, and of a channel far away in the list."""
ODD_FREQ, ODD_SHAPE = 0.06, 0.2
"""Standard deviations of the odd repeat: of its frequencies, relative, and of its shapes over their largest entry."""


def fault_scenarios() -> tuple[Scenario, ...]:
    """Every fault alone and beside an effect."""
    alone = (Scenario(f"fault/{name}", "fault") for name in FAULTS)
    return (*alone, *(Scenario(f"fault/{name}/any", "fault", ANY) for name in FAULTS))


def misread(
    fault: str, shapes: np.ndarray, layout: Sequence[Sensor], rng: np.random.Generator, modes: Mapping[str, float]
) -> tuple[np.ndarray, str]:
    """Shapes (n_sensors, n_modes) as a test with that fault reads them, unchanged for a fault of another kind.

    With the name of the candidate that is right where the fault is one of a pair, else empty. ``modes`` holds the
    natural frequencies, Hz.
    """
    names, right = [s.name for s in layout], ""
    out, k = shapes.copy(), int(rng.integers(len(layout)))
    sign = 1.0 if rng.random() < 0.5 else -1.0
    if fault == "gain":
        out[k] *= 1 + sign * rng.uniform(*GAIN)
    elif fault == "cross-talk":
        out[k] += rng.uniform(*SHARE) * shapes[k - 1]
    elif fault == "rotation":
        # towards the nearest channel of another direction
        apart = [
            float(np.linalg.norm(np.subtract(s.point, layout[k].point))) + 1e9 * (s.direction == layout[k].direction)
            for s in layout
        ]  # fmt: skip
        angle = sign * np.deg2rad(rng.uniform(*ANGLE))
        out[k] = np.cos(angle) * shapes[k] + np.sin(angle) * shapes[int(np.argmin(apart))]
    elif fault == "set-up factor":
        part = len(layout) // 3
        first = int(rng.integers(3)) * part
        out[first : first + part] *= 1 + sign * rng.uniform(*FACTOR)
    elif fault == "exchange":
        j = int(rng.choice([i for i in range(len(layout)) if i != k]))
        out[[k, j]] = shapes[[j, k]]
        right = f"exchange of sensors {names[min(j, k)]} and {names[max(j, k)]}"
    elif fault == "axes":
        pairs = [(i, j) for i, j in itertools.combinations(range(len(layout)), 2) if layout[i].node == layout[j].node]
        i, j = sorted(pairs[int(rng.integers(len(pairs)))], key=lambda at: layout[at].direction)
        out[i], out[j] = sign * shapes[j], -sign * shapes[i]
        right = f"exchange of axes of sensors {names[i]} and {names[j]}, {names[j if sign > 0 else i]} reversed"
    elif fault == "far cross-talk":
        j = int(rng.choice([i for i in range(len(layout)) if abs(i - k) > 1]))
        out[k] += rng.uniform(*FAR) * shapes[j]
        right = f"cross-talk of sensor {names[j]} into {names[k]}"
    elif fault == "mixed modes":
        order, freq = np.argsort(list(modes.values())), np.sort(list(modes.values()))
        closest = int(np.argmin(np.diff(freq) / freq[:-1]))
        i, j = order[[closest, closest + 1]][:: int(sign)]
        size = np.linalg.norm(shapes[:, i]) / np.linalg.norm(shapes[:, j])
        out[:, i] += rng.uniform(*MIXED) * size * shapes[:, j]
        right = "share of mode {1} in mode {0}".format(*np.array(list(modes))[[i, j]])
    return out, right


def _most_real(shapes: np.ndarray) -> np.ndarray:
    return np.asarray(shapes * np.exp(-0.5j * np.angle(np.sum(shapes**2, axis=0))))


@dataclass(frozen=True, eq=False)
class FaultyWorld(World):
    """A world whose tests have a fault each.

    Attributes
    ----------
    now : list
        Fault and generator of the run that is being made.
    right : list of str
        The fault of a pair that is in it, as the candidate is named.
    """

    now: list[Any] = field(default_factory=list)
    right: list[str] = field(default_factory=list)

    @property
    def kinds(self) -> tuple[Scenario, ...]:
        """Faults."""
        return fault_scenarios()

    def measure(self, scenario: Scenario, number: int) -> Measured:
        """As any world's, with the fault."""
        self.now[:] = [scenario.name.split("/")[1], np.random.default_rng([*scenario.name.encode(), number, 7])]
        return super().measure(scenario, number)

    def _solved(
        self, hidden: Sequence[Effect], values: dict[str, float], rng: np.random.Generator
    ) -> tuple[tuple[str, ...], Modes, np.ndarray]:
        with self._misplaced():
            return super()._solved(hidden, values, rng)

    @contextmanager
    def _misplaced(self) -> Iterator[None]:
        """With one sensor at another place of its part, where that is the fault."""
        own, (fault, rng) = self.specimen, self.now
        if fault == "place":
            self.__dict__["specimen"] = replace(own, layout=self._shifted(own.layout, rng))
        try:
            yield
        finally:
            self.__dict__["specimen"] = own

    def _shifted(self, layout: tuple[Sensor, ...], rng: np.random.Generator) -> tuple[Sensor, ...]:
        while True:
            k, axis = int(rng.integers(len(layout))), int(rng.integers(3))
            sensor, step = layout[k], np.zeros(3)
            step[axis] = rng.uniform(*OFF) * (1 if rng.random() < 0.5 else -1)
            x, y, z = np.add(sensor.point, step)
            there = replace(sensor, point=(float(x), float(y), float(z)))
            _, distance = self.specimen.fine.locator.row(there.point, "xyz".index(sensor.direction), sensor.on)
            if distance < 0.1:
                return (*layout[:k], there, *layout[k + 1 :])

    def _combined(self, repeats: Sequence[Repeat]) -> MeasuredModes:
        fault, rng = self.now
        state, out, right = rng.bit_generator.state, list[Repeat](), ""
        assert repeats[0].shape_set is not None
        first = _most_real(repeats[0].shape_set.shapes)
        modes = dict(zip(repeats[0].names, repeats[0].natural_freq.tolist(), strict=True))
        for k, one in enumerate(repeats):
            rng.bit_generator.state = state  # the same fault in all repeats
            shapes, freq = one.shape_set, one.natural_freq
            assert shapes is not None
            own = _most_real(shapes.shapes)  # phases and signs of repeats mean nothing
            own = own * np.sign(np.sum(own * np.conj(first), axis=0).real)
            read, right = misread(fault, own, self.specimen.layout, rng, modes)
            if fault == "odd repeat" and k == len(repeats) - 1:
                freq = freq * np.exp(ODD_FREQ * rng.standard_normal(freq.shape))
                read = read + ODD_SHAPE * np.abs(read).max(axis=0) * rng.standard_normal(read.shape)
            out.append(replace(one, natural_freq=freq, shape_set=replace(shapes, shapes=read)))
        self.right[:] = [right] if right else []
        return super()._combined(out)

    def _told(self, found: Explanation) -> dict[str, Any]:
        told = [fault.name for fault, _ in found.faulty]
        return {"fault": self.now[0], "faults_told": told, "fault_right": self.right[0] in told if self.right else None}


@dataclass(frozen=True, eq=False)
class FaultyFrameWorld(FaultyWorld, FrameWorld):
    """Frames whose tests have a fault each."""
