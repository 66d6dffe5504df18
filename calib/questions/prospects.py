"""What else could be measured on a structure: sensors, modes, repeats, tests of parts by themselves."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from calib.correlation.problem import ModalProblem
from calib.correlation.residual import ModalResidual
from calib.correlation.scatter import Scatter
from calib.effect import Effect
from calib.errors import EvaluationError, InputError
from calib.measurement.modal import DIRECTIONS, MeasuredModes, Sensor
from calib.missing.advice import Option, Prospects
from calib.missing.score import Scores
from calib.missing.state import State
from calib.questions.hypotheses import ModalHypotheses
from calib.structure.modes import Modes

PLACES = 40
"""Places on the structure at which a further sensor is tried, in three directions each."""
TOGETHER = 4
"""Sensors that make one option."""
MORE_MODES = 3
"""Modes beyond those measured that are tried."""
NEAR = 0.1
"""Relative distance in frequency within which a model mode is taken for a withheld one."""
BENCH = 0.03
"""Standard deviation of a parameter, over its value, after a test of that part by itself."""


def modal_prospects(
    hypotheses: ModalHypotheses,
    state: State,
    effects: Sequence[Effect],
    found: Scores,
    scale: float,
    withheld: Mapping[str, float] | None = None,
) -> Prospects:
    """Further measurements of a modal test, linearised at a fitted model.

    The modes of the fitted model stand in for measured ones, at the measured sensors and at places spread over the
    structure, with the scatter of the measurement.

    Parameters
    ----------
    hypotheses : ModalHypotheses
    state : State
    effects : sequence of Effect
        Candidates, none of them in the state's model.
    found : Scores
        Scores of the candidates, for the point of a grid that speaks for each of them.
    scale : float
        Factor on the scatter.
    withheld : mapping from str to float, optional
        Natural frequency (Hz) of every withheld mode, which can be used without measuring it.
    """
    imagined = _Imagined(hypotheses, state, withheld or {})
    residual = imagined.residual(state.effects)
    slope = -residual.jacobian(state.values, state.names)
    columns = []
    for effect in effects:
        point = found.points[found.best(effect.name)]
        if not point:
            columns.append(-residual.jacobian(state.values, [effect.name])[:, 0])
            continue
        try:
            changed = imagined.residual((*state.effects, effect.name)).residual({**state.values, **point})
        except (EvaluationError, InputError):
            changed = np.zeros(len(slope))
        columns.append((residual.residual(state.values) - changed) / point[effect.name])
    labels = residual.rows
    modes, sensors = set(imagined.modes), {s.name for s in imagined.sensors}
    measured = np.array([row.mode in modes and (not row.sensor or row.sensor in sensors) for row in labels])
    table = np.column_stack(columns) / scale
    options = _options(hypotheses, state, imagined, residual, slope / scale, table)
    names = tuple(e.name for e in effects)
    return Prospects(state.names, state.prior_sd, slope / scale, names, table, measured, tuple(options))


def _options(
    hypotheses: ModalHypotheses,
    state: State,
    imagined: _Imagined,
    residual: ModalResidual,
    slope: np.ndarray,
    columns: np.ndarray,
) -> list[Option]:
    labels, known = residual.rows, {s.name for s in imagined.sensors}
    measured = set(imagined.modes)
    out = [Option("twice the repeats", "repeats", scale=1 / math.sqrt(2))]
    for mode in imagined.more:
        own = np.array([row.mode == mode and (not row.sensor or row.sensor in known) for row in labels])
        out.append(Option(f"{mode}", "mode", rows=own))
    of_sensor: dict[str, np.ndarray] = {}
    for name in imagined.extra:
        of_sensor[name] = np.array([row.sensor == name and row.mode in measured for row in labels])
    if of_sensor:
        here = np.array([row.mode in measured and (not row.sensor or row.sensor in known) for row in labels])
        chosen: dict[tuple[str, ...], None] = {}
        for k in range(columns.shape[1]):
            chosen.setdefault(_best_sensors(slope, columns[:, k], here, of_sensor, state.prior_sd))
        for several in chosen:
            places = ", ".join(imagined.extra[name] for name in several)
            rows = np.logical_or.reduce([of_sensor[name] for name in several])
            out.append(Option(f"{len(several)} more sensors at {places}", "sensor", rows=rows))
    for name in state.names:
        p = hypotheses.space[name] if name in hypotheses.space else None
        if p is not None and abs(p.value) > 0 and BENCH * abs(p.value) < p.prior_width:
            label = f"{p.description or name} ({name}) tested by itself to {100 * BENCH:.0f} %"
            out.append(Option(label, "bench", prior_sd={name: BENCH * abs(p.value)}))
    return out


def _best_sensors(
    slope: np.ndarray, column: np.ndarray, here: np.ndarray, of_sensor: dict[str, np.ndarray], prior_sd: np.ndarray
) -> tuple[str, ...]:
    """Sensors that each by itself would add most to the length of a fingerprint after projection."""
    g = slope * prior_sd
    information = g[here].T @ g[here] + np.eye(len(prior_sd))
    follow = np.linalg.solve(information, g[here].T @ column[here])
    # What a further row would see once the parameters have followed; that they follow it too is second order.
    rest = column - g @ follow
    gains = {name: float(np.sum(rest[rows] ** 2)) for name, rows in of_sensor.items()}
    return tuple(sorted(sorted(gains, key=lambda n: -gains[n])[:TOGETHER]))


def imagined_measurement(
    known: MeasuredModes,
    scatter: Scatter,
    names: tuple[str, ...],
    modes: Modes,
    which: Sequence[int],
    sensors: tuple[Sensor, ...],
    shapes: np.ndarray,
) -> MeasuredModes:
    """Modes of a model as if they had been measured without error, with the scatter of a measurement.

    Parameters
    ----------
    known : MeasuredModes
        What was measured.
    scatter : Scatter
        Its standard deviations; their root mean squares are taken.
    names : tuple of str
        Length n_modes.
    modes : Modes
    which : sequence of int
        Indices of the modes that are measured, length n_modes.
    sensors : tuple of Sensor
    shapes : ndarray (n_sensors, n_modes)
        In the scale of the measured shapes: largest modulus 1 at the sensors that were there.
    """
    freq, ratio = modes.natural_freq[list(which)], modes.damping_ratio[list(which)]
    sizes = [float(np.sqrt(np.mean(s**2))) if s.size else np.nan for s in (scatter.freq, scatter.damping)]
    spread = float(np.sqrt(np.nanmean(scatter.shape**2))) if scatter.shape.size else np.nan
    return replace(
        known,
        names=names,
        natural_freq=freq,
        damped_freq=modes.damped_freq[list(which)],
        freq_std=sizes[0] * freq,
        damping_ratio=ratio,
        damping_std=sizes[1] * ratio,
        sensors=sensors,
        shapes=shapes,
        shape_std=np.full(shapes.shape, spread),
        n_repeats=1,
    )


class _Imagined:
    """A measurement without error of the fitted model, with more sensors and more modes."""

    def __init__(self, hypotheses: ModalHypotheses, state: State, withheld: Mapping[str, float]):
        question = hypotheses.question(state.effects)
        self.hypotheses, self.found = hypotheses, question.at(state.values)
        problem, measured = hypotheses.problem, hypotheses.problem.measured
        self.scatter = question.inner.scatter
        self.sensors = measured.sensors
        index = self.found.pairing.model_index
        self.paired = [int(i) for i in self.found.pairing.paired]
        self.modes = [measured.names[i] for i in self.paired]
        self.columns = [int(index[i]) for i in self.paired]
        freq, window = self.found.modes.natural_freq, problem.freq_window or (0.0, np.inf)
        free = [j for j in range(len(freq)) if j not in self.columns and window[0] <= freq[j] <= window[1]]
        further = [j for j in free if self.found.modes.damping_ratio[j] < 0.9][:MORE_MODES]
        self.more = [_mode_in_words(float(freq[j]), withheld) for j in further]
        self.columns += further
        self.places = self._places() if measured.has_shapes else ()
        self.extra = {s.name: _in_words(s) for s in self.places}
        self.measurement = self._measurement()

    def _places(self) -> tuple[Sensor, ...]:
        """Sensors spread over the structure: each time the node farthest from all before."""
        model = self.hypotheses.variants.model
        points = model.mesh.points
        known = np.array([s.point for s in self.sensors if s.point is not None]).reshape(-1, 3)
        distance = np.linalg.norm(points[:, None] - known[None], axis=2).min(axis=1) if len(known) else np.inf
        distance = np.broadcast_to(distance, (len(points),)).copy()
        first = max((s.node for s in self.sensors), default=0) + 1
        out: list[Sensor] = []
        for k in range(min(PLACES, len(points))):
            n = int(np.argmax(distance))
            if distance[n] <= 1e-6:
                break
            distance = np.minimum(distance, np.linalg.norm(points - points[n], axis=1))
            x, y, z = (round(float(c), 4) for c in points[n])
            out += [s for d in DIRECTIONS[:3] if self._moves(s := Sensor(first + k, d, (x, y, z)))]
        return tuple(out)

    def _moves(self, sensor: Sensor) -> bool:
        try:
            self.hypotheses.variants.model.sensor_rows([sensor])
        except InputError:
            return False
        return True

    def _measurement(self) -> MeasuredModes:
        modes, cols, known = self.found.modes, self.columns, self.hypotheses.problem.measured
        shapes = np.zeros((0, len(cols)), dtype=complex)
        if known.has_shapes:
            model = self.found.model
            shapes = (model.sensor_rows((*self.sensors, *self.places)) @ modes.shapes[:, cols]).astype(complex)
            shapes = shapes / np.abs(shapes[: len(self.sensors)]).max(axis=0)
        names, sensors = (*self.modes, *self.more), (*self.sensors, *self.places)
        return imagined_measurement(known, self.scatter, names, modes, cols, sensors, shapes)

    def residual(self, effects: tuple[str, ...]) -> ModalResidual:
        """Against a variant of the model; modes are paired by what they are."""
        problem: ModalProblem = self.hypotheses.question(effects).inner.problem
        kept = {m: c for m, c in problem.mode_clusters.items() if m in self.modes}
        imagined = replace(problem, measured=self.measurement, mode_clusters=kept, override={}, threshold=0.05)
        floors = replace(self.hypotheses.floors, freq=0.0, damping=0.0, shape=0.0)
        # Scale and phase come from the sensors that are there: what others would see is predicted.
        return ModalResidual(imagined, floors, factor_sensors=tuple(s.name for s in self.sensors))


def _mode_in_words(freq: float, withheld: Mapping[str, float]) -> str:
    near = [name for name, own in withheld.items() if abs(own / freq - 1) < NEAR]
    return f"mode {near[0]}, withheld so far" if len(near) == 1 else f"the mode computed at {freq:.3g} Hz"


def _in_words(sensor: Sensor) -> str:
    assert sensor.point is not None
    return f"({', '.join(f'{c:.2f}' for c in sensor.point)}) {sensor.direction}"
