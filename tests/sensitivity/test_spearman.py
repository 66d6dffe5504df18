import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.stats import spearmanr

from calib.errors.errors import InputError
from calib.sensitivity.spearman import counts, noise_floor, spearman


def tables(seed: int, n: int = 40) -> tuple[pd.DataFrame, pd.DataFrame]:
    rng = np.random.default_rng(seed)
    points = pd.DataFrame(rng.uniform(1, 2, size=(n, 3)), columns=["k", "m", "step"])
    points["step"] = np.round(3 * points["step"])  # ties
    responses = pd.DataFrame(
        {
            "freq": np.sqrt(points["k"] / points["m"]),
            "noise": rng.standard_normal(n),
            "steps": points["step"] + np.round(rng.standard_normal(n)),
        }
    )
    return points, responses


@pytest.mark.medium
@given(st.integers(0, 2**32 - 1))
def test_it_agrees_with_an_independent_implementation(seed):
    points, responses = tables(seed)
    found = spearman(points, responses)
    assert found.index.tolist() == ["k", "m", "step"] and found.columns.tolist() == ["freq", "noise", "steps"]
    for p in points:
        for r in responses:
            assert found.loc[p, r] == pytest.approx(spearmanr(points[p], responses[r]).statistic, abs=1e-12)


def test_rank_correlation_sees_monotony_and_not_shape():
    x = np.arange(1.0, 22.0)
    points = pd.DataFrame({"x": x})
    found = spearman(points, pd.DataFrame({"up": np.exp(5 * x), "down": -(x**3), "valley": (x - 11) ** 2}))
    assert found.loc["x"].tolist() == pytest.approx([1.0, -1.0, 0.0], abs=1e-12)


def test_each_pair_uses_its_own_complete_rows():
    points, responses = tables(1)
    responses.loc[5:20, "freq"] = np.nan
    points.loc[0, "k"] = np.nan
    found, used = spearman(points, responses), counts(points, responses)
    assert used.loc["k"].tolist() == [23, 39, 39] and used.loc["m"].tolist() == [24, 40, 40]
    keep = responses["freq"].notna() & points["k"].notna()
    expected = spearmanr(points.loc[keep, "k"], responses.loc[keep, "freq"]).statistic
    assert found.loc["k", "freq"] == pytest.approx(expected)
    assert found.loc["m", "noise"] == pytest.approx(spearmanr(points["m"], responses["noise"]).statistic)


def test_constant_and_nearly_empty_columns_stay_blank():
    points, responses = tables(2)
    points["m"] = 1.0
    responses["noise"] = 7.0
    responses.loc[2:, "steps"] = np.nan
    found = spearman(points, responses)
    assert found.loc["m"].isna().all() and found["noise"].isna().all() and found["steps"].isna().all()
    assert np.isfinite(found.loc["k", "freq"])


def test_tables_that_do_not_belong_together_are_refused():
    points, responses = tables(3)
    with pytest.raises(InputError, match="40 points and 39 rows"):
        spearman(points, responses.iloc[1:])
    with pytest.raises(InputError):
        counts(points, responses.iloc[::-1])


@pytest.mark.parametrize(("n", "measured"), [(500, 0.164), (250, 0.235)])
def test_noise_floor_of_a_table_of_15_by_16(n, measured):
    """The 95 % quantile of the largest entry over many random tables."""
    assert noise_floor(n, 15 * 16) == pytest.approx(measured, rel=0.05)


def test_noise_floor_is_the_quantile_of_the_largest_spurious_entry():
    rng = np.random.default_rng(11)
    n, tries = 120, 2000
    ranks = rng.permuted(np.broadcast_to(np.arange(n) - (n - 1) / 2, (tries, 7, n)), axis=2)
    products = ranks[:, :3] @ ranks[:, 3:].transpose(0, 2, 1)  # three parameters and four responses
    largest = np.abs(12 * products / (n * (n**2 - 1))).max(axis=(1, 2))
    assert noise_floor(n, 12) == pytest.approx(np.quantile(largest, 0.95), rel=0.08)
    assert noise_floor(n, 12, level=0.5) == pytest.approx(np.quantile(largest, 0.5), rel=0.06)


def test_noise_floor_grows_with_the_table_and_never_beyond_one():
    assert noise_floor(100, 1) == pytest.approx(1.96 / np.sqrt(99), rel=1e-3)
    assert noise_floor(100, 1000) > noise_floor(100, 10) > noise_floor(1000, 10)
    assert noise_floor(3, 10_000) == 1.0
    with pytest.raises(InputError):
        noise_floor(2, 10)
