"""A problem with a ledger: solved points are kept in a file, and the same call solves none of them again."""

from pathlib import Path

import numpy as np
import pytest

import calib
from calib.results.ledger import Ledger
from models.four_storey_rig import four_storey_rig

STUDIES = Path(__file__).resolve().parents[2] / "studies"
CALLS = []


def oscillator(v):
    CALLS.append(dict(v))
    if v["k"] > 85.0:
        raise ValueError("it buckles")
    return {"w2": 1e3 * v["k"] / (v["m"] + v["load"]), "m": v["m"]}


SPACE = calib.ParameterSpace((
    calib.Parameter("k", 30.0, 10.0, 90.0, "kN/m"), calib.Parameter("m", 7.0, 1.0, 20.0, "kg"),
    calib.Parameter("load", 0.0, 0.0, 50.0, "kg"),
))  # fmt: skip
MODEL = calib.FunctionModel("oscillator", SPACE, oscillator)


def both():
    return [
        calib.ResponseTest({"w2": (1e3 * 40 / (10 + x), 1.0)}, name=f"{x:g}", condition={"load": x})
        for x in (0.0, 25.0)
    ]


@pytest.mark.medium
@pytest.mark.parametrize("several", [False, True])
def test_a_second_run_calls_the_function_for_no_point(several, tmp_path):
    given = both() if several else both()[0]
    file = tmp_path / "made here" / "kept.sqlite"

    def run():
        problem = calib.Problem(MODEL, given, ledger=file)
        first = len(CALLS)
        fit = problem.calibrate(starts=2, progress=False)
        found = problem.search(cases=2, population=8, generations=4, progress=False)
        samples = problem.sensitivity(samples=20, progress=False).samples
        return len(CALLS) - first, [fit.parameters, found.parameters, samples, found.search.convergence], fit

    called, tables, fit = run()
    again, same, other = run()
    bare = calib.Problem(MODEL, given).calibrate(starts=2, progress=False)
    assert called > 60 and again == 0
    for one, two in zip(tables, same, strict=True):
        assert one.equals(two)
    assert fit.values == other.values == bare.values
    assert other.cases.cases[0].result.solved == 0 < fit.cases.cases[0].result.solved
    part = fit.problem.fit_problem.parts["0"] if several else fit.problem.fit_problem
    with Ledger.open(file) as ledger:
        assert ledger.count(part.pair.problem.fingerprint) > 0


def test_failed_points_are_kept_as_failed(tmp_path):
    problem = calib.Problem(MODEL, both(), ledger=tmp_path / "kept.sqlite")
    values = problem.space.values | {"k": 88.0}
    for _ in range(2):
        before = len(CALLS)
        with pytest.raises(calib.EvaluationError, match="it buckles"):
            calib.Problem(MODEL, both(), ledger=tmp_path / "kept.sqlite").statistics_at(values)
        called = len(CALLS) - before
    assert called == 0


def test_conditions_and_functions_have_points_of_their_own(tmp_path):
    """The parameter that a condition sets is no part of a search's points, nor is the function."""
    file = tmp_path / "kept.sqlite"

    def found(load, function=oscillator):
        test = calib.ResponseTest({"w2": (4000.0, 4.0)}, name="one", condition={"load": load})
        problem = calib.Problem(calib.FunctionModel("oscillator", SPACE, function), test, ledger=file)
        return problem.sensitivity(samples=10, progress=False).samples["w2"].to_numpy()

    def heavier(v):
        return {"w2": 1e3 * v["k"] / (2 * v["m"] + v["load"])}

    empty, loaded = found(0.0), found(25.0)
    assert (loaded < empty).all() and not np.allclose(found(0.0, heavier), empty)
    np.testing.assert_array_equal(found(0.0), empty)


@pytest.mark.medium
def test_residuals_of_modes_are_kept_too(tmp_path):
    modes = calib.read_modes(STUDIES / "four_storey_rig/measured.csv", repeats=100, std_of="repeat")
    fits = []
    for _ in range(2):
        problem = calib.Problem(four_storey_rig(), calib.ModalTest(modes, mode_count=4), ledger=tmp_path / "rig.sqlite")
        fits.append(problem.calibrate(["k1", "k2"], starts=1, progress=False))
    one, two = fits
    assert one.values == two.values and one.parameters.equals(two.parameters)
    solved = [fit.cases.cases[0].result.solved for fit in fits]
    assert solved[1] < solved[0] / 2


def test_a_copy_shares_the_ledger(tmp_path):
    problem = calib.Problem(MODEL, both(), ledger=str(tmp_path / "kept.sqlite"))
    assert problem.keep(["k"]).ledger is problem.ledger
    joined = calib.Problem.join(problem, calib.Problem(MODEL, calib.ResponseTest({"m": (10.0, 0.1)}, name="scale")))
    assert joined.ledger is problem.ledger


@pytest.mark.parametrize("wrong", ["folder", "text", 3])
def test_a_wrong_ledger_is_refused_in_one_sentence(wrong, tmp_path):
    (tmp_path / "text").write_text("no ledger\n" * 100)
    (tmp_path / "folder").mkdir()
    given = tmp_path / wrong if isinstance(wrong, str) else wrong
    with pytest.raises(calib.InputError) as told:
        calib.Problem(MODEL, both(), ledger=given)
    words = str(told.value)
    assert "ledger" in words and "--results" not in words and "\n" not in words
    if isinstance(wrong, str):
        assert str(given) in words
