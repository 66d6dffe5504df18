"""The front of two groups of responses: against a closed form, seeded, resumed, by command and from Python."""

import math
from concurrent.futures import ThreadPoolExecutor

import matplotlib.pyplot as plt
import numpy as np
import pandas as pd
import pytest

import calib
from calib.analyses.pareto import ParetoRun, pareto_at
from calib.command import cli
from calib.command.example import write_example
from calib.command.options import groups_named
from calib.errors.errors import InputError
from calib.inference.objective import FrequencyMacObjective, JointObjective
from calib.inference.pareto import front_of, groups_of, knee_of
from calib.report.pareto import draw_pareto
from calib.study.search_settings import ParetoSettings

SMALL = {"population": 16, "generations": 12, "progress": False}
TWO = {"one": ["y"], "two": ["z"]}


def bent(ledger=None, calls=None, broken=False):
    """``y`` is right at a = b = 0, ``z`` at a = b = 1; each error is the squared distance from there."""
    space = calib.ParameterSpace([calib.Parameter(name, 0.5, -1.0, 2.0) for name in "ab"])

    def respond(v):
        if calls is not None:
            calls.append(dict(v))
        if broken and v["a"] < 0:
            raise RuntimeError("no mesh")
        return {"y": 1 + v["a"] ** 2 + v["b"] ** 2, "z": 1 + (v["a"] - 1) ** 2 + (v["b"] - 1) ** 2}

    test = calib.ResponseTest({"y": (1.0, 0.1), "z": (1.0, 0.1)})
    return calib.Problem(calib.FunctionModel("bent", space, respond), test, ledger=ledger)


@pytest.fixture(scope="module")
def fit():
    return bent().calibrate(starts=2, progress=False)


@pytest.fixture(scope="module")
def found(fit):
    return fit.pareto(objectives=TWO, population=30, generations=40, progress=False)


@pytest.mark.medium
def test_the_front_is_that_of_the_closed_form(found):
    front = found.of.front
    # on the segment between both centres sqrt(y) + sqrt(z) = sqrt(2)
    roots = np.sqrt(front["first"]) + np.sqrt(front["second"])
    assert (roots >= math.sqrt(2) - 1e-9).all() and np.median(roots) < 1.01 * math.sqrt(2)
    assert front["first"].min() < 0.02 and front["second"].min() < 0.02 and len(front) > 30
    assert front["first"].is_monotonic_increasing and front["second"].is_monotonic_decreasing
    knee, lowest = front[front["knee"]], front[front["lowest"]]
    assert len(knee) == len(lowest) == 1  # both are in the middle: y + z is smallest there
    np.testing.assert_allclose(knee[["first", "second"]], 0.5, atol=0.06)
    np.testing.assert_allclose(lowest["objective"], 1.0, atol=0.01)
    (fitted,) = found.table[found.table["kind"] == "least squares"].to_dict("records")
    np.testing.assert_allclose([fitted["first"], fitted["second"], fitted["a"]], 0.5, atol=0.01)
    one, two = found.of.objectives.to_dict("records")
    assert (one["name"], one["responses"], one["weight"], one["of"]) == ("one", "y", 1.0, "error")
    assert two["least"] == front["second"].min() and one["least_squares"] == fitted["first"]


@pytest.mark.medium
def test_same_seed_same_table_whoever_evaluates(fit):
    first = fit.pareto(objectives=TWO, **SMALL)
    with ThreadPoolExecutor(2) as executor:
        second = fit.pareto(objectives=TWO, executor=executor, **SMALL)
    pd.testing.assert_frame_equal(first.table.drop(columns="design"), second.table.drop(columns="design"))
    other = fit.pareto(objectives=TWO, seed=2, **SMALL)
    assert not first.table["a"].equals(other.table["a"])


@pytest.mark.medium
def test_an_interrupted_search_resumes_from_the_ledger(tmp_path, fit):
    whole, calls = fit.pareto(objectives=TWO, **SMALL), []
    fitted = bent(tmp_path / "some.sqlite", calls).calibrate(starts=2, progress=False)

    def stop(stage, done=0, total=0, best=math.nan):
        if stage == "searching the front" and done == 5:
            raise KeyboardInterrupt

    settings = ParetoSettings(objectives=TWO, population=16, generations=12)
    study, calls[:] = fitted.problem.study(), []
    with pytest.raises(KeyboardInterrupt):
        pareto_at(study, fit.values, ParetoRun(fitted.problem.ledger, settings, progress=stop))
    before, calls[:] = len(calls), []
    again = pareto_at(study, fit.values, ParetoRun(fitted.problem.ledger, settings))
    assert before > 30 and len(calls) <= whole.of.searched - before + 1
    pd.testing.assert_frame_equal(again.table.drop(columns="design"), whole.table.drop(columns="design"))


@pytest.mark.medium
def test_points_that_fail_are_left_out():
    found = bent(broken=True).calibrate(starts=2, progress=False).pareto(objectives=TWO, **SMALL)
    assert (found.of.front["a"] >= 0).all() and found.of.searched < 16 * 12


def test_equalities_are_kept():
    a, b = (calib.Parameter(name, 0.5, 0.0, 1.0) for name in "ab")
    total = calib.LinearConstraint("total", (("a", 1.0), ("b", 1.0)), 1.0, 1.0)
    model = calib.FunctionModel(
        "tied", calib.ParameterSpace((a, b), (total,)), lambda v: {"y": 1 + v["a"], "z": 1 + v["b"] ** 2}
    )
    fit = calib.Problem(model, calib.ResponseTest({"y": (1.0, 0.1), "z": (1.0, 0.1)})).calibrate(
        starts=1, progress=False
    )
    found = fit.pareto(objectives=TWO, **SMALL)
    np.testing.assert_allclose(found.table["a"] + found.table["b"], 1.0, atol=1e-12)
    np.testing.assert_allclose(np.sqrt(found.of.front["second"]), 1 - found.of.front["first"], atol=1e-9)


def test_weights_of_the_calibration_hold_for_its_front():
    fit = bent().calibrate(starts=1, weight_freq=3.0, progress=False)
    assert (fit.problem.settings.calibration.weight_freq, fit.problem.settings.calibration.weight_mac) == (3.0, 1.0)
    plain = bent().calibrate(starts=1, weight_freq=1.0, progress=False).problem.settings.calibration
    assert not {"weight_freq", "weight_mac"} & plain.model_fields_set  # a stated weight asks for a search first


# -- groups ------------------------------------------------------------------------------------------------------------


def test_frequencies_are_weighed_against_shapes_by_the_weights_of_the_objective():
    objective = FrequencyMacObjective(("A", "B"), {"A": 10.0, "B": 20.0}, weight_freq=3.0, weight_mac=0.5)
    responses = {"natural_freq_A": 11.0, "mac_A": 0.9, "natural_freq_B": math.nan, "mac_B": 0.7}
    frequencies, shapes = groups_of(objective, {})
    terms = objective.terms(responses)
    assert frequencies(terms) == pytest.approx((0.1 + 1.0) / 2) and shapes(terms) == pytest.approx((0.1 + 1.0) / 2)
    assert (frequencies.weight, shapes.weight) == (6.0, 1.0)
    assert frequencies.weight * frequencies(terms) + shapes.weight * shapes(terms) == pytest.approx(
        objective(responses)
    )
    modes = groups_of(objective, {"first": ("*_A",), "second": ("natural_freq_B", "mac_?")[:1]})
    assert modes[0](terms) == pytest.approx((3.0 * 0.1 + 0.5 * 0.1) / 2) and modes[0].weight == 2.0
    joint = JointObjective({"t": objective, "u": objective})
    both = {f"{test}: {name}": value for test in "tu" for name, value in responses.items()}
    first, second = groups_of(joint, {"t": ("t: *",), "u": ("u: *",)})
    assert (
        first.weight * first(joint.terms(both))
        == pytest.approx(objective(responses))
        == pytest.approx(second.weight * second(joint.terms(both)))
    )


def test_groups_are_refused_that_match_nothing_or_overlap(fit):
    for objectives, words in (
        ({}, "no shapes were measured"),
        ({"one": ["y"], "two": ["q*"]}, "'q\\*' matches no response"),
        ({"one": ["y", "z"], "two": ["z"]}, "'z' belongs to 'one' and to 'two'"),
        ({"one": ["y"]}, "pareto"),
        ({"one": ["y"], "two": []}, "names no response"),
    ):
        with pytest.raises(InputError, match=words):
            fit.pareto(objectives=objectives, **SMALL)
    assert groups_named(["low=f_1*,mac_1*", "b=z"]) == {"low": ("f_1*", "mac_1*"), "b": ("z",)}
    with pytest.raises(InputError, match="names no group"):
        groups_named(["low"])


def test_front_and_knee_of_points():
    points = np.array([[1.0, 1.0], [0.0, 3.0], [3.0, 0.0], [0.0, 4.0], [1.0, 1.0], [2.0, 2.0], [2.0, 0.9]])
    assert front_of(points).tolist() == [1, 0, 6, 2]
    assert knee_of(points[front_of(points)]) == 1
    straight = np.array([[0.0, 2.0], [1.0, 1.01], [2.0, 0.0]])
    assert knee_of(straight) is None and knee_of(straight[:2]) is None
    assert knee_of(np.array([[0.0, 2.0], [1.5, 1.5], [2.0, 0.0]])) is None  # beyond the line


# -- drawn, by command -------------------------------------------------------------------------------------------------


@pytest.mark.medium
def test_the_weights_are_a_line_through_the_best_design(found):
    ax = draw_pareto(found.table, found.of.objectives)
    lines = {line.get_gid(): line for line in ax.get_lines()}
    front, lowest = found.of.front, found.of.front[found.of.front["lowest"]].iloc[0]
    np.testing.assert_allclose(lines["front"].get_xdata(), 100 * front["first"])
    x, y = lines["weights"].get_data()
    assert (y[1] - y[0]) / (x[1] - x[0]) == pytest.approx(-1.0)
    assert np.interp(100 * lowest["first"], x, y) == pytest.approx(100 * lowest["second"])
    (fitted,) = lines["fit"].get_xydata()
    np.testing.assert_allclose(fitted, 100 * found.table[["first", "second"]].iloc[-1])
    assert {"knee", "lowest"} <= set(lines)
    plt.close(ax.figure)


@pytest.mark.slow
def test_the_command_writes_what_python_returns(tmp_path, capsys):
    write_example(tmp_path / "mast")
    folder, out = str(tmp_path / "mast"), str(tmp_path / "out")
    assert cli.execute(["pareto", folder, "--results", out]) == 2
    assert "calib calibrate" in capsys.readouterr().err
    assert cli.execute(["calibrate", folder, "--results", out]) == 0
    sizes = ["--population", "12", "--generations", "6", "--workers", "2"]
    assert cli.execute(["pareto", folder, "--results", out, *sizes]) == 0
    stored, said = pd.read_csv(tmp_path / "out/mast/pareto.csv"), capsys.readouterr().out
    assert (tmp_path / "out/mast/pareto.png").exists()
    study = calib.Study.load(folder, results=out, workers=1, progress=False)
    own = study.pareto(population=12, generations=6)
    pd.testing.assert_frame_equal(own.table, stored, check_dtype=False, rtol=1e-6)
    assert all(sentence in said for sentence in own.sentences)
    assert "shapes: mean of 1 − MAC" in study.report().read_text("utf-8")
    number = int(stored["design"].iloc[0])
    assert number in set(study.designs().table["design"])  # any design of the front is one of the study
    assert cli.execute(["calibrate", folder, "--results", out]) == 0
    assert not (tmp_path / "out/mast/pareto.csv").exists()
