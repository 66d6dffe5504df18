import numpy as np
import pandas as pd
import pytest

from calib.errors.errors import InputError
from calib.sensitivity.partial import partial, partial_noise_floor
from calib.sensitivity.rules import RULES
from calib.sensitivity.spearman import noise_floor, spearman
from calib.sensitivity.variance_share import joint_variance_share, variance_share


def grid(levels: int = 9) -> pd.DataFrame:
    """Every combination of three parameters: exactly uncorrelated and symmetric."""
    axis = np.linspace(-1.0, 1.0, levels)
    return pd.DataFrame(np.array(np.meshgrid(axis, axis, axis)).reshape(3, -1).T, columns=list("abc"))


def test_shares_of_independent_inputs_are_those_of_an_analysis_of_variance():
    points = grid()
    rng = np.random.default_rng(1)
    # Normal scores of a normal response change nothing, so the shares are those of the parts.
    parts = {"a": points["a"], "b": points["b"] ** 2, "ac": points["a"] * points["c"]}
    noise = rng.standard_normal(len(points))
    y = sum(0.4 * (v - v.mean()) / v.std(ddof=0) for v in parts.values()) + np.sqrt(1 - 3 * 0.16) * noise
    found = variance_share(points, pd.DataFrame({"y": y}))
    share = found.table["y"] ** 2
    assert share["a"] == pytest.approx(0.32, abs=0.06) and share["b"] == pytest.approx(0.16, abs=0.05)
    assert share["c"] == pytest.approx(0.16, abs=0.05)
    assert found.straight.loc["a", "y"] == pytest.approx(0.5, abs=0.1)
    assert found.curved.loc["b", "y"] > 0.9 and found.straight.loc["b", "y"] < 0.05
    assert found.straight.loc["c", "y"] + found.curved.loc["c", "y"] < 0.1


def test_variance_share_of_a_free_monotone_parameter_is_the_size_of_its_spearman_value():
    rng = np.random.default_rng(2)
    points = pd.DataFrame(rng.uniform(size=(800, 3)), columns=list("abc"))
    y = pd.DataFrame({"y": np.exp(points["a"] - 0.5 * points["b"] + 0.3 * rng.standard_normal(800))})
    found, rank = variance_share(points, y).table["y"], spearman(points, y)["y"].abs()
    assert found["a"] == pytest.approx(rank["a"], abs=0.06) and found["b"] == pytest.approx(rank["b"], abs=0.06)


@pytest.mark.slow
def test_an_even_effect_of_an_integer_parameter_is_found_where_correlations_are_blind(draw):
    found = missed = 0
    for seed in range(50):
        points, responses = draw(seed, 150)
        responses = responses[["even"]]
        got = variance_share(points, responses)
        found += got.table.loc["place", "even"] > max(got.floor.loc["place", "even"], RULES.relevant)
        rank, part = spearman(points, responses), partial(points, responses)
        missed += (abs(rank.loc["place", "even"]) < noise_floor(150, 5)) and (
            abs(part.loc["place", "even"]) < partial_noise_floor(150, 5, 5)
        )
    assert found == 50 and missed >= 47


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 0.5])
def test_inert_parameters_bound_to_an_active_one_are_not_found(draw, noise):
    """Per response the level is 5 % of the tables; steep, even and product responses included."""
    false, active, tied = {}, {}, 0
    tables = 100 if noise == 0 else 40
    for seed in range(tables):
        points, responses = draw(seed, 150, noise=noise)
        for name in responses:  # each its own table, so that each has the whole 5 %
            got = variance_share(points, responses[[name]])
            passed = got.table[name] > got.floor[name].clip(lower=RULES.relevant)
            false[name] = false.get(name, 0) + passed[["inert_mass", "nothing"]].any()
            active[name] = active.get(name, 0) + passed["place" if name == "even" else "mass"]
        tied += abs(spearman(points, responses[["steep"]]).loc["inert_mass", "steep"]) > noise_floor(150, 5)
    assert tied == tables  # Spearman's value takes the inert one for active every time
    assert max(false.values()) <= 0.1 * tables and sum(false.values()) <= 0.05 * 5 * tables
    assert min(active[n] for n in ("freq", "even", "valley", "steep")) >= (0.99 if noise == 0 else 0.85) * tables


@pytest.mark.slow
def test_floor_is_passed_by_chance_in_one_table_of_twenty():
    rng = np.random.default_rng(5)
    tries, n, passed, mean = 250, 80, 0, []
    for _ in range(tries):
        points = pd.DataFrame(rng.uniform(size=(n, 3)), columns=list("abc"))
        points["b"] = points["a"] + 0.1 * points["b"]
        got = variance_share(points, pd.DataFrame(rng.standard_normal((n, 4))))
        passed += (got.table > got.floor).any(axis=None)
        mean.append(got.floor.to_numpy().mean())
    assert 0.01 * tries <= passed <= 0.091 * tries  # 5 %, within three standard errors
    assert 0.3 < np.mean(mean) < 0.6


def test_monotone_changes_of_scale_change_nothing(bound):
    points, responses = bound
    found = variance_share(points, responses)
    again = variance_share(points.assign(mass=np.exp(points["mass"])), np.exp(3 * responses))
    pd.testing.assert_frame_equal(again.table, found.table)
    pd.testing.assert_frame_equal(again.floor, found.floor)


def test_an_outlier_does_not_hide_a_variance_share(bound):
    points, responses = bound
    before = variance_share(points, responses).table
    responses.loc[7] = 1e6
    after = variance_share(points, responses).table
    assert (after - before).abs().to_numpy().max() < 0.1


def test_a_parameter_that_follows_from_others_is_blank_and_counts_with_its_partner(bound):
    points, responses = bound
    points = points.assign(inert_mass=1.0 - points["mass"])
    got = variance_share(points, responses)
    assert got.table.loc[["mass", "inert_mass"]].isna().all(axis=None)
    both = joint_variance_share(points, responses, [("mass", "inert_mass"), ("nothing", "stiffness")])
    assert both.table.index.tolist() == ["mass+inert_mass", "nothing+stiffness"]
    assert both.table.loc["mass+inert_mass", "steep"] > 0.8 > both.floor.loc["mass+inert_mass", "steep"]
    assert both.table.loc["mass+inert_mass", "even"] < both.floor.loc["mass+inert_mass", "even"]


def test_few_rows_give_a_simpler_regression_and_too_few_give_none(draw):
    points, responses = draw(3, 22)  # 1 + 2 * 5 terms at 1.5 rows each, but not 1 + 4 * 5
    got = variance_share(points, responses[["even"]])
    assert got.table.loc["place", "even"] > got.floor.loc["place", "even"]
    got = variance_share(*draw(3, 16))
    assert got.table.isna().all(axis=None) and got.floor.isna().all(axis=None)


def test_unknown_and_constant_responses_cost_only_themselves(bound):
    points, responses = bound
    whole = variance_share(points, responses)
    responses = responses.assign(flat=1.0)
    responses.loc[:99, "freq"] = np.nan
    got = variance_share(points, responses)
    assert got.table["flat"].isna().all()
    np.testing.assert_allclose(got.table["steep"], whole.table["steep"])
    keep = responses["freq"].notna()
    np.testing.assert_allclose(got.table["freq"], variance_share(points[keep], responses.loc[keep]).table["freq"])


def test_tables_that_do_not_belong_together_are_refused(bound):
    points, responses = bound
    with pytest.raises(InputError, match="300 points and 299 rows"):
        variance_share(points, responses.iloc[1:])
