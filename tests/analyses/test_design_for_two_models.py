"""Experimental design for two competing models."""

import copy
from dataclasses import replace

import numpy as np
import pytest

from calib.analyses.hypotheses_of_study import modal_hypotheses
from calib.correlation.modal.residual import ModalResidual
from calib.execution.tasks import in_this_process, shared_by, unreported
from calib.hypotheses.design.modal import modal_design
from calib.hypotheses.hypotheses import ModelHypotheses
from calib.missing.linearised_fit import least_squares_fit
from calib.missing.score import scores
from calib.results.results import Results
from calib.study.study import LoadedStudy
from tests.analyses.mast_designs import candidates_of, measured_mast, pair_of


@pytest.fixture(scope="module")
def world(mast, tmp_path_factory):
    return measured_mast(mast, tmp_path_factory.mktemp("design"))


@pytest.mark.medium
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
            and competitor.sampled_rows.all()
            and competitor.rows_at_fit.all()
        )
        k = candidate_fit.fit.names.index(competitor.name)
        step = candidate_fit.fit.covariance[k, k] ** 0.5
        moved = competitor.sampled - competitor.predicted
        linear = np.array(
            [[p[n] - candidate_fit.fit.values[n] for n in candidate_fit.fit.names] for p in competitor.points]
        ) @ competitor.slope.T  # fmt: skip
        assert step > 0 and np.linalg.norm(moved - linear) < 0.2 * np.linalg.norm(moved)


@pytest.mark.medium
def test_gains_and_counted_points_are_the_same_whoever_solves_the_samples(world):
    """Copies, as other processes get them, know no points that were solved before."""
    _, hypotheses, fit = world
    pair, found = pair_of(hypotheses), scores(fit, hypotheses.effects, {})

    def elsewhere(function, shared, items, told=unreported):
        copies = [copy.deepcopy((shared, item)) for item in items]
        return [function(*one) for one in reversed(copies)][::-1]

    designs, counted = [], []
    for share in (in_this_process, elsewhere):
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
            tests.append(LoadedStudy.load(near_lamp(mast, folder, hidden, number + again)))
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
        base = least_squares_fit(fit_problem, (), fit_problem.space.values)
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
