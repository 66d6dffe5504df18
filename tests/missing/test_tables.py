"""Tables of an explanation, against the objects they are made from."""

import math
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from calib.missing.decision import decide
from calib.missing.effect_facts import smallest_visible
from calib.missing.evidence import ln_evidence
from calib.missing.linearised_fit import least_squares_fit
from calib.missing.plausible import parameter_pulls
from calib.missing.rules import RULES
from calib.missing.tables import (
    CORRELATED,
    EFFECT_COLUMNS,
    UNTESTED,
    candidate_fits_table,
    confounded_with,
    confounding_table,
    effects_table,
    expected_ln_bayes,
    misfit_table,
    pull_table,
)
from calib.report.explanation import MOST


def found_in(toy, truth, seed=1):
    toy = toy.drawn(np.random.default_rng(seed), truth)
    return toy, decide(toy)


@pytest.fixture(scope="module")
def one(toy):
    """One effect is missing; E1 may be negative, E4 has the signature of E2, E5 is too weak to be visible."""
    made = toy(effects=6, signed=("E1",))
    made = made.correlated("E4", "E2", 0.995)
    made = replace(made, columns={**made.columns, "E5": made.columns["E5"] / 10})
    return found_in(made, {"E3": 1.0})


@pytest.fixture(scope="module")
def nothing(toy):
    return found_in(toy(effects=4, signed=("E1",)), {})


def table_of(found, intervals=None, gains=None):
    return effects_table(found, intervals or {}, gains or {})


# -- effects -----------------------------------------------------------------------------------------------------------


def test_every_candidate_has_a_row_with_the_documented_columns(one, nothing):
    for _, found in (one, nothing):
        table = table_of(found)
        assert tuple(table.columns) == EFFECT_COLUMNS
        assert sorted(table["name"]) == sorted(name for g in found.groups for name in g.names)


def test_scores_and_sizes_are_those_of_the_test(one):
    toy, found = one
    table = table_of(found).set_index("name")
    fit, named = found.base.fit, found.base_adequacy.named
    g = np.column_stack([toy.columns[n] for n in fit.names])  # the toy is linear: its columns are its slope
    a = np.vstack([g, np.diag(1 / fit.prior_sd)])
    for name in table.index.drop("E4"):  # it is collinear with E2 and not tested by itself
        own = np.concatenate([toy.columns[name], np.zeros(len(fit.names))])
        projected = own - a @ np.linalg.lstsq(a, own, rcond=None)[0]
        size = np.linalg.norm(projected)
        assert table.loc[name, "z"] == pytest.approx(projected @ fit.augmented / size, rel=1e-6, abs=1e-9)
        assert table.loc[name, "unabsorbed"] == pytest.approx(size / np.linalg.norm(own))
        assert table.loc[name, "magnitude_min"] == pytest.approx(4.0 / size)
        assert smallest_visible(named, name) == table.loc[name, "magnitude_min"]


def test_visible_is_what_a_plausible_magnitude_would_show(one):
    _, found = one
    table = table_of(found).set_index("name")
    assert not table.loc["E5", "visible"] and table.loc[["E0", "E1", "E2", "E3"], "visible"].all()
    tested = table.drop("E4")
    assert (tested["visible"] == (tested["magnitude_min"] <= tested["plausible"])).all()
    assert (table["plausible"] == 1.0).all() and (table["largest"] == 50.0).all()


def test_the_true_effect_comes_first_with_its_magnitude(one):
    _, found = one
    table = table_of(found)
    first = table.iloc[0]
    (candidate_fit,) = [t for t in found.singles if t.names == ("E3",)]
    magnitude, std = candidate_fit.magnitude("E3")
    assert found.verdict == "effect" and first["name"] == "E3" and first["refitted"] and first["credible"]
    assert first["magnitude"] == magnitude == candidate_fit.fit.values["E3"] == pytest.approx(1.0, abs=4 * std)
    assert (first["magnitude_low"], first["magnitude_high"]) == pytest.approx(
        (magnitude - 1.96 * std, magnitude + 1.96 * std)
    )
    assert first["model_probability"] > 0.9 and table["credible"].sum() == 1


def test_refitted_effects_come_before_others_and_each_best_first(one):
    _, found = one
    table = table_of(found)
    refitted = table["refitted"].astype(bool)
    assert refitted.is_monotonic_decreasing
    for _, part in table.groupby(refitted):
        assert part["ln_bayes"].is_monotonic_decreasing
    assert set(table.loc[refitted, "name"]) == {t.names[0] for t in found.singles}
    assert table.loc[~refitted, ["magnitude", "magnitude_low", "magnitude_high"]].isna().all(axis=None)


def test_given_intervals_are_used_and_end_at_physical_limits(one):
    _, found = one
    table = table_of(found, {"E3": (0.8, 70.0)}).set_index("name")
    assert tuple(table.loc["E3", ["magnitude_low", "magnitude_high"]]) == (0.8, 50.0)
    others = table[table["refitted"].astype(bool) & (table.index != "E3")]
    assert (others["magnitude_low"].dropna() >= np.where(others.index == "E1", -50.0, 0.0)).all()


def test_gains_on_held_out_data_are_those_given(one):
    _, found = one
    table = table_of(found, gains={"E3": 12.5}).set_index("name")
    assert table.loc["E3", "held_out_gain"] == 12.5 and table["held_out_gain"].isna().sum() == len(table) - 1


def test_evidence_is_against_the_base_model_and_exact_for_a_linear_one(one):
    """Of two Gaussian marginal densities of the data; a half-normal prior of a strong effect doubles one of them."""
    toy, found = one
    table = table_of(found).set_index("name")
    g = np.column_stack([toy.columns[n] * toy.base[n].prior_width for n in toy.base.names])
    covariance = np.eye(len(toy.rows)) + g @ g.T

    def ln(c):
        return -0.5 * (toy.data @ np.linalg.solve(c, toy.data) + np.linalg.slogdet(c)[1])

    b = toy.columns["E3"]
    for column, plausible in (("ln_bayes", 1.0), ("ln_bayes_third", 1 / 3), ("ln_bayes_triple", 3.0)):
        exact = ln(covariance + np.outer(b, b) * plausible**2) - ln(covariance) + math.log(2)
        assert table.loc["E3", column] == pytest.approx(exact, abs=0.05)


def test_evidence_of_what_was_not_fitted_is_the_linear_one(nothing):
    toy, found = nothing
    table = table_of(found).set_index("name")
    assert not table["refitted"].any() and found.candidate_fits == ()
    g = np.column_stack([toy.columns[n] * toy.base[n].prior_width for n in toy.base.names])
    covariance = np.eye(len(toy.rows)) + g @ g.T

    def ln(c):
        return -0.5 * (toy.data @ np.linalg.solve(c, toy.data) + np.linalg.slogdet(c)[1])

    b = toy.columns["E1"]  # signed: its prior is a whole Gaussian
    for column, plausible in (("ln_bayes", 1.0), ("ln_bayes_third", 1 / 3), ("ln_bayes_triple", 3.0)):
        exact = ln(covariance + np.outer(b, b) * plausible**2) - ln(covariance)
        assert table.loc["E1", column] == pytest.approx(exact, abs=0.01)


def test_bayes_factors_for_other_plausible_magnitudes_are_those_of_fits(one):
    """The columns with a third and three times the plausible size against fits with such a prior."""
    toy, found = one
    table = table_of(found).set_index("name")
    for column, factor in (("ln_bayes_third", 1 / 3), ("ln_bayes_triple", 3.0)):
        effects = tuple(
            replace(e, magnitude=replace(e.magnitude, prior_sd=factor * e.plausible)) if e.name == "E3" else e
            for e in toy.effects
        )
        other = replace(toy, effects=effects)
        (e3,) = [e for e in effects if e.name == "E3"]
        fit_problem = other.fit_problem(("E3",))
        fit = least_squares_fit(fit_problem, ("E3",), {**fit_problem.space.values, "E3": 1.0})
        assert table.loc["E3", column] == pytest.approx(ln_evidence(fit, [e3]) - found.base.ln_evidence, abs=0.05)


def test_probabilities_within_the_library_leave_half_of_the_prior_to_the_base_model(one, nothing):
    for _, found in (one, nothing):
        table = table_of(found)
        stands = {name: g.effect.name for g in found.groups for name in g.names}
        first = table[table["name"].isin(stands.values())].set_index("name")
        own = table.set_index("name")
        size = pd.Series({name: len(g.names) for g in found.groups for name in g.names})
        weights = np.exp(own["ln_bayes"].astype(float)) / len(first) / size[own.index]
        assert own["model_probability"].to_dict() == pytest.approx((weights / (1 + weights.sum())).to_dict())
    assert table_of(nothing[1])["model_probability"].sum() < 0.5


def test_collinear_effects_are_listed_with_their_leader(one):
    table = table_of(one[1]).set_index("name")
    first, other = table.loc["E2"], table.loc["E4"]
    assert first["refitted"] and first["stands_for"] == "E4" and (table.drop("E2")["stands_for"] == "").all()
    assert other["confounded_with"] == "E2" and other["ln_bayes"] == first["ln_bayes"]
    assert (
        other["model_probability"] == first["model_probability"]
        and not other["refitted"]
        and np.isnan(other["magnitude"])
    )
    assert other["credible"] == first["credible"] and list(table.index).index("E4") > list(table.index).index("E2")
    assert other["z"] != first["z"] and other["magnitude_min"] != first["magnitude_min"]  # these differ between the two


def test_fitted_effects_of_a_group_have_their_own_values(toy):
    made = toy(effects=5).correlated("E4", "E2", 0.995)
    _, found = found_in(made, {"E2": 1.3})
    table = table_of(found).set_index("name")
    assert {"E2", "E4"} in [set(g.names) for g in found.groups]
    both = table.loc[["E2", "E4"]]
    assert both["refitted"].all() and both["magnitude"].notna().all() and (table["stands_for"] == "").all()
    for name in ("E2", "E4"):
        (own,) = [t for t in found.singles if t.names == (name,)]
        assert table.loc[name, "ln_bayes"] == pytest.approx(found.ln_bayes(own))
    bayes_factor = both["model_probability"].iloc[0] / both["model_probability"].iloc[1]
    assert bayes_factor == pytest.approx(math.exp(both["ln_bayes"].iloc[0] - both["ln_bayes"].iloc[1]))


def test_an_effect_that_was_not_tested_has_a_row_that_says_so(one):
    _, found = one
    (e0,) = [g.effect for g in found.groups if g.effect.name == "E0"]
    table = effects_table(found, {}, {}, untested=[e0]).set_index("name")
    assert table.loc["E0", "implausible"] == UNTESTED and np.isnan(table.loc["E0", "z"])
    assert not table.loc["E0", "visible"] and table["model_probability"].sum() < 1.0 and table.index[-1] == "E0"


def test_given_visible_magnitudes_replace_linearised_ones(one):
    table = effects_table(one[1], {}, {}, {"E5": 0.7, "E0": np.inf}).set_index("name")
    assert table.loc["E5", "magnitude_min"] == 0.7 and table.loc["E5", "visible"] and not table.loc["E0", "visible"]


def test_a_fit_worse_than_the_base_model_is_ignored(one):
    _, found = one
    (own,) = [t for t in found.candidate_fits if t.names == ("E0",)]
    worse = replace(own, fit=replace(own.fit, residual=10 * own.fit.residual))
    other = replace(found, candidate_fits=tuple(worse if t is own else t for t in found.candidate_fits))
    plain, table = (effects_table(f, {}, {}).set_index("name") for f in (found, other))
    assert plain.loc["E0", "refitted"] and not table.loc["E0", "refitted"] and table.loc["E0", "ln_bayes"] > -3


def test_an_implausible_effect_has_its_reason_in_its_row(toy):
    made = toy(prior=0.5, reach=5.0, perturbations=0, effects=3, size=20.0)
    made = replace(made, columns={**made.columns, "hidden": made.columns["E0"] - 4.0 * made.columns["P1"]})
    _, found = found_in(made, {"hidden": 1.0})
    table = table_of(found).set_index("name")
    assert "P1 has shifted" in table.loc["E0", "implausible"] and not table.loc["E0", "credible"]


# -- collinear and confounded ------------------------------------------------------------------------------------------


def test_the_correlation_of_signatures_is_that_after_projection(one):
    toy, found = one
    table = confounding_table(found).set_index("effect")
    assert list(table.index) == list(table.columns) == [name for g in found.groups for name in g.names]
    matrix = table.to_numpy()
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-12)
    np.testing.assert_allclose(np.diag(matrix), 1.0)
    fit = found.base.fit
    a = np.vstack([np.column_stack([toy.columns[n] for n in fit.names]), np.diag(1 / fit.prior_sd)])

    def projected(name):
        own = np.concatenate([toy.columns[name], np.zeros(len(fit.names))])
        return own - a @ np.linalg.lstsq(a, own, rcond=None)[0]

    u, v = projected("E0"), projected("E3")
    assert table.loc["E0", "E3"] == pytest.approx(u @ v / np.linalg.norm(u) / np.linalg.norm(v), abs=1e-9)


def test_of_hundreds_of_effects_those_with_most_evidence_are_correlated(toy):
    _, found = found_in(toy(effects=CORRELATED + 5), {"E3": 1.0})
    effects = table_of(found)
    table = confounding_table(found, effects)
    assert table.shape == (CORRELATED, CORRELATED + 1) and list(table.columns[1:]) == list(table["effect"])
    least = effects.set_index("name")["ln_bayes"].nsmallest(5)
    assert set(effects["name"]) - set(table["effect"]) == set(least.index)
    assert "E3" in set(table["effect"]) and MOST < CORRELATED


def test_collinear_effects_are_confounded_with_each_other(toy):
    made = toy(effects=4).correlated("E3", "E1", 0.97)
    _, found = found_in(made, {"E1": 0.5})
    rho = confounding_table(found).set_index("effect").loc["E1", "E3"]
    assert RULES.confounded < rho < 0.98
    assert confounded_with(found, "E1") == ["E3"] and confounded_with(found, "E3") == ["E1"]
    assert confounded_with(found, "E0") == []
    table = table_of(found).set_index("name")
    assert table.loc["E1", "confounded_with"] == "E3" and table.loc["E0", "confounded_with"] == ""


def test_collinear_effects_are_confounded_although_nothing_is_missing(toy):
    _, found = found_in(toy(effects=4).correlated("E3", "E1", 0.97), {})
    assert found.verdict == "nothing_detectable" and confounded_with(found, "E1") == ["E3"]


@pytest.mark.parametrize(("magnitude", "expected"), [(0.5, ["E3"]), (5.0, [])])
def test_correlated_effects_are_confounded_only_while_weak(toy, magnitude, expected):
    """Correlation 0.85: at a score of 5 the expected Bayes factor is below 20:1, at 40 far beyond."""
    made = toy(effects=4, parameters=1, reach=0.1).correlated("E3", "E1", 0.88)
    _, found = found_in(made, {"E1": magnitude})
    rho = confounding_table(found).set_index("effect").loc["E1", "E3"]
    assert 0.8 < rho < RULES.confounded
    assert confounded_with(found, "E1") == expected


def test_expected_bayes_factors():
    assert expected_ln_bayes(6.0, 0.0) == 18.0
    assert expected_ln_bayes(6.0, 1.0) == expected_ln_bayes(6.0, -1.0) == 0.0
    assert expected_ln_bayes(10.0, 0.8) == pytest.approx(18.0)


# -- others ------------------------------------------------------------------------------------------------------------


def test_pulls_are_listed_before_and_after(one, nothing):
    _, found = one
    table = pull_table(found)
    assert table.columns[0] == "model" and list(dict.fromkeys(table["model"])) == ["base", "E3"]
    before = table[table["model"] == "base"].drop(columns="model").reset_index(drop=True)
    pd.testing.assert_frame_equal(before, parameter_pulls(found.base.fit), check_dtype=False)
    for row in table.to_dict("records"):
        candidate_fit = found.base if row["model"] == "base" else found.chosen
        k = candidate_fit.fit.names.index(row["parameter"])
        expected = candidate_fit.fit.shift[k] / math.sqrt(1 - candidate_fit.fit.covariance[k, k] / row["prior_sd"] ** 2)
        assert row["standardised"] == pytest.approx(expected, rel=1e-6)
        assert row["pulled"] == (abs(row["standardised"]) > row["limit"])
    assert set(table["parameter"]) == {"P0", "P1", "P2", "P3"}  # magnitudes are not calibration parameters
    assert set(pull_table(nothing[1])["model"]) == {"base"}


def test_misfit_is_listed_by_mode_and_kind(one, nothing, toy):
    _, found = one
    table = misfit_table(found)
    assert list(table.columns) == ["stage", "mode", "kind", "chi2", "dof", "p"]
    assert list(dict.fromkeys(table["stage"])) == ["base", "explained"] and len(table) == 2 * 8 * 3
    before, after = (
        table.loc[(table["stage"] == s) & (table["kind"] == "shape"), "chi2"].sum() for s in ("base", "explained")
    )
    assert after < before
    assert set(misfit_table(nothing[1])["stage"]) == {"base"}
    _, plain = found_in(toy(modes=0, sensors=60), {})
    assert set(misfit_table(plain)["mode"]) == {"responses"}


def test_every_candidate_fit_is_listed(one, nothing, toy):
    _, found = one
    table = candidate_fits_table(found)
    assert list(table.columns) == ["effects", "misfit", "ln_bayes", "implausible"]
    assert table.iloc[0].to_dict() == {
        "effects": "none",
        "misfit": found.base.fit.misfit,
        "ln_bayes": 0.0,
        "implausible": found.base.implausible,
    }
    assert len(table) == 1 + len(found.candidate_fits) + (found.perturbation is not None)
    best = table.loc[table["ln_bayes"].idxmax()]
    assert best["effects"] == "E3" and best["misfit"] == found.chosen.fit.misfit < found.base.fit.misfit
    assert len(candidate_fits_table(nothing[1])) == 1
    _, two = found_in(toy(), {"E0": 1.5, "E4": 1.5})
    assert "E0 + E4" in set(candidate_fits_table(two)["effects"])


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_effect_of_either_sign_is_confounded_with_what_its_size_does_not_tell_apart(one, monkeypatch, sign):
    """Of two signatures with a correlation of 0.85, a score of 4.3 gives a Bayes factor below 20:1, one of 5 above."""
    _, found = one
    named, names = found.base_adequacy.named, [n for group in found.groups for n in group.names]
    alike = np.full((len(names), len(names)), 0.85)
    monkeypatch.setattr("calib.missing.tables.correlation", lambda *given: alike)
    single = next(t for t in found.singles if t.names == ("E3",))

    def others(score):
        values = {**single.fit.values, "E3": sign * score / float(named.size[named.best("E3")])}
        refitted = replace(single, fit=replace(single.fit, values=values))
        return confounded_with(replace(found, candidate_fits=(refitted,)), "E3")

    assert others(4.3) == [n for n in names if n != "E3"] and others(5.0) == []
