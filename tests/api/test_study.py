"""A study in a folder, run from Python, gives the results of the command."""

import re
import shutil
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import calib
from calib.command import cli
from calib.command.example import write_example

STUDIES = Path(__file__).resolve().parents[2] / "studies"


@pytest.fixture(scope="module")
def rig(no_drawing, tmp_path_factory):
    """The four-storey rig: run here, and by the command, each into its own folder; no figures are drawn.

    Of its four cases two are left, which still have to agree.
    """
    root = tmp_path_factory.mktemp("rig")
    own = shutil.copytree(STUDIES / "four_storey_rig", root / "four_storey_rig")
    text = (own / "study.toml").read_text("utf-8")
    (own / "study.toml").write_text(re.sub(r"(?m)^.*name = \"R[34]\".*\n", "", text), "utf-8")
    study = calib.Study.load(own, root / "here", workers=1, quick=True)
    there = ["--results", str(root / "there"), "--workers", "1"]
    with no_drawing():
        answers = study.compare(), study.sensitivity(), study.calibrate()
        for verb, *more in (("compare",), ("sensitivity", "--quick"), ("calibrate", "--quick")):
            assert cli.execute([verb, str(own), *there[: 4 if more else 2], *more]) == 0
    return study, answers, root


@pytest.mark.medium
def test_a_study_gives_the_results_of_the_command(rig):
    study, (_, sensitivity, calibrated), root = rig
    for name in ("selection.csv", "verdicts.csv", "parameters.csv"):
        mine, own = (pd.read_csv(root / place / "four_storey_rig/quick" / name) for place in ("here", "there"))
        pd.testing.assert_frame_equal(mine, own)
    assert list(sensitivity.table["parameter"]) == list(mine["parameter"].unique()) or len(sensitivity.table)
    assert calibrated.folder == study.folder.path
    told = pd.read_csv(calibrated.folder / "verdicts.csv").set_index("parameter")
    np.testing.assert_allclose(calibrated.table.set_index("parameter")["std"], told["std"], rtol=1e-8)


@pytest.mark.medium
def test_the_posterior_correlation_is_that_of_the_covariance(rig):
    calibrated = rig[1][2]
    table = pd.read_csv(calibrated.folder / "posterior_correlation.csv").set_index("parameter")
    known = calibrated.of.best.statistics.identification.posterior
    assert tuple(table.index) == tuple(table.columns) == known.names and len(known.names) > 1
    expected = known.covariance / np.outer(known.std, known.std)
    np.testing.assert_allclose(table.to_numpy(), expected, atol=1e-9)
    pairs = pd.read_csv(calibrated.folder / "confounded.csv")
    for row in pairs.to_dict("records"):
        assert table.loc[row["parameter_a"], row["parameter_b"]] == pytest.approx(row["correlation"])


@pytest.mark.medium
def test_what_is_shown_is_in_the_table(rig):
    compared, _, calibrated = rig[1]
    assert all(f"{value:.3f}" in str(compared) for value in compared.table["natural_freq_model"])
    answer = calibrated.of.answer
    assert [line[10:] for line in str(calibrated).split("\n\n")[0].split("\n")] == [
        *answer.labelled.values(),
        str(calibrated.folder),
    ]
    assert "<table" in calibrated._repr_html_() and "\n" not in repr(calibrated) + repr(rig[0])


def test_the_problem_of_a_study_is_fitted_as_the_study_is(rig):
    study, (_, _, calibrated), _ = rig
    fit = study.problem.calibrate(starts=1)
    best = calibrated.of.best.statistics
    assert fit.statistics.criterion == pytest.approx(best.criterion, rel=1e-3)
    assert set(fit.values) >= set(study.loaded.search_space.free_names)


def test_the_problem_of_scalar_responses_is_that_of_the_study(functions_in_this_process):
    study = calib.Study.load(STUDIES / "five_mass_chain")
    problem = study.problem
    assert dict(problem.tests.measured.targets) == dict(study.loaded.experiment.measured.targets)
    assert len(problem.fit_problem.rows) == len(study.loaded.targets)
    np.testing.assert_allclose(
        problem.fit_problem.residual({}), calib.Problem(problem.model, problem.tests).fit_problem.residual({})
    )


@pytest.mark.slow
def test_run_does_every_analysis_and_returns_a_study(tmp_path, monkeypatch):
    monkeypatch.setattr("calib.report.figures.Figures.save", lambda *given: [])
    write_example(tmp_path / "mast")
    study = calib.Study.load(tmp_path / "mast", tmp_path / "results", workers=1, quick=True)
    last = study.run()
    assert (study.folder.path / "report.html").is_file()
    assert (last.path == study.path) != (last.folder.path / "verdicts.csv").is_file() or last is study
    assert study.report() == tmp_path / "results/mast/report.html"


def test_what_is_no_study_is_refused(tmp_path):
    with pytest.raises(calib.InputError):
        calib.Study.load(tmp_path)
    with pytest.raises(calib.InputError):
        calib.Study(tmp_path).report()
