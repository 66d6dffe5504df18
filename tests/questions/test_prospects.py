"""What else could be measured: every promise against the problem in which it has been measured."""

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from calib.correlation.residual import ModalResidual
from calib.errors import EvaluationError
from calib.measurement.modal import Sensor
from calib.missing.advice import advise
from calib.missing.evidence import ln_evidence
from calib.missing.findings import Trial
from calib.missing.score import scores
from calib.missing.state import State, fitted
from calib.problem import Problem
from calib.questions import prospects as prospects_module
from calib.questions.hypotheses import ModelHypotheses
from calib.questions.library import modal_hypotheses
from calib.questions.prospects import BENCH, MORE_MODES, modal_prospects
from calib.results import Results
from calib.study import Study

EXACT = 1e-3
CLOSE = 0.02
"""Scale and phase of a shape are taken from the sensors that are there; a further one would have its say in them."""
HELD = ("1x", "1z", "3x", "3z", "5x", "5z")


@pytest.fixture(scope="module")
def world(mast, tmp_path_factory):
    """A mast that lacks nothing, measured with half of the sensors and without the third bending along x."""
    folder = tmp_path_factory.mktemp("prospects")
    study = Study.load(mast.write_study(folder / "mast"))
    hypotheses, _ = modal_hypotheses(study, Results.at(folder / "results", "mast"))
    used = study.measured.without(("B3x",), HELD)
    clusters = {m: c for m, c in hypotheses.pair.problem.mode_clusters.items() if m in used.names}
    problem = replace(hypotheses.pair.problem, measured=used, mode_clusters=clusters)
    hypotheses = ModelHypotheses(ModalResidual(problem), hypotheses.variants, hypotheses.space)
    question = hypotheses.question(())
    return study, hypotheses, fitted(question, (), question.space.values)


def prospects_of(hypotheses, state, withheld=None, scale=1.0, draws=1, certain=True):
    """Seen from the fit alone: its posterior shrunk to a point."""
    found = scores(state, hypotheses.effects, {})
    sharp = replace(state, slope=1e7 * state.slope) if certain else state
    trial = Trial((), sharp, 0.0, "")
    return modal_prospects(hypotheses, [trial], hypotheses.effects, found, scale, withheld, draws)


def measured_again(hypotheses, state, extra=(), more_modes=(), scale=1.0, prior=None):
    """Scores' sizes in the problem where the fitted model itself has been measured, with more sensors or modes."""
    question = hypotheses.question(())
    found, known = question.at(state.values), hypotheses.pair.problem.measured
    index = [int(j) for j in found.pairing.model_index] + list(more_modes)
    names = (*known.names, *(f"more {j}" for j in more_modes))
    sensors = (*known.sensors, *extra)
    rows = hypotheses.variants.model.sensor_rows(sensors)
    moved = model_modes(hypotheses, state).shapes[:, index]
    shapes = rows @ moved
    # Measured modes in the scale of their measured shapes, further ones in that of their largest motion.
    points = hypotheses.variants.model.mesh.points
    anywhere = hypotheses.variants.model.sensor_rows(
        [Sensor(2000 + k, d, tuple(map(float, p)), "mast") for k, p in enumerate(points) for d in "xz" if p[1] > 0]
    )
    scale_of = np.abs(known.shapes).max(axis=0) / np.abs(shapes[: len(known.sensors), : known.n_modes]).max(axis=0)
    largest = np.abs(anywhere @ moved).max(axis=0)
    shapes = shapes * np.append(scale_of, 1 / largest[known.n_modes :])
    scatter = question.pair.scatter
    freq = found.modes.natural_freq[index]
    measured = replace(
        known, names=names, natural_freq=freq, damped_freq=freq, sensors=sensors, shapes=shapes.astype(complex),
        freq_std=scale * np.sqrt(np.mean(scatter.freq**2)) * freq,
        shape_std=scale * np.sqrt(np.mean(scatter.shape**2)) * np.maximum(np.abs(shapes), 1.0),
        damping_ratio=np.full(len(names), np.nan), damping_std=np.full(len(names), np.nan),
    )  # fmt: skip
    problem = replace(hypotheses.pair.problem, measured=measured)
    floors = replace(hypotheses.pair.floors, freq=0.0, shape=0.0)
    space = hypotheses.space
    for name, sd in (prior or {}).items():
        space = space.replace(name, prior_sd=sd)
    other = ModelHypotheses(ModalResidual(problem, floors), hypotheses.variants, space)
    asked = other.question(())
    there = State(
        (), asked, state.names, state.values, asked.residual(state.values), -asked.jacobian(state.values, state.names),
        np.array([space[n].prior_width for n in state.names]), np.zeros(len(state.names)),
    )  # fmt: skip
    assert np.abs(there.residual).max() < 1e-6
    return scores(there, other.effects, {}).size


def test_repeats_that_lack_something_do_not_hinder_advice(world):
    """Counts of the repeats behind each value belong to what was measured and not to what is imagined."""
    _, hypotheses, _ = world
    known = hypotheses.pair.problem.measured
    held = np.full(known.n_modes, 5)
    held[0] = 4
    shapes = np.full(known.shapes.shape, 5)
    told = replace(known, n_repeats=5, freq_count=held, damping_count=held, shape_count=shapes)
    other = ModelHypotheses(
        ModalResidual(replace(hypotheses.pair.problem, measured=told)), hypotheses.variants, hypotheses.space
    )
    question = other.question(())
    found = prospects_of(other, fitted(question, (), question.space.values))
    assert found is not None and all(np.isfinite(sizes(found, o)).all() for o in found.options)


def model_modes(hypotheses, state):
    return hypotheses.question(()).at(state.values).modes


def option_of(prospects, kind):
    return [o for o in prospects.options if o.kind == kind]


def sizes(prospects, option=None):
    return prospects.sizes(option)[0]


def sensors_in(option, first=900):
    places = re.findall(r"\(([-\d.]+), ([-\d.]+), ([-\d.]+)\) (\w+)", option.name)
    assert option.name.startswith(f"{len(places)} more sensors at ") and places
    return tuple(Sensor(first + k, d, (float(x), float(y), float(z)), "mast") for k, (x, y, z, d) in enumerate(places))


def test_what_is_seen_now_is_what_the_measured_problem_sees(world):
    _, hypotheses, state = world
    np.testing.assert_allclose(sizes(prospects_of(hypotheses, state)), measured_again(hypotheses, state), rtol=EXACT)


def test_more_sensors_keep_their_promise(world):
    _, hypotheses, state = world
    prospects = prospects_of(hypotheses, state)
    options, now = option_of(prospects, "sensor"), measured_again(hypotheses, state)
    assert options
    for option in options:
        real = measured_again(hypotheses, state, sensors_in(option))
        np.testing.assert_allclose(sizes(prospects, option), real, rtol=CLOSE)
        assert (real >= now * (1 - 1e-6)).all()
    best = max(options, key=lambda o: (sizes(prospects, o) / sizes(prospects)).max())
    assert (measured_again(hypotheses, state, sensors_in(best)) / now).max() > 1.1


def test_another_mode_keeps_its_promise(world):
    """Seen by the sensors that are there."""
    _, hypotheses, state = world
    prospects = prospects_of(hypotheses, state)
    options = option_of(prospects, "mode")
    assert len(options) == MORE_MODES
    modes, index = model_modes(hypotheses, state), hypotheses.question(()).at(state.values).pairing.model_index
    free = [j for j in range(modes.n_modes) if j not in index and modes.natural_freq[j] < 100.0]
    for j, option in zip(free, options, strict=False):
        assert option.name == f"the mode computed at {modes.natural_freq[j]:.3g} Hz"
        real = measured_again(hypotheses, state, more_modes=[j])
        np.testing.assert_allclose(sizes(prospects, option), real, rtol=EXACT)


def test_twice_the_repeats_keep_their_promise(world):
    _, hypotheses, state = world
    prospects = prospects_of(hypotheses, state)
    (option,) = option_of(prospects, "repeats")
    real = measured_again(hypotheses, state, scale=1 / np.sqrt(2))
    np.testing.assert_allclose(sizes(prospects, option), real, rtol=EXACT)
    gain = sizes(prospects, option) / sizes(prospects)
    assert (gain > 1.2).all() and (gain <= np.sqrt(2) + 1e-9).all()


def test_a_test_of_a_part_keeps_its_promise(world):
    _, hypotheses, state = world
    prospects = prospects_of(hypotheses, state)
    options = option_of(prospects, "bench")
    assert [next(iter(o.prior_sd)) for o in options] == [
        name for name in state.names if BENCH * hypotheses.space[name].value < hypotheses.space[name].prior_width
    ]
    for option in options:
        ((name, sd),) = option.prior_sd.items()
        p = hypotheses.space[name]
        assert (
            sd == pytest.approx(0.03 * p.value) and option.name == f"{p.description} ({name}) tested by itself to 3 %"
        )
        real = measured_again(hypotheses, state, prior={name: sd})
        np.testing.assert_allclose(sizes(prospects, option), real, rtol=EXACT)


def test_a_part_that_is_known_better_need_not_be_tested(world):
    _, hypotheses, state = world
    names = [next(iter(o.prior_sd)) for o in option_of(prospects_of(hypotheses, state), "bench")]
    assert "E" not in names and {"m_top", "K_base"} <= set(names)  # E is known to 6 of 210 GPa


def test_no_option_lowers_a_score(world):
    _, hypotheses, state = world
    prospects = prospects_of(hypotheses, state)
    assert prospects.options
    for option in prospects.options:
        assert (sizes(prospects, option) >= sizes(prospects) * (1 - 1e-9)).all(), option.name


def test_a_larger_scatter_lowers_all_scores_alike_but_for_priors(world):
    _, hypotheses, state = world
    one, two = (sizes(prospects_of(hypotheses, state, scale=s)) for s in (1.0, 2.0))
    assert (two < one).all() and (two >= one / 2 * (1 - 1e-9)).all()
    assert (two < one / 2 * 1.5).all()


def test_further_sensors_are_where_none_is_and_can_move(world):
    _, hypotheses, state = world
    known = {s.name for s in hypotheses.pair.problem.measured.sensors}
    heights = {s.point[1] for s in hypotheses.pair.problem.measured.sensors}
    found = [s for o in option_of(prospects_of(hypotheses, state), "sensor") for s in sensors_in(o)]
    assert found
    for s in found:
        assert s.point[1] not in heights and s.name not in known
        assert np.abs(hypotheses.variants.model.sensor_rows([s])).max() > 0


def test_without_shapes_no_sensor_is_advised(world):
    _, hypotheses, _ = world
    measured = hypotheses.pair.problem.measured
    bare = replace(
        measured, sensors=(), shapes=np.zeros((0, measured.n_modes)), shape_std=np.zeros((0, measured.n_modes))
    )
    other = ModelHypotheses(
        ModalResidual(replace(hypotheses.pair.problem, measured=bare)), hypotheses.variants, hypotheses.space
    )
    question = other.question(())
    prospects = prospects_of(other, fitted(question, (), question.space.values))
    kinds = {o.kind for o in prospects.options}
    assert kinds == {"repeats", "mode", "bench"} and prospects.measured.sum() == measured.n_modes


# -- modes that were withheld ------------------------------------------------------------------------------------------


def test_a_withheld_mode_is_named_as_such(world):
    study, hypotheses, state = world
    freq = study.measured.natural_freq[study.measured.names.index("B3x")]
    names = [o.name for o in option_of(prospects_of(hypotheses, state, {"B3x": freq}), "mode")]
    assert names.count("mode B3x, withheld so far") == 1
    assert all(n.startswith("the mode computed at ") for n in names if "B3x" not in n)


@pytest.mark.parametrize("withheld", [{"B3x": 1.0}, {"B3x": 40.5, "B3y": 40.0}])
def test_a_mode_far_from_a_withheld_one_or_near_two_is_told_by_its_frequency(world, withheld):
    study, hypotheses, state = world
    freq = study.measured.natural_freq[study.measured.names.index("B3x")]
    withheld = {name: f * freq / 40.0 for name, f in withheld.items()}
    names = [o.name for o in option_of(prospects_of(hypotheses, state, withheld), "mode")]
    assert all(n.startswith("the mode computed at ") for n in names)


def test_two_modes_near_a_withheld_one_are_two_options(world, monkeypatch):
    study, hypotheses, state = world
    freq = study.measured.natural_freq[study.measured.names.index("B3x")]
    monkeypatch.setattr(prospects_module, "NEAR", 100.0)
    names = [o.name for o in option_of(prospects_of(hypotheses, state, {"B3x": freq}), "mode")]
    assert len(set(names)) == MORE_MODES and names.count("mode B3x, withheld so far") == 1


def test_nothing_is_advised_where_the_model_cannot_be_solved(world, monkeypatch):
    def fails(self, values, names):
        raise EvaluationError("beside the point")

    _, hypotheses, state = world
    found, trial = scores(state, hypotheses.effects, {}), Trial((), state, 0.0, "")
    monkeypatch.setattr(Problem, "jacobian", fails)
    prospects = modal_prospects(hypotheses, [trial], hypotheses.effects, found, 1.0)
    assert prospects.views == () and advise(prospects).empty


# -- effects with a grid -----------------------------------------------------------------------------------------------


def test_the_fingerprint_of_an_effect_with_a_grid_is_taken_where_it_speaks(world):
    """At the point of its grid with the largest score, by difference; for a tiny strength that is the derivative."""
    _, hypotheses, state = world
    (plain,) = [e for e in hypotheses.effects if e.name == "platform"]
    gridded = replace(plain, grid=({"platform": 60.0}, {"platform": 1e-4}))
    effects = tuple(gridded if e is plain else e for e in hypotheses.effects)
    other = replace(hypotheses, variants=replace(hypotheses.variants, effects=effects))
    found = scores(state, effects, {"platform": other.question(("platform",))})
    k = effects.index(gridded)
    derivative = prospects_of(hypotheses, state).views[0].columns[:, k]
    for strength in (60.0, 1e-4):
        column = next(j for j, p in enumerate(found.points) if p == {"platform": strength})
        told = replace(found, z=np.where(np.arange(len(found.z)) == column, 99.0, found.z))
        trial = Trial((), replace(state, slope=1e7 * state.slope), 0.0, "")
        here = modal_prospects(other, [trial], effects, told, 1.0, draws=1).views[0].columns[:, k]
        close = np.linalg.norm(here - derivative) / np.linalg.norm(derivative)
        assert close < 0.01 if strength < 1 else close > 0.05


# -- over what may be true ---------------------------------------------------------------------------------------------


def test_a_posterior_that_has_shrunk_to_a_point_promises_what_the_fit_does(world):
    _, hypotheses, state = world
    one, several = prospects_of(hypotheses, state), prospects_of(hypotheses, state, draws=4)
    assert len(several.views) == 4 and [o.name for o in one.options] == [o.name for o in several.options]
    pd.testing.assert_frame_equal(advise(one), advise(several), rtol=1e-4)


def test_points_differ_as_the_posterior_leaves_them_and_are_the_same_again(world):
    _, hypotheses, state = world
    one, again = (prospects_of(hypotheses, state, draws=5, certain=False) for _ in range(2))
    pd.testing.assert_frame_equal(advise(one), advise(again), check_exact=True)
    spread = one.sizes(None).std(axis=0) / one.sizes(None).mean(axis=0)
    assert (spread > 1e-4).all() and (spread < 0.5).all()
    table = advise(one)
    assert (table["gain_low"] <= table["gain"]).all() and (table["gain"] <= table["gain_high"]).all()
    assert (table["gain_low"] < table["gain_high"]).any()


def test_a_further_mode_that_leaves_the_window_at_some_points_brings_nothing_there(world):
    """The window ends just above the first of the further modes, which the draws move by some per cent."""
    _, hypotheses, state = world
    modes, index = model_modes(hypotheses, state), hypotheses.question(()).at(state.values).pairing.model_index
    free = [j for j in range(modes.n_modes) if j not in index and modes.natural_freq[j] < 100.0]
    top = float(modes.natural_freq[free[0]]) * 1.0005
    window = replace(hypotheses.pair.problem, freq_window=(0.5, top))
    narrow = ModelHypotheses(ModalResidual(window), hypotheses.variants, hypotheses.space)
    prospects = prospects_of(narrow, state, draws=8, certain=False)
    (option,) = [o for o in option_of(prospects, "mode") if o.name.endswith(f"{modes.natural_freq[free[0]]:.3g} Hz")]
    gains = prospects.sizes(option) / prospects.sizes(None)
    lost = np.isclose(gains, 1.0, atol=1e-12).all(axis=1)
    assert 0 < lost.sum() < 8
    wide = prospects_of(hypotheses, state, draws=8, certain=False)
    (same,) = [o for o in option_of(wide, "mode") if o.name == option.name]
    whole = wide.sizes(same) / wide.sizes(None)
    np.testing.assert_allclose(gains[~lost], whole[~lost], rtol=1e-6)
    assert (whole[lost].max(axis=1) > 1 + 1e-6).all()


# -- two models --------------------------------------------------------------------------------------------------------


def pair_of(hypotheses, names=("platform", "lamp")):
    trials = []
    for name in names:
        question = hypotheses.question((name,))
        state = fitted(question, (name,), question.space.values)
        (own,) = [e for e in hypotheses.effects if e.name == name]
        trials.append(Trial((own,), state, ln_evidence(state, [own]), ""))
    return trials


def test_two_models_are_seen_from_points_of_both_as_the_data_weigh_them(world):
    _, hypotheses, state = world
    pair, found = pair_of(hypotheses), scores(state, hypotheses.effects, {})
    prospects = modal_prospects(hypotheses, pair, hypotheses.effects, found, 1.0, draws=3)
    assert [view.names[3] for view in prospects.views] == ["platform"] * 3 + ["lamp"] * 3
    assert prospects.rivals.names == ("platform", "lamp")
    assert {view.weight for view in prospects.views} == set(prospects.rivals.weights)
    for rival, trial in zip(prospects.rivals.pair, pair, strict=True):
        assert len({p[rival.name] for p in rival.points}) == 3 and rival.seen.all() and rival.there.all()
        k = trial.state.names.index(rival.name)
        step = trial.state.covariance[k, k] ** 0.5
        moved = rival.drawn - rival.fit
        linear = np.array(
            [[p[n] - trial.state.values[n] for n in trial.state.names] for p in rival.points]
        ) @ rival.slope.T  # fmt: skip
        assert step > 0 and np.linalg.norm(moved - linear) < 0.2 * np.linalg.norm(moved)


@pytest.mark.slow
def test_the_odds_promised_for_twice_the_repeats_come_out(mast, tmp_path):
    """Two masses near each other, which one test hardly tells apart; the truth is in turn one and the other."""
    promised, realised, inside = [], [], 0
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
        question = first.question(())
        base = fitted(question, (), question.space.values)
        prospects = modal_prospects(first, pair, pair[0].effects, scores(base, first.effects, {}), 1.0, draws=6)
        (option,) = option_of(prospects, "repeats")
        odds = prospects.rivals.odds(option)
        sign = 1 if hidden == "platform" else -1
        promised.append(odds.mean)
        realised.append(sign * (after[0].ln_evidence - after[1].ln_evidence))
        inside += odds.low <= realised[-1] <= odds.high
    error = np.std(realised, ddof=1) / np.sqrt(len(realised))
    assert np.mean(realised) == pytest.approx(np.mean(promised), abs=2.5 * error)
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
