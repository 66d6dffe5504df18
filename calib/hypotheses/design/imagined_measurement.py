"""A noise-free measurement of a fitted model, with further sensors and modes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from calib.correlation.modal.problem import ModalProblem
from calib.correlation.modal.residual import ModalResidual
from calib.correlation.standard_deviations import StandardDeviations
from calib.hypotheses.design.candidate_places import motion_words, spread_places, where_acting
from calib.hypotheses.hypotheses import ModelHypotheses
from calib.hypotheses.own_modes import added_shares
from calib.hypotheses.rules import RULES
from calib.measurement.accuracy import Accuracy
from calib.measurement.modal import DIRECTIONS, MeasuredModes, Sensor
from calib.missing.competing import Excitation
from calib.missing.linearised_fit import LinearisedFit
from calib.missing.recommendation import HELD_OUT
from calib.problem.effect import Effect
from calib.problem.problem import PairProblem
from calib.results.answer import hertz
from calib.structure.effect_places import effect_places
from calib.structure.model import StructuralModel
from calib.structure.modes import Modes
from calib.structure.reduction.reduced import ReducedModel


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


class ImaginedMeasurement:
    """A noise-free measurement of the fitted model, with more sensors and more modes."""

    def __init__(
        self,
        hypotheses: ModelHypotheses[ModalResidual],
        fit: LinearisedFit,
        held_out: Mapping[str, float],
        held_sensors: tuple[Sensor, ...] = (),
        acting: tuple[Effect, ...] = (),
    ):
        fit_problem = hypotheses.fit_problem(fit.effects)
        self.hypotheses, self.found = hypotheses, fit_problem.at(fit.values)
        problem, measured = hypotheses.pair.problem, hypotheses.pair.problem.measured
        self.std = fit_problem.pair.std
        self.acting = tuple(effect for name in fit.effects for effect in acting if effect.name == name)
        self.sensors = measured.sensors
        index = self.found.pairing.model_index
        self.paired = [int(i) for i in self.found.pairing.paired]
        self.modes = [measured.names[i] for i in self.paired]
        self.columns = [int(index[i]) for i in self.paired]
        freq, window = self.found.modes.natural_freq, problem.freq_window or (0.0, np.inf)
        free = [j for j in range(len(freq)) if j not in self.columns and window[0] <= freq[j] <= window[1]]
        more = [j for j in free if self.found.modes.damping_ratio[j] < RULES.overdamped][: RULES.more_modes]
        self.more = _modes_in_words(freq[more].tolist(), held_out)
        self.columns += more
        self.held = held_sensors if measured.has_shapes else ()
        model = hypotheses.variants.model
        further = spread_places(model, (*self.sensors, *self.held), RULES.sensor_places) if measured.has_shapes else ()
        self.extra = {s.name: motion_words(s) for s in further}
        label = 1 + max((s.node for s in (*self.sensors, *self.held, *further)), default=0)
        at = where_acting(model, acting, label) if measured.has_shapes else {}
        self.places = (*self.held, *further, *(s for own in at.values() for s in own))
        self.together = {words: frozenset(s.name for s in own) for words, own in at.items()}
        if self.held:
            several = "sensor" + "s" * (len(self.held) > 1)
            names = ", ".join(s.name for s in self.held)
            self.together[f"{several} {names}{HELD_OUT}"] = frozenset(s.name for s in self.held)
        self.measurement = self._measurement()
        self._fit_problems: dict[tuple[str, ...], PairProblem[ModalResidual]] = {}

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

    def fit_problem(self, effects: tuple[str, ...]) -> PairProblem[ModalResidual]:
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

    def excitation(self, mode: str) -> Excitation | None:
        """Where and along which axis one of the further modes moves most; None without a place.

        A mode that moves the added degrees of freedom of an effect most is excited where these hang.
        """
        j = self.columns[len(self.paired) + self.more.index(mode)]
        shape, points = self.found.modes.shapes[:, [j]], self.hypotheses.variants.model.mesh.points
        size = np.abs(self.found.model.displacement(shape)[:, :, 0])
        size[~np.isfinite(points).all(axis=1)] = 0.0
        if not size.any():
            return None
        hung, node = self._hung(shape), int(np.argmax(size.max(axis=1)))
        at = points[node]
        if hung is not None:
            at = np.array(effect_places(self.hypotheses.variants.model, hung)[0])
            node = int(np.nanargmin(np.linalg.norm(points - at, axis=1)))
        x, y, z = (float(c) for c in at)
        freq, damping = (float(of[j]) for of in (self.found.modes.natural_freq, self.found.modes.damping_ratio))
        return Excitation((x, y, z), DIRECTIONS[int(np.argmax(size[node]))], freq, damping, hung.name if hung else "")

    def _hung(self, shape: np.ndarray) -> Effect | None:
        """The effect whose added degrees of freedom hold most of the kinetic energy of a mode."""
        base, model = self.hypotheses.variants.model, self.found.model
        if isinstance(model, ReducedModel):
            shape, model = model.lift(shape), model.model
        if not isinstance(base, StructuralModel) or not isinstance(model, StructuralModel):
            return None
        shares = added_shares(base, self.acting, model, self.found.values, shape)
        return next((e for e in self.acting if shares[e.name][0] > RULES.own_mode and effect_places(base, e)), None)

    def forget(self) -> None:
        """Drop all cached points."""
        for fit_problem in self._fit_problems.values():
            fit_problem.forget()

    def identified(self, fit_problem: PairProblem[ModalResidual], values: Mapping[str, float]) -> np.ndarray:
        """Mask of the rows of modes that a test at these values would identify as modes of the fit, (n_rows,)."""
        found = fit_problem.at(values)
        damping = found.paired(found.modes.damping_ratio)  # NaN where there is no such mode
        similar = np.isnan(found.pairing.mac) | (found.pairing.mac >= RULES.alike)
        there = (damping < RULES.overdamped) & similar
        names = {name for name, one in zip(self.measurement.names, there, strict=True) if one}
        return np.array([row.mode in names for row in fit_problem.pair.rows])

    def loose(self, fit_problem: PairProblem[ModalResidual], values: Mapping[str, float]) -> np.ndarray:
        """The scale of a shape at further sensors is known only as well as the existing sensors determine it."""
        return fit_problem.pair.factor_spread(fit_problem.at(values))


def _modes_in_words(freqs: Sequence[float], held_out: Mapping[str, float]) -> list[str]:
    """Unique labels of computed modes; a held-out mode by its name where the match is unambiguous."""
    closest = {
        name: min(range(len(freqs)), key=lambda k: abs(own / freqs[k] - 1), default=-1)
        for name, own in held_out.items()
    }
    words = []
    for k, freq in enumerate(freqs):
        near = [name for name, own in held_out.items() if abs(own / freq - 1) < RULES.held_out_near]
        known = len(near) == 1 and closest[near[0]] == k
        words.append(f"mode {near[0]}{HELD_OUT}" if known else f"a further mode, computed at {hertz(freq)}")
    same = {w: words.count(w) for w in words}
    return [w if same[w] == 1 else f"{w} ({words[: k + 1].count(w)} of {same[w]})" for k, w in enumerate(words)]
