"""Which parameter differs between tests: against a fit that gives each test its own, and by simulation."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import kstest

import calib
from calib.missing.between_tests import differences
from calib.missing.linearised_fit import LinearisedFit
from calib.problem.joint import JointProblem
from calib.results.answer import Answer

NAMES = ("a", "b", "only")
PRIOR = np.array([0.5, 2.0, 1.0])


def columns(sizes, seed=1):
    """Slopes of each test; the parameter ``only`` acts in the first."""
    rng = np.random.default_rng(seed)
    slope = rng.standard_normal((sum(sizes), 3)) * (8.0, 3.0, 5.0)
    slope[sizes[0] :, 2] = 0.0
    owner = np.repeat([f"t{k}" for k in range(len(sizes))], sizes)
    return slope, owner


class Linear:
    """One test with a linear response."""

    def __init__(self, slope, data):
        parameters = (calib.Parameter(n, 0.0, -9.0, 9.0, "kg", prior_sd=s) for n, s in zip(NAMES, PRIOR, strict=True))
        self.space, self.slope, self.data = calib.ParameterSpace(tuple(parameters)), slope, data
        self.rows = [SimpleNamespace(mode="", kind="response", sensor=f"r{k}") for k in range(len(data))]

    def residual(self, values):
        return self.data - self.slope @ [values[name] for name in NAMES]

    def jacobian(self, values, names):
        return -self.slope[:, [NAMES.index(name) for name in names]]


def joint(slope, data, owner):
    return JointProblem({t: Linear(slope[owner == t], data[owner == t]) for t in dict.fromkeys(owner)})


def fitted(slope, data, owner):
    """The exact fit of a linear model to whitened data, priors centred on 0."""
    wide, right = np.vstack([slope, np.diag(1 / PRIOR)]), np.concatenate([data, np.zeros(3)])
    theta = np.linalg.lstsq(wide, right, rcond=None)[0]
    return LinearisedFit(
        effects=(), fit_problem=joint(slope, data, owner), names=NAMES, values=dict(zip(NAMES, theta, strict=True)),
        residual=data - slope @ theta, slope=slope, prior_sd=PRIOR, shift=theta / PRIOR,
    )  # fmt: skip


def rows_of(owner):
    rows = [SimpleNamespace(test=test, mode="", kind="response", sensor=f"r{k}") for k, test in enumerate(owner)]
    return SimpleNamespace(rows=rows, parts=dict.fromkeys(dict.fromkeys(owner)), std_dof={})


def asked(slope, owner, data):
    return differences(fitted(slope, data, owner), rows_of(owner), seed=1, alpha=0.01)


@pytest.mark.parametrize("sizes", [(8, 6), (8, 6, 7)])
def test_a_difference_is_that_of_a_fit_with_a_parameter_of_its_own_in_that_test(sizes):
    slope, owner = columns(sizes)
    data = slope @ [0.3, -1.0, 0.4] + np.random.default_rng(5).standard_normal(len(slope))
    for row in asked(slope, owner, data).table.itertuples():
        k = NAMES.index(row.parameter)
        own = np.where(owner == row.test, slope[:, k], 0.0)
        wide = np.vstack([np.column_stack([slope, own]), np.column_stack([np.diag(1 / PRIOR), np.zeros(3)])])
        right = np.concatenate([data, np.zeros(3)])
        found = np.linalg.lstsq(wide, right, rcond=None)[0][-1]
        std = np.sqrt(np.linalg.inv(wide.T @ wide)[-1, -1])
        assert row.change == pytest.approx(found, rel=1e-9)
        assert row.z == pytest.approx(found / std, rel=1e-9)
        assert (row.change_high - row.change_low) / 2 == pytest.approx(1.96 * std, rel=1e-9)


def test_only_shared_parameters_are_asked_and_of_two_tests_the_second():
    slope, owner = columns((8, 6))
    table = asked(slope, owner, slope @ np.ones(3)).table
    assert {(r.parameter, r.test) for r in table.itertuples()} == {("a", "t1"), ("b", "t1")}
    slope, owner = columns((8, 6, 7))
    assert len(asked(slope, owner, slope @ np.ones(3)).table) == 6
    alone = asked(*columns((9,)), np.ones(9))
    assert alone.table.empty and alone.p == 1.0 and alone.sentence(0.01) == ""


def test_what_differs_is_named_with_its_size():
    slope, owner = columns((8, 6, 7))
    data = slope @ [0.2, 1.0, 0.0] + np.where(owner == "t2", 1.5 * slope[:, 1], 0.0)
    found = asked(slope, owner, data + np.random.default_rng(3).standard_normal(len(slope)))
    first = found.table.iloc[0]
    assert (first["parameter"], first["test"]) == ("b", "t2") and found.p < 0.01
    assert first["change_low"] < 1.5 < first["change_high"]
    said = found.sentence(0.01)
    assert "b in t2" in said and "kg" in said and not found.table["differs"][1:].any() and found.p_left > 0.01
    assert found.sentence(0.0).startswith("No parameter differs")


@pytest.mark.medium
def test_the_p_value_is_uniform_where_nothing_differs():
    slope, owner = columns((8, 6, 7))
    rng, p = np.random.default_rng(11), []
    for _ in range(150):
        data = slope @ (PRIOR * rng.standard_normal(3)) + rng.standard_normal(len(slope))
        p.append(asked(slope, owner, data).p)
    assert kstest(p, "uniform").pvalue > 0.01


@pytest.mark.parametrize("seed", range(6))
def test_all_that_differ_are_named_with_the_sizes_of_a_joint_fit(seed):
    """Single scores would give each the effect of both."""
    slope, owner = columns((12, 11), seed)
    slope[:, 1] += 0.8 * slope[:, 0]  # much alike
    slope *= 3.0
    true = {"a": 0.6, "b": -0.9}
    extra = sum(np.where(owner == "t1", size * slope[:, NAMES.index(name)], 0.0) for name, size in true.items())
    data = slope @ [0.2, 1.0, 0.0] + extra + np.random.default_rng(seed + 50).standard_normal(len(slope))
    found = asked(slope, owner, data)
    named = found.table[found.table["differs"]].set_index("parameter")
    assert set(named.index) == {"a", "b"} and found.alternatives == ()
    for name, size in true.items():
        std = (named.loc[name, "change_high"] - named.loc[name, "change_low"]) / (2 * 1.96)
        assert abs(named.loc[name, "change"] - size) < 4 * std and std < 0.1


def test_parameters_that_act_alike_cannot_be_told_apart():
    slope, owner = columns((8, 6, 7))
    slope[owner != "t0", 1] = 1.001 * slope[owner != "t0", 0]
    data = slope @ [0.2, 0.5, 0.0] + np.where(owner == "t2", 1.5 * slope[:, 0], 0.0)
    found = asked(slope, owner, data + np.random.default_rng(3).standard_normal(len(slope)))
    assert found.p < 0.01 and found.alternatives
    said = found.sentence(0.01)
    assert "cannot be told apart" in said and "a in t2" in said + found.alternatives[0] and "b" in said


def test_what_differs_is_the_answer_where_nothing_else_is_named():
    slope, owner = columns((8, 6, 7))
    data = slope @ [0.2, 1.0, 0.0] + np.where(owner == "t2", 1.5 * slope[:, 1], 0.0)
    found, answer = asked(slope, owner, data), Answer("The model lacks something.", "p = 0.001.", "Look there.")
    told = found.told(answer, 0.01, named=False)
    assert told.found == found.sentence(0.01) and "b in t2" in told.then
    assert found.told(answer, 0.01, named=True).found == answer.found
    assert "b in t2" in found.told(answer, 0.01, named=True).sure
    nothing = asked(slope, owner, slope @ [0.2, 1.0, 0.0])
    assert nothing.told(answer, 0.01, named=False) == answer
