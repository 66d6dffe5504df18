import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import spearmanr

from calib.sensitivity.induced import decompose, input_correlation
from calib.sensitivity.spearman import noise_floor, spearman


def test_input_correlation_agrees_with_an_independent_implementation(bound):
    points, _ = bound
    found = input_correlation(points)
    np.testing.assert_allclose(found, spearmanr(points).statistic, atol=1e-12)
    assert found.index.tolist() == found.columns.tolist() == list(points.columns)
    assert found.loc["mass", "inert_mass"] == pytest.approx(-0.9, abs=0.05)
    free = found.drop(index="inert_mass", columns="inert_mass").to_numpy()
    assert np.abs(free[~np.eye(4, dtype=bool)]).max() < noise_floor(300, 10)
    assert input_correlation(points.assign(place=0.0))["place"].isna().all()


@pytest.mark.medium
@given(st.integers(0, 2**32 - 1))
def test_own_and_induced_parts_add_up_to_spearman_and_the_partners_account_for_the_induced_one(seed):
    rng = np.random.default_rng(seed)
    points = pd.DataFrame(rng.standard_normal((50, 4)) @ rng.standard_normal((4, 4)), columns=list("abcd"))
    responses = pd.DataFrame({"y": points["a"] ** 3 - points["c"] + rng.standard_normal(50)})
    parts, rank = decompose(points, responses), spearman(points, responses)
    np.testing.assert_allclose(parts.own + parts.induced, rank, atol=1e-9)
    between = input_correlation(points) - np.eye(4)
    np.testing.assert_allclose(parts.induced, between @ parts.own, atol=1e-6)


def test_without_correlation_everything_is_own():
    grid = np.array(np.meshgrid(*[np.arange(5.0)] * 3)).reshape(3, -1).T
    points = pd.DataFrame(grid, columns=list("abc"))
    responses = pd.DataFrame({"y": points["a"] + 5 * points["b"]})
    parts = decompose(points, responses)
    np.testing.assert_allclose(parts.induced, 0.0, atol=1e-9)
    np.testing.assert_allclose(parts.own, spearman(points, responses), atol=1e-9)


def test_the_spearman_value_of_an_inert_parameter_is_induced_by_its_partner(bound):
    points, responses = bound
    parts, rank = decompose(points, responses), spearman(points, responses)
    assert rank.loc["inert_mass", "steep"] < -0.7
    assert parts.own.loc["inert_mass", "steep"] == pytest.approx(0.0, abs=0.1)
    assert parts.partner.loc["inert_mass", "steep"] == "mass"
    assert parts.own.loc["mass", "steep"] > 0.7 and abs(parts.induced.loc["mass", "steep"]) < 0.15


def test_exactly_bound_parameters_and_constants_stay_blank(bound):
    points, responses = bound
    points = points.assign(inert_mass=1.0 - points["mass"], nothing=2.0)
    parts = decompose(points, responses.assign(flat=1.0))
    assert parts.own.loc[["mass", "inert_mass", "nothing"]].isna().all(axis=None)
    assert parts.own["flat"].isna().all() and (parts.partner["flat"] == "").all()
    assert parts.own.loc["stiffness", "freq"] > 0.5
