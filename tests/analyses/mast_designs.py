"""A mast without a missing effect, and designs of its next measurement."""

import re
from dataclasses import replace

import numpy as np

from calib.analyses.hypotheses_of_study import modal_hypotheses
from calib.correlation.modal.residual import ModalResidual
from calib.hypotheses.design.modal import modal_design
from calib.hypotheses.hypotheses import ModelHypotheses
from calib.measurement.modal import Sensor
from calib.missing.candidate_fit import CandidateFit
from calib.missing.evidence import ln_evidence
from calib.missing.linearised_fit import LinearisedFit, least_squares_fit
from calib.missing.score import scores
from calib.results.results import Results
from calib.study.study import LoadedStudy

EXACT = 1e-3
CLOSE = 0.02
"""Scale and phase of a shape are fitted at the existing sensors; a further sensor would slightly change them."""
HELD = ("1x", "1z", "3x", "3z", "5x", "5z")


def measured_mast(mast, folder):
    """A mast without a missing effect, measured with half of the sensors and without the third bending along x."""
    study = LoadedStudy.load(mast.write_study(folder / "mast"))
    hypotheses, _ = modal_hypotheses(study, Results.at(folder / "results", "mast"))
    used = study.measured.without(("B3x",), HELD)
    clusters = {m: c for m, c in hypotheses.pair.problem.mode_clusters.items() if m in used.names}
    problem = replace(hypotheses.pair.problem, measured=used, mode_clusters=clusters)
    hypotheses = ModelHypotheses(ModalResidual(problem), hypotheses.variants, hypotheses.space)
    fit_problem = hypotheses.fit_problem(())
    return study, hypotheses, least_squares_fit(fit_problem, (), fit_problem.space.values)


def design_of(hypotheses, fit, held_out=None, scale=1.0, samples=1, certain=True, held_sensors=()):
    """Design linearised at the fit alone: its posterior is shrunk to a point."""
    found = scores(fit, hypotheses.effects, {})
    sharp = replace(fit, slope=1e7 * fit.slope) if certain else fit
    candidate_fit = CandidateFit((), sharp, 0.0, "")
    return modal_design(
        hypotheses, [candidate_fit], hypotheses.effects, found, scale, held_out, samples, held_sensors=held_sensors
    )


def measured_again(hypotheses, fit, extra=(), more_modes=(), scale=1.0, prior=None):
    """Sizes of the scores on a noise-free measurement of the fitted model with more sensors or modes."""
    fit_problem = hypotheses.fit_problem(())
    found, known = fit_problem.at(fit.values), hypotheses.pair.problem.measured
    index = [int(j) for j in found.pairing.model_index] + list(more_modes)
    names = (*known.names, *(f"more {j}" for j in more_modes))
    sensors = (*known.sensors, *extra)
    rows = hypotheses.variants.model.sensor_rows(sensors)
    moved = model_modes(hypotheses, fit).shapes[:, index]
    shapes = rows @ moved
    # Measured modes in the scale of their measured shapes, further ones in that of their largest motion.
    points = hypotheses.variants.model.mesh.points
    anywhere = hypotheses.variants.model.sensor_rows(
        [Sensor(2000 + k, d, tuple(map(float, p)), "mast") for k, p in enumerate(points) for d in "xz" if p[1] > 0]
    )
    scale_of = np.abs(known.shapes).max(axis=0) / np.abs(shapes[: len(known.sensors), : known.n_modes]).max(axis=0)
    largest = np.abs(anywhere @ moved).max(axis=0)
    shapes = shapes * np.append(scale_of, 1 / largest[known.n_modes :])
    std = fit_problem.pair.std
    freq = found.modes.natural_freq[index]
    measured = replace(
        known, names=names, natural_freq=freq, damped_freq=freq, sensors=sensors, shapes=shapes.astype(complex),
        freq_std=scale * np.sqrt(np.mean(std.freq**2)) * freq,
        shape_std=scale * np.sqrt(np.mean(std.shape**2)) * np.maximum(np.abs(shapes), 1.0),
        damping_ratio=np.full(len(names), np.nan), damping_std=np.full(len(names), np.nan),
    )  # fmt: skip
    problem = replace(hypotheses.pair.problem, measured=measured)
    floors = replace(hypotheses.pair.floors, freq=0.0, shape=0.0)
    space = hypotheses.space
    for name, sd in (prior or {}).items():
        space = space.replace(name, prior_sd=sd)
    other = ModelHypotheses(ModalResidual(problem, floors), hypotheses.variants, space)
    again = other.fit_problem(())
    there = LinearisedFit(
        (), again, fit.names, fit.values, again.residual(fit.values), -again.jacobian(fit.values, fit.names),
        np.array([space[n].prior_width for n in fit.names]), np.zeros(len(fit.names)),
    )  # fmt: skip
    assert np.abs(there.residual).max() < 1e-6
    return scores(there, other.effects, {}).size


def model_modes(hypotheses, fit):
    return hypotheses.fit_problem(()).at(fit.values).modes


def candidates_of(design, kind):
    return [o for o in design.measurements if o.kind == kind]


def sizes(design, measurement=None):
    return design.sizes(measurement)[0]


def sensors_in(measurement, first=900):
    places = re.findall(r"\(([-\d.]+), ([-\d.]+), ([-\d.]+)\) (\w+)", measurement.name)
    assert measurement.name.startswith(f"{len(places)} more sensors at ") and places
    return tuple(Sensor(first + k, d, (float(x), float(y), float(z)), "mast") for k, (x, y, z, d) in enumerate(places))


def pair_of(hypotheses, names=("platform", "lamp")):
    candidate_fits = []
    for name in names:
        fit_problem = hypotheses.fit_problem((name,))
        fit = least_squares_fit(fit_problem, (name,), fit_problem.space.values)
        (own,) = [e for e in hypotheses.effects if e.name == name]
        candidate_fits.append(CandidateFit((own,), fit, ln_evidence(fit, [own]), ""))
    return candidate_fits
