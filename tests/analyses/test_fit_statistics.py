"""Goodness of fit of a calibration: the test of an explanation, with priors and repeats in its degrees of freedom."""

import shutil

import numpy as np
import pytest
from scipy import stats

from calib.analyses.calibrate import calibrate
from calib.analyses.explain import explain
from calib.analyses.extend import write_extension
from calib.analyses.fit_statistics import ObjectiveTerms, fit_problem, statistics_at
from calib.results.ledger import Ledger
from calib.results.results import Results
from calib.study.study import LoadedStudy

MODEL = """
from calib.problem.effect import Effect
from calib.structure.function_model import FunctionModel
from calib.problem.space import Parameter, ParameterSpace

def line():
    space = ParameterSpace(tuple(
        Parameter(name, 0.0, -50.0, 50.0, "-", prior_sd=sd) for name, sd in (("a", None), ("b", None), ("idle", 1.0))
    ))
    return FunctionModel("line", space, lambda v: {f"y_{x}": v["a"] + v["b"] * x for x in range(8)})
"""
STUDY = """
title = "A line, synthetic"
model = "model.py:line"
selection = [{names}]
[measurement]
responses = "measured.csv"
synthetic = true
{more}
[calibration]
method = "gauss-newton"
starts = 2
cases = [{{ name = "A", seed = 1 }}]
"""


@pytest.fixture
def line(tmp_path):
    """Calibrates a line to values of standard deviation 0.1."""

    def calibrated(y, names=("a", "b"), more=""):
        folder = tmp_path / "line"
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        (folder / "model.py").write_text(MODEL)
        rows = "\n".join(f"y_{x},{v},0.1" for x, v in enumerate(y))
        (folder / "measured.csv").write_text(f"response,value,std\n{rows}\n")
        (folder / "study.toml").write_text(STUDY.format(names=", ".join(f'"{n}"' for n in names), more=more))
        study, results = LoadedStudy.load(folder), Results.at(tmp_path / "results", "line")
        with Ledger.open(results.path / "ledger.sqlite") as ledger:
            return calibrate(study, results, ledger, 1)

    return calibrated


def around(size, seed=1, n=8):
    return 1.0 + 0.5 * np.arange(n) + size * np.random.default_rng(seed).standard_normal(n)


def test_a_parameter_determined_by_its_prior_takes_no_degree_of_freedom(line):
    found = line(around(0.1), ("a", "b", "idle")).best.statistics
    assert found.dof == pytest.approx(6.0, abs=1e-3)
    assert found.fits is True


@pytest.mark.medium
def test_repeats_make_the_standard_deviations_uncertain(line):
    y = around(0.25)
    known, repeated = line(y).best.statistics, line(y, more="repeats = 2").best.statistics
    assert known.misfit == pytest.approx(repeated.misfit)
    # Twice that of the sum of squares: the test takes the worst of all kinds, and of shapes (Bonferroni).
    assert known.p_fit == pytest.approx(2 * stats.chi2.sf(known.misfit, known.dof), rel=1e-6)
    assert repeated.p_fit == pytest.approx(2 * stats.f.sf(known.misfit / 6, 6, 8), rel=1e-3)
    assert known.fits is False and repeated.fits is True


def test_a_perfect_fit_of_two_values_by_two_unknowns_is_undecided(line):
    assert line([1.0, 1.5]).best.statistics.fits is None


def test_two_values_that_two_unknowns_cannot_reach_do_not_fit(line):
    """The limits keep the line away from both."""
    found = line([1.0, 90.0]).best.statistics
    assert found.dof < 1 and found.misfit > 100
    assert found.fits is False


@pytest.mark.slow
def test_calibration_and_explanation_agree_after_an_extension(guyed, tmp_path):
    """The explanation of the extended study finds nothing more."""
    study = guyed[0]
    file = write_extension(study, ["guy"], tmp_path / "mast_guy").file
    extended = LoadedStudy.load(file)
    results = Results.at(tmp_path / "results", extended.name)
    found = explain(extended, results).explanation
    with Ledger.open(results.path / "ledger.sqlite") as ledger:
        statistics = calibrate(extended, results, ledger, 1).best.statistics
    assert found.verdict == "nothing_detectable"
    assert statistics.fits is True
    assert statistics.p_fit == pytest.approx(found.base_adequacy.p_fit, abs=1e-3)
    assert statistics.dof == pytest.approx(found.base_adequacy.kinds["dof"].sum(), abs=1e-3)


# -- identifiability ---------------------------------------------------------------------------------------------------


@pytest.mark.medium
def test_a_parameter_without_influence_is_not_identified_by_its_prior(line):
    found = line(around(0.1), ("a", "b", "idle"))
    table = found.verdicts.set_index("parameter")
    assert table["std"]["idle"] == pytest.approx(1.0) and table["needed"]["idle"] == 1.0
    assert table["identified"].to_dict() == {"a": True, "b": True, "idle": False}
    assert table["not_identified"]["idle"] == "prior" and table["data_share"]["idle"] == pytest.approx(0.0, abs=1e-9)
    assert found.parameters.set_index("parameter")["identified"].to_dict() == table["identified"].to_dict()
    assert found.sentences[0] == "2 of 3 parameters are identified; not idle."


def test_a_parameter_at_its_limit_is_not_identified(line):
    table = line(48.0 + 51.0 * np.arange(8)).verdicts.set_index("parameter")
    assert table["std"]["b"] < 0.02 * table["needed"]["b"] and table["on_limit"]["b"]
    assert not table["identified"]["b"] and table["not_identified"]["b"] == "misfit, limit"


@pytest.mark.medium
def test_a_rejected_model_has_no_identified_parameter(line):
    """Alternating errors of 8, against a stated standard deviation of 0.1; the Birge ratio scales what is told."""
    good, bad = line(around(0.1)), line(around(0.1) + 8.0 * (-1.0) ** np.arange(8))
    assert bad.best.statistics.fits is False
    scale = bad.best.statistics.birge
    assert scale == pytest.approx(np.sqrt(bad.best.statistics.misfit / 6), rel=1e-3) and scale > 50
    before, after = (found.verdicts.set_index("parameter") for found in (good, bad))
    np.testing.assert_allclose(after["std"], scale * before["std"], rtol=0.03)  # the priors help a little
    assert before["identified"].all() and not after["identified"].any()
    assert after["not_identified"].tolist() == ["misfit", "misfit"]
    assert (bad.parameters["identified"] == False).all()  # noqa: E712
    sentence = next(words for words in bad.sentences if "parameters are identified" in words)
    assert sentence.startswith("0 of 2") and sentence in bad.answer.sure and "do not hold" in sentence


@pytest.mark.medium
def test_with_fewer_than_two_degrees_of_freedom_a_model_error_cannot_be_seen(line):
    """Three values of a line: one degree of freedom is left, and the fit is good."""
    three, four = line(around(0.1, n=3)), line(around(0.1, n=4))
    assert three.best.statistics.dof == pytest.approx(1.0, abs=1e-3) and three.best.statistics.fits is None
    assert four.best.statistics.dof == pytest.approx(2.0, abs=1e-3) and four.best.statistics.fits is True
    assert four.verdicts["identified"].all()
    assert three.verdicts["not_identified"].tolist() == ["few_data", "few_data"]
    assert "error of the model" in three.sentences[0] and "Measure more" in three.answer.then


def test_a_model_that_held_out_data_contradict_has_no_identified_parameter(line):
    """Held out is what lies far off the line; the rest fits."""
    y = around(0.1)
    y[7] += 9.0
    found = line(y, more='[held_out]\nresponses = ["y_7"]')
    assert found.best.statistics.fits is True and found.contradictions
    assert found.verdicts["not_identified"].tolist() == ["held_out", "held_out"]
    assert not found.parameters["identified"].any()
    assert "validation data contradict" in found.sentences[0]


@pytest.mark.medium
def test_without_a_fit_no_datum_is_suspected(line, tmp_path):
    """One datum is wrong: a fit suspects it, the same parameter values without a fit do not."""
    y = around(0.1)
    y[5] += 2.0
    found = line(y)
    assert found.best.statistics.suspects["what"][0] == "y_5"
    study = LoadedStudy.load(tmp_path / "line")
    with Ledger.open(tmp_path / "other.sqlite") as ledger:
        beside = statistics_at(fit_problem(study, ledger), ObjectiveTerms.of(study), found.best.statistics.values)
    assert beside.p_fit == pytest.approx(found.best.statistics.p_fit) and beside.fits is False
    assert beside.suspects.empty
