"""Intervals of parameters after an explanation that names nothing, in tables and words."""

import runpy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

import calib
from calib.analyses import calibrate
from calib.analyses.explain import explain, write_explanation
from calib.api.entries.explained import _predictions
from calib.command import cli
from calib.results.results import Results
from calib.study.study import LoadedStudy

missing = runpy.run_path(str(Path(__file__).parents[1] / "docs/tables.py"))["missing"]
HELD = ("modes = []\nsensors = []", 'modes = ["B3x"]\nsensors = ["2x", "4z"]')
FILES = ("unexplained", "unexplained_predictions", "unexplained_errors")
TRUE = {"E": 206.0, "m_top": 46.0, "K_base": 1.8}


@pytest.mark.slow
def test_the_true_values_lie_inside_where_the_effect_is_not_in_the_library(mast, edited, tmp_path):
    folder = edited(mast.write_study(tmp_path / "mast", {"guy": 12000.0}), *HELD)
    text = (folder / "effects.py").read_text()
    (folder / "effects.py").write_text(
        text.replace('        _one("guy", "Guy rope along x", 4.5, (0,), "stiffness", "N/m", 5e3, 1e5),\n', "")
    )
    results = Results.at(tmp_path / "r", "mast")
    answer = explain(LoadedStudy.load(folder), results)
    assert answer.verdict == "none_explains"
    table = pd.read_csv(results.path / "unexplained.csv").set_index("parameter")
    assert set(table.index) == set(TRUE) and (table["low_unexplained"] < table["high_unexplained"]).all()
    inside = [table["low_unexplained"][n] <= v <= table["high_unexplained"][n] for n, v in TRUE.items()]
    alone = [table["low"][n] <= v <= table["high"][n] for n, v in TRUE.items()]
    assert all(inside) and not all(alone)
    predicted, errors = (pd.read_csv(results.path / f"{name}.csv") for name in FILES[1:])
    assert predicted["inside_unexplained"].mean() >= 0.93 > predicted["inside"].mean()
    assert missing(results.path) == {}  # every column is documented
    (printed,) = _predictions(answer)
    for line, row in zip(printed.rows, errors.to_dict("records"), strict=True):
        told = answer.errors.set_index(["stage", "group"]).loc[("before", row["group"])]
        assert [row["rms"], row["expected"]] == pytest.approx([told["rms"], told["expected"]])
        own = predicted[predicted["group"] == row["group"]]
        counts = (
            f"{own['inside'].sum()} and {own['inside_unexplained'].sum()} of {len(own)} (rms error {row['rms']:.2g}, "
        )
        assert any(counts in words for words in answer.sentences)
        inside = [f"{own[name].sum()} of {len(own)}" for name in ("inside", "inside_unexplained")]
        expected = [f"{row[name]:.2f}" for name in ("rms", "expected", "expected_unexplained")]
        assert list(line[1:6]) == [*inside, *expected]
    write_explanation(LoadedStudy.load(folder), results, replace(answer, tables={}))
    assert not any((results.path / f"{name}.csv").exists() for name in FILES)  # nothing of an earlier verdict is left
    (words,) = [s for s in answer.sentences if s.startswith("The unexplained misfit")]
    assert "times as wide as those of the fit alone" in words


def test_a_named_effect_leaves_no_second_interval(guyed):
    _, results, answer, _ = guyed
    assert answer.verdict == "effect" and not any((results.path / f"{name}.csv").exists() for name in FILES)
    assert not any(s.startswith(("The unexplained misfit", "Validation data inside")) for s in answer.sentences)


# -- after a calibration -----------------------------------------------------------------------------------------------


def calibrated(mast, tmp_path, hidden):
    """A mast of which a guy rope may be missing, calibrated in a folder."""
    return calib.Study.load(mast.write_study(tmp_path / "mast", hidden), results=tmp_path / "r", progress=False)


@pytest.mark.medium
def test_a_rejected_calibration_gives_intervals_that_know_of_the_misfit(mast, tmp_path):
    study = calibrated(mast, tmp_path, {"guy": 12000.0})
    fit = study.problem.calibrate(starts=1, progress=False)
    table = fit.calibration.with_misfit.set_index("parameter")
    assert fit.statistics.fits is False and set(table.index) == set(TRUE)
    inside = [table["low_unexplained"][n] <= v <= table["high_unexplained"][n] for n, v in TRUE.items()]
    alone = [table["low"][n] <= v <= table["high"][n] for n, v in TRUE.items()]
    assert all(inside) and not all(alone)
    assert any("times as wide as those of the fit alone" in words for words in fit.sentences)
    assert "with the misfit" in str(fit)
    (drawn,) = [c for c in fit.figure("parameters").collections if c.get_gid() == "with the misfit"]
    space = fit.problem.space
    for segment, (name, row) in zip(drawn.get_segments(), table.reindex(fit.parameters.index).iterrows(), strict=True):
        ends = [(row[f"{end}_unexplained"] - space[name].lower) for end in ("low", "high")]
        assert segment[:, 0] * (space[name].upper - space[name].lower) == pytest.approx(ends, rel=1e-6)


@pytest.mark.medium
def test_they_know_of_the_effects_that_the_model_may_lack_in_python_as_in_a_study(mast, tmp_path):
    study = calibrated(mast, tmp_path, {"guy": 12000.0})
    own = study.calibrate().of.with_misfit
    mine = study.problem.calibrate(effects=study.effects, progress=False).calibration.with_misfit
    pd.testing.assert_frame_equal(mine, own, rtol=1e-6)
    composed = study.problem.calibrate(effects="generic", progress=False).calibration.with_misfit
    alone = study.problem.calibrate(progress=False).calibration.with_misfit
    assert (alone["value"] - own["value"]).abs().max() < 1e-6 * own["value"].max()
    for other in (alone, composed):
        assert not np.allclose(other["value_unexplained"], own["value_unexplained"], rtol=1e-4)


@pytest.mark.medium
@pytest.mark.parametrize("door", ["command", "python"])
def test_an_effect_that_cannot_be_built_is_refused_before_a_fit_begins(mast, tmp_path, door, capsys, monkeypatch):
    monkeypatch.setattr(calibrate, "CaseFinder", lambda *_: pytest.fail("a fit began"))
    folder = mast.write_study(tmp_path / "mast", {"guy": 12000.0})
    text = (folder / "effects.py").read_text()
    broken = text.replace("        rows = [", '        raise RuntimeError("no such joint")\n        rows = [')
    assert broken != text
    (folder / "effects.py").write_text(broken)
    if door == "command":
        assert cli.execute(["calibrate", str(folder), "--results", str(tmp_path / "r")]) == 2
        told = capsys.readouterr().err
        assert not list((tmp_path / "r").rglob("*.csv"))
    else:
        study = calib.Study.load(folder, progress=False)
        with pytest.raises(calib.InputError) as refused:
            study.problem.calibrate(effects=study.effects, progress=False)
        told = str(refused.value)
    assert "no such joint" in told and "effects.py" in told
    assert "Traceback" not in told


@pytest.mark.medium
def test_a_calibration_that_fits_has_the_intervals_of_the_fit_alone(mast, tmp_path):
    fit = calibrated(mast, tmp_path, None).problem.calibrate(starts=1, progress=False)
    assert fit.statistics.fits and fit.calibration.with_misfit is None
    assert not any("do not hold" in words or "misfit makes" in words for words in fit.sentences)


def test_a_rejected_function_says_that_its_standard_deviations_do_not_hold():
    space = calib.ParameterSpace((calib.Parameter("k", 2.0, 1.0, 4.0),))
    model = calib.FunctionModel("line", space, lambda v: {f"y{n}": v["k"] for n in range(4)})
    test = calib.ResponseTest({f"y{n}": (2.0 + n, 0.1) for n in range(4)})
    fit = calib.Problem(model, test).calibrate(progress=False)
    assert fit.statistics.fits is False and fit.calibration.with_misfit is None
    assert any("standard deviations do not hold" in words for words in fit.sentences)


@pytest.mark.slow
def test_these_intervals_stand_on_the_screen_and_in_the_report(mast, tmp_path, capsys):
    study = calibrated(mast, tmp_path, {"guy": 12000.0})
    study.compare()
    answer = study.calibrate()
    folder = answer.folder
    table = pd.read_csv(folder / "unexplained_calibrated.csv").set_index("parameter")
    assert missing(folder) == {}
    assert any("times as wide" in words for words in answer.sentences)
    study.report()
    page = (folder / "report.html").read_text("utf-8")
    assert "Parameters with the misfit" in page and set(table.index) == set(TRUE)
