"""Experimental design for modal tests: further sensors, modes, repeats, and bench tests of parts."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence

import numpy as np

from calib.correlation.modal.residual import ModalResidual
from calib.correlation.modal.rows import ModalRow
from calib.execution.stage import Progress, silent
from calib.hypotheses.design.imagined import imagined_linearisations
from calib.hypotheses.design.imagined_measurement import ImaginedMeasurement
from calib.hypotheses.hypotheses import ModelHypotheses
from calib.hypotheses.rules import RULES
from calib.measurement.modal import Sensor
from calib.missing.candidate_fit import CandidateFit
from calib.missing.competing import CandidateMeasurement, CompetingModels
from calib.missing.linearised_fit import LinearisedFit
from calib.missing.recommendation import ExperimentalDesign, Linearisation
from calib.missing.score import Scores
from calib.problem.candidate import Candidate
from calib.problem.space import ParameterSpace


def modal_design(
    hypotheses: ModelHypotheses[ModalResidual],
    believed: Sequence[CandidateFit],
    effects: Sequence[Candidate],
    found: Scores,
    scale: float,
    held_out: Mapping[str, float] | None = None,
    samples: int = 10,
    seed: int = 1,
    progress: Progress = silent,
    held_sensors: tuple[Sensor, ...] = (),
) -> ExperimentalDesign:
    """Candidate measurements of a modal test, linearised at posterior samples of the credible models.

    The modes of the fitted model stand in for measured ones, at the measured and held-out sensors, where the credible
    effects act, and at locations spread over the structure, with the standard deviation of the measurement. At each
    sample, a mode that leaves the frequency window, is overdamped or resembles no mode of the fit contributes nothing.
    Where the model cannot be solved at any sample, there is no candidate measurement.

    Parameters
    ----------
    hypotheses : ModelHypotheses
    believed : sequence of CandidateFit
        The credible model, or the two that the data cannot discriminate.
    effects : sequence of Candidate
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
    held_sensors : tuple of Sensor
        Held-out sensors, which are available without a new test.
    """
    known = {effect.name: effect for effect in hypotheses.variants.effects}
    acting = tuple(known[name] for name in dict.fromkeys(name for one in believed for name in one.names))
    imagined = ImaginedMeasurement(hypotheses, believed[0].fit, held_out or {}, held_sensors, acting)
    labels = imagined.fit_problem(believed[0].names).pair.rows
    measured = _rows_of(labels, imagined.modes, {s.name for s in imagined.sensors})
    linearisations, competing = imagined_linearisations(
        imagined, believed, effects, found, scale, measured, samples, seed, progress
    )
    measurements = (
        _options(hypotheses, believed[0].fit, imagined, labels, linearisations, competing) if linearisations else []
    )
    known_freq = hypotheses.pair.problem.measured.natural_freq
    return ExperimentalDesign(
        tuple(e.name for e in effects), measured, tuple(measurements), linearisations, competing,
        hypotheses.pair.problem.measured.n_repeats, (float(np.min(known_freq)), float(np.max(known_freq))),
    )  # fmt: skip


def _options(
    hypotheses: ModelHypotheses[ModalResidual],
    fit: LinearisedFit,
    imagined: ImaginedMeasurement,
    labels: Sequence[ModalRow],
    linearisations: Sequence[Linearisation],
    competing: CompetingModels | None,
) -> list[CandidateMeasurement]:
    known = {s.name for s in imagined.sensors}
    here = _rows_of(labels, imagined.modes, known)
    out = [CandidateMeasurement("twice the repeats", "repeats", scale=1 / math.sqrt(2))]
    for mode in imagined.more:
        rows = _rows_of(labels, {mode}, known)
        out.append(CandidateMeasurement(mode, "mode", rows=rows, excitation=imagined.excitation(mode)))
    for label, sensors in imagined.together.items():
        rows = np.array([row.sensor in sensors and row.mode in imagined.modes for row in labels])
        out.append(CandidateMeasurement(label, "sensor", rows=rows))
    of_sensor: dict[str, np.ndarray] = {}
    for name in imagined.extra:
        of_sensor[name] = np.array([row.sensor == name and row.mode in imagined.modes for row in labels])
    out += best_sensors(of_sensor, imagined.extra, here, linearisations, competing)
    return [*out, *bench_tests(hypotheses.space, fit)]


def best_sensors(
    of_sensor: Mapping[str, np.ndarray],
    words: Mapping[str, str],
    here: np.ndarray,
    linearisations: Sequence[Linearisation],
    competing: CompetingModels | None,
) -> list[CandidateMeasurement]:
    """Groups of further sensors: the best for every effect, and for the difference of competing models.

    Parameters
    ----------
    of_sensor : mapping from str to ndarray (n_rows,), bool
        Rows that each sensor adds.
    words : mapping from str to str
        Place and direction of each.
    here : ndarray (n_rows,), bool
        Measured rows.
    linearisations : sequence of Linearisation
    competing : CompetingModels or None
    """
    if not of_sensor:
        return []
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
    out = []
    for several in chosen:
        places = ", ".join(words[name] for name in several)
        rows = np.logical_or.reduce([of_sensor[name] for name in several])
        out.append(CandidateMeasurement(f"{len(several)} more sensors at {places}", "sensor", rows=rows))
    return out


def bench_tests(space: ParameterSpace, fit: LinearisedFit) -> list[CandidateMeasurement]:
    """A test of each part by itself, to `RULES.bench`, where that says more than its prior."""
    out = []
    for name in fit.names:
        p = space[name] if name in space else None
        if p is not None and abs(p.value) > 0 and RULES.bench * abs(p.value) < p.prior_width:
            label = f"{p.description or name} ({name}) tested by itself to {100 * RULES.bench:.0f} %"
            out.append(CandidateMeasurement(label, "bench", prior_sd={name: RULES.bench * abs(p.value)}))
    return out


def _rows_of(labels: Sequence[ModalRow], modes: Collection[str], sensors: Collection[str]) -> np.ndarray:
    """Mask of the rows of some modes at some sensors, with frequencies and damping, which need none, (n_rows,)."""
    return np.array([row.mode in modes and (not row.sensor or row.sensor in sensors) for row in labels])


def _largest(gains: Mapping[str, float]) -> tuple[str, ...]:
    return tuple(sorted(sorted(gains, key=lambda n: -gains[n])[: RULES.together]))


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
