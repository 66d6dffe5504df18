"""Intervals of a study's parameters, from the command and from Python."""

import json

import numpy as np
import pandas as pd
import pytest

import calib
from calib.command import cli
from calib.command.example import write_example

SCALE = 40.0  # N/m of each spring


def oscillators(v):
    """Two springs in series are one stiffness; a third acts alone."""
    return {"f1": np.sqrt(v["a"] * v["b"] / (v["a"] + v["b"]) * SCALE), "f2": np.sqrt(v["c"] * SCALE)}


def problem(**measured):
    space = calib.ParameterSpace(tuple(calib.Parameter(name, 1.0, 0.2, 6.0, prior_sd=50.0) for name in ("a", "b", "c")))
    test = calib.ResponseTest(measured)
    return calib.Problem(calib.FunctionModel("springs", space, oscillators), test)


@pytest.mark.medium
def test_the_data_bound_a_spring_alone_and_of_two_in_series_one_side():
    fit = problem(f1=(5.0, 0.1), f2=(7.0, 0.1)).calibrate(starts=1, progress=False)
    found = fit.intervals(progress=False)
    table = found.table.set_index("parameter")
    np.testing.assert_allclose(
        table.loc["c", ["lower", "upper"]].astype(float),
        [(7 - 0.196) ** 2 / SCALE, (7 + 0.196) ** 2 / SCALE],
        rtol=5e-3,
    )
    assert table.loc["c", "kind"] == "two-sided"
    # k = f1^2/40 = 0.625 from a and b in series: each is above k, and above what a limit of the other leaves.
    lowest = (5 - 0.196) ** 2 / SCALE
    for name in "ab":
        assert table.loc[name, "kind"] == "one-sided" and np.isnan(table.loc[name, "upper"])
        assert table.loc[name, "lower"] == pytest.approx(1 / (1 / lowest - 1 / 6.0), rel=2e-2)
    assert "a and b on one side only" in str(found) and "prior_sd" in found.lines["Next"]
    axes = [ax for ax in found.figure().axes if ax.get_visible()]
    assert [ax.get_title(loc="left") for ax in axes] == ["a", "b", "c"]
    assert set(found.of.curves["parameter"]) == {"a", "b", "c"}


def test_integers_and_strangers_have_no_profile():
    space = calib.ParameterSpace((calib.Parameter("n", 2, 1, 5, integer=True), calib.Parameter("k", 1.0, 0.1, 9.0)))
    model = calib.FunctionModel("stack", space, lambda v: {"load": v["n"] * v["k"]})
    fit = calib.Problem(model, calib.ResponseTest({"load": (6.0, 0.1)})).calibrate(starts=1, progress=False)
    assert list(fit.intervals(progress=False).table["parameter"]) == ["k"]
    with pytest.raises(calib.InputError, match="n is an integer"):
        fit.intervals(["n"], progress=False)
    with pytest.raises(calib.InputError, match="m was not fitted"):
        fit.intervals(["m"], progress=False)


def test_a_model_that_does_not_fit_has_wider_intervals():
    widths = []
    for f2 in (7.0, 9.0):
        space = calib.ParameterSpace((calib.Parameter("c", 1.0, 0.2, 6.0, prior_sd=50.0),))
        model = calib.FunctionModel("spring", space, lambda v: {k: np.sqrt(v["c"] * SCALE) for k in ("f1", "f2", "f3")})
        test = calib.ResponseTest({"f1": (7.0, 0.1), "f2": (f2, 0.1), "f3": (7.0, 0.1)})
        found = calib.Problem(model, test).calibrate(starts=1, progress=False).intervals(progress=False)
        widths.append(float(found.table["upper"].iloc[0] - found.table["lower"].iloc[0]))
        assert any("does not fit" in one for one in found.sentences) == (f2 == 9.0)
    assert widths[1] > 3 * widths[0]


@pytest.fixture(scope="module")
def mast(tmp_path_factory, no_drawing):
    folder = tmp_path_factory.mktemp("intervals")
    write_example(folder / "mast")
    with no_drawing():
        assert cli.execute(["calibrate", str(folder / "mast"), "--results", str(folder / "results")]) == 0
        yield folder


def told(folder, capsys, *more):
    capsys.readouterr()
    code = cli.execute(["intervals", str(folder / "mast"), "--results", str(folder / "results"), *more])
    found = capsys.readouterr()
    return code, found.out + found.err


@pytest.mark.slow
def test_the_command_writes_what_it_prints_and_python_gets_the_same(mast, capsys):
    code, said = told(mast, capsys, "-v")
    assert code == 0
    stored = pd.read_csv(mast / "results/mast/intervals.csv").set_index("parameter")
    assert set(stored.index) == {"E", "m_top", "K_base"} and (stored["kind"] == "two-sided").all()
    for _, row in stored.iterrows():
        assert f"{row['lower']:.4g} to {row['upper']:.4g}" in said and row["sentence"] in " ".join(said.split())
    study = calib.Study.load(mast / "mast", results=mast / "results", progress=False)
    fit = study.problem.calibrate(progress=False)
    again = fit.intervals(["E"], progress=False).table.set_index("parameter")
    np.testing.assert_allclose(
        again.loc["E", ["lower", "upper"]].astype(float), stored.loc["E", ["lower", "upper"]].astype(float), rtol=1e-3
    )
    record = json.loads((mast / "results/mast/record.json").read_text())
    assert "intervals" in record["analyses"]


@pytest.mark.medium
def test_a_new_calibration_removes_them_and_without_one_they_are_refused(mast, capsys):
    assert told(mast, capsys, "--parameter", "E")[0] == 0
    assert (mast / "results/mast/profiles.csv").exists()
    code, said = told(mast, capsys, "--parameter", "stranger")
    assert code == 2 and "stranger was not fitted" in said and (mast / "results/mast/profiles.csv").exists()
    assert cli.execute(["calibrate", str(mast / "mast"), "--results", str(mast / "results")]) == 0
    assert not (mast / "results/mast/profiles.csv").exists() and not (mast / "results/mast/intervals.csv").exists()
    (mast / "results/mast/summary.json").unlink()
    code, said = told(mast, capsys)
    assert code == 2 and "not calibrated yet" in said and "calib calibrate" in said
