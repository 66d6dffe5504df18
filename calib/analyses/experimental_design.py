"""Experimental design for modal tests: further sensors, modes, repeats, and bench tests of parts."""

from __future__ import annotations

import itertools
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

import numpy as np

from calib.analyses.hypotheses import ModelHypotheses
from calib.correlation.problem import ModalProblem
from calib.correlation.residual import ModalResidual, Row
from calib.correlation.standard_deviations import StandardDeviations
from calib.effect import Effect
from calib.errors import EvaluationError, InputError
from calib.measurement.accuracy import Accuracy
from calib.measurement.modal import DIRECTIONS, MeasuredModes, Sensor
from calib.missing.candidate_measurement import CandidateMeasurement
from calib.missing.competing import CompetingModel, CompetingModels
from calib.missing.explanation import CandidateFit
from calib.missing.linearised_fit import LinearisedFit
from calib.missing.recommendation import HELD_OUT, ExperimentalDesign, Linearisation
from calib.missing.samples import posterior_samples
from calib.missing.score import Scores
from calib.problem import Problem
from calib.stage import Progress, unheard
from calib.structure.modes import Modes

PLACES = 40
"""Candidate locations of a further sensor, in three directions each."""
TOGETHER = 4
"""Sensors in one candidate measurement."""
MORE_MODES = 3
"""Candidate modes beyond those measured."""
NEAR = 0.1
"""Relative distance in frequency within which a model mode is identified with a held-out one."""
OVERDAMPED = 0.9
"""Damping ratio above which a test does not identify a mode."""
ALIKE = 0.6
"""MAC with the mode of the fit above which a mode counts as the same.

Two modes that mix in equal parts have a MAC of 0.5, and a test could name neither. The blind measurements of
``studies/blind_twin.py`` identify modes by the same threshold (``LEAST_MAC``), so the recommendation relies on no mode
that such a test would miss.
"""
BENCH = 0.03
"""Relative standard deviation of a parameter after a bench test of its part."""


def modal_design(
    hypotheses: ModelHypotheses[ModalResidual],
    believed: Sequence[CandidateFit],
    effects: Sequence[Effect],
    found: Scores,
    scale: float,
    held_out: Mapping[str, float] | None = None,
    samples: int = 10,
    seed: int = 1,
    progress: Progress = unheard,
) -> ExperimentalDesign:
    """Candidate measurements of a modal test, linearised at posterior samples of the credible models.

    The modes of the fitted model stand in for measured ones, at the measured sensors and at locations spread over the
    structure, with the standard deviation of the measurement. At each sample, a mode that leaves the frequency window,
    is overdamped or resembles no mode of the fit contributes nothing. Where the model cannot be solved at any sample,
    there is no candidate measurement.

    Parameters
    ----------
    hypotheses : ModelHypotheses
    believed : sequence of CandidateFit
        The credible model, or the two that the data cannot discriminate.
    effects : sequence of Effect
        Candidates.
    found : Scores
        Scores of the candidates; of an effect with a grid, at its best point.
    scale : float
        Factor on the standard deviation.
    held_out : mapping from str to float, optional
        Natural frequency (Hz) of every held-out mode, which is available without a new test.
    samples : int
        Posterior samples of each model.
    seed : int
    progress : callable
        Called before every sample.
    """
    imagined = _Imagined(hypotheses, believed[0].fit, held_out or {})
    labels = imagined.fit_problem(believed[0].names).pair.rows
    measured = _rows_of(labels, imagined.modes, {s.name for s in imagined.sensors})
    seeds = np.random.default_rng(seed).integers(2**31, size=len(believed))
    points = [posterior_samples(one.fit, samples, int(s)) for one, s in zip(believed, seeds, strict=True)]
    competing = None
    if len(believed) > 1:
        pair = (imagined.competitor(one, own, scale) for one, own in zip(believed[:2], points[:2], strict=True))
        first, second = pair
        competing = CompetingModels((first, second), measured, seed)
    shares = (1.0,) if competing is None else competing.weights
    linearisations, number = [], itertools.count()
    for candidate_fit, own, share in zip(believed, points, shares, strict=True):
        for values in own:
            progress("what to measure next", next(number), sum(map(len, points)))
            linearisation = imagined.linearisation(candidate_fit, values, effects, found, scale, share)
            linearisations += [] if linearisation is None else [linearisation]
    measurements = (
        _options(hypotheses, believed[0].fit, imagined, labels, linearisations, competing) if linearisations else []
    )
    return ExperimentalDesign(
        tuple(e.name for e in effects), measured, tuple(measurements), tuple(linearisations), competing
    )


def _options(
    hypotheses: ModelHypotheses[ModalResidual],
    fit: LinearisedFit,
    imagined: _Imagined,
    labels: Sequence[Row],
    linearisations: Sequence[Linearisation],
    competing: CompetingModels | None,
) -> list[CandidateMeasurement]:
    known = {s.name for s in imagined.sensors}
    here = _rows_of(labels, imagined.modes, known)
    out = [CandidateMeasurement("twice the repeats", "repeats", scale=1 / math.sqrt(2))]
    for mode in imagined.more:
        out.append(CandidateMeasurement(mode, "mode", rows=_rows_of(labels, {mode}, known)))
    of_sensor: dict[str, np.ndarray] = {}
    for name in imagined.extra:
        of_sensor[name] = np.array([row.sensor == name and row.mode in imagined.modes for row in labels])
    if of_sensor:
        chosen: dict[tuple[str, ...], None] = {}
        if competing is not None:
            apart = {
                name: competing.difference(CandidateMeasurement(name, "sensor", rows=rows))
                for name, rows in of_sensor.items()
            }
            chosen.setdefault(_largest(apart))
        gains = [_gains_of_sensors(linearisation, here, of_sensor) for linearisation in linearisations]
        for k in range(linearisations[0].columns.shape[1]):
            chosen.setdefault(_largest({n: sum(float(g[n][k]) for g in gains) for n in of_sensor}))
        for several in chosen:
            places = ", ".join(imagined.extra[name] for name in several)
            rows = np.logical_or.reduce([of_sensor[name] for name in several])
            out.append(CandidateMeasurement(f"{len(several)} more sensors at {places}", "sensor", rows=rows))
    for name in fit.names:
        p = hypotheses.space[name] if name in hypotheses.space else None
        if p is not None and abs(p.value) > 0 and BENCH * abs(p.value) < p.prior_width:
            label = f"{p.description or name} ({name}) tested by itself to {100 * BENCH:.0f} %"
            out.append(CandidateMeasurement(label, "bench", prior_sd={name: BENCH * abs(p.value)}))
    return out


def _rows_of(labels: Sequence[Row], modes: Collection[str], sensors: Collection[str]) -> np.ndarray:
    """Mask of the rows of some modes at some sensors, with frequencies and damping, which need none, (n_rows,)."""
    return np.array([row.mode in modes and (not row.sensor or row.sensor in sensors) for row in labels])


def _largest(gains: Mapping[str, float]) -> tuple[str, ...]:
    return tuple(sorted(sorted(gains, key=lambda n: -gains[n])[:TOGETHER]))


def _gains_of_sensors(
    linearisation: Linearisation, here: np.ndarray, of_sensor: Mapping[str, np.ndarray]
) -> dict[str, np.ndarray]:
    """Gain of each sensor alone in the squared length of every projected signature, (n_effects,)."""
    g = linearisation.slope * linearisation.prior_sd
    information = g[here].T @ g[here] + np.eye(len(linearisation.names))
    update = np.linalg.solve(information, g[here].T @ linearisation.columns[here])
    # Signatures in the further rows after the parameters are updated; their update by these rows is second order.
    rest = linearisation.columns - g @ update
    return {name: np.sum(rest[rows] ** 2, axis=0) * linearisation.weight for name, rows in of_sensor.items()}


def imagined_measurement(
    known: MeasuredModes,
    std: StandardDeviations,
    names: tuple[str, ...],
    modes: Modes,
    which: Sequence[int],
    sensors: tuple[Sensor, ...],
    shapes: np.ndarray,
) -> MeasuredModes:
    """Modes of a model as a noise-free measurement with the standard deviations of a real one.

    Parameters
    ----------
    known : MeasuredModes
        The real measurement.
    std : StandardDeviations
        Its standard deviations, of which the root mean squares are used.
    names : tuple of str
        Length n_modes.
    modes : Modes
    which : sequence of int
        Indices of these modes, length n_modes.
    sensors : tuple of Sensor
    shapes : ndarray (n_sensors, n_modes)
        In the scale of the measured shapes. The standard deviation of an entry above 1 grows in proportion, since
        that of a shape is relative to its largest motion.
    """
    freq, ratio = modes.natural_freq[list(which)], modes.damping_ratio[list(which)]
    sizes = [float(np.sqrt(np.mean(s**2))) if s.size else np.nan for s in (std.freq, std.damping)]
    shape_std = float(np.sqrt(np.nanmean(std.shape**2))) if std.shape.size else np.nan
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
        shape_std=shape_std * np.maximum(np.abs(shapes), 1.0),
        n_repeats=1,
        freq_count=None,
        damping_count=None,
        shape_count=None,
        accuracy=Accuracy(),  # the standard deviations contain it already
    )


class _Imagined:
    """A noise-free measurement of the fitted model, with more sensors and more modes."""

    def __init__(self, hypotheses: ModelHypotheses[ModalResidual], fit: LinearisedFit, held_out: Mapping[str, float]):
        fit_problem = hypotheses.fit_problem(fit.effects)
        self.hypotheses, self.found = hypotheses, fit_problem.at(fit.values)
        problem, measured = hypotheses.pair.problem, hypotheses.pair.problem.measured
        self.std = fit_problem.pair.std
        self.sensors = measured.sensors
        index = self.found.pairing.model_index
        self.paired = [int(i) for i in self.found.pairing.paired]
        self.modes = [measured.names[i] for i in self.paired]
        self.columns = [int(index[i]) for i in self.paired]
        freq, window = self.found.modes.natural_freq, problem.freq_window or (0.0, np.inf)
        free = [j for j in range(len(freq)) if j not in self.columns and window[0] <= freq[j] <= window[1]]
        further = [j for j in free if self.found.modes.damping_ratio[j] < OVERDAMPED][:MORE_MODES]
        self.more = _modes_in_words(freq[further].tolist(), held_out)
        self.columns += further
        self.places = self._places() if measured.has_shapes else ()
        self.extra = {s.name: _in_words(s) for s in self.places}
        self.measurement = self._measurement()
        self._fit_problems: dict[tuple[str, ...], Problem[ModalResidual]] = {}

    def _places(self) -> tuple[Sensor, ...]:
        """Sensors spread over the structure: each one at the node farthest from all earlier ones."""
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
            # Scale of the standard deviations: the measured shapes' own, which with held-out sensors is not the largest
            # entry; for a further mode its largest motion anywhere, where there may be no sensor.
            there, here = (np.abs(part).max(axis=0) for part in (shapes, shapes[: len(self.sensors)]))
            scale = np.nanmax(np.abs(known.shapes[:, self.paired]), axis=0) / here[: len(self.paired)]
            shapes = shapes * np.concatenate([scale, 1 / there[len(self.paired) :]])
        names, sensors = (*self.modes, *self.more), (*self.sensors, *self.places)
        return imagined_measurement(known, self.std, names, modes, cols, sensors, shapes)

    def fit_problem(self, effects: tuple[str, ...]) -> Problem[ModalResidual]:
        """The problem of a variant of the model against this measurement."""
        if effects not in self._fit_problems:
            real = self.hypotheses.fit_problem(effects)
            problem: ModalProblem = real.pair.problem
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
            # Scale and phase are fitted at the existing sensors; entries at further ones are predicted.
            residual = ModalResidual(imagined, floors, factor_sensors=tuple(s.name for s in self.sensors))
            self._fit_problems[effects] = replace(real, pair=residual)
        return self._fit_problems[effects]

    def identified(self, fit_problem: Problem[ModalResidual], values: Mapping[str, float]) -> np.ndarray:
        """Mask of the rows of modes that a test at these values would identify as modes of the fit, (n_rows,)."""
        found = fit_problem.at(values)
        damping = found.paired(found.modes.damping_ratio)  # NaN where there is no such mode
        similar = np.isnan(found.pairing.mac) | (found.pairing.mac >= ALIKE)
        there = (damping < OVERDAMPED) & similar
        names = {name for name, one in zip(self.measurement.names, there, strict=True) if one}
        return np.array([row.mode in names for row in fit_problem.pair.rows])

    def linearisation(
        self,
        candidate_fit: CandidateFit,
        values: Mapping[str, float],
        effects: Sequence[Effect],
        found: Scores,
        scale: float,
        share: float,
    ) -> Linearisation | None:
        """Slopes and signatures at a point; None where the model cannot be solved there or near it."""
        fit_problem, names = self.fit_problem(candidate_fit.names), candidate_fit.fit.names
        points = {e.name: found.points[found.best(e.name)] for e in effects if e.name not in candidate_fit.names}
        differentiable = [name for name, point in points.items() if not point]
        try:
            seen, slope = self.identified(fit_problem, values), -fit_problem.jacobian(values, [*names, *differentiable])
        except EvaluationError:
            return None
        here, columns = fit_problem.residual(values), []
        for effect in effects:
            if effect.name in candidate_fit.names or effect.name in differentiable:
                columns.append(slope[:, [*names, *differentiable].index(effect.name)])
                continue
            point = points[effect.name]
            other = self.fit_problem((*candidate_fit.names, effect.name))
            try:
                changed = other.residual({**values, **point})
                both = self.identified(other, {**values, **point})
                columns.append(np.where(both, here - changed, 0.0) / point[effect.name])
            except (EvaluationError, InputError):
                columns.append(np.zeros(len(here)))
        factor = seen[:, None] / scale
        table = np.column_stack(columns) * factor
        # The scale of a shape at further sensors is known only as well as the existing sensors determine it.
        loose = fit_problem.pair.factor_spread(fit_problem.at(values)) * seen[:, None]
        every = (*names, *(f"scale {k}" for k in range(loose.shape[1])))
        known = np.append(candidate_fit.fit.prior_sd, np.ones(loose.shape[1]))
        return Linearisation(every, known, np.hstack([slope[:, : len(names)] * factor, loose]), table, share)

    def competitor(
        self, candidate_fit: CandidateFit, points: Sequence[Mapping[str, float]], scale: float
    ) -> CompetingModel:
        """Predictions of a model at its fit and at posterior samples, relative to the imagined measurement."""
        fit_problem, fit = self.fit_problem(candidate_fit.names), candidate_fit.fit
        there = self.identified(fit_problem, fit.values)
        kept, sampled, seen = [], [], []
        for values in points:
            try:
                rows = self.identified(fit_problem, values)
                sampled.append(np.where(rows, -fit_problem.residual(values), 0.0) / scale)
            except EvaluationError:
                continue
            kept.append(values)
            seen.append(rows)
        factor = there / scale
        predicted, slope = -fit_problem.residual(fit.values) * factor, -fit_problem.jacobian(fit.values, fit.names)
        return CompetingModel(
            candidate_fit.names[0], candidate_fit.ln_evidence, fit, predicted, slope * factor[:, None], tuple(kept),
            np.array(sampled), np.array(seen), there,
            fit_problem.pair.factor_spread(fit_problem.at(fit.values)) * there[:, None],
        )  # fmt: skip


def _modes_in_words(freqs: Sequence[float], held_out: Mapping[str, float]) -> list[str]:
    """Unique labels of computed modes; a held-out mode by its name where the match is unambiguous."""
    closest = {
        name: min(range(len(freqs)), key=lambda k: abs(own / freqs[k] - 1), default=-1)
        for name, own in held_out.items()
    }
    words = []
    for k, freq in enumerate(freqs):
        near = [name for name, own in held_out.items() if abs(own / freq - 1) < NEAR]
        known = len(near) == 1 and closest[near[0]] == k
        words.append(f"mode {near[0]}{HELD_OUT}" if known else f"the mode computed at {freq:.3g} Hz")
    same = {w: words.count(w) for w in words}
    return [w if same[w] == 1 else f"{w} ({words[: k + 1].count(w)} of {same[w]})" for k, w in enumerate(words)]


def _in_words(sensor: Sensor) -> str:
    assert sensor.point is not None
    return f"({', '.join(f'{c:.2f}' for c in sensor.point)}) {sensor.direction}"
