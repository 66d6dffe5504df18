"""A noise-free FRF test of a fitted model, with further responses, references and lines."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from scipy.optimize import nnls

from calib.correlation import rules as comparison
from calib.correlation.frf.residual import FRFResidual, FRFRow
from calib.hypotheses.design.candidate_places import motion_words, spread_places, where_acting
from calib.hypotheses.hypotheses import ModelHypotheses
from calib.hypotheses.rules import RULES
from calib.measurement.accuracy import NOTHING
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.frf_parts import BANDS, REFERENCES, SENSORS
from calib.measurement.modal import DIRECTIONS, Sensor
from calib.missing.linearised_fit import LinearisedFit
from calib.missing.recommendation import HELD_OUT
from calib.problem.effect import Effect
from calib.problem.problem import PairProblem


@dataclass(frozen=True, eq=False)
class ImaginedFRFs:
    """A noise-free FRF test of the fitted model, with more responses, references and lines than were measured.

    Further responses are imagined under the references in use, further references at the responses in use, and held-out
    lines of these. Errors of further channels are neglected.

    Attributes
    ----------
    hypotheses : ModelHypotheses
    fit : LinearisedFit
    held_out : mapping from str to MeasuredFRFs
        Held-out FRFs by group, see `calib.measurement.frf_parts.HeldOutFRFs.split`.
    acting : tuple of Effect
        Effects where whose places further sensors are imagined.
    """

    hypotheses: ModelHypotheses[FRFResidual]
    fit: LinearisedFit
    held_out: Mapping[str, MeasuredFRFs]
    acting: tuple[Effect, ...] = ()
    _fit_problems: dict[tuple[str, ...], PairProblem[FRFResidual]] = field(init=False, repr=False, default_factory=dict)

    @property
    def used(self) -> MeasuredFRFs:
        """The FRFs in use."""
        return self.hypotheses.pair.problem.measured

    # -- what is imagined ----------------------------------------------------------------------------------------------

    @cached_property
    def held(self) -> tuple[tuple[Sensor, ...], tuple[Sensor, ...], np.ndarray]:
        """Held-out responses, references and lines (Hz)."""
        groups, used = self.held_out, self.used
        responses = groups[SENSORS].responses if SENSORS in groups else ()
        references = groups[REFERENCES].references if REFERENCES in groups else ()
        lines = np.setdiff1d(groups[BANDS].freq, used.freq) if BANDS in groups else np.zeros(0)
        return responses, references, lines

    @cached_property
    def further(self) -> tuple[Sensor, ...]:
        """Responses spread over the structure."""
        return spread_places(
            self.hypotheses.variants.model, (*self.used.sensors, *self.held[0], *self.held[1]), RULES.frf_places
        )

    @cached_property
    def at_effects(self) -> dict[str, tuple[Sensor, ...]]:
        """Responses where effects act, by the measurement in words."""
        there = (*self.used.sensors, *self.held[0], *self.held[1], *self.further)
        return where_acting(self.hypotheses.variants.model, self.acting, 1 + max(s.node for s in there))

    @cached_property
    def forces(self) -> tuple[Sensor, ...]:
        """Further references at responses in use: each one at the sensor farthest from all earlier ones."""
        known = {s.name for s in (*self.used.references, *self.held[1])}
        free = [s for s in self.used.responses if s.name not in known and s.direction in DIRECTIONS[:3]]
        chosen: list[Sensor] = []
        while free and len(chosen) < RULES.frf_forces:
            there = [s.point for s in (*self.used.references, *chosen) if s.point is not None]
            chosen.append(free.pop(int(np.argmax([_distance(s, there) for s in free]))))
        return tuple(chosen)

    @cached_property
    def measured(self) -> MeasuredFRFs:
        """The imagined test, with the standard deviations of the real one."""
        used, (responses, references, lines) = self.used, self.held
        others = (*responses, *self.further, *(s for own in self.at_effects.values() for s in own))
        freq = np.union1d(used.freq, lines)
        shape = (
            len(freq),
            len(used.responses) + len(others),
            len(used.references) + len(references) + len(self.forces),
        )
        known = np.zeros(shape, dtype=bool)
        of_used, n, m = np.isin(freq, used.freq), len(used.responses), len(used.references)
        known[of_used, :n, :m] = np.isfinite(used.values)
        known[~of_used, :n, :m] = known[of_used, :n, :m].any(axis=0)
        known[of_used, n:, :m] = True
        known[of_used, :n, m:] = True
        wanted = replace(
            used, freq=freq, responses=(*used.responses, *others),
            references=(*used.references, *references, *self.forces), values=np.ones(shape, dtype=complex),
            std=np.ones(shape), n_repeats=1, accuracy=NOTHING,  # the standard deviations below contain it already
        )  # fmt: skip
        problem = replace(self.hypotheses.fit_problem(self.fit.effects).pair.problem, measured=wanted)
        functions = problem.functions(self.fit.values)
        share, floor = _noise(used)
        std = np.hypot(share * np.abs(functions), floor)
        std[of_used, :n, :m] = np.where(known[of_used, :n, :m], _std_of(used), std[of_used, :n, :m])
        return replace(wanted, values=np.where(known, functions, np.nan), std=np.maximum(std, np.finfo(float).tiny))

    # -- its rows ------------------------------------------------------------------------------------------------------

    def rows_of(
        self,
        responses: Collection[str] | None = None,
        references: Collection[str] | None = None,
        lines: np.ndarray | None = None,
    ) -> np.ndarray:
        """Mask of the rows of some functions on some lines, (n_rows,); by default those in use."""
        used = self.used
        responses = {s.name for s in used.responses} if responses is None else responses
        references = {s.name for s in used.references} if references is None else references
        lines = used.freq if lines is None else lines
        which = {row.sensor for row in self._rows}
        split = {name: name.partition("/")[::2] for name in which}
        chosen = {name for name, (i, j) in split.items() if i in responses and j in references}
        on_line = np.isin([row.freq for row in self._rows], lines)
        return on_line & np.array([row.sensor in chosen for row in self._rows])

    @property
    def held_out_parts(self) -> dict[str, np.ndarray]:
        """Rows that the fit could use without a new test, by their name in words."""
        responses, references, lines = self.held
        out = {}
        if responses:
            names = [s.name for s in responses]
            out[f"sensor{'s' * (len(names) > 1)} {', '.join(names)}{HELD_OUT}"] = self.rows_of(responses=names)
        if references:
            names = [s.name for s in references]
            out[f"force{'s' * (len(names) > 1)} at {', '.join(names)}{HELD_OUT}"] = self.rows_of(references=names)
        if len(lines):
            words = f"the {len(lines)} lines from {lines[0]:.4g} to {lines[-1]:.4g} Hz"
            out[f"{words}{HELD_OUT}"] = self.rows_of(lines=lines)
        return out

    @property
    def of_sensor(self) -> dict[str, np.ndarray]:
        """Rows of each further response, by its name."""
        return {s.name: self.rows_of(responses=[s.name]) for s in self.further}

    @property
    def words(self) -> dict[str, str]:
        """Place and direction of each further response, by its name."""
        return {s.name: motion_words(s) for s in self.further}

    @property
    def twice_the_repeats(self) -> float:
        """Factor on the standard deviations after twice the repeats, which leave a claimed accuracy as it is.

        The root mean square over all entries; 1 where the repeats say nothing.
        """
        own, total = self.used.std, self.used.total_std
        known = np.isfinite(own) & np.isfinite(total) & (total > 0)
        return float(np.sqrt(1 - 0.5 * np.mean((own[known] / total[known]) ** 2))) if known.any() else 1.0

    @cached_property
    def _rows(self) -> Sequence[FRFRow]:
        return self.fit_problem(self.fit.effects).pair.rows

    # -- models against it ---------------------------------------------------------------------------------------------

    def fit_problem(self, effects: tuple[str, ...]) -> PairProblem[FRFResidual]:
        """The problem of a variant of the model against this test."""
        if effects not in self._fit_problems:
            real = self.hypotheses.fit_problem(effects)
            imagined = FRFResidual(replace(real.pair.problem, measured=self.measured))
            self._fit_problems[effects] = replace(real, pair=imagined)
        return self._fit_problems[effects]

    def forget(self) -> None:
        """Drop all cached points."""
        for fit_problem in self._fit_problems.values():
            fit_problem.forget()

    def identified(self, fit_problem: PairProblem[FRFResidual], values: Mapping[str, float]) -> np.ndarray:
        """Every row, (n_rows,): a test measures lines whatever the structure."""
        return np.ones(len(fit_problem.pair.rows), dtype=bool)

    def loose(self, fit_problem: PairProblem[FRFResidual], values: Mapping[str, float]) -> np.ndarray:
        """Nothing, (n_rows, 0): functions are measured in their units."""
        return np.zeros((len(fit_problem.pair.rows), 0))


def _noise(frfs: MeasuredFRFs) -> tuple[float, float]:
    """Share of the modulus and floor that explain the standard deviations of a test, by non-negative least squares.

    Each entry counts by the relative error of its variance.
    """
    known = np.isfinite(frfs.values)
    size, variance = np.abs(frfs.values[known]) ** 2, _std_of(frfs)[known] ** 2
    columns = np.column_stack([size / variance, 1 / variance])
    unit = columns.max(axis=0)
    found, _ = nnls(columns / unit, np.ones(len(size)))
    share, floor = np.sqrt(found / unit)
    return float(share), float(floor)


def _std_of(frfs: MeasuredFRFs) -> np.ndarray:
    """Standard deviations by which a fit weighs, (n_freq, n_responses, n_references)."""
    total = frfs.total_std
    return np.where(np.isfinite(total), total, comparison.RULES.unknown_frf_std * np.abs(frfs.values))


def _distance(sensor: Sensor, there: Sequence[tuple[float, float, float]]) -> float:
    """Distance to the nearest of some points, m; 0 where places are unknown, so that these come in their order."""
    if sensor.point is None or not there:
        return 0.0
    return float(np.linalg.norm(np.array(there) - np.array(sensor.point), axis=1).min())
