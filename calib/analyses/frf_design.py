"""Experimental design for tests of FRFs: further responses, references, lines, repeats, and bench tests of parts."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from calib.analyses.experimental_design import bench_tests, best_sensors
from calib.analyses.hypotheses import ModelHypotheses
from calib.analyses.imagined_frfs import ImaginedFRFs
from calib.correlation.frf_residual import FRFResidual
from calib.effect import Effect
from calib.measurement.frf import MeasuredFRFs
from calib.missing.candidate_measurement import CandidateMeasurement
from calib.missing.competing import CompetingModels
from calib.missing.explanation import CandidateFit
from calib.missing.recommendation import ExperimentalDesign, Linearisation
from calib.missing.samples import posterior_samples
from calib.missing.score import Scores
from calib.stage import Progress, unheard


def frf_design(
    hypotheses: ModelHypotheses[FRFResidual],
    believed: Sequence[CandidateFit],
    effects: Sequence[Effect],
    found: Scores,
    scale: float,
    held_out: Mapping[str, MeasuredFRFs],
    samples: int = 10,
    seed: int = 1,
    progress: Progress = unheard,
) -> ExperimentalDesign:
    """Candidate measurements of a test of FRFs, linearised at posterior samples of the credible models.

    As `calib.analyses.experimental_design.modal_design`, with the functions of the fitted model in place of measured
    ones. Errors of different lines count as independent there as in the fit.

    Parameters
    ----------
    hypotheses, believed, effects, found, scale, samples, seed, progress
        As of `modal_design`.
    held_out : mapping from str to MeasuredFRFs
        Held-out FRFs by group; they are available without a new test.
    """
    acting = {effect.name: effect for one in believed for effect in one.effects}
    imagined = ImaginedFRFs(hypotheses, believed[0].fit, held_out, tuple(acting.values()))
    measured = imagined.rows_of()
    seeds = np.random.default_rng(seed).integers(2**31, size=len(believed))
    points = [posterior_samples(one.fit, samples, int(s)) for one, s in zip(believed, seeds, strict=True)]
    competing = None
    if len(believed) > 1:
        first, second = (imagined.competitor(b, own, scale) for b, own in zip(believed[:2], points[:2], strict=True))
        competing = CompetingModels((first, second), measured, seed)
    shares = (1.0,) if competing is None else competing.weights
    linearisations, number = list[Linearisation](), itertools.count()
    for candidate_fit, own, share in zip(believed, points, shares, strict=True):
        for values in own:
            progress("what to measure next", next(number), sum(map(len, points)))
            linearisation = imagined.linearisation(candidate_fit, values, effects, found, scale, share)
            linearisations += [] if linearisation is None else [linearisation]
    measurements: list[CandidateMeasurement] = []
    if linearisations:
        measurements = [
            CandidateMeasurement("twice the repeats", "repeats", scale=imagined.twice_the_repeats),
            *(CandidateMeasurement(words, "held out", rows=rows) for words, rows in imagined.held_out_parts.items()),
            *(
                CandidateMeasurement(words, "sensor", rows=imagined.rows_of(responses={s.name for s in own}))
                for words, own in imagined.at_effects.items()
            ),
            *best_sensors(imagined.of_sensor, imagined.words, measured, linearisations, competing),
            *(
                CandidateMeasurement(
                    f"a force at {s.name} too", "reference", rows=imagined.rows_of(references=[s.name])
                )
                for s in imagined.forces
            ),
            *bench_tests(hypotheses.space, believed[0].fit),
        ]
    return ExperimentalDesign(
        tuple(e.name for e in effects), measured, tuple(measurements), tuple(linearisations), competing
    )
