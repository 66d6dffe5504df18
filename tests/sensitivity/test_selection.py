import numpy as np
import pandas as pd
import pytest

from calib.errors.errors import InputError
from calib.sensitivity.rules import RULES
from calib.sensitivity.selection import assess


def rows(assessment):
    return assessment.selection.set_index("parameter")


@pytest.mark.medium
@pytest.mark.parametrize(("tables", "allowed"), [(15, 2), pytest.param(100, 5, marks=pytest.mark.slow)])
def test_measures_together_select_active_parameters_and_not_those_bound_to_them(draw, tables, allowed):
    wrong, right = 0, 0
    for seed in range(tables):
        table = rows(assess(*draw(seed, 150)))
        wrong += table.loc[["inert_mass", "nothing"], "selected"].any()
        right += table.loc[["mass", "stiffness", "place"], "selected"].all()
        assert abs(table.loc["inert_mass", "max_spearman"]) > table.loc["inert_mass", "spearman_floor"]
    assert wrong <= allowed and right == tables


def test_reasons_are_given_in_words(bound):
    table = rows(assess(*bound))
    why = table["why"]
    assert why["mass"].startswith("moves steep (partial rank correlation +")
    assert why["stiffness"].startswith("moves freq (partial rank correlation +")
    assert "acts evenly on even" in why["place"] and "% of its variance" in why["place"]
    assert why["inert_mass"].startswith("its Spearman value on steep (−") and why["inert_mass"].endswith("by mass")
    assert why["nothing"] == "nothing above the noise"
    assert table["selected"].tolist() == [True, False, True, False, True]
    assert not table["forced"].any() and table["measured"].equals(table["selected"])


def test_values_are_those_of_the_tables_where_they_are_largest(bound):
    found = assess(*bound)
    for name, row in rows(found).iterrows():
        for measure, values in (
            ("spearman", found.spearman), ("partial", found.partial), ("variance_share", found.variance_share.table)
        ):  # fmt: skip
            assert row[f"max_{measure}"] == values.loc[name, row[f"{measure}_response"]]
        assert abs(row["max_partial"]) == found.partial.loc[name].abs().max()
        assert row["variance_share_floor"] >= RULES.relevant
        assert row["spearman_floor"] == found.spearman_floor[row["spearman_response"]]


def test_what_the_study_names_is_kept_and_what_it_leaves_out_is_named(bound):
    found = assess(*bound, forced=["mass", "nothing", "stiffness"])
    table = rows(found)
    assert table.index[table["selected"]].tolist() == ["mass", "stiffness", "nothing"]
    assert table.loc["nothing", "why"] == "kept by the study: nothing above the noise"
    assert table.loc["place", "why"].startswith("left out by the study: acts evenly on even")
    assert table["measured"].tolist() == [True, False, True, False, True]
    assert found.sentence == (
        "The measures select 3 of 5 parameters; the study leaves out place, which they would select; "
        "the study keeps nothing, which they would not."
    )
    assert assess(*bound).sentence == "The measures select 3 of 5 parameters."
    with pytest.raises(InputError, match="'gravity' is selected but was not sampled"):
        assess(*bound, forced=["gravity"])


def test_a_spearman_value_of_the_wrong_sign_is_named():
    """An additional mass whose partner acts more: by rank correlation alone it seems to raise the frequency."""
    rng = np.random.default_rng(3)
    heavy = rng.uniform(size=400)
    light = 1.0 - heavy + 0.15 * rng.uniform(-1, 1, size=400)
    points = pd.DataFrame({"heavy": heavy, "light": light, "k": rng.uniform(size=400)})
    responses = pd.DataFrame({"freq": np.sqrt((1 + 0.3 * points["k"]) / (1 + heavy + 0.5 * light))})
    row = rows(assess(points, responses)).loc["light"]
    assert row["max_spearman"] > 0.5 and row["max_partial"] < -0.5 and row["selected"]
    assert row["why"].startswith("moves freq (partial rank correlation −")
    assert row["why"].endswith("is induced by heavy")


def test_collinear_parameters_are_selected_together(draw):
    points, responses = draw(1, 300)
    points = points.assign(inert_mass=1.0 - points["mass"])
    table = rows(assess(points, responses))
    assert table.loc[["mass", "inert_mass"], "selected"].all() and not table.loc["nothing", "selected"]
    assert table.loc["mass", "why"].startswith(
        ("moves steep together with inert_mass (", "moves valley together with inert_mass (")
    )
    table = rows(assess(points, responses[["even"]]))
    assert not table.loc[["mass", "inert_mass"], "selected"].any()
    assert table.loc["mass", "why"] == "it follows from the other parameters and is confounded with them"


def test_a_certain_but_small_effect_is_not_selected():
    rng = np.random.default_rng(4)
    points = pd.DataFrame(rng.uniform(size=(200, 3)), columns=["big", "small", "other"])
    responses = pd.DataFrame({"y": points["big"] + 0.05 * points["small"]})
    row = rows(assess(points, responses)).loc["small"]
    assert abs(row["max_partial"]) > 0.5 and not row["selected"]  # close to 1 since nothing else is left to explain
    assert row["why"].startswith("moves y, but by only 0.") and row["why"].endswith("% of its variance")
    assert rows(assess(points, responses, relevant=0.02)).loc["small", "selected"]


def test_with_too_few_rows_for_the_variance_share_the_partial_rank_correlation_decides(draw):
    points, responses = draw(2, 16)
    table = rows(assess(points, responses[["steep"]]))
    assert table["max_variance_share"].isna().all() and table.loc["mass", "selected"]
    assert table.loc["mass", "why"].startswith("moves steep (partial rank correlation +")


def test_responses_that_never_change_or_are_never_known_are_survived(bound):
    points, _ = bound
    for value in (1.0, np.nan):
        table = rows(assess(points, pd.DataFrame({"y": np.full(300, value)})))
        assert not table["selected"].any() and table["max_spearman"].isna().all()
        assert table.loc["mass", "why"].startswith("no response is known often enough")
