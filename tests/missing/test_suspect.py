"""Single bad data: against fits without them, error rates, and cases with two or none."""

import math
from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest

from calib.missing.goodness import goodness, overall
from calib.missing.linearised_fit import FINE, least_squares_fit, linearised
from calib.missing.suspect import data_of, suspect_in_short, suspect_sentence, suspects_table
from calib.problem.labels import RowLabels


def linear(toy, wrong, seed=1, modes=6, sensors=6):
    """A fitted, correctly specified model with some rows moved by so many standard deviations."""
    made = toy(modes=modes, sensors=sensors).drawn(np.random.default_rng(seed))
    data = made.data.copy()
    for k, size in wrong.items():
        data[k] += size * made.sd[k]
    return replace(made, data=data)


def table_of(made):
    return suspects_table(made.calibrated(), made)


def row_of(made, mode, kind, sensor=None):
    return next(
        k for k, row in enumerate(made.rows) if (row.mode, row.kind) == (mode, kind) and sensor in (None, row.sensor)
    )


def test_every_value_shape_mode_and_sensor_is_left_out(toy):
    made = toy(modes=3, sensors=4)
    data = data_of(made.rows)
    kinds = [d.kind for d in data]
    assert {k: kinds.count(k) for k in kinds} == {"value": 3 * (2 + 4), "shape": 3, "mode": 3, "sensor": 4}
    every = [tuple(d.rows) for d in data]
    assert len(set(every)) == len(every)
    for d in data:
        if d.kind == "mode":
            assert {made.rows[k].mode for k in d.rows} == {d.what.removeprefix("mode ")}


def test_one_bad_value_is_named_and_nothing_else(toy):
    bad = row_of(toy(modes=6, sensors=6), "M2", "frequency")
    made = linear(toy, {bad: 15.0})
    table = table_of(made)
    assert table["what"][0] == "frequency of M2" and table["explains"][0]
    explaining = table[table["explains"]]
    assert set(explaining["what"]) <= {"frequency of M2", "mode M2"}  # the mode contains the value
    assert "frequency of M2" in suspect_sentence(table) and "before the model" in suspect_sentence(table)
    beside = suspect_sentence(table, "E1")  # an effect that is named all the same explains it better
    assert "frequency of M2" in beside and "the odds are more than 20:1 against that measurement being wrong" in beside
    assert "the odds are 150:1 against that measurement" in suspect_sentence(table, "E1", math.log(150.0))
    capped = suspect_in_short(table, 100.0)
    assert capped.endswith(
        "the odds are over 10,000:1 against that measurement being wrong. Check the frequency of M2 to be sure."
    )


def test_the_closed_form_is_a_fit_without_the_datum(toy):
    """Rows are removed and the linear fit is repeated."""
    made = linear(toy, {row_of(toy(modes=6, sensors=6), "M2", "frequency"): 15.0})
    near = made.calibrated()
    fit = near.relinearised({}, near.residual)
    table = suspects_table(fit, made).set_index("what")
    for datum in data_of(made.rows):
        weight = np.ones(len(made.rows))
        weight[datum.rows] = 0.0
        less = replace(fit, residual=weight * fit.residual, slope=weight[:, None] * fit.slope)
        alone = less.relinearised({}, less.residual)
        assert table["chi2"][datum.what] == pytest.approx(fit.misfit - alone.misfit, rel=1e-9, abs=1e-9)
        if np.isfinite(table["p_fit_without"][datum.what]):
            kept = np.delete(np.arange(len(made.rows)), datum.rows)
            rest = replace(alone, residual=alone.residual[kept], slope=alone.slope[kept])
            expected = overall(*goodness(rest, RowLabels.of(made, kept)))
            assert table["p_fit_without"][datum.what] == pytest.approx(expected, rel=1e-6)


def test_a_bad_sensor_is_named(toy):
    plain = toy(modes=6, sensors=6)
    name = next(row.sensor for row in plain.rows if row.kind == "shape")
    rng = np.random.default_rng(3)
    wrong = {k: 6.0 * rng.choice([-1, 1]) for k, row in enumerate(plain.rows) if row.sensor == name}
    table = table_of(linear(toy, wrong))
    assert table[table["explains"]]["what"].tolist() == [f"sensor {name}"]


def test_two_bad_values_are_not_explained_by_one(toy):
    plain = toy(modes=6, sensors=6)
    wrong = {row_of(plain, "M1", "frequency"): 15.0, row_of(plain, "M4", "damping"): -15.0}
    table = table_of(linear(toy, wrong))
    assert len(table) and not table["explains"].any() and suspect_sentence(table) == suspect_in_short(table) == ""


@pytest.mark.medium
def test_nothing_is_suspect_where_everything_fits(toy):
    """Where a fit fails by chance, a datum is suspect at most at the level."""
    blamed = 0
    for seed in range(150):
        table = table_of(linear(toy, {}, seed, modes=4, sensors=4))
        blamed += len(table) > 0 and bool(table["explains"].any())
    assert blamed <= 6  # 99.9 % of a binomial of 150 at the level 1 %
    made = linear(toy, {}, 1)
    assert overall(*goodness(made.calibrated(), made)) > 0.01 and table_of(made).empty


def test_a_value_absorbed_by_a_parameter_is_not_suspect(toy):
    """The search ended eight standard deviations of the value away from the optimum."""
    made = linear(toy, {})
    fit = made.calibrated()
    k = row_of(made, "M0", "frequency")
    slope = np.where(np.arange(len(made.rows))[:, None] == k, 0.0, fit.slope)
    own = 100.0 * (np.arange(len(made.rows)) == k)
    own[row_of(made, "M1", "frequency")] = 10.0
    slope = np.column_stack([slope, own])
    residual = np.where(np.arange(len(made.rows)) == k, 8.0, fit.residual)
    optimum = _Fit(residual, slope, np.append(fit.prior_sd, np.inf))
    assert overall(*goodness(optimum, made)) < 0.01
    table = suspects_table(optimum, made)
    assert "frequency of M0" not in set(table["what"])


@dataclass(frozen=True)
class _Fit:
    residual: np.ndarray
    slope: np.ndarray
    prior_sd: np.ndarray
    converged: bool = True


def test_nothing_is_suspect_without_a_converged_fit(toy):
    bad = row_of(toy(modes=6, sensors=6), "M2", "frequency")
    made = linear(toy, {bad: 15.0})
    fit = made.calibrated()
    assert fit.converged and len(suspects_table(fit, made))
    once = least_squares_fit(fit.fit_problem, (), fit.fit_problem.space.values, 0, replace(FINE, evaluations=1))
    assert not once.converged and suspects_table(once, made).empty
    assert not linearised(fit.fit_problem, (), fit.values).converged


@pytest.mark.medium
def test_batches_of_data_left_out_do_not_change_the_result(toy, monkeypatch):
    """Of 900 values more than a hundred are improbable."""
    made = toy(modes=30, sensors=28, parameters=12).drawn(np.random.default_rng(1))
    made = replace(made, data=made.data + 4 * np.random.default_rng(2).standard_normal(len(made.rows)))
    fit = made.calibrated()
    factors = {(f"M{k}", "shape"): 1 for k in range(30)}
    table = suspects_table(fit, replace(made, fitted_factors=factors))
    assert len(made.rows) == 900 and (table["p"] < 0.01).sum() > 100
    monkeypatch.setattr("calib.missing.suspect._AT_ONCE", 7)
    pd.testing.assert_frame_equal(suspects_table(fit, replace(made, fitted_factors=factors)), table)


def test_data_that_alone_determine_a_parameter_are_not_tested():
    rows = [SimpleNamespace(mode="", kind="response", sensor=f"y{k}") for k in range(2)]
    optimum = _Fit(np.array([9.0, 9.0]), np.eye(2), np.full(2, np.inf))
    assert suspects_table(optimum, RowLabels(rows)).empty
