"""Which parameter differs between tests: against a fit that gives each test its own, and by simulation."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import kstest

import calib
from calib.missing.between_tests import differences
from calib.missing.linearised_fit import LinearisedFit

NAMES = ("a", "b", "only")
PRIOR = np.array([0.5, 2.0, 1.0])


def columns(sizes, seed=1):
    """Slopes of each test; the parameter ``only`` acts in the first."""
    rng = np.random.default_rng(seed)
    slope = rng.standard_normal((sum(sizes), 3)) * (8.0, 3.0, 5.0)
    slope[sizes[0] :, 2] = 0.0
    owner = np.repeat([f"t{k}" for k in range(len(sizes))], sizes)
    return slope, owner


def fitted(slope, data):
    """The exact fit of a linear model to whitened data, priors centred on 0."""
    wide, right = np.vstack([slope, np.diag(1 / PRIOR)]), np.concatenate([data, np.zeros(3)])
    theta = np.linalg.lstsq(wide, right, rcond=None)[0]
    space = calib.ParameterSpace(tuple(calib.Parameter(n, 0.0, -9.0, 9.0, "kg") for n in NAMES))
    return LinearisedFit(
        effects=(), fit_problem=SimpleNamespace(space=space), names=NAMES, values=dict(zip(NAMES, theta, strict=True)),
        residual=data - slope @ theta, slope=slope, prior_sd=PRIOR, shift=theta / PRIOR,
    )  # fmt: skip


def rows_of(owner):
    rows = [SimpleNamespace(test=test, mode="", kind="response", sensor=f"r{k}") for k, test in enumerate(owner)]
    return SimpleNamespace(rows=rows, parts=dict.fromkeys(dict.fromkeys(owner)), std_dof={})


def asked(slope, owner, data):
    return differences(fitted(slope, data), rows_of(owner), seed=1)


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
    assert "b differs" in said and "t2" in said and "kg" in said
    assert found.sentence(0.0).startswith("No parameter differs")


def test_the_p_value_is_uniform_where_nothing_differs():
    slope, owner = columns((8, 6, 7))
    rng, p = np.random.default_rng(11), []
    for _ in range(150):
        data = slope @ (PRIOR * rng.standard_normal(3)) + rng.standard_normal(len(slope))
        p.append(asked(slope, owner, data).p)
    assert kstest(p, "uniform").pvalue > 0.01
