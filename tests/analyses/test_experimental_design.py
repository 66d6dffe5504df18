"""Experimental design: predicted gains against problems in which the candidate measurement has been made."""

import copy
import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from calib.analyses import imagined_measurement
from calib.analyses.experimental_design import BENCH, modal_design
from calib.analyses.hypotheses import ModelHypotheses
from calib.analyses.imagined_measurement import MORE_MODES
from calib.analyses.library import modal_hypotheses
from calib.correlation.residual import ModalResidual
from calib.errors import EvaluationError
from calib.measurement.modal import Sensor
from calib.missing.candidate_fit import CandidateFit
from calib.missing.candidate_measurement import at_effect
from calib.missing.evidence import ln_evidence
from calib.missing.linearised_fit import LinearisedFit, fitted
from calib.missing.recommendation import recommend
from calib.missing.score import scores
from calib.problem import Problem
from calib.results import Results
from calib.structure.effect_places import effect_places
from calib.study import Study
from calib.tasks import alone, shared_by, untold

EXACT = 1e-3
CLOSE = 0.02
"""Scale and phase of a shape are fitted at the existing sensors; a further sensor would slightly change them."""
HELD = ("1x", "1z", "3x", "3z", "5x", "5z")


@pytest.fixture(scope="module")
def world(mast, tmp_path_factory):
    """A mast without a missing effect, measured with half of the sensors and without the third bending along x."""
    folder = tmp_path_factory.mktemp("design")
    study = Study.load(mast.write_study(folder / "mast"))
    hypotheses, _ = modal_hypotheses(study, Results.at(folder / "results", "mast"))
    used = study.measured.without(("B3x",), HELD)
    clusters = {m: c for m, c in hypotheses.pair.problem.mode_clusters.items() if m in used.names}
    problem = replace(hypotheses.pair.problem, measured=used, mode_clusters=clusters)
    hypotheses = ModelHypotheses(ModalResidual(problem), hypotheses.variants, hypotheses.space)
    fit_problem = hypotheses.fit_problem(())
    return study, hypotheses, fitted(fit_problem, (), fit_problem.space.values)


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


def test_repeats_with_missing_values_do_not_prevent_a_recommendation(world):
    """Counts of repeats behind each value belong to the real measurement, not to the imagined one."""
    _, hypotheses, _ = world
    known = hypotheses.pair.problem.measured
    held = np.full(known.n_modes, 5)
    held[0] = 4
    shapes = np.full(known.shapes.shape, 5)
    incomplete = replace(known, n_repeats=5, freq_count=held, damping_count=held, shape_count=shapes)
    other = ModelHypotheses(
        ModalResidual(replace(hypotheses.pair.problem, measured=incomplete)), hypotheses.variants, hypotheses.space
    )
    fit_problem = other.fit_problem(())
    found = design_of(other, fitted(fit_problem, (), fit_problem.space.values))
    assert found is not None and all(np.isfinite(sizes(found, o)).all() for o in found.measurements)


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


def test_present_signatures_are_those_of_the_measured_problem(world):
    _, hypotheses, fit = world
    np.testing.assert_allclose(sizes(design_of(hypotheses, fit)), measured_again(hypotheses, fit), rtol=EXACT)


def test_more_sensors_gain_as_predicted(world):
    _, hypotheses, fit = world
    design = design_of(hypotheses, fit)
    measurements, now = candidates_of(design, "sensor"), measured_again(hypotheses, fit)
    assert measurements
    for measurement in measurements:
        real = measured_again(hypotheses, fit, sensors_in(measurement))
        np.testing.assert_allclose(sizes(design, measurement), real, rtol=CLOSE)
        assert (real >= now * (1 - 1e-6)).all()
    best = max(measurements, key=lambda o: (sizes(design, o) / sizes(design)).max())
    assert (measured_again(hypotheses, fit, sensors_in(best)) / now).max() > 1.1


def test_held_out_sensors_are_to_be_used_and_not_measured_again(world):
    study, hypotheses, fit = world
    held = tuple(s for s in study.measured.sensors if s.name in HELD)
    design = design_of(hypotheses, fit, held_sensors=held)
    own, *others = candidates_of(design, "sensor")
    assert own.name == f"sensors {', '.join(HELD)}, held out so far"
    real = measured_again(hypotheses, fit, tuple(replace(s, node=900 + s.node) for s in held))
    np.testing.assert_allclose(sizes(design, own), real, rtol=CLOSE)

    def proposed(measurements):
        return {s.point for o in measurements for s in sensors_in(o)}

    places = {tuple(round(float(c), 2) for c in s.point) for s in held}
    assert others and not places & proposed(others)
    assert places & proposed(candidates_of(design_of(hypotheses, fit), "sensor"))


def test_sensors_where_a_credible_effect_acts_are_a_candidate(world):
    _, hypotheses, fit = world
    (one,) = pair_of(hypotheses, ("platform",))
    design = modal_design(hypotheses, [one], hypotheses.effects, scores(fit, hypotheses.effects, {}), 1.0, samples=1)
    (own,) = [o for o in candidates_of(design, "sensor") if o.name.startswith(at_effect("platform"))]
    (place,) = effect_places(hypotheses.variants.model, one.effects[0])
    assert own.name.endswith(f"({', '.join(f'{c:.2f}' for c in place)})")
    assert own.rows.any() and not (own.rows & design.measured).any()


def test_another_mode_gains_as_predicted(world):
    """Measured by the existing sensors."""
    _, hypotheses, fit = world
    design = design_of(hypotheses, fit)
    measurements = candidates_of(design, "mode")
    assert len(measurements) == MORE_MODES
    modes, index = model_modes(hypotheses, fit), hypotheses.fit_problem(()).at(fit.values).pairing.model_index
    free = [j for j in range(modes.n_modes) if j not in index and modes.natural_freq[j] < 100.0]
    for j, measurement in zip(free, measurements, strict=False):
        assert measurement.name == f"a further mode, computed at {modes.natural_freq[j]:.3g} Hz"
        real = measured_again(hypotheses, fit, more_modes=[j])
        np.testing.assert_allclose(sizes(design, measurement), real, rtol=EXACT)


def test_twice_the_repeats_gain_as_predicted(world):
    _, hypotheses, fit = world
    design = design_of(hypotheses, fit)
    (measurement,) = candidates_of(design, "repeats")
    real = measured_again(hypotheses, fit, scale=1 / np.sqrt(2))
    np.testing.assert_allclose(sizes(design, measurement), real, rtol=EXACT)
    gain = sizes(design, measurement) / sizes(design)
    assert (gain > 1.2).all() and (gain <= np.sqrt(2) + 1e-9).all()


def test_a_bench_test_of_a_part_gains_as_predicted(world):
    _, hypotheses, fit = world
    design = design_of(hypotheses, fit)
    measurements = candidates_of(design, "bench")
    assert [next(iter(o.prior_sd)) for o in measurements] == [
        name for name in fit.names if BENCH * hypotheses.space[name].value < hypotheses.space[name].prior_width
    ]
    for measurement in measurements:
        ((name, sd),) = measurement.prior_sd.items()
        p = hypotheses.space[name]
        assert (
            sd == pytest.approx(0.03 * p.value)
            and measurement.name == f"{p.description} ({name}) tested by itself to 3 %"
        )
        real = measured_again(hypotheses, fit, prior={name: sd})
        np.testing.assert_allclose(sizes(design, measurement), real, rtol=EXACT)


def test_a_part_that_is_known_better_is_no_candidate_for_a_bench_test(world):
    _, hypotheses, fit = world
    names = [next(iter(o.prior_sd)) for o in candidates_of(design_of(hypotheses, fit), "bench")]
    assert "E" not in names and {"m_top", "K_base"} <= set(names)  # E is known to 6 of 210 GPa


def test_no_candidate_measurement_lowers_a_score(world):
    _, hypotheses, fit = world
    design = design_of(hypotheses, fit)
    assert design.measurements
    for measurement in design.measurements:
        assert (sizes(design, measurement) >= sizes(design) * (1 - 1e-9)).all(), measurement.name


def test_a_larger_standard_deviation_lowers_all_scores_equally_except_for_priors(world):
    _, hypotheses, fit = world
    one, two = (sizes(design_of(hypotheses, fit, scale=s)) for s in (1.0, 2.0))
    assert (two < one).all() and (two >= one / 2 * (1 - 1e-9)).all()
    assert (two < one / 2 * 1.5).all()


def test_further_sensors_are_at_free_locations_that_can_move(world):
    _, hypotheses, fit = world
    known = {s.name for s in hypotheses.pair.problem.measured.sensors}
    heights = {s.point[1] for s in hypotheses.pair.problem.measured.sensors}
    found = [s for o in candidates_of(design_of(hypotheses, fit), "sensor") for s in sensors_in(o)]
    assert found
    for s in found:
        assert s.point[1] not in heights and s.name not in known
        assert np.abs(hypotheses.variants.model.sensor_rows([s])).max() > 0


def test_without_shapes_no_sensor_is_recommended(world):
    _, hypotheses, _ = world
    measured = hypotheses.pair.problem.measured
    bare = replace(
        measured, sensors=(), shapes=np.zeros((0, measured.n_modes)), shape_std=np.zeros((0, measured.n_modes))
    )
    other = ModelHypotheses(
        ModalResidual(replace(hypotheses.pair.problem, measured=bare)), hypotheses.variants, hypotheses.space
    )
    fit_problem = other.fit_problem(())
    design = design_of(other, fitted(fit_problem, (), fit_problem.space.values))
    kinds = {o.kind for o in design.measurements}
    assert kinds == {"repeats", "mode", "bench"} and design.measured.sum() == measured.n_modes


# -- held-out modes ----------------------------------------------------------------------------------------------------


def test_a_held_out_mode_is_named_as_such(world):
    study, hypotheses, fit = world
    freq = study.measured.natural_freq[study.measured.names.index("B3x")]
    names = [o.name for o in candidates_of(design_of(hypotheses, fit, {"B3x": freq}), "mode")]
    assert names.count("mode B3x, held out so far") == 1
    assert all(n.startswith("a further mode, computed at ") for n in names if "B3x" not in n)


@pytest.mark.parametrize("held_out", [{"B3x": 1.0}, {"B3x": 40.5, "B3y": 40.0}])
def test_a_mode_far_from_a_held_out_one_or_near_two_is_labelled_by_its_frequency(world, held_out):
    study, hypotheses, fit = world
    freq = study.measured.natural_freq[study.measured.names.index("B3x")]
    held_out = {name: f * freq / 40.0 for name, f in held_out.items()}
    names = [o.name for o in candidates_of(design_of(hypotheses, fit, held_out), "mode")]
    assert all(n.startswith("a further mode, computed at ") for n in names)


def test_two_modes_near_a_held_out_one_are_two_candidates(world, monkeypatch):
    study, hypotheses, fit = world
    freq = study.measured.natural_freq[study.measured.names.index("B3x")]
    monkeypatch.setattr(imagined_measurement, "NEAR", 100.0)
    names = [o.name for o in candidates_of(design_of(hypotheses, fit, {"B3x": freq}), "mode")]
    assert len(set(names)) == MORE_MODES and names.count("mode B3x, held out so far") == 1


def test_nothing_is_recommended_where_the_model_cannot_be_solved(world, monkeypatch):
    def fails(self, values, names):
        raise EvaluationError("near the point")

    _, hypotheses, fit = world
    found, candidate_fit = scores(fit, hypotheses.effects, {}), CandidateFit((), fit, 0.0, "")
    monkeypatch.setattr(Problem, "jacobian", fails)
    design = modal_design(hypotheses, [candidate_fit], hypotheses.effects, found, 1.0)
    assert design.linearisations == () and recommend(design).empty


# -- effects with a grid -----------------------------------------------------------------------------------------------


def test_the_signature_of_an_effect_with_a_grid_is_taken_at_its_best_point(world):
    """At the point of its grid with the largest score, by difference; for a tiny magnitude that is the derivative."""
    _, hypotheses, fit = world
    (smooth,) = [e for e in hypotheses.effects if e.name == "platform"]
    gridded = replace(smooth, grid=({"platform": 60.0}, {"platform": 1e-4}))
    effects = tuple(gridded if e is smooth else e for e in hypotheses.effects)
    other = replace(hypotheses, variants=replace(hypotheses.variants, effects=effects))
    found = scores(fit, effects, {"platform": other.fit_problem(("platform",))})
    k = effects.index(gridded)
    derivative = design_of(hypotheses, fit).linearisations[0].columns[:, k]
    for magnitude in (60.0, 1e-4):
        column = next(j for j, p in enumerate(found.points) if p == {"platform": magnitude})
        best = replace(found, z=np.where(np.arange(len(found.z)) == column, 99.0, found.z))
        candidate_fit = CandidateFit((), replace(fit, slope=1e7 * fit.slope), 0.0, "")
        here = modal_design(other, [candidate_fit], effects, best, 1.0, samples=1).linearisations[0].columns[:, k]
        close = np.linalg.norm(here - derivative) / np.linalg.norm(derivative)
        assert close < 0.01 if magnitude < 1 else close > 0.05


# -- posterior samples -------------------------------------------------------------------------------------------------


def test_a_posterior_shrunk_to_a_point_predicts_the_same_gain_as_the_fit(world):
    _, hypotheses, fit = world
    one, several = design_of(hypotheses, fit), design_of(hypotheses, fit, samples=4)
    assert len(several.linearisations) == 4 and [o.name for o in one.measurements] == [
        o.name for o in several.measurements
    ]
    pd.testing.assert_frame_equal(recommend(one), recommend(several), rtol=1e-4)


def test_posterior_samples_differ_and_are_reproducible(world):
    _, hypotheses, fit = world
    one, again = (design_of(hypotheses, fit, samples=5, certain=False) for _ in range(2))
    pd.testing.assert_frame_equal(recommend(one), recommend(again), check_exact=True)
    spread = one.sizes(None).std(axis=0) / one.sizes(None).mean(axis=0)
    assert (spread > 1e-4).all() and (spread < 0.5).all()
    table = recommend(one)
    assert (table["gain_low"] <= table["gain"]).all() and (table["gain"] <= table["gain_high"]).all()
    assert (table["gain_low"] < table["gain_high"]).any()


def test_a_further_mode_outside_the_window_at_some_samples_gains_nothing_there(world):
    """The window ends just above the first of the further modes, which the samples shift by a few per cent."""
    _, hypotheses, fit = world
    modes, index = model_modes(hypotheses, fit), hypotheses.fit_problem(()).at(fit.values).pairing.model_index
    free = [j for j in range(modes.n_modes) if j not in index and modes.natural_freq[j] < 100.0]
    top = float(modes.natural_freq[free[0]]) * 1.0005
    window = replace(hypotheses.pair.problem, freq_window=(0.5, top))
    narrow = ModelHypotheses(ModalResidual(window), hypotheses.variants, hypotheses.space)
    design = design_of(narrow, fit, samples=8, certain=False)
    (measurement,) = [
        o for o in candidates_of(design, "mode") if o.name.endswith(f"{modes.natural_freq[free[0]]:.3g} Hz")
    ]
    gains = design.sizes(measurement) / design.sizes(None)
    lost = np.isclose(gains, 1.0, atol=1e-12).all(axis=1)
    assert 0 < lost.sum() < 8
    wide = design_of(hypotheses, fit, samples=8, certain=False)
    (same,) = [o for o in candidates_of(wide, "mode") if o.name == measurement.name]
    whole = wide.sizes(same) / wide.sizes(None)
    np.testing.assert_allclose(gains[~lost], whole[~lost], rtol=1e-6)
    assert (whole[lost].max(axis=1) > 1 + 1e-6).all()


# -- two models --------------------------------------------------------------------------------------------------------


def pair_of(hypotheses, names=("platform", "lamp")):
    candidate_fits = []
    for name in names:
        fit_problem = hypotheses.fit_problem((name,))
        fit = fitted(fit_problem, (name,), fit_problem.space.values)
        (own,) = [e for e in hypotheses.effects if e.name == name]
        candidate_fits.append(CandidateFit((own,), fit, ln_evidence(fit, [own]), ""))
    return candidate_fits


def test_two_models_are_linearised_at_samples_of_both_weighted_by_their_probability(world):
    _, hypotheses, fit = world
    pair, found = pair_of(hypotheses), scores(fit, hypotheses.effects, {})
    design = modal_design(hypotheses, pair, hypotheses.effects, found, 1.0, samples=3)
    assert [linearisation.names[3] for linearisation in design.linearisations] == ["platform"] * 3 + ["lamp"] * 3
    assert design.competing.names == ("platform", "lamp")
    assert {linearisation.weight for linearisation in design.linearisations} == set(design.competing.weights)
    for competitor, candidate_fit in zip(design.competing.pair, pair, strict=True):
        assert (
            len({p[competitor.name] for p in competitor.points}) == 3
            and competitor.seen.all()
            and competitor.there.all()
        )
        k = candidate_fit.fit.names.index(competitor.name)
        step = candidate_fit.fit.covariance[k, k] ** 0.5
        moved = competitor.drawn - competitor.predicted
        linear = np.array(
            [[p[n] - candidate_fit.fit.values[n] for n in candidate_fit.fit.names] for p in competitor.points]
        ) @ competitor.slope.T  # fmt: skip
        assert step > 0 and np.linalg.norm(moved - linear) < 0.2 * np.linalg.norm(moved)


def test_gains_and_counted_points_are_the_same_whoever_solves_the_samples(world):
    """Copies, as other processes get them, know no points that were solved before."""
    _, hypotheses, fit = world
    pair, found = pair_of(hypotheses), scores(fit, hypotheses.effects, {})

    def elsewhere(function, shared, items, told=untold):
        copies = [copy.deepcopy((shared, item)) for item in items]
        return [function(*one) for one in reversed(copies)][::-1]

    designs, counted = [], []
    for share in (alone, elsewhere):
        before = hypotheses.evaluations
        with shared_by(share):
            designs.append(modal_design(hypotheses, pair, hypotheses.effects, found, 1.0, samples=3))
        counted.append(hypotheses.evaluations - before)
    assert counted[0] == counted[1] > 6
    for one, other in zip(*(design.linearisations for design in designs), strict=True):
        assert one.slope.tobytes() == other.slope.tobytes() and one.columns.tobytes() == other.columns.tobytes()


@pytest.mark.slow
def test_the_bayes_factors_predicted_for_twice_the_repeats_are_realised(mast, tmp_path):
    """Two masses near each other, hardly distinguished by one test; each is the truth in turn."""
    predicted, realised, inside = [], [], 0
    for number in range(12):
        hidden = ("platform", "lamp")[number % 2]
        tests = []
        for again in (0, 1000):
            folder = tmp_path / f"{number}_{again}" / "mast"
            tests.append(Study.load(near_lamp(mast, folder, hidden, number + again)))
        first, _ = modal_hypotheses(tests[0], Results.at(tmp_path / f"r{number}", "mast"))
        one, other = (t.measured for t in tests)
        both = replace(
            one, natural_freq=(one.natural_freq + other.natural_freq) / 2, shapes=(one.shapes + other.shapes) / 2,
            damped_freq=(one.damped_freq + other.damped_freq) / 2, freq_std=one.freq_std / np.sqrt(2),
            shape_std=one.shape_std / np.sqrt(2),
        )  # fmt: skip
        more = ModelHypotheses(ModalResidual(replace(first.pair.problem, measured=both)), first.variants, first.space)
        pair, after = pair_of(first), pair_of(more)
        fit_problem = first.fit_problem(())
        base = fitted(fit_problem, (), fit_problem.space.values)
        design = modal_design(first, pair, pair[0].effects, scores(base, first.effects, {}), 1.0, samples=6)
        (measurement,) = candidates_of(design, "repeats")
        bayes_factor = design.competing.bayes_factor(measurement)
        sign = 1 if hidden == "platform" else -1
        predicted.append(bayes_factor.mean)
        realised.append(sign * (after[0].ln_evidence - after[1].ln_evidence))
        inside += bayes_factor.low <= realised[-1] <= bayes_factor.high
    error = np.std(realised, ddof=1) / np.sqrt(len(realised))
    assert np.mean(realised) == pytest.approx(np.mean(predicted), abs=2.5 * error)
    assert error < 1.5 and inside >= 7 and np.mean(np.array(realised) > 0) >= 0.75


def near_lamp(mast, folder, hidden, seed):
    """A study whose lamp hangs just above the platform."""
    lamp = '"Lamp near the top", 4.5', '"Lamp near the platform", 3.5'
    library = mast.library
    mast.library = lambda: tuple(
        mast._one("lamp", "Lamp near the platform", 3.5, (0, 1, 2), "mass", "kg", 10.0, 100.0)
        if e.name == "lamp"
        else e
        for e in library()
    )
    try:
        mast.write_study(folder, {hidden: 3.0}, seed)
    finally:
        mast.library = library
    text = (folder / "effects.py").read_text()
    assert lamp[0] in text
    (folder / "effects.py").write_text(text.replace(*lamp))
    return folder
