"""Patterns of residual and effect, against an independent projection."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from calib.missing.decision import decide
from calib.missing.pattern import PLACE_COLUMNS, PRIOR, explaining, parameter_table, pattern_table, place_table
from calib.missing.tables import effects_table

pytestmark = pytest.mark.usefixtures("fewer_samples")


def found_in(toy, truth, seed=1):
    toy = toy.drawn(np.random.default_rng(seed), truth)
    return toy, decide(toy)


def labels(toy):
    return pd.DataFrame([(row.kind, row.mode, row.sensor) for row in toy.rows], columns=["kind", "mode", "sensor"])


def off_parameters(found, column):
    """What least squares leave of a column when the parameters may move, priors as rows of their own."""
    fit = found.base.fit
    matrix = np.vstack([fit.slope, np.diag(1.0 / fit.prior_sd)])
    return column - matrix @ np.linalg.lstsq(matrix, column, rcond=None)[0]


@pytest.fixture(scope="module")
def one(toy):
    return found_in(toy(effects=6, signed=("E1",)), {"E3": 1.2})


@pytest.fixture(scope="module")
def two(toy):
    for seed in range(1, 20):
        made, found = found_in(toy(effects=5, size=12.0), {"E0": 1.3, "E1": 1.1}, seed)
        if found.verdict == "two_effects":
            return made, found
    raise AssertionError("no pair was named")


@pytest.fixture(scope="module")
def tied(toy):
    made = toy(effects=5).correlated("E4", "E2", 0.995)
    return found_in(made, {"E2": 1.3})


def test_residual_and_signature_are_those_that_the_parameters_cannot_absorb(one):
    toy, found = one
    table, fit = pattern_table(found, labels(toy)), found.base.fit
    assert found.verdict == "effect" and set(table["effect"]) == {"E3"}
    data = table["kind"] != PRIOR
    assert table[data][["kind", "mode", "sensor"]].to_numpy().tolist() == labels(toy).to_numpy().tolist()
    assert table.loc[~data, "sensor"].tolist() == list(fit.names) == ["P0", "P1", "P2", "P3"]
    augmented = np.concatenate([fit.residual, -fit.shift])
    np.testing.assert_allclose(table["residual"], off_parameters(found, augmented), atol=1e-9)
    magnitude = found.chosen.fit.values["E3"]
    column = np.concatenate([magnitude * toy.columns["E3"], np.zeros(len(fit.names))])
    np.testing.assert_allclose(table["signature"], off_parameters(found, column), atol=1e-6)
    z = effects_table(found, {}, {}).set_index("name").loc["E3", "z"]
    gain = (table["residual"] ** 2).sum() - (table["left"] ** 2).sum()
    assert 0.95 * z**2 < gain <= z**2  # the largest gain is that of the magnitude without its prior


def test_what_is_left_is_the_residual_without_the_signatures_of_all_effects_of_the_fit(one, two, tied):
    for toy, found in (one, two, tied):
        table = pattern_table(found, labels(toy))
        for together, rows in table.groupby("effects"):
            parts = {name: own.reset_index(drop=True) for name, own in rows.groupby("effect")}
            assert set(parts) == set(together.split(" + "))
            explained = sum(own["signature"] for own in parts.values())
            for own in parts.values():
                np.testing.assert_allclose(own["residual"], explained + own["left"], atol=1e-9)


def test_the_score_of_an_effect_follows_from_its_rows(one, two, tied):
    for toy, found in (one, two, tied):
        scores = effects_table(found, {}, {}).set_index("name")["z"]
        for name, own in pattern_table(found, labels(toy)).groupby("effect"):
            length = np.linalg.norm(own["signature"])
            assert own["signature"] @ own["residual"] / length == pytest.approx(scores[name], rel=1e-6)


def test_the_fits_are_what_is_named_or_attempted(one, two, tied, toy):
    assert [t.names for t in explaining(one[1])] == [("E3",)]
    assert [t.names for t in explaining(two[1])] == [two[1].chosen.names] and len(two[1].chosen.names) == 2
    found = tied[1]
    assert found.verdict == "indistinguishable"
    assert {t.names for t in explaining(found)} == {("E2",), ("E4",)} and explaining(found)[0] is found.chosen
    assert explaining(one[1].unconfirmed()) == (one[1].chosen,)  # an attempt is shown too
    made, nothing = found_in(toy(effects=4), {})
    assert nothing.chosen is None and not explaining(nothing)
    for table in (pattern_table(nothing, labels(made)), place_table(nothing, {})):
        assert table.empty and "effect" in table
    assert set(PLACE_COLUMNS) == set(place_table(nothing, {}).columns)


def test_no_more_than_three_indistinguishable_effects_are_given(tied):
    found = tied[1]
    others = tuple(replace(found.chosen, effects=(e,)) for g in found.groups for e in g.effects)
    credible = tuple(name for t in others for name in t.names)
    many = replace(found, candidate_fits=found.candidate_fits + others, credible=credible)
    assert len(explaining(many)) == 3 and explaining(many)[0] is found.chosen


def test_a_local_perturbation_with_the_same_signature_has_the_correlation_1(toy):
    made = toy(effects=4)
    made = replace(made, columns={**made.columns, "A2": -0.3 * made.columns["E1"]})
    made, found = found_in(made, {"E1": 1.5})
    assert found.chosen is not None and "E1" in found.chosen.names
    places = {e.name: ("stiffness", (float(k), 0.0, 0.0), "") for k, e in enumerate(made.perturbations)}
    table = place_table(found, places)
    own = table[table["effect"] == "E1"].set_index("perturbation")
    assert set(own.index) == {e.name for e in made.perturbations}
    assert own.loc["A2", "correlation"] == pytest.approx(-1.0) and own.loc["A2", "x"] == 2.0
    column = {n: off_parameters(found, np.concatenate([made.columns[n], np.zeros(4)])) for n in ("E1", "A5")}
    expected = column["E1"] @ column["A5"] / np.linalg.norm(column["E1"]) / np.linalg.norm(column["A5"])
    assert own.loc["A5", "correlation"] == pytest.approx(expected, abs=1e-6)


def test_a_local_perturbation_that_the_parameters_absorb_has_no_place(one):
    _, found = one
    local = found.base_adequacy.perturbations
    absorbed = replace(local, size=np.where([n == "A3" for n in local.owners], 0.0, local.size))
    found = replace(found, base_adequacy=replace(found.base_adequacy, perturbations=absorbed))
    table = place_table(found, {n: ("mass", (0.0, 0.0, 0.0), "") for n in local.owners})
    assert set(table["perturbation"]) == set(local.owners) - {"A3"}


def test_fitted_parameters_are_those_of_the_fits_with_their_descriptions(one, two, tied, toy):
    hung = found_in(toy(bump=True), {"hung": 8.0, "at": 5.0}, 3)
    for _, found in (one, two, tied, hung):
        table = parameter_table(found)
        for fit in explaining(found):
            own = table[table["effects"] == " + ".join(fit.names)]
            assert list(own["parameter"]) == [p.name for effect in fit.effects for p in effect.parameters]
            for row in own.itertuples():
                k = fit.fit.names.index(row.parameter)
                assert row.value == fit.fit.values[row.parameter]
                assert row.std == pytest.approx(np.sqrt(fit.fit.covariance[k, k]))
    assert set(table[table["effect"] == "hung"]["parameter"]) == {"hung", "at"}
