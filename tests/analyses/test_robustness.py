"""Responses over the posterior: against closed forms, with held and limited parameters, by command and from Python."""

import json
import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest
from scipy import stats

import calib
from calib.analyses.robustness import share_interval
from calib.command import cli
from calib.command.example import write_example
from calib.command.options import limits_of
from calib.errors.errors import InputError


def linear(held=False, **changes):
    """``y = 2 a + b``, ``z = 5 + a - b``, of which y and z are measured."""
    a = calib.Parameter("a", 1.0, -9.0, 9.0, **({"prior_sd": 50.0} | changes))
    b = calib.Parameter("b", 1.0, -9.0, 9.0, prior_sd=0.3 if held else 50.0)
    model = calib.FunctionModel(
        "linear", calib.ParameterSpace((a, b)),
        lambda v: {"y": 2 * v["a"] + v["b"], "z": 5 + v["a"] - v["b"], "w": 10 * v["b"]},
    )  # fmt: skip
    test = calib.ResponseTest({"y": (3.0, 0.1), "z": (5.0, 0.2)})
    problem = calib.Problem(model, test)
    return problem.keep(["a"]) if held else problem


def fitted(problem):
    return problem.calibrate(starts=1, progress=False)


@pytest.mark.medium
def test_a_linear_model_has_the_spread_of_its_covariance():
    fit = fitted(linear())
    found = fit.robustness(samples=4000, limits={"y": (2.9, math.inf), "w": (9.0, 11.0)}, progress=False)
    table = found.table.set_index("response")
    # two data, two parameters: the responses spread as their measurements
    assert table.loc["y", "std"] == pytest.approx(0.1, rel=0.05) and table.loc["z", "std"] == pytest.approx(
        0.2, rel=0.05
    )
    b = math.hypot(0.1 / 3, 2 * 0.2 / 3)
    assert table.loc["w", "std"] == pytest.approx(10 * b, rel=0.05)
    assert table.loc["y", "outside"] == pytest.approx(stats.norm.cdf(-1), abs=0.02)
    assert table.loc["w", "outside"] == pytest.approx(2 * stats.norm.cdf(-0.1 / b), abs=0.02)
    assert table.loc["y", "outside_low"] < table.loc["y", "outside"] < table.loc["y", "outside_high"]
    assert math.isnan(table.loc["z", "outside"]) and table.loc["y", "measured"] == 3.0
    assert list(table.index) == ["y", "w", "z"] or list(table.index) == ["w", "y", "z"]  # those with limits first
    quantiles = table.loc["y", ["q025", "q975"]].to_numpy(dtype=float)
    np.testing.assert_allclose(quantiles, [3 - 0.196, 3 + 0.196], atol=0.015)
    assert found.of.samples.shape == (4000, 5)
    again = fit.robustness(samples=4000, progress=False).of.samples
    pd.testing.assert_frame_equal(again, found.of.samples)


@pytest.mark.medium
def test_fitted_parameters_follow_those_that_are_held_though_uncertain():
    found = fitted(linear(held=True)).robustness(samples=4000, progress=False)
    drawn = found.of.samples
    assert drawn["b"].std() == pytest.approx(0.3, rel=0.05)
    g, h = np.array([2 / 0.1, 1 / 0.2]), np.array([1 / 0.1, -1 / 0.2])
    slope = -(g @ h) / (g @ g)
    assert np.polyfit(drawn["b"], drawn["a"], 1)[0] == pytest.approx(slope, abs=0.02)
    assert any("drawn from their priors: b" in one for one in found.sentences)


@pytest.mark.medium
def test_samples_scatter_as_the_fit_says_where_the_mesh_is_uncertain():
    problem = linear()
    fine = calib.FunctionModel(
        "fine", problem.space, lambda v: {"y": 2 * v["a"] + v["b"] + 1.0, "z": 5 + v["a"] - v["b"], "w": 10 * v["b"]}
    )
    fit = replace(problem, finer={"linear": fine}).calibrate(starts=1, mesh_sd=1.0, progress=False)
    drawn = fit.robustness(samples=4000, progress=False).of.samples
    told = fit.parameters["std"]
    for name in "ab":
        assert drawn[name].std() == pytest.approx(told[name], rel=0.05)
    assert drawn["a"].std() == pytest.approx(math.hypot(1 / 3, 0.1 / 3, 0.2 / 3), rel=0.05)


def test_samples_stay_within_limits_and_constraints():
    a, b = (calib.Parameter(name, 1.0, 0.0, 3.0) for name in "ab")
    total = calib.LinearConstraint("total", (("a", 1.0), ("b", 1.0)), 2.0, 2.0)
    model = calib.FunctionModel(
        "sum", calib.ParameterSpace((a, b), (total,)), lambda v: {"y": v["a"], "z": v["a"] + v["b"]}
    )
    test = calib.ResponseTest({"y": (0.05, 0.2), "z": (2.0, 0.5)})
    drawn = fitted(calib.Problem(model, test)).robustness(samples=300, progress=False).of.samples
    assert (drawn["a"] >= 0).all() and drawn["a"].std() > 0.05
    np.testing.assert_allclose(drawn["a"] + drawn["b"], 2.0, atol=1e-9)


@pytest.mark.medium
def test_a_parameter_over_decades_spreads_by_a_factor():
    k = calib.Parameter("k", 1e5, 1e3, 1e7, scale="log")
    model = calib.FunctionModel("log", calib.ParameterSpace((k,)), lambda v: {"y": math.log(v["k"]), "z": v["k"]})
    test = calib.ResponseTest({"y": (math.log(2e4), 0.5)})
    table = fitted(calib.Problem(model, test)).robustness(samples=2000, progress=False).table.set_index("response")
    sd = 1 / math.hypot(1 / 0.5, math.sqrt(12) / math.log(1e4))
    assert table.loc["y", "std"] == pytest.approx(sd, rel=0.06)
    low, middle, high = (table.loc["z", name] for name in ("q025", "median", "q975"))
    assert middle / low == pytest.approx(high / middle, rel=0.15)


def test_samples_of_the_posterior_are_taken_where_they_are_given():
    posterior = pd.DataFrame({"a": np.linspace(0.9, 1.1, 50), "b": 1.0})
    found = fitted(linear()).robustness(samples=50, posterior=posterior, progress=False)
    assert sorted(found.of.samples["a"].round(9)) == sorted(posterior["a"].round(9))
    assert "the samples of the posterior" in found.sentences[-1]


def near_only(elsewhere):
    """A fit of a model that has the response z only next to the fitted value, and does ``elsewhere`` beyond."""
    a = calib.Parameter("a", 1.0, -9.0, 9.0)

    def respond(v):
        return {"y": v["a"]} | ({"z": 1.0} if abs(v["a"] - 1.0) < 0.05 else elsewhere())

    model = calib.FunctionModel("near", calib.ParameterSpace((a,)), respond)
    return fitted(calib.Problem(model, calib.ResponseTest({"y": (1.0, 5.0)})))


def test_a_limited_response_that_no_sample_has_is_told_so():
    found = near_only(dict).robustness(samples=20, limits={"z": (0.0, 2.0)}, progress=False)
    (row,) = found.table[found.table["response"] == "z"].to_dict("records")
    assert row["samples"] == 0 and math.isnan(row["outside"]) and row["sentence"]
    assert any(words.startswith("z: ") for words in found.sentences)


def test_a_model_that_fails_at_all_samples_has_no_robustness():
    with pytest.raises(InputError, match="fails at all 20 samples"):
        near_only(lambda: 1 / 0).robustness(samples=20, progress=False)


@pytest.mark.parametrize(("count", "total"), [(0, 30), (3, 50), (50, 50)])
def test_the_interval_of_a_share(count, total):
    low, high = share_interval(count, total)
    exact = stats.binomtest(count, total).proportion_ci(0.95, "exact")
    assert (low, high) == pytest.approx((exact.low, exact.high))


def test_limits_are_read_and_refused():
    assert limits_of(["natural_freq_1=1.5:2", "a=b=:3"]) == {"natural_freq_1": (1.5, 2.0), "a=b": (-math.inf, 3.0)}
    for wrong in ("y", "y=3", "=1:2", "y=a:b"):
        with pytest.raises(InputError, match="names no limits"):
            limits_of([wrong])
    fit = fitted(linear())
    with pytest.raises(InputError, match="'q', which is no response"):
        fit.robustness(limits={"q": (0.0, 1.0)}, progress=False)
    with pytest.raises(InputError, match="robustness"):
        fit.robustness(limits={"y": (2.0, 1.0)}, progress=False)


@pytest.mark.slow
def test_the_command_writes_what_python_returns(tmp_path, capsys, no_drawing):
    write_example(tmp_path / "mast")
    with no_drawing():
        assert cli.execute(["calibrate", str(tmp_path / "mast"), "--results", str(tmp_path / "out")]) == 0
        capsys.readouterr()
        limit = ["--samples", "40", "--limit", "natural_freq_B1x=1.71:"]
        assert cli.execute(["robustness", str(tmp_path / "mast"), "--results", str(tmp_path / "out"), *limit]) == 0
    stored = pd.read_csv(tmp_path / "out/mast/robustness.csv").fillna({"sentence": ""}).set_index("response")
    said = capsys.readouterr().out
    assert f"{100 * stored.loc['natural_freq_B1x', 'outside']:.3g} %" in said
    assert stored.loc["natural_freq_B1x", "unit"] == "Hz" and stored.index[0] == "natural_freq_B1x"
    assert len(pd.read_csv(tmp_path / "out/mast/robustness_samples.csv")) == 40
    record = json.loads((tmp_path / "out/mast/record.json").read_text())
    assert record["analyses"]["robustness"]["seeds"] == {"samples": 1}
    study = calib.Study.load(tmp_path / "mast", results=tmp_path / "out", progress=False)
    with no_drawing():
        found = study.robustness(samples=40, limits={"natural_freq_B1x": (1.71, math.inf)})
    pd.testing.assert_frame_equal(found.table.set_index("response"), stored, check_dtype=False, rtol=1e-6)
    with no_drawing():
        study.intervals(["m_top"])
        assert (tmp_path / "out/mast/robustness.csv").exists()  # it rests on no samples of intervals
        study.intervals(["m_top"], samples=40)
        assert not (tmp_path / "out/mast/robustness.csv").exists()
        study.robustness(samples=40)
        assert cli.execute(["calibrate", str(tmp_path / "mast"), "--results", str(tmp_path / "out")]) == 0
    assert not (tmp_path / "out/mast/robustness.csv").exists()
