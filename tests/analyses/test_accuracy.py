"""Claimed and assumed standard deviations: the same in every analysis, and reported wherever they are used."""

import json
import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from calib.analyses.calibrate import calibrate
from calib.analyses.compare import compare, nominal_comparison
from calib.analyses.explain import explain
from calib.analyses.provenance.record import measured_table
from calib.analyses.uncertainty import assumed_std, assumed_words
from calib.correlation.modal.residual import ModalResidual
from calib.correlation.standard_deviations import std_for
from calib.errors.errors import InputError
from calib.measurement.accuracy import Accuracy, Claim, widened
from calib.report.html.study_results import StudyResults
from calib.report.html.summary import page_summary
from calib.report.numbers import percent
from calib.results.ledger import Ledger
from calib.results.results import Results
from calib.study.study import LoadedStudy


def bare_std(folder):
    """The same files without standard deviations."""
    for name, drop in (("modes.csv", "freq_std"), ("shapes.csv", "std")):
        pd.read_csv(folder / name, comment="#").drop(columns=drop).to_csv(folder / name, index=False)
    return folder


def claiming(edited, folder, claim):
    return edited(folder, 'std_of = "mean"', f'std_of = "mean"\naccuracy = {claim}')


def calibrated(study, tmp_path):
    results = Results.at(tmp_path / "results", study.name)
    with Ledger.open(results.path / "ledger.sqlite") as ledger:
        return calibrate(study, results, ledger, 1), results.path


def reported_noise(folder):
    """The frequency errors in the summary at the top of the page."""
    (words,) = [
        number for what, number in page_summary(StudyResults(folder, "Mast", True)).facts if "frequencies" in what
    ]
    return words


# -- claimed accuracy --------------------------------------------------------------------------------------------------


def test_a_claim_is_relative_or_absolute():
    assert Claim.of("1 %") == Claim(share=0.01) and Claim.of("0.5%") == Claim(share=0.005)
    assert Claim.of(0.02) == Claim(own=0.02)
    np.testing.assert_allclose(Claim.of(0.02).relative(np.array([2.0, 4.0])), [0.01, 0.005])
    for wrong in ("1", "one %", "-1 %", "0 %", "200 %", 0.0, -1.0, math.nan):
        with pytest.raises(ValueError, match="accuracy"):
            Claim.of(wrong)
    assert Accuracy.of("2 %") == Accuracy(*(Claim(0.02),) * 3)
    assert Accuracy.of({"damping": "10 %"}).damping.share == 0.1 and not Accuracy.of(None).given
    with pytest.raises(ValueError, match="stiffness"):
        Accuracy.of({"stiffness": "1 %"})


def test_a_claim_is_added_in_quadrature_and_replaces_unknown_standard_deviations(mast, edited, tmp_path):
    study = LoadedStudy.load(mast.write_study(tmp_path / "mast"))
    claim = '{ freq = "1 %", shape = 0.02 }'
    claimed = LoadedStudy.load(claiming(edited, mast.write_study(tmp_path / "claimed"), claim))
    before, after = std_for(study.measured), std_for(claimed.measured)
    np.testing.assert_allclose(after.freq, np.hypot(before.freq, 0.01))
    np.testing.assert_allclose(after.shape, np.hypot(before.shape, 0.02))
    np.testing.assert_allclose(after.damping, before.damping)
    alone = LoadedStudy.load(claiming(edited, bare_std(mast.write_study(tmp_path / "alone")), '{ freq = "1 %" }'))
    np.testing.assert_allclose(std_for(alone.measured).freq, np.hypot(0.01, 2e-4))
    assert [a.item for a in assumed_std(alone)] == ["standard deviation of shapes"]
    assert study.problem.fingerprint != claimed.problem.fingerprint


def test_scalar_responses_by_name_and_by_kind():
    targets = {"freq_1": (10.0, 0.3), "freq_2": (20.0, None), "force": (-2.0, None)}
    kinds = {"freq_1": "freq", "freq_2": "freq", "force": "response"}
    assert widened(targets, kinds, None) == targets
    every = widened(targets, kinds, "4 %")
    assert every["freq_1"] == (10.0, pytest.approx(0.5)) and every["force"] == (-2.0, pytest.approx(0.08))
    some = widened(targets, kinds, {"freq": "1 %", "freq_1": 0.4})
    assert some == {"freq_1": (10.0, pytest.approx(0.5)), "freq_2": (20.0, pytest.approx(0.2)), "force": (-2.0, None)}
    with pytest.raises(InputError, match="'mass'"):
        widened(targets, kinds, {"mass": "1 %"})


@pytest.mark.parametrize("claim", ["0.01", '"much"', '{ mass = "1 %" }', '{ freq = "-1 %" }'])
def test_an_invalid_claim_is_refused(mast, edited, tmp_path, claim):
    with pytest.raises(InputError, match="accuracy"):
        LoadedStudy.load(claiming(edited, mast.write_study(tmp_path / "mast"), claim))


# -- use ---------------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_compare_calibrate_and_explain_weight_by_the_same_standard_deviation(mast, edited, tmp_path):
    """A hidden guy rope shifts frequencies by a few per cent: with a claimed accuracy of 10 % nothing is detectable."""
    stated = LoadedStudy.load(mast.write_study(tmp_path / "stated", {"guy": 9000.0}))
    rough = LoadedStudy.load(claiming(edited, mast.write_study(tmp_path / "rough", {"guy": 9000.0}), '"10 %"'))
    first, last = (calibrated(s, tmp_path)[0].best.statistics for s in (stated, rough))
    assert first.fits is False and last.fits is True
    results = Results.at(tmp_path / "results", "rough")
    found = explain(rough, results)
    assert found.verdict == "nothing_detectable"
    assert found.explanation.base.fit.misfit == pytest.approx(last.misfit, rel=0.2)
    table = compare(rough, results).comparison.where_it_fails().set_index(["kind", "what"])["in_std"]
    error = pd.read_csv(results.path / "comparison_before.csv").set_index("mode")["freq_error"]
    for mode, size in np.log1p(error).abs().items():
        assert table["frequency", mode] == pytest.approx(size / np.hypot(0.1, 0.002), rel=1e-3)
    record = json.loads((results.path / "record.json").read_text())
    assert "10 %" in record["accuracy"] and record["std_assumed"] == ""
    weighed = pd.read_csv(results.path / "measured.csv").eval("freq_std_used / natural_freq")
    noise = json.loads((results.path / "summary.json").read_text())["noise_freq_error"]
    assert noise == pytest.approx(weighed.mean() * math.sqrt(2 / math.pi), rel=1e-6) and noise > 0.07
    assert f"(a perfect model: {percent(noise)} %)" in reported_noise(results.path)


@pytest.mark.slow
def test_an_assumed_standard_deviation_is_reported_wherever_it_is_used(mast, tmp_path):
    study = LoadedStudy.load(bare_std(mast.write_study(tmp_path / "mast")))
    assert {(a.item, a.value) for a in assumed_std(study)} == {
        ("standard deviation of natural frequencies", "0.5"), ("standard deviation of shapes", "3")
    }  # fmt: skip
    answer, folder = calibrated(study, tmp_path)
    assert answer.best.statistics.assumed and answer.best.statistics.assumed in answer.best.statistics.sentence
    for name in ("parameters", "verdicts", "predictions", "data_errors"):
        assert set(pd.read_csv(folder / f"{name}.csv")["std_from"]) == {"assumed"}, name
    items = set(pd.read_csv(folder / "assumptions.csv")["item"])
    assert {a.item for a in assumed_std(study)} <= items
    assert json.loads((folder / "summary.json").read_text())["std_assumed"] == answer.best.statistics.assumed
    assert json.loads((folder / "summary.json").read_text())["noise_freq_error"] is None
    assert "a perfect model" not in reported_noise(folder)
    measured = pd.read_csv(folder / "measured.csv")
    assert measured["freq_std"].isna().all()
    np.testing.assert_allclose(measured["freq_std_used"], ModalResidual(study.problem).std.freq
                               * study.measured.natural_freq)  # fmt: skip


def test_the_measured_table_has_the_standard_deviations_that_fits_weight_by(mast, tmp_path):
    """Held-out modes with another standard deviation do not influence the weights of the others."""
    study = LoadedStudy.load(mast.write_study(tmp_path / "mast"))
    whole = study.whole
    freq_std = whole.freq_std * np.where(np.arange(whole.n_modes) == whole.n_modes - 1, 9.0, 1.0)
    whole = replace(whole, freq_std=freq_std, n_repeats=5)
    used = whole.without((whole.names[-1],), ())
    experiment = replace(study.experiment, modes=whole, held_out=(whole.names[-1],))
    own = replace(study, experiment=experiment, problem=replace(study.problem, measured=used, mode_clusters={}))
    table = measured_table(own).set_index("mode")
    np.testing.assert_allclose(table.loc[list(used.names), "freq_std_used"], std_for(used).freq * used.natural_freq)
    assert table.loc[whole.names[-1], "freq_std_used"] > 2 * std_for(used).freq[-1] * whole.natural_freq[-1]


@pytest.mark.slow
def test_an_explanation_reports_the_accuracy_at_which_its_verdict_changes(guyed, bare):
    _, results, answer, _ = guyed
    table = pd.read_csv(results.path / "accuracy.csv")
    assert table["missing"].tolist() == [True] * (len(table) - 1) + [False]
    assert answer.figures["accuracy_that_explains"] == table["accuracy"].iloc[-1] > 0.002
    assert np.all(np.diff(table["misfit"]) < 0)
    assert bare[2].tables["accuracy"].empty and bare[2].figures["accuracy_that_explains"] is None


def test_a_comparison_tells_the_deviation_that_a_calibration_assumes(mast, tmp_path):
    study = LoadedStudy.load(bare_std(mast.write_study(tmp_path / "mast")))
    told, assumed = nominal_comparison(study).answer.sure, assumed_words(study)
    assert assumed.startswith("natural frequencies 0.5 % of each, ") and assumed.count("is stated") == 1
    assert told.startswith("No standard deviation is stated") and assumed in told
