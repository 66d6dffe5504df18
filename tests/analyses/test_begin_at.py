"""Starting points of least squares beside the end of a search."""

import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from calib.analyses.calibrate import calibrate
from calib.analyses.case import CaseFinder
from calib.analyses.explained_fit import explained_fit, explained_fits
from calib.analyses.extend import write_extension
from calib.analyses.provenance.record import write_record
from calib.errors.errors import InputError
from calib.report.html.study_results import StudyResults
from calib.report.html.write import sections
from calib.results.ledger import Ledger
from calib.results.results import Results
from calib.study.study import LoadedStudy
from tests.report.html.page_blocks import Picture, Table, Words, section_blocks

MODEL = """
from calib.structure.function_model import FunctionModel
from calib.problem.space import Parameter, ParameterSpace

def wave():
    space = ParameterSpace((Parameter("a", 0.0, -3.0, 3.0, "-"),))
    return FunctionModel("wave", space, lambda v: {"y": v["a"] ** 3 - 3 * v["a"], "z": 0.01 * v["a"]})
"""
STUDY = """
title = "Two valleys"
model = "model.py:wave"
selection = ["a"]
[measurement]
responses = "measured.csv"
[sensitivity]
samples = 20
[calibration]
{more}
cases = [{{ name = "A", seed = 1 }}]
"""
VALLEYS = (-1.0, 2.0)
"""Both have y = 2, where the first is a stationary point; z discriminates in favour of the second."""


@pytest.fixture
def study(tmp_path):
    def load(more):
        (tmp_path / "model.py").write_text(MODEL)
        (tmp_path / "measured.csv").write_text("response,value,std\ny,2.0,0.01\nz,0.02,0.01\n")
        (tmp_path / "study.toml").write_text(STUDY.format(more=more))
        return LoadedStudy.load(tmp_path)

    return load


def answer(study, tmp_path, method):
    results = Results.at(Path(tmp_path) / "results", study.name)
    with Ledger.open(results.path / "ledger.sqlite") as ledger:
        return calibrate(study, results, ledger, 1, method=method)


@pytest.mark.medium
@pytest.mark.parametrize("valley", VALLEYS)
def test_least_squares_end_in_the_valley_they_begin_in(study, tmp_path, valley):
    found = answer(study(f"starts = 1\nbegin_at = {{ a = {valley + 0.1} }}"), tmp_path, "gauss-newton")
    assert found.best.result.values["a"] == pytest.approx(valley, abs=0.1)


@pytest.mark.medium
@pytest.mark.parametrize("valley", VALLEYS)
def test_least_squares_begin_at_a_design_that_was_evaluated(study, tmp_path, valley):
    answer(study(f"starts = 1\nbegin_at = {{ a = {valley + 0.1} }}"), tmp_path, "gauss-newton")
    loaded = study("starts = 1")
    with Ledger.open(tmp_path / "results" / loaded.name / "ledger.sqlite") as ledger:
        found = ledger.lookup(loaded.problem.fingerprint, ledger.keys(loaded.problem.fingerprint))
        key = min(found, key=lambda key: abs(found[key].values["a"] - valley - 0.1))
        number = ledger.numbers(loaded.problem.fingerprint, [key])[key]
        assert ledger.design(number) == found[key] and ledger.design(10**6) is None
    named = answer(study(f'starts = 1\nbegin_at = "design {number}"'), tmp_path, "gauss-newton")
    assert named.best.result.values["a"] == pytest.approx(valley, abs=0.1)
    with pytest.raises(InputError, match=r"begin_at names design 1000000\b"):
        answer(study('begin_at = "design 1000000"'), tmp_path, "gauss-newton")


@pytest.mark.medium
def test_least_squares_start_from_the_end_of_a_search_and_from_known_points(study, tmp_path, monkeypatch):
    asked, refined = [], CaseFinder.refined

    def watched(self, reduction, starts, *rest, **more):
        asked.append(starts)
        return refined(self, reduction, starts, *rest, **more)

    monkeypatch.setattr(CaseFinder, "refined", watched)
    small = "population = 4\ngenerations = 2\n"
    answer(study(small), tmp_path, "genetic")
    found = answer(study(small + "begin_at = { a = 1.9 }"), tmp_path, "genetic")
    assert [len(starts) for starts in asked] == [1, 1]
    assert asked[0][0] == asked[1][0]  # the search itself does not know it
    assert found.best.result.values["a"] == pytest.approx(VALLEYS[1], abs=0.01)


# -- search and least squares ------------------------------------------------------------------------------------------

BETWEEN = """
from calib.structure.function_model import FunctionModel
from calib.problem.space import Parameter, ParameterSpace

def between():
    space = ParameterSpace((Parameter("a", 1.0, 0.0, 3.0, "-"),))
    return FunctionModel("between", space, lambda v: {"y": v["a"], "z": v["a"]})
"""


@pytest.mark.medium
def test_both_points_are_reported_where_least_squares_minimise_another_criterion(study, tmp_path):
    """Relative errors are smallest at a = 1; weighted by standard deviations only z = 2 counts."""
    loaded = study("population = 12\ngenerations = 12")
    (tmp_path / "model.py").write_text(BETWEEN.replace("between()", "wave()"))
    (tmp_path / "measured.csv").write_text("response,value,std\ny,1.0,10.0\nz,2.0,0.01\n")
    found = answer(LoadedStudy.load(loaded.file), tmp_path, "genetic")
    table = pd.read_csv(tmp_path / "results" / tmp_path.name / "points.csv").set_index("point")
    assert table["objective"]["search"] == pytest.approx(0.5, abs=0.05)
    assert table["objective"]["least squares"] == pytest.approx(1.0, abs=1e-3)
    assert table["total"]["least squares"] < table["total"]["search"]
    for point, values in (("search", found.best.search.values), ("least squares", found.best.result.values)):
        a = values["a"]
        assert table["objective"][point] == pytest.approx(abs(a - 1) + abs(a - 2) / 2, rel=1e-6)
        assert table["sum_of_squares"][point] == pytest.approx(((a - 1) / 10) ** 2 + ((a - 2) / 0.01) ** 2, rel=1e-6)
        assert table["prior"][point] == pytest.approx(((a - 1) * 12**0.5 / 3) ** 2, rel=1e-6)
    folder = tmp_path / "results" / tmp_path.name
    errors = pd.read_csv(folder / "errors_by_case.csv").set_index(["point", "what"])["error"]
    mean = table["mean_error"]
    assert errors["least squares", "y"] == pytest.approx(1.0, abs=1e-3)
    assert errors["search"].abs().mean() == pytest.approx(mean["search"], rel=1e-6)
    assert mean["search"] < mean["least squares"] == pytest.approx(0.5, abs=1e-3) and table["mean_mac"].isna().all()
    assert f"{found.best.name}, had ended at a mean error of {100 * mean['search']:.2f} %" in found.answer.found
    assert found.best.worsened and sum(found.best.name in s and "raised the misfit" in s for s in found.sentences) == 1


@pytest.mark.medium
def test_least_squares_that_did_not_run_are_not_reported(study, tmp_path):
    """The search's values are reported as they are: one point a case, one state in the figures and on the page."""
    loaded = study("population = 6\ngenerations = 3\nrefine = false")
    found = answer(loaded, tmp_path, "genetic")
    folder = tmp_path / "results" / loaded.name
    assert found.best.statistics.fit is None and not found.best.worsened
    assert pd.read_csv(folder / "points.csv")["point"].tolist() == ["search"]
    table = pd.read_csv(folder / "parameters.csv")
    assert table["value"].item() == pytest.approx(found.best.search.values["a"], rel=1e-9)
    assert table["search_value"].isna().all()
    shown = {section.name: section for section in sections(StudyResults(folder, "Two valleys", True))}
    blocks = section_blocks(shown["calibrated"])
    assert [block.name for block in blocks if isinstance(block, Picture)][:1] == ["parameters"]
    assert "searches" not in [block.name for block in blocks if isinstance(block, Picture)]
    assert not [block for block in blocks if isinstance(block, Table) and "both criteria" in block.caption]
    told = [block.text for block in blocks if isinstance(block, Words)]
    assert told and not [words for words in told if "least squares" in words]


def test_least_squares_start_from_the_nominal_values_too(study, tmp_path):
    """A search of two generations ends near the first valley; the nominal values are near the second."""
    study("population = 4\ngenerations = 2")
    with (tmp_path / "study.toml").open("a") as stream:
        stream.write("[parameters]\na = { value = 1.7, search = [-3.0, 3.0] }\n")
    found = answer(LoadedStudy.load(tmp_path), tmp_path, "genetic")
    assert found.best.result.values["a"] == pytest.approx(VALLEYS[1], abs=0.01)


@pytest.mark.medium
def test_the_reported_case_has_the_lowest_sum_of_squares(study, tmp_path):
    loaded = study("population = 4\ngenerations = 2")
    text = (tmp_path / "study.toml").read_text().replace('{ name = "A", seed = 1 }', ", ".join(
        f'{{ name = "{name}", seed = {k} }}' for k, name in enumerate("ABC")))  # fmt: skip
    (tmp_path / "study.toml").write_text(text)
    found = answer(LoadedStudy.load(loaded.file), tmp_path, "genetic")
    assert len(found.cases) == 3
    assert found.best.statistics.criterion <= min(c.statistics.criterion for c in found.cases) + 0.1


# -- fits of an explanation --------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_calibration_begins_where_an_explanation_ended_and_never_ends_above(guyed, tmp_path):
    study, _, told, _ = guyed
    results = Results.at(tmp_path / "results", study.name)
    results.write_table("explained_fits", explained_fits(study, told.explanation))
    write_record(study, results, "explain", {})
    base, chosen = told.explanation.base.fit, told.explanation.chosen.fit
    start = explained_fit(study, results)
    assert start == pytest.approx({name: base.values[name] for name in study.search_space.free_names})
    for one, state in (
        (study, base),
        (LoadedStudy.load(write_extension(study, ["guy"], tmp_path / "mast_guy").file), chosen),
    ):
        own = Results.at(tmp_path / "results", one.name)
        assert explained_fit(one, own) == pytest.approx({n: state.values[n] for n in one.search_space.free_names})
        with Ledger.open(own.path / "ledger.sqlite") as ledger:
            assert CaseFinder(one, ledger, {one.test: own}, 1, True).known == (
                one.search_space.complete(explained_fit(one, own)),
            )
            found = calibrate(one, own, ledger, 1, quick=True)
        assert found.best.statistics.criterion <= state.misfit * (1 + 1e-9)


@pytest.mark.medium
def test_a_fit_by_an_explanation_of_another_state_is_not_a_start(guyed, tmp_path):
    """Neither for its own study nor for the one that was extended from it."""
    study, _, told, _ = guyed
    shutil.copytree(study.file.resolve().parent, tmp_path / "mast")
    own = LoadedStudy.load(tmp_path / "mast")
    results = Results.at(tmp_path / "results", "mast")
    results.write_table("explained_fits", explained_fits(own, told.explanation))
    write_record(own, results, "explain", {})
    wider = LoadedStudy.load(write_extension(own, ["guy"], tmp_path / "mast_guy").file)
    beside = Results.at(tmp_path / "results", "mast_guy")
    assert explained_fit(own, results) and explained_fit(wider, beside)
    modes = pd.read_csv(tmp_path / "mast" / "modes.csv", comment="#")
    modes.assign(freq=1.01 * modes["freq"]).to_csv(tmp_path / "mast" / "modes.csv", index=False)
    assert explained_fit(LoadedStudy.load(own.file), results) == {} == explained_fit(wider, beside)


@pytest.mark.medium
def test_a_fit_of_another_model_is_not_a_start(guyed, tmp_path):
    study = guyed[0]
    results = Results.at(tmp_path / "results", study.name)
    assert explained_fit(study, results) == {}
    write_record(study, results, "explain", {})
    (results.path / "explained_fits.csv").write_text("effects,parameter,value\nlamp,E,200\n")
    assert explained_fit(study, results) == {}
    write_record(study, results, "explain", {})
    (results.path / "explained_fits.csv").write_text("effects,parameter,value\n,E,many\n")
    with pytest.raises(InputError, match="explain the study again"):
        explained_fit(study, results)


# -- solutions that the data cannot discriminate -----------------------------------------------------------------------

SQUARE = """
from calib.structure.function_model import FunctionModel
from calib.problem.space import Parameter, ParameterSpace

def wave():
    space = ParameterSpace((Parameter("a", 0.5, -3.0, 3.0, "-"),))
    return FunctionModel("square", space, lambda v: {"y": v["a"] ** 2, "y2": 2 * v["a"] ** 2, "z": 1 + 0.01 * v["a"]})
"""


@pytest.mark.slow
@pytest.mark.parametrize("discriminated", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_case_leaves_its_own_solution_only_where_the_data_prefer_another(study, tmp_path, discriminated):
    """Both roots of ``y = 1`` fit; the priors favour the positive one, on the side of the nominal value."""
    loaded = study("population = 6\ngenerations = 6")
    (tmp_path / "model.py").write_text(SQUARE)
    z_std = 0.001 if discriminated else 0.1
    (tmp_path / "measured.csv").write_text(f"response,value,std\ny,1.0,0.01\ny2,2.0,0.02\nz,1.01,{z_std}\n")
    text = (tmp_path / "study.toml").read_text()
    cases = ", ".join(f'{{ name = "{name}", seed = {k} }}' for k, name in enumerate("ABCDEF"))
    (tmp_path / "study.toml").write_text(text.replace('{ name = "A", seed = 1 }', cases))
    found = answer(LoadedStudy.load(loaded.file), tmp_path, "genetic")
    sides = {np.sign(case.search.values["a"]) for case in found.cases}
    assert sides == {-1.0, 1.0}
    for case in found.cases:
        root = 1.0 if discriminated else np.sign(case.search.values["a"])
        assert case.result.values["a"] == pytest.approx(root, abs=0.01)
        assert case.statistics.misfit == pytest.approx(0.0, abs=0.1)
    assert found.best.result.values["a"] == pytest.approx(1.0, abs=0.01)
    assert found.agreement.verdict == ("one solution" if discriminated else "several solutions")
    reason = "" if discriminated else "solutions"
    starts = answer(
        LoadedStudy.load(loaded.file), tmp_path, "gauss-newton"
    )  # each case has both roots among its own starts
    assert starts.agreement.verdict == found.agreement.verdict
    assert {case.result.values["a"] > 0 for case in starts.cases} == {True}
    assert starts.verdicts.loc[0, "identified"] == discriminated
    assert found.verdicts.loc[0, ["identified", "not_identified"]].tolist() == [discriminated, reason]
    assert (found.parameters["identified"] == discriminated).all()
