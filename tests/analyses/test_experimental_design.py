"""Experimental design: predicted gains against problems in which the candidate measurement has been made."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from calib.correlation.modal.residual import ModalResidual
from calib.errors.errors import EvaluationError
from calib.hypotheses.design import imagined_measurement
from calib.hypotheses.design.modal import modal_design
from calib.hypotheses.hypotheses import ModelHypotheses
from calib.hypotheses.rules import RULES
from calib.missing.candidate_fit import CandidateFit
from calib.missing.competing import at_effect
from calib.missing.linearised_fit import least_squares_fit
from calib.missing.recommendation import recommend
from calib.missing.score import scores
from calib.problem.problem import PairProblem
from calib.structure.effect_places import effect_places
from tests.analyses.mast_designs import (
    CLOSE,
    EXACT,
    HELD,
    candidates_of,
    design_of,
    measured_again,
    measured_mast,
    model_modes,
    pair_of,
    sensors_in,
    sizes,
)


@pytest.fixture(scope="module")
def world(mast, tmp_path_factory):
    return measured_mast(mast, tmp_path_factory.mktemp("design"))


@pytest.mark.medium
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
    found = design_of(other, least_squares_fit(fit_problem, (), fit_problem.space.values))
    assert found is not None and all(np.isfinite(sizes(found, o)).all() for o in found.measurements)


@pytest.mark.medium
def test_present_signatures_are_those_of_the_measured_problem(world):
    _, hypotheses, fit = world
    np.testing.assert_allclose(sizes(design_of(hypotheses, fit)), measured_again(hypotheses, fit), rtol=EXACT)


@pytest.mark.medium
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


@pytest.mark.medium
def test_held_out_sensors_are_to_be_used_and_not_measured_again(world):
    study, hypotheses, fit = world
    held = tuple(s for s in study.measured.sensors if s.name in HELD)
    design = design_of(hypotheses, fit, held_sensors=held)
    own, *others = candidates_of(design, "sensor")
    assert own.name == f"sensors {', '.join(HELD)}, validation data so far"
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
    assert len(measurements) == RULES.more_modes
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
        name for name in fit.names if RULES.bench * hypotheses.space[name].value < hypotheses.space[name].prior_width
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
    design = design_of(other, least_squares_fit(fit_problem, (), fit_problem.space.values))
    kinds = {o.kind for o in design.measurements}
    assert kinds == {"repeats", "mode", "bench"} and design.measured.sum() == measured.n_modes


# -- held-out modes ----------------------------------------------------------------------------------------------------


def test_a_held_out_mode_is_named_as_such(world):
    study, hypotheses, fit = world
    freq = study.measured.natural_freq[study.measured.names.index("B3x")]
    names = [o.name for o in candidates_of(design_of(hypotheses, fit, {"B3x": freq}), "mode")]
    assert names.count("mode B3x, validation data so far") == 1
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
    monkeypatch.setattr(imagined_measurement, "RULES", replace(RULES, held_out_near=100.0))
    names = [o.name for o in candidates_of(design_of(hypotheses, fit, {"B3x": freq}), "mode")]
    assert len(set(names)) == RULES.more_modes and names.count("mode B3x, validation data so far") == 1


def test_nothing_is_recommended_where_the_model_cannot_be_solved(world, monkeypatch):
    def fails(self, values, names):
        raise EvaluationError("near the point")

    _, hypotheses, fit = world
    found, candidate_fit = scores(fit, hypotheses.effects, {}), CandidateFit((), fit, 0.0, "")
    monkeypatch.setattr(PairProblem, "jacobian", fails)
    design = modal_design(hypotheses, [candidate_fit], hypotheses.effects, found, 1.0)
    assert design.linearisations == () and recommend(design).empty


# -- effects with a grid -----------------------------------------------------------------------------------------------


@pytest.mark.medium
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


@pytest.mark.medium
def test_a_posterior_shrunk_to_a_point_predicts_the_same_gain_as_the_fit(world):
    _, hypotheses, fit = world
    one, several = design_of(hypotheses, fit), design_of(hypotheses, fit, samples=4)
    assert len(several.linearisations) == 4 and [o.name for o in one.measurements] == [
        o.name for o in several.measurements
    ]
    pd.testing.assert_frame_equal(recommend(one), recommend(several), rtol=1e-4)


@pytest.mark.medium
def test_posterior_samples_differ_and_are_reproducible(world):
    _, hypotheses, fit = world
    one, again = (design_of(hypotheses, fit, samples=5, certain=False) for _ in range(2))
    pd.testing.assert_frame_equal(recommend(one), recommend(again), check_exact=True)
    spread = one.sizes(None).std(axis=0) / one.sizes(None).mean(axis=0)
    assert (spread > 1e-4).all() and (spread < 0.5).all()
    table = recommend(one)
    assert (table["gain_low"] <= table["gain"]).all() and (table["gain"] <= table["gain_high"]).all()
    assert (table["gain_low"] < table["gain_high"]).any()


@pytest.mark.medium
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
