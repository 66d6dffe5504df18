"""Parameters that are not selected: uncertain by their priors, in an explanation and in a calibration."""

import json

import numpy as np
import pandas as pd
import pytest

import calib
from calib.analyses.explain import explain
from calib.analyses.uncertain import uncertain, uncertain_note, with_uncertain
from calib.errors.errors import InputError
from calib.inference.considered import At, changes_by_held
from calib.inference.identify import posterior
from calib.results.results import Results
from calib.study.study import LoadedStudy

ALL, TWO = 'selection = ["E", "m_top", "K_base"]', 'selection = ["E", "K_base"]'
"""The mast's true mass at the top is 15 % larger than its nominal value."""


@pytest.fixture
def asked(mast, edited, tmp_path):
    """The explanation of a mast of which two of three parameters are fitted, and its results."""

    def ask(mass, hidden=None):
        folder = edited(mast.write_study(tmp_path / "mast", hidden), ALL, TWO)
        study = LoadedStudy.load(edited(folder, "m_top = { prior_sd = 8.0 }", f"m_top = {{ {mass} }}"))
        results = Results.at(tmp_path / "results", "mast")
        return study, explain(study, results), results

    return ask


@pytest.mark.slow
def test_a_parameter_that_is_held_at_a_wrong_value_is_taken_for_a_missing_effect(asked):
    assert asked("fixed = true")[1].verdict != "nothing_detectable"


@pytest.mark.medium
def test_nothing_seems_missing_where_that_parameter_is_uncertain_by_as_much(asked):
    study, answer, results = asked("prior_sd = 6.0")
    assert answer.verdict == "nothing_detectable"
    pulls = pd.read_csv(results.path / "pulls.csv").set_index("parameter")
    assert pulls.loc["m_top", "prior_sd"] == pytest.approx(6.0)
    assert 0.5 < (pulls.loc["m_top", "value"] - study.model.space["m_top"].value) / 6.0 < 1.5
    assert "Parameters that are not selected are uncertain by their priors: m_top" in answer.notes[-1]
    assert json.loads((results.path / "explanation.json").read_text())["notes"][-1] == answer.notes[-1]


@pytest.mark.slow
def test_an_effect_is_still_named_beside_an_uncertain_parameter(asked):
    _, answer, _ = asked("prior_sd = 6.0", {"guy": 12000.0})
    assert answer.verdict == "effect" and answer.explanation.credible == ("guy",)
    low, high = answer.effects.set_index("name").loc["guy", ["magnitude_low", "magnitude_high"]]
    assert low < 12000.0 < high


@pytest.mark.slow
def test_a_parameter_off_by_many_standard_deviations_is_told(asked):
    """A standard deviation of 2 % where the mass is 15 % off."""
    results = asked("prior_sd = 0.8")[2]
    pulls = pd.read_csv(results.path / "pulls.csv").set_index(["model", "parameter"])
    assert bool(pulls.loc[("base", "m_top"), "pulled"])


def test_the_unselected_parameters_are_free_under_their_priors(mast, edited, tmp_path):
    study = LoadedStudy.load(edited(mast.write_study(tmp_path / "mast"), ALL, TWO))
    assert [p.name for p in uncertain(study)] == ["m_top"] and study.held_sd == {"m_top": 8.0}
    free, own = with_uncertain(study), study.search_space
    p = free.search_space["m_top"]
    assert (p.prior_width, p.lower, p.upper) == (
        8.0,
        study.model.space["m_top"].lower,
        study.model.space["m_top"].upper,
    )
    assert set(free.search_space.free_names) == {*own.free_names, "m_top"} and free.held_sd == {}
    assert all(free.search_space[n] == own[n] for n in own.free_names)
    assert uncertain_note(study) == ("Parameters that are not selected are uncertain by their priors: m_top.",)


def test_a_fixed_parameter_is_exact(mast, edited, tmp_path):
    folder = edited(mast.write_study(tmp_path / "mast"), ALL, TWO)
    study = LoadedStudy.load(edited(folder, "m_top = { prior_sd = 8.0 }", "m_top = { fixed = true }"))
    assert study.held_sd == {} and with_uncertain(study) is study and uncertain_note(study) == ()


def test_where_all_are_selected_the_study_is_as_it_was(bare):
    assert with_uncertain(bare[0]) is bare[0] and uncertain_note(bare[0]) == ()


def test_the_former_key_is_refused_with_its_line_and_the_present_one(mast, edited, tmp_path):
    folder = edited(
        mast.write_study(tmp_path / "mast"), "[calibration]", '[explain]\nfixed_sd = "3 %"\n\n[calibration]'
    )
    with pytest.raises(InputError, match="fixed_sd") as refused:
        LoadedStudy.load(folder)
    assert (
        "line" in str(refused.value) and "prior_sd" in refused.value.remedy and "fixed = true" in refused.value.remedy
    )


# -- calibration -------------------------------------------------------------------------------------------------------


def masses(*, bent=False, selection=("k",), data=(100.0, 50.0, 25.0, 12.5), **mass):
    """A stiffness k over a mass m, which only together decide what is measured; k = 10, m = 1 is in the data."""
    space = calib.ParameterSpace(
        (calib.Parameter("k", 9.0, 1.0, 20.0, "kN/m"), calib.Parameter("m", 1.0, 0.2, 5.0, "kg", **mass))
    )
    power = 3.0 if bent else 1.0
    model = calib.FunctionModel(
        "ratio", space, lambda v: {f"y_{n}": 10.0 * v["k"] / v["m"] ** power / 2**n for n in range(4)}
    )
    measured = {f"y_{n}": (y, 0.01 * y) for n, y in enumerate(data)}
    return calib.Problem(model, calib.ResponseTest(measured)).calibrate(list(selection), progress=False)


@pytest.mark.medium
def test_a_held_parameter_adds_what_it_shifts():
    """k follows m: with m off by 10 % so is k; the data alone know it to 0.5 %."""
    exact, held = masses(distribution="fixed"), masses(prior_sd=0.1)
    alone = exact.parameters.loc["k", "std"]
    assert alone == pytest.approx(0.05, rel=0.01) and exact.statistics.considered.empty
    assert held.values["k"] == pytest.approx(exact.values["k"])
    assert held.parameters.loc["k", "std"] == pytest.approx(np.hypot(alone, 1.0), rel=0.02)
    assert exact.parameters.loc["k", "identified"] and not held.parameters.loc["k", "identified"]
    row = held.statistics.considered.iloc[0]
    assert row["parameter"] == "m" and row["adds_to"] == "k" and row["matters"]
    assert row["std_with"] == pytest.approx(held.parameters.loc["k", "std"])
    assert any("m is held at" in words and "select it" in words for words in held.sentences)
    sure = masses(prior_sd=1e-4)
    assert sure.parameters.loc["k", "std"] == pytest.approx(alone, rel=1e-3)
    assert not sure.statistics.considered["matters"].any() and not any(
        "is held at" in words for words in sure.sentences
    )


def test_a_parameter_without_a_stated_uncertainty_has_that_of_its_limits():
    row = masses().statistics.considered.iloc[0]
    assert row["std"] == pytest.approx(4.8 / np.sqrt(12))


@pytest.mark.parametrize(("sd", "shift"), [(0.2, 10.0 * (1.2**3 - 1)), (0.4, 10.0)])
def test_a_shift_that_is_not_linear_is_the_larger_of_those_to_either_side(sd, shift):
    """k = 10 m^3: between m = 0.6 and 1.4 it goes from 2.16 to 27.4, which its limit ends at 20."""
    row = masses(bent=True, prior_sd=sd).statistics.considered.iloc[0]
    assert row["std_with"] == pytest.approx(shift, rel=0.02)
    near = masses(bent=True, prior_sd=0.002).statistics.considered.iloc[0]
    assert np.sqrt(near["std_with"] ** 2 - near["std_without"] ** 2) == pytest.approx(10.0 * 3 * 0.002, rel=0.02)


def test_limits_on_both_sides_do_not_make_a_shift_small():
    """Between m = 0.2 and 1.8 k goes from 0.08 to 58, which its limits end at 1 and 20; its derivative gives 24."""
    assert masses(bent=True, prior_sd=0.8).statistics.considered.iloc[0]["std_with"] > 20.0


@pytest.mark.medium
def test_the_test_of_the_fit_counts_held_parameters():
    """The offset b is held at 0 and is 3 in truth: the slope alone does not fit."""
    rng = np.random.default_rng(5)
    x = np.arange(8.0)
    y = 3.0 + 2.0 * x + 0.1 * rng.standard_normal(8)
    found = {}
    for told, given in {
        "exact": {"distribution": "fixed"},
        "unsure": {"prior_sd": 2.0},
        "sure": {"prior_sd": 0.01},
    }.items():
        space = calib.ParameterSpace(
            (calib.Parameter("a", 1.0, -5.0, 5.0, prior_sd=2.0), calib.Parameter("b", 0.0, -9.0, 9.0, **given))
        )
        model = calib.FunctionModel("line", space, lambda v: {f"y_{k}": v["b"] + v["a"] * k for k in range(8)})
        problem = calib.Problem(model, calib.ResponseTest({f"y_{k}": (y[k], 0.1) for k in range(8)}))
        found[told] = problem.calibrate(["a"], progress=False)
    assert found["exact"].statistics.fits is False and found["sure"].statistics.fits is False
    unsure = found["unsure"].statistics
    assert unsure.fits is True and unsure.considered_misfit < 20 < unsure.misfit
    assert unsure.dof == pytest.approx(6.0, abs=0.02)  # as with both fitted
    errors = {told: one.errors.set_index("group").loc["fit"] for told, one in found.items()}
    assert errors["exact"]["p"] < 1e-9 and errors["unsure"]["p"] > 0.05
    # What 2 of the offset leave of the line: its part beside the slope, over the standard deviation.
    left = 2.0 / 0.1 * (np.ones(8) - x * (x.sum() / (x @ x + (0.1 / 2.0) ** 2)))
    assert errors["unsure"]["expected"] == pytest.approx(np.sqrt((7.0 + left @ left) / 8), rel=1e-3)
    assert abs(found["unsure"].values["a"] - 2.0) < 2 * found["unsure"].parameters.loc["a", "std"]


class Rows:
    """Rows k (1 + b), k s, m of a stiffness k; a coarse model does not know how b acts."""

    space = calib.ParameterSpace(
        (
            calib.Parameter("k", 1.0, 0.1, 4.0),
            calib.Parameter("b", 0.0, -0.5, 0.5, distribution="fixed"),
            calib.Parameter("s", 1.0, 0.5, 1.5, distribution="fixed"),
        )
    )

    def __init__(self, bend):
        self.bend, self.calls = bend, []

    def residual(self, values):
        self.calls.append(values)
        k, b, s = (values[name] for name in ("k", "b", "s"))
        return np.array([100.0 * (k * (1 + b + self.bend * b**3) - 1.0), 0.01 * (k * s - 1.0)])

    def jacobian(self, values, names):
        k, b, s = (values[name] for name in ("k", "b", "s"))
        by = {
            "k": [100.0 * (1 + b + self.bend * b**3), 0.01 * s],
            "b": [100.0 * k * (1 + 3 * self.bend * b**2), 0.0],
            "s": [0.0, 0.01 * k],
        }
        return np.array([by[name] for name in names]).T


def changes(problem, nearby=None):
    """The changes by b and s, each held within 0.4, with the shift of k that follows."""
    values = problem.space.complete({})
    at = At(("k",), values, problem.residual(values), problem.jacobian(values, ["k"]), np.array([1.0]), True)
    held = changes_by_held(problem, at, {"b": 0.4, "s": 0.4}, nearby).of_estimates
    covariance = posterior(at.names, at.slope, at.prior_sd).covariance
    return held, (-covariance @ at.slope.T @ held)[0]


def test_a_better_model_is_asked_where_a_coarse_one_is_not_linear_and_only_there():
    asked, fine = [], Rows(2.0)
    ends = [1 / (1 - 0.4 - 2.0 * 0.4**3), 1 / (1 + 0.4 + 2.0 * 0.4**3)]  # the first is further from 1

    def nearby(points):
        asked.extend(points)
        return fine

    held, shift = changes(Rows(0.0), nearby)
    assert [point["b"] for point in asked] == [-0.4, 0.4] and all(point["s"] == 1.0 for point in asked)
    assert shift[0] == pytest.approx(1 - ends[0], rel=0.01)  # with the better model
    assert held[:, 1] == pytest.approx([0.0, 0.004])  # of the coarse one
    assert changes(Rows(0.0))[1][0] == pytest.approx(1 - 1 / 0.6, rel=0.01)


def test_nobody_is_asked_where_all_is_linear():
    class Linear(Rows):
        def residual(self, values):
            own = self.space.complete({})
            step = [values[name] - own[name] for name in ("k", "b", "s")]
            return self.jacobian(own, ("k", "b", "s")) @ step

    held, _ = changes(Linear(0.0), lambda points: pytest.fail("it is linear"))
    assert held == pytest.approx(np.array([[40.0, 0.0], [0.0, 0.004]]))


@pytest.mark.medium
@pytest.mark.parametrize("least", [2.0, 4.3])
def test_a_held_parameter_takes_part_in_a_constraint(least):
    """The truth is a = 1, c = 3. With c held at 0 ± 3 the constraint takes a to its limit, far from the data.

    At the two ends of c the constraint leaves a at ``least + 3``, and at the larger of ``least - 3`` and its data: it
    moves by 3 at the first, whatever stops it at the second.
    """
    rng = np.random.default_rng(8)
    by, truth = ["a", "c", "c"] * 4, {"a": 1.0, "c": 3.0}
    measured = {f"y_{k}": (truth[name] + 0.5 * rng.standard_normal(), 0.5) for k, name in enumerate(by)}

    def problem(sd):
        space = calib.ParameterSpace(
            (calib.Parameter("a", 1.0, -9.0, 9.0), calib.Parameter("c", 0.0, -9.0, 9.0, prior_sd=sd)),
            (calib.LinearConstraint("a and c", (("a", 1.0), ("c", 1.0)), least, 50.0),),
        )
        model = calib.FunctionModel("two", space, lambda v: {f"y_{k}": v[name] for k, name in enumerate(by)})
        return calib.Problem(model, calib.ResponseTest(measured))

    found = problem(sd=3.0).calibrate(["a"], progress=False)
    assert found.values["a"] == pytest.approx(least)
    assert found.statistics.misfit > 200 and found.statistics.fits is True
    both = problem(sd=3.0).calibrate(["a", "c"], progress=False)
    assert found.statistics.considered_misfit == pytest.approx(both.statistics.misfit, rel=1e-3)
    used = found.errors.set_index("group").loc["fit"]
    assert 2 * used["p"] == pytest.approx(found.statistics.p_fit) and used["rms"] > 4.0  # one of two tests of the fit
    row = found.parameters.loc["a"]
    assert row["std"] == pytest.approx(3.0, rel=0.1) and row["low"] < 1.0 < row["high"]
    assert "constraint" not in row["not_identified"]
    exact = problem(sd=0.01).calibrate(["a"], progress=False)
    assert exact.statistics.fits is False and "constraint" in exact.parameters.loc["a", "not_identified"]
