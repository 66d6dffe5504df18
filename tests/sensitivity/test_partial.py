import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import rankdata

from calib.errors.errors import InputError
from calib.sensitivity.partial import partial, partial_noise_floor
from calib.sensitivity.spearman import noise_floor, spearman


def correlated(seed: int, n: int = 60, p: int = 4) -> tuple[pd.DataFrame, pd.DataFrame]:
    rng = np.random.default_rng(seed)
    points = pd.DataFrame(rng.standard_normal((n, p)) @ rng.standard_normal((p, p)), columns=list("abcd")[:p])
    responses = pd.DataFrame({"y": points["a"] - points["b"] + rng.standard_normal(n), "z": rng.standard_normal(n)})
    return points, responses


@pytest.mark.medium
@given(st.integers(0, 2**32 - 1))
def test_it_is_the_inverse_of_the_rank_correlation_matrix(seed):
    """Textbook form (partial correlation from the precision matrix), an independent route to the same numbers."""
    points, responses = correlated(seed)
    found = partial(points, responses)
    for response in responses:
        ranks = np.apply_along_axis(rankdata, 0, points.assign(y_=responses[response]).to_numpy())
        precision = np.linalg.inv(np.corrcoef(ranks.T))
        expected = -precision[:-1, -1] / np.sqrt(np.diag(precision)[:-1] * precision[-1, -1])
        np.testing.assert_allclose(found[response], expected, atol=1e-8)


def test_monotone_changes_of_scale_change_nothing():
    points, responses = correlated(3)
    found = partial(points, responses)
    bent = points.assign(a=np.exp(points["a"]), b=points["b"] ** 3)
    pd.testing.assert_frame_equal(partial(bent, np.exp(responses)), found)
    pd.testing.assert_frame_equal(partial(-points, responses), -found)


def test_a_partner_under_a_constraint_has_spearman_but_no_partial_correlation(bound):
    points, responses = bound
    rank, part = spearman(points, responses), partial(points, responses)
    floor = partial_noise_floor(300, 5, part.size)
    assert rank.loc["inert_mass", "freq"] > 0.5 > noise_floor(300, rank.size)
    assert abs(part.loc["inert_mass", "freq"]) < floor < abs(part.loc["mass", "freq"])
    assert part.loc["mass", "freq"] < 0 < part.loc["stiffness", "freq"]


@pytest.mark.parametrize("width", [1e-2, 1e-4, 1e-5])
def test_nearly_bound_inputs_do_not_make_an_inert_parameter_active(width):
    hits = 0
    for seed in range(40):
        rng = np.random.default_rng(seed)
        a = rng.uniform(size=100)
        points = pd.DataFrame({"a": a, "b": -a + width * rng.uniform(size=100), "c": rng.uniform(size=100)})
        y = pd.DataFrame({"y": a + points["c"]})
        hits += abs(partial(points, y).loc["b", "y"]) > partial_noise_floor(100, 3, 3)
    assert hits <= 6  # 5 % of the tables at most, and ranks tie where the width is below their spacing


def test_exactly_bound_and_constant_parameters_stay_blank():
    points, responses = correlated(4)
    points["d"] = 10.0 - points["a"]
    points["held"] = 1.0
    responses["flat"] = 3.0
    found = partial(points, responses)
    assert found.loc[["a", "d", "held"]].isna().all(axis=None) and found["flat"].isna().all()
    alone = partial(points[["a", "b", "c"]], responses)
    np.testing.assert_allclose(found.loc[["b", "c"], ["y", "z"]], alone.loc[["b", "c"], ["y", "z"]], atol=1e-9)


def test_each_response_drops_its_own_unknown_rows():
    points, responses = correlated(5)
    responses.loc[3:20, "y"] = np.nan
    found = partial(points, responses)
    keep = responses["y"].notna()
    np.testing.assert_allclose(found["y"], partial(points[keep], responses.loc[keep, ["y"]])["y"])
    np.testing.assert_allclose(found["z"], partial(*correlated(5))["z"])
    responses.loc[4:, "z"] = np.nan  # 4 rows for 4 parameters: no degrees of freedom
    assert partial(points, responses)["z"].isna().all()


@pytest.mark.slow
def test_floor_is_the_quantile_of_the_largest_spurious_entry():
    rng = np.random.default_rng(12)
    n, p, r, tries = 30, 8, 3, 500
    largest = []
    for _ in range(tries):
        points = pd.DataFrame(rng.uniform(size=(n, p)))
        points[1] = points[0] + 0.2 * points[1]  # correlated inputs do not matter
        largest.append(partial(points, pd.DataFrame(rng.uniform(size=(n, r)))).abs().to_numpy().max())
    assert partial_noise_floor(n, p, p * r) == pytest.approx(np.quantile(largest, 0.95), rel=0.05)
    # without the p - 1 degrees of freedom that were regressed out, the floor would be too low by more than that
    assert partial_noise_floor(n, 1, p * r) < 0.94 * np.quantile(largest, 0.95)


def test_floor_of_one_parameter_is_that_of_a_simple_correlation_and_1_without_degrees_of_freedom():
    assert partial_noise_floor(500, 1, 1) == pytest.approx(0.0877, abs=2e-4)  # tables of the correlation coefficient
    assert partial_noise_floor(10, 9, 4) == 1.0
    assert partial_noise_floor(100, 14, 200) > partial_noise_floor(100, 14, 20) > partial_noise_floor(200, 14, 20)
    with pytest.raises(InputError):
        partial_noise_floor(100, 3, 0)


def test_tables_that_do_not_belong_together_are_refused():
    points, responses = correlated(6)
    with pytest.raises(InputError, match="60 points and 59 rows"):
        partial(points, responses.iloc[1:])
    points.loc[3, "c"] = np.nan
    with pytest.raises(InputError, match="'c' is unknown"):
        partial(points, responses)
