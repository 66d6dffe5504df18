"""Genetic search and sensitivity of a problem in memory give the results of a study, with any executor."""

import math
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import calib
from calib.analyses.calibrate import calibrate
from calib.analyses.provenance.places import QUICK_GENERATIONS, QUICK_POPULATION, QUICK_SAMPLES
from calib.analyses.sensitivity import sensitivity
from calib.execution.executor import Injected
from calib.inference.agreement import agreement_sentences
from calib.results.ledger import Ledger
from calib.results.results import Results
from calib.study.study import LoadedStudy
from models.five_mass_chain import five_mass_chain
from models.four_storey_rig import four_storey_rig

STUDIES = Path(__file__).resolve().parents[2] / "studies"
STOREYS = ("k1", "k2", "k3", "k4")
SIZE = {"population": QUICK_POPULATION, "generations": QUICK_GENERATIONS}


@pytest.fixture(scope="module")
def rig():
    modes = calib.read_modes(STUDIES / "four_storey_rig/measured.csv", repeats=100, std_of="repeat")
    return calib.Problem(four_storey_rig(), calib.ModalTest(modes, mode_count=4))


@pytest.fixture(scope="module")
def chain():
    measured = calib.read_responses(STUDIES / "five_mass_chain/measured.csv")
    return calib.Problem(five_mass_chain(), calib.ResponseTest(measured))


@pytest.fixture(scope="module")
def found(rig):
    return rig.search(STOREYS, cases=2, **SIZE)


def oscillator(function=lambda v: {"w2": 1e3 * v["k"] / (v["m"] + v["load"])}):
    names = (("k", 30.0, 1.0, 100.0, "kN/m"), ("m", 7.0, 1.0, 50.0, "kg"), ("load", 0.0, 0.0, 50.0, "kg"))
    return calib.FunctionModel("oscillator", calib.ParameterSpace(tuple(calib.Parameter(*p) for p in names)), function)


def weighed(model=None):
    """One oscillator in two tests, empty and loaded, of 40 kN/m and 10 kg."""
    tests = [
        calib.ResponseTest({"w2": (4e4 / (10 + x), 1.0)}, name=name, condition={"load": x})
        for name, x in (("empty", 0.0), ("loaded", 25.0))
    ]
    return calib.Problem(oscillator() if model is None else model, tests)


# -- search ------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", [pytest.param("four_storey_rig", marks=pytest.mark.slow), "five_mass_chain"])
def test_a_search_is_that_of_the_study(rig, chain, name, tmp_path):
    study = LoadedStudy.load(STUDIES / name)
    problem = {"four_storey_rig": rig, "five_mass_chain": chain}[name]
    results = Results.at(tmp_path, name)
    with Ledger.open(results.path / "ledger.sqlite") as ledger:
        own = calibrate(study, results, ledger, only=study.settings.calibration.cases[0].name, quick=True,
                        method="genetic").cases[0]  # fmt: skip
    seed = study.settings.calibration.cases[0].seed
    fit = problem.search(study.search_space.free_names, cases=1, seed=seed, **SIZE)
    (case,) = fit.search.cases
    assert case.values == own.search.values and case.misfit == own.search.misfit
    assert (case.solved, case.reused, case.failed) == (own.search.solved, own.search.reused, own.search.failed)
    np.testing.assert_array_equal(case.convergence, own.search.convergence)
    assert fit.statistics.criterion == pytest.approx(own.statistics.criterion, abs=1e-3)
    for name, value in own.statistics.values.items():
        assert fit.values[name] == pytest.approx(value, rel=1e-3)


@pytest.mark.medium
@pytest.mark.parametrize(
    "make",
    [
        lambda: ThreadPoolExecutor(3),
        pytest.param(lambda: ProcessPoolExecutor(1, get_context("spawn")), marks=pytest.mark.slow),
    ],
    ids=["threads", "another process"],
)
def test_an_executor_changes_nothing(rig, make):
    small = {"population": 8, "generations": 6}
    with make() as executor:
        given = rig.search(STOREYS, cases=2, executor=executor, **small)
        again = rig.search(STOREYS, cases=1, seed=2, executor=Injected(executor), **small)
        samples = rig.sensitivity(STOREYS, samples=40, executor=executor).samples
    here = rig.search(STOREYS, cases=2, **small)
    for table in ("table", "convergence", "parameters"):
        pd.testing.assert_frame_equal(getattr(given.search, table), getattr(here.search, table), check_exact=True)
    assert given.values == here.values
    np.testing.assert_array_equal(again.search.cases[0].convergence, here.search.cases[1].convergence)
    pd.testing.assert_frame_equal(samples, rig.sensitivity(STOREYS, samples=40).samples, check_exact=True)


@pytest.mark.medium
def test_least_squares_follow_from_where_the_cases_ended(rig, found):
    assert list(found.search.table["asked"]) == [SIZE["population"] * SIZE["generations"]] * 2
    assert [case.misfit for case in found.search.best] == sorted(found.search.table["misfit"])
    for case in found.search.cases:
        assert found.statistics.criterion < rig.keep(STOREYS).statistics_at(case.values).statistics.criterion
    assert list(found.parameters.index) == list(STOREYS)
    ends = agreement_sentences(found.agreement, found.search.agreement)
    assert ends and set(ends) <= set(found.sentences) and all(name in str(found) for name in STOREYS)
    assert rig.keep(STOREYS).calibrate(starts=1).search is None


@pytest.mark.medium
def test_tests_are_searched_together_each_under_its_condition():
    problem = weighed()
    with ThreadPoolExecutor(2) as threads:
        fit = problem.search(cases=1, population=10, generations=20, executor=threads)
    (case,) = fit.search.cases
    error = [abs(1e3 * case.values["k"] / (case.values["m"] + x) / (4e4 / (10 + x)) - 1) for x in (0.0, 25.0)]
    assert case.misfit == pytest.approx(sum(error), rel=1e-12) and min(error) > 0
    assert (fit.values["k"], fit.values["m"]) == pytest.approx((40, 10), rel=1e-3)


@pytest.mark.medium
def test_joined_problems_are_searched_together(rig):
    space = calib.ParameterSpace((rig.model.space["k1"],))
    spring = calib.FunctionModel("spring", space, lambda v: {"stiffness": v["k1"]})
    bench = calib.Problem(spring, calib.ResponseTest({"stiffness": (1.02 * space["k1"].value, 1.0)}, name="bench"))
    joint = calib.Problem.join(rig, bench)
    fit = joint.search(STOREYS, cases=1, **SIZE)
    (case,) = fit.search.cases
    alone = abs(case.values["k1"] / (1.02 * space["k1"].value) - 1)
    modes = rig.compare({n: case.values[n] for n in rig.space.names}).table["freq_error"].abs().sum()
    assert case.misfit == pytest.approx(alone + modes, rel=1e-9)


def test_integers_are_searched():
    space = calib.ParameterSpace((calib.Parameter("n", 2, 1, 9, integer=True), calib.Parameter("x", 0.0, -1.0, 1.0)))
    model = calib.FunctionModel("steps", space, lambda v: {"a": 10 * v["n"] + v["x"], "b": 5 + v["x"]})
    problem = calib.Problem(model, calib.ResponseTest({"a": (70.5, 0.01), "b": (5.5, 0.01)}))
    fit = problem.search(cases=1, population=10, generations=15)
    assert fit.values["n"] == 7 and fit.values["x"] == pytest.approx(0.5, abs=0.02)


@pytest.mark.medium
def test_points_that_fail_are_counted_and_told():
    def fragile(v):
        if v["k"] > 60:
            raise calib.EvaluationError("the spring tears")
        return {"w2": 1e3 * v["k"] / (v["m"] + v["load"])}

    fit = weighed(oscillator(fragile)).search(cases=1, population=12, generations=8)
    assert fit.search.table["failed"].sum() > 0 and fit.values["k"] == pytest.approx(40, rel=1e-3)
    assert any("the spring tears" in sentence for sentence in fit.sentences)

    def broken(v):
        raise calib.EvaluationError("no licence")

    for ask in (lambda p: p.search(cases=1, population=5, generations=3), lambda p: p.sensitivity(samples=5)):
        with pytest.raises(calib.EvaluationError, match="no licence"):
            ask(weighed(oscillator(broken)))


# -- sensitivity -------------------------------------------------------------------------------------------------------


@pytest.mark.medium
@pytest.mark.parametrize("name", ["four_storey_rig", "five_mass_chain"])
def test_measures_are_those_of_the_study(rig, chain, name, tmp_path):
    study = LoadedStudy.load(STUDIES / name)
    results = Results.at(tmp_path, name)
    with Ledger.open(results.path / "ledger.sqlite") as ledger:
        own = sensitivity(study, results, ledger, quick=True)
    problem = {"four_storey_rig": rig, "five_mass_chain": chain}[name]
    seed = study.settings.sensitivity.seed
    found = problem.sensitivity(study.sensitivity_space.free_names, samples=QUICK_SAMPLES, seed=seed)
    for mine, theirs in (
        (found.spearman, own.assessment.spearman),
        (found.partial, own.assessment.partial),
        (found.variance_share, own.assessment.variance_share.table),
    ):
        pd.testing.assert_frame_equal(mine, theirs, check_exact=True)
    assert (found.answer.samples, found.answer.failed, found.answer.unpaired) == (own.samples, own.failed, own.unpaired)
    assert found.answer.noise_floor == own.noise_floor


@pytest.mark.medium
def test_what_matters_is_selected_and_can_be_fitted():
    def lever(v):
        return {"a": v["p"] ** 3 + 0.2 * v["q"], "b": v["q"]}

    space = calib.ParameterSpace(tuple(calib.Parameter(n, 1.0, 0.5, 1.5) for n in ("p", "q", "idle")))
    problem = calib.Problem(calib.FunctionModel("lever", space, lever), calib.ResponseTest({"a": 1.2, "b": 0.9}))
    found = problem.sensitivity(samples=200)
    assert found.selected == ("p", "q") and list(found.table["parameter"]) == ["p", "q", "idle"]
    assert found.spearman.loc["p", "a"] > 0.9 and abs(found.spearman.loc["idle"]).max() < found.answer.noise_floor
    ranks = found.samples[["p", "a"]].rank().corr().iloc[0, 1]
    assert found.spearman.loc["p", "a"] == pytest.approx(ranks)
    np.testing.assert_allclose(found.samples["a"], found.samples["p"] ** 3 + 0.2 * found.samples["q"], rtol=1e-14)
    assert list(problem.calibrate(found.selected, starts=1).parameters.index) == ["p", "q"]
    only = problem.sensitivity(["q"], samples=50)
    assert list(only.table["parameter"]) == ["q"] and only.spearman.loc["q", "b"] == 1.0
    for text in (str(found), found._repr_html_()):
        assert all(f"{value:.2f}" in text for value in found.table["max_variance_share"])
    assert "\n" not in repr(found)


def test_several_tests_have_their_own_columns_and_failed_points_none():
    def fragile(v):
        if v["k"] > 90:
            raise calib.EvaluationError("the spring tears")
        return {"w2": 1e3 * v["k"] / (v["m"] + v["load"])}

    found = weighed(oscillator(fragile)).sensitivity(samples=60)
    table = found.samples
    assert list(table.columns) == ["k", "m", "empty: w2", "loaded: w2"]
    good = table["k"] <= 90
    np.testing.assert_allclose(table["loaded: w2"][good], 1e3 * table["k"][good] / (table["m"][good] + 25))
    assert table[~good].iloc[:, 2:].isna().all(axis=None) and found.answer.failed == (~good).sum() > 0
    assert "the spring tears" in found.sentences[1]


def test_a_condition_holds_in_its_test_only():
    free = calib.ResponseTest({"w2": 1e3}, name="free")
    held = calib.ResponseTest({"w2": 4e3}, name="held", condition={"load": 0.0})
    table = calib.Problem(oscillator(), [held, free]).sensitivity(samples=20).samples
    assert table["load"].nunique() == 20
    np.testing.assert_allclose(table["held: w2"], 1e3 * table["k"] / table["m"])
    np.testing.assert_allclose(table["free: w2"], 1e3 * table["k"] / (table["m"] + table["load"]))


# -- what is refused ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "wrong",
    [
        lambda p, pool: p.search(["k9"]),
        lambda p, pool: p.search("k"),
        lambda p, pool: p.search(cases=0),
        lambda p, pool: p.search(population=3),
        lambda p, pool: p.search(generations=0.5),
        lambda p, pool: p.search(seed=-1),
        lambda p, pool: p.search(executor=4),
        lambda p, pool: p.search(executor=ThreadPoolExecutor),
        lambda p, pool: p.search(population=4, generations=2, executor=pool),  # it holds a lambda
        lambda p, pool: p.sensitivity(["k9"]),
        lambda p, pool: p.sensitivity(samples=2),
        lambda p, pool: p.sensitivity(samples=5, executor=pool),
        lambda p, pool: replace(p, tests=calib.ResponseTest({"w2": (0.0, 1.0)})).search(population=4, generations=2),
    ],
)
def test_what_cannot_be_asked_is_refused(wrong):
    with ProcessPoolExecutor(1, get_context("spawn")) as pool, pytest.raises(calib.InputError):
        wrong(weighed(), pool)


def test_a_case_needs_a_number_for_its_misfit():
    model = oscillator(lambda v: {"w2": math.nan})
    with pytest.raises(calib.EvaluationError):
        weighed(model).search(cases=1, population=4, generations=2)
