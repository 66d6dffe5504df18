"""Experimental design for tests of FRFs: further responses, references, lines, repeats, and bench tests of parts."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from calib.correlation.frf.residual import FRFResidual
from calib.execution.stage import Progress, silent
from calib.hypotheses.design.imagined import imagined_linearisations
from calib.hypotheses.design.imagined_frfs import ImaginedFRFs
from calib.hypotheses.design.modal import bench_tests, best_sensors
from calib.hypotheses.hypotheses import ModelHypotheses
from calib.measurement.frf import MeasuredFRFs
from calib.missing.candidate_fit import CandidateFit
from calib.missing.competing import CandidateMeasurement
from calib.missing.recommendation import ExperimentalDesign
from calib.missing.score import Scores
from calib.problem.candidate import Candidate


def frf_design(
    hypotheses: ModelHypotheses[FRFResidual],
    believed: Sequence[CandidateFit],
    effects: Sequence[Candidate],
    found: Scores,
    scale: float,
    held_out: Mapping[str, MeasuredFRFs],
    samples: int = 10,
    seed: int = 1,
    progress: Progress = silent,
) -> ExperimentalDesign:
    """Candidate measurements of a test of FRFs, linearised at posterior samples of the credible models.

    As `calib.hypotheses.design.modal.modal_design`, with the functions of the fitted model in place of measured
    ones. Errors of different lines count as independent there as in the fit.

    Parameters
    ----------
    hypotheses, believed, effects, found, scale, samples, seed, progress
        As of `modal_design`.
    held_out : mapping from str to MeasuredFRFs
        Held-out FRFs by group; they are available without a new test.
    """
    known = {effect.name: effect for effect in hypotheses.variants.effects}
    acting = tuple(known[name] for name in dict.fromkeys(name for one in believed for name in one.names))
    imagined = ImaginedFRFs(hypotheses, believed[0].fit, held_out, acting)
    measured = imagined.rows_of()
    linearisations, competing = imagined_linearisations(
        imagined, believed, effects, found, scale, measured, samples, seed, progress
    )
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
    return ExperimentalDesign(tuple(e.name for e in effects), measured, tuple(measurements), linearisations, competing)
