"""What else could be measured on a structure: sensors, modes, repeats, tests of parts by themselves."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from calib.correlation.problem import ModalProblem
from calib.correlation.residual import ModalResidual, Row
from calib.correlation.scatter import Scatter
from calib.effect import Effect
from calib.errors import EvaluationError, InputError
from calib.measurement.accuracy import Accuracy
from calib.measurement.modal import DIRECTIONS, MeasuredModes, Sensor
from calib.missing.advice import WITHHELD, Prospects, View
from calib.missing.draws import drawn
from calib.missing.findings import Trial
from calib.missing.option import Option
from calib.missing.rivals import Rival, Rivals
from calib.missing.score import Scores
from calib.missing.state import State
from calib.problem import Problem
from calib.questions.hypotheses import ModelHypotheses
from calib.structure.modes import Modes

PLACES = 40
"""Places on the structure at which a further sensor is tried, in three directions each."""
TOGETHER = 4
"""Sensors that make one option."""
MORE_MODES = 3
"""Modes beyond those measured that are tried."""
NEAR = 0.1
"""Relative distance in frequency within which a model mode is taken for a withheld one."""
OVERDAMPED = 0.9
"""Damping ratio from which a mode is not identified in a test."""
ALIKE = 0.6
"""MAC with the mode of the fit from which a mode is taken for the same.

Where two modes mix in equal parts it is 0.5, and no test would give either its name. The blind measurements of
``studies/blind_twin.py`` name a mode by the computed shapes from the same MAC on (``LEAST_MAC``): the advice counts on
no mode that such a test would not find.
"""
BENCH = 0.03
"""Standard deviation of a parameter, over its value, after a test of that part by itself."""


def modal_prospects(
    hypotheses: ModelHypotheses[ModalResidual],
    believed: Sequence[Trial],
    effects: Sequence[Effect],
    found: Scores,
    scale: float,
    withheld: Mapping[str, float] | None = None,
    draws: int = 10,
    seed: int = 1,
) -> Prospects:
    """Further measurements of a modal test, seen from points of the posterior of what may be the truth.

    The modes of the fitted model stand in for measured ones, at the measured sensors and at places spread over the
    structure, with the scatter of the measurement. Every point is laid over these: a mode that leaves the window there,
    is overdamped or looks like no mode of the fit brings nothing there. Where the model cannot be solved at any of
    them there is nothing to advise, and no option.

    Parameters
    ----------
    hypotheses : ModelHypotheses
    believed : sequence of Trial
        The model taken for true, or two that the data cannot tell apart.
    effects : sequence of Effect
        Candidates.
    found : Scores
        Scores of the candidates, for the point of a grid that speaks for each of them.
    scale : float
        Factor on the scatter.
    withheld : mapping from str to float, optional
        Natural frequency (Hz) of every withheld mode, which can be used without measuring it.
    draws : int
        Points drawn from each model.
    seed : int
    """
    imagined = _Imagined(hypotheses, believed[0].state, withheld or {})
    labels = imagined.question(believed[0].names).pair.rows
    measured = _rows_of(labels, imagined.modes, {s.name for s in imagined.sensors})
    seeds = np.random.default_rng(seed).integers(2**31, size=len(believed))
    points = [drawn(trial.state, draws, int(s)) for trial, s in zip(believed, seeds, strict=True)]
    rivals = None
    if len(believed) > 1:
        first, second = (imagined.rival(t, own, scale) for t, own in zip(believed[:2], points[:2], strict=True))
        rivals = Rivals((first, second), measured, seed)
    shares = (1.0,) if rivals is None else rivals.weights
    views = []
    for trial, own, share in zip(believed, points, shares, strict=True):
        seen = [imagined.view(trial, values, effects, found, scale, share) for values in own]
        views += [view for view in seen if view is not None]
    options = _options(hypotheses, believed[0].state, imagined, labels, views, rivals) if views else []
    return Prospects(tuple(e.name for e in effects), measured, tuple(options), tuple(views), rivals)


def _options(
    hypotheses: ModelHypotheses[ModalResidual],
    state: State,
    imagined: _Imagined,
    labels: Sequence[Row],
    views: Sequence[View],
    rivals: Rivals | None,
) -> list[Option]:
    known = {s.name for s in imagined.sensors}
    here = _rows_of(labels, imagined.modes, known)
    out = [Option("twice the repeats", "repeats", scale=1 / math.sqrt(2))]
    for mode in imagined.more:
        out.append(Option(mode, "mode", rows=_rows_of(labels, {mode}, known)))
    of_sensor: dict[str, np.ndarray] = {}
    for name in imagined.extra:
        of_sensor[name] = np.array([row.sensor == name and row.mode in imagined.modes for row in labels])
    if of_sensor:
        chosen: dict[tuple[str, ...], None] = {}
        if rivals is not None:
            apart = {name: rivals.difference(Option(name, "sensor", rows=rows)) for name, rows in of_sensor.items()}
            chosen.setdefault(_largest(apart))
        gains = [_gains_of_sensors(view, here, of_sensor) for view in views]
        for k in range(views[0].columns.shape[1]):
            chosen.setdefault(_largest({n: sum(float(g[n][k]) for g in gains) for n in of_sensor}))
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


def _rows_of(labels: Sequence[Row], modes: Collection[str], sensors: Collection[str]) -> np.ndarray:
    """Rows of some modes that some sensors see, with frequencies and damping, which need none, (n_rows,)."""
    return np.array([row.mode in modes and (not row.sensor or row.sensor in sensors) for row in labels])


def _largest(gains: Mapping[str, float]) -> tuple[str, ...]:
    return tuple(sorted(sorted(gains, key=lambda n: -gains[n])[:TOGETHER]))


def _gains_of_sensors(view: View, here: np.ndarray, of_sensor: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """What each sensor by itself would add to the squared length of every fingerprint after projection, (m,)."""
    g = view.slope * view.prior_sd
    information = g[here].T @ g[here] + np.eye(len(view.names))
    follow = np.linalg.solve(information, g[here].T @ view.columns[here])
    # What a further row would see once the parameters have followed; that they follow it too is second order.
    rest = view.columns - g @ follow
    return {name: np.sum(rest[rows] ** 2, axis=0) * view.weight for name, rows in of_sensor.items()}


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
        In the scale of the measured shapes. A sensor that moves by more than 1 there scatters in proportion: the
        scatter of a shape is a part of its largest motion.
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
        shape_std=spread * np.maximum(np.abs(shapes), 1.0),
        n_repeats=1,
        freq_count=None,
        damping_count=None,
        shape_count=None,
        accuracy=Accuracy(),  # it is in the scatter already
    )


class _Imagined:
    """A measurement without error of the fitted model, with more sensors and more modes."""

    def __init__(self, hypotheses: ModelHypotheses[ModalResidual], state: State, withheld: Mapping[str, float]):
        question = hypotheses.question(state.effects)
        self.hypotheses, self.found = hypotheses, question.at(state.values)
        problem, measured = hypotheses.pair.problem, hypotheses.pair.problem.measured
        self.scatter = question.pair.scatter
        self.sensors = measured.sensors
        index = self.found.pairing.model_index
        self.paired = [int(i) for i in self.found.pairing.paired]
        self.modes = [measured.names[i] for i in self.paired]
        self.columns = [int(index[i]) for i in self.paired]
        freq, window = self.found.modes.natural_freq, problem.freq_window or (0.0, np.inf)
        free = [j for j in range(len(freq)) if j not in self.columns and window[0] <= freq[j] <= window[1]]
        further = [j for j in free if self.found.modes.damping_ratio[j] < OVERDAMPED][:MORE_MODES]
        self.more = _modes_in_words(freq[further].tolist(), withheld)
        self.columns += further
        self.places = self._places() if measured.has_shapes else ()
        self.extra = {s.name: _in_words(s) for s in self.places}
        self.measurement = self._measurement()
        self._questions: dict[tuple[str, ...], Problem[ModalResidual]] = {}

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
        modes, cols, known = self.found.modes, self.columns, self.hypotheses.pair.problem.measured
        shapes = np.zeros((0, len(cols)), dtype=complex)
        if known.has_shapes:
            model = self.found.model
            shapes = (model.sensor_rows((*self.sensors, *self.places)) @ modes.shapes[:, cols]).astype(complex)
            # In the scale that the scatter is told in: not of the largest entry where sensors were left out, and of
            # a further mode that of its largest motion anywhere, which the sensors may hardly see.
            there, here = (np.abs(part).max(axis=0) for part in (shapes, shapes[: len(self.sensors)]))
            told = np.nanmax(np.abs(known.shapes[:, self.paired]), axis=0) / here[: len(self.paired)]
            shapes = shapes * np.concatenate([told, 1 / there[len(self.paired) :]])
        names, sensors = (*self.modes, *self.more), (*self.sensors, *self.places)
        return imagined_measurement(known, self.scatter, names, modes, cols, sensors, shapes)

    def question(self, effects: tuple[str, ...]) -> Problem[ModalResidual]:
        """Against a variant of the model; modes are paired by what they are."""
        if effects not in self._questions:
            asked = self.hypotheses.question(effects)
            problem: ModalProblem = asked.pair.problem
            kept = {m: c for m, c in problem.mode_clusters.items() if m in self.modes}
            imagined = replace(
                problem,
                measured=self.measurement,
                mode_clusters=kept,
                override={},
                reference=self.found.values,
                base=None,
                threshold=0.05,
            )
            floors = replace(self.hypotheses.pair.floors, freq=0.0, damping=0.0, shape=0.0)
            # Scale and phase come from the sensors that are there: what others would see is predicted.
            residual = ModalResidual(imagined, floors, factor_sensors=tuple(s.name for s in self.sensors))
            self._questions[effects] = replace(asked, pair=residual)
        return self._questions[effects]

    def identified(self, question: Problem[ModalResidual], values: Mapping[str, float]) -> np.ndarray:
        """Rows of modes that a test of the model with these values would identify as those of the fit, (n_rows,)."""
        found = question.at(values)
        damping = found.paired(found.modes.damping_ratio)  # NaN where there is no such mode
        alike = np.isnan(found.pairing.mac) | (found.pairing.mac >= ALIKE)
        there = (damping < OVERDAMPED) & alike
        names = {name for name, one in zip(self.measurement.names, there, strict=True) if one}
        return np.array([row.mode in names for row in question.pair.rows])

    def view(
        self,
        trial: Trial,
        values: Mapping[str, float],
        effects: Sequence[Effect],
        found: Scores,
        scale: float,
        share: float,
    ) -> View | None:
        """Slopes and fingerprints at a point; None where the model cannot be solved there or beside it."""
        question, names = self.question(trial.names), trial.state.names
        points = {e.name: found.points[found.best(e.name)] for e in effects if e.name not in trial.names}
        plain = [name for name, point in points.items() if not point]
        try:
            seen, slope = self.identified(question, values), -question.jacobian(values, [*names, *plain])
        except EvaluationError:
            return None
        here, columns = question.residual(values), []
        for effect in effects:
            if effect.name in trial.names or effect.name in plain:
                columns.append(slope[:, [*names, *plain].index(effect.name)])
                continue
            point = points[effect.name]
            other = self.question((*trial.names, effect.name))
            try:
                changed = other.residual({**values, **point})
                both = self.identified(other, {**values, **point})
                columns.append(np.where(both, here - changed, 0.0) / point[effect.name])
            except (EvaluationError, InputError):
                columns.append(np.zeros(len(here)))
        factor = seen[:, None] / scale
        table = np.column_stack(columns) * factor
        # The scale of a shape at further sensors is only as well known as the first ones tell it.
        loose = question.pair.factor_spread(question.at(values)) * seen[:, None]
        every = (*names, *(f"scale {k}" for k in range(loose.shape[1])))
        known = np.append(trial.state.prior_sd, np.ones(loose.shape[1]))
        return View(every, known, np.hstack([slope[:, : len(names)] * factor, loose]), table, share)

    def rival(self, trial: Trial, points: Sequence[Mapping[str, float]], scale: float) -> Rival:
        """What a fitted model predicts at its fit and at points of its posterior; both count from the imagined test."""
        question, state = self.question(trial.names), trial.state
        there = self.identified(question, state.values)
        kept, drawn_there, seen = [], [], []
        for values in points:
            try:
                rows = self.identified(question, values)
                drawn_there.append(np.where(rows, -question.residual(values), 0.0) / scale)
            except EvaluationError:
                continue
            kept.append(values)
            seen.append(rows)
        factor = there / scale
        fit, slope = -question.residual(state.values) * factor, -question.jacobian(state.values, state.names)
        return Rival(
            trial.names[0], trial.ln_evidence, state, fit, slope * factor[:, None], tuple(kept),
            np.array(drawn_there), np.array(seen), there,
            question.pair.factor_spread(question.at(state.values)) * there[:, None],
        )  # fmt: skip


def _modes_in_words(freqs: Sequence[float], withheld: Mapping[str, float]) -> list[str]:
    """What each computed mode is called, no two alike: a withheld one by its name, where it can be no other."""
    closest = {
        name: min(range(len(freqs)), key=lambda k: abs(own / freqs[k] - 1), default=-1)
        for name, own in withheld.items()
    }
    words = []
    for k, freq in enumerate(freqs):
        near = [name for name, own in withheld.items() if abs(own / freq - 1) < NEAR]
        known = len(near) == 1 and closest[near[0]] == k
        words.append(f"mode {near[0]}{WITHHELD}" if known else f"the mode computed at {freq:.3g} Hz")
    same = {w: words.count(w) for w in words}
    return [w if same[w] == 1 else f"{w} ({words[: k + 1].count(w)} of {same[w]})" for k, w in enumerate(words)]


def _in_words(sensor: Sensor) -> str:
    assert sensor.point is not None
    return f"({', '.join(f'{c:.2f}' for c in sensor.point)}) {sensor.direction}"
