"""Mean and spread of a parameter between tests, against the exact posterior of means of several groups."""

import inspect

import numpy as np
import pandas as pd
import pytest

import calib
from calib.command import cli
from calib.inference.between import MEAN, SPREAD, between_tests
from calib.problem.joint import JointProblem
from calib.problem.space import Parameter, ParameterSpace

STD, REPEATS, WIDTH = 2.0, 5, 30.0


class Readings:
    """Repeated readings of one quantity, whose value is the parameter."""

    def __init__(self, values, square=False):
        prior = {"prior": "uniform"}
        self.space = ParameterSpace((Parameter("m", 100.0, 100 - 3**0.5 * WIDTH, 100 + 3**0.5 * WIDTH, "mm", **prior),))
        self.values, self.square = np.asarray(values), square

    @property
    def shared_errors(self):
        return np.zeros((len(self.values), 0))

    def residual(self, values):
        m = values["m"]
        return (self.values - (m**2 / 100 if self.square else m)) / STD

    def jacobian(self, values, names):
        slope = values["m"] / 50 if self.square else 1.0
        return np.full((len(self.values), len(names)), -slope / STD)


def groups(spread, count, seed=1):
    rng = np.random.default_rng(seed)
    true = 100 + spread * rng.standard_normal(count)
    return true, {f"t{k}": one + STD * rng.standard_normal(REPEATS) for k, one in enumerate(true)}


def exact(means):
    """Quantiles of the spread, a uniform prior for it and for the mean, which is integrated out."""
    tau = np.linspace(1e-3, WIDTH, 6001)
    variance = tau**2 + STD**2 / REPEATS
    level = -(len(means) - 1) / 2 * np.log(variance) - np.sum((means - means.mean()) ** 2) / (2 * variance)
    weight = np.exp(level - level.max())
    share = np.cumsum(weight) / weight.sum()
    mean_std = np.sqrt(np.sum(weight * variance) / weight.sum() / len(means))
    return np.interp([0.5, 0.025, 0.975], share, tau), mean_std


@pytest.mark.parametrize(("spread", "count"), [(6.0, 8), (0.0, 6), (1.5, 3)])
def test_spread_and_mean_have_the_exact_posterior_of_group_means(spread, count):
    _, readings = groups(spread, count)
    joint = JointProblem({name: Readings(values) for name, values in readings.items()})
    found = between_tests(joint, ["m"], {"m": 100.0}).table.set_index("what")
    means = np.array([values.mean() for values in readings.values()])
    quantiles, mean_std = exact(means)
    assert found.loc[SPREAD, ["value", "low", "high"]].tolist() == pytest.approx(quantiles, rel=0.05, abs=0.05)
    mean = found.loc[MEAN]
    assert mean["value"] == pytest.approx(means.mean(), abs=0.02)
    assert (mean["high"] - mean["low"]) / 2 == pytest.approx(1.96 * mean_std, rel=0.03)
    assert (found.loc[SPREAD, "p"] < 1e-3) == (spread > 5)


def test_own_values_are_between_the_own_mean_and_the_common_one():
    true, readings = groups(3.0, 10, seed=3)
    found = between_tests(JointProblem({n: Readings(v) for n, v in readings.items()}), ["m"], {"m": 100.0}).table
    own = found[~found["what"].isin([MEAN, SPREAD])].set_index("what")
    mean = float(found.loc[found["what"] == MEAN, "value"].iloc[0])
    inside = [row["low"] < value < row["high"] for (_, row), value in zip(own.iterrows(), true, strict=True)]
    assert sum(inside) >= 8
    for name, values in readings.items():
        low, high = sorted([mean, values.mean()])
        assert low - 0.05 <= own.loc[name, "value"] <= high + 0.05


def test_a_nonlinear_model_is_fitted_where_it_ends():
    rng = np.random.default_rng(5)
    true = 100 + 15 * rng.standard_normal(6)
    parts = {
        f"t{k}": Readings(m**2 / 100 + STD * rng.standard_normal(REPEATS), square=True) for k, m in enumerate(true)
    }
    found = between_tests(JointProblem(parts), ["m"], {"m": 100.0})
    own = found.table[~found.table["what"].isin([MEAN, SPREAD])]
    assert own["value"].to_numpy() == pytest.approx(true, abs=4 * STD / 2 / np.sqrt(REPEATS))
    assert found.misfit < 50 and found.shared_misfit > 100 * found.misfit


MODEL = """
def bar():
    space = calib.ParameterSpace((
        calib.Parameter("E", 68.0, 55.0, 85.0, "GPa", prior_sd=6.0),
        calib.Parameter("k", 35.0, 20.0, 60.0, "MN/m", prior_sd=10.0),
        calib.Parameter("length", 1.0, 0.5, 1.5, "m", distribution="fixed"),
    ))
    return calib.FunctionModel("bar", space, lambda v: bar_frequencies(8, v["length"], v["E"], v["k"]))
"""


def bar_frequencies(n, length, modulus, spring):
    """Three frequencies (Hz) of an aluminium bar of 4 cm2 on a spring (MN/m) at one end."""
    e, area, h = modulus * 1e9, 4e-4, length / n
    k, m = np.zeros((n + 1, n + 1)), np.zeros((n + 1, n + 1))
    for i in range(n):
        k[i : i + 2, i : i + 2] += e * area / h * np.array([[1, -1], [-1, 1]])
        m[i : i + 2, i : i + 2] += 2700 * area * h / 12 * np.array([[5, 1], [1, 5]])
    k[0, 0] += spring * 1e6
    lam = np.linalg.eigvals(np.linalg.solve(m, k))
    return {f"f{j}": float(f) for j, f in enumerate(np.sqrt(np.sort(lam.real)[:3]) / (2 * np.pi))}


def specimens(spread):
    """Bars of own lengths on a shared spring: the problem, (length, modulus) and data of each.

    The data are synthetic, from 64 elements where the model has 8.
    """
    rng = np.random.default_rng(11)
    bars = {
        f"bar_{k}": (length, 70.0 * (1 + spread * rng.standard_normal()))
        for k, length in enumerate([0.8, 0.9, 1.0, 1.1, 1.2, 1.3])
    }
    data = {
        name: {n: (f * (1 + 0.002 * rng.standard_normal()), 0.002 * f)
               for n, f in bar_frequencies(64, length, modulus, 40.0).items()}
        for name, (length, modulus) in bars.items()
    }  # fmt: skip
    tests = [calib.ResponseTest(own, name=name, condition={"length": bars[name][0]}) for name, own in data.items()]
    held = {"calib": calib, "bar_frequencies": bar_frequencies}
    exec(MODEL, held)
    return calib.Problem(held["bar"](), tests), bars, data


@pytest.mark.medium
def test_specimens_of_own_length_share_a_spring_and_have_a_modulus_each():
    problem, bars, _ = specimens(0.04)
    fit = problem.calibrate(varies=["E"], method="gauss-newton", starts=1, progress=False)
    table = fit.between_tests.set_index("what")
    true = {name: modulus for name, (_, modulus) in bars.items()}
    assert table.loc[SPREAD, "low"] < 70 * 0.04 < table.loc[SPREAD, "high"] and table.loc[SPREAD, "p"] < 1e-4
    assert sum(table.loc[name, "low"] < e < table.loc[name, "high"] for name, e in true.items()) >= 5
    assert abs(table.loc[list(bars), "value"] - pd.Series(true)).max() < 1.0
    assert fit.statistics.between.p_fit > 0.01 > 1e-6 > fit.statistics.p_fit
    assert fit.answer.then.startswith("Use the value that each test has of E, in between_tests.csv")
    assert "E varies between 6 tests" in fit.answer.sure and fit.answer.sure in " ".join(fit.lines.values())


@pytest.mark.parametrize(
    ("varies", "words"), [(["length"], "fitted are E, k"), (["density"], "fitted are E, k"), ("E", "varies")]
)
def test_what_cannot_vary_is_refused(varies, words):
    problem, *_ = specimens(0.04)
    with pytest.raises(calib.InputError, match=words):
        problem.calibrate(varies=varies, progress=False)


@pytest.mark.slow
def test_a_study_in_a_folder_writes_the_same(tmp_path, monkeypatch, undrawn):
    problem, bars, data = specimens(0.04)
    code = f"import numpy as np\n\nimport calib\n\n\n{inspect.getsource(bar_frequencies)}\n{MODEL}"
    (tmp_path / "model.py").write_text(code)
    keys = 'method = "gauss-newton"\nstarts = 1\nvaries = ["E"]'
    text = [f'title = "Bars"\nmodel = "model.py:bar"\n\n[calibration]\n{keys}\n']
    for name, own in data.items():
        rows = [f"{n},{value!r},{std!r}" for n, (value, std) in own.items()]
        (tmp_path / f"{name}.csv").write_text("\n".join(["response,value,std", *rows]))
        text.append(f'[[tests]]\nname = "{name}"\nresponses = "{name}.csv"\nset = {{ length = {bars[name][0]} }}\n')
    (tmp_path / "study.toml").write_text("\n".join(text))
    monkeypatch.chdir(tmp_path)
    assert cli.execute(["calibrate", ".", "--results", "results"]) == 0
    written = pd.read_csv(next((tmp_path / "results").rglob("between_tests.csv")))
    own = problem.calibrate(varies=["E"], method="gauss-newton", starts=1, progress=False).between_tests
    assert written[["parameter", "what"]].to_numpy().tolist() == own[["parameter", "what"]].to_numpy().tolist()
    assert written["value"].to_numpy() == pytest.approx(own["value"].to_numpy(), rel=1e-3)


def test_of_two_tests_no_spread_is_known():
    problem, *_ = specimens(0.04)
    with pytest.raises(calib.InputError, match="2 tests leave it free"):
        calib.Problem(problem.model, problem.tests[:2]).calibrate(varies=["E"], progress=False)
