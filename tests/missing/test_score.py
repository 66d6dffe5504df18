"""Scores and the family-wise p-value of the largest, against closed forms and simulation."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

from calib.missing import score
from calib.missing.evidence import ln_evidence
from calib.missing.linearised_fit import LinearisedFit
from calib.missing.rules import RULES
from calib.missing.score import Scores, _reached, correlation, family_p, noise_limit, scores
from calib.problem.labels import RowLabels


def many(toy, fit: LinearisedFit, found: Scores, draws: int, seed: int, scale=None) -> np.ndarray:
    """Scores of data simulated with nothing missing, (m, draws); only the data change in a linear model."""
    rng = np.random.default_rng(seed)
    e = rng.standard_normal((len(toy.rows), draws)) / (1.0 if scale is None else scale)
    theta = rng.standard_normal((len(fit.names), draws))
    augmented = np.vstack([e + fit.slope * fit.prior_sd @ theta, np.zeros_like(theta)])
    return found.unit.T @ augmented


def critical(found: Scores, toy, level: float, dof=None) -> float:
    """Score whose family-wise p-value is the level."""
    low, high = 0.0, 60.0
    for _ in range(22):
        middle = 0.5 * (low + high)
        p = family_p(replace(found, z=np.full(len(found.z), middle)), RowLabels(toy.rows, {}, dof or {}), seed=1)
        low, high = (middle, high) if p > level else (low, middle)
    return 0.5 * (low + high)


@pytest.mark.medium
def test_scores_are_standard_normal_when_nothing_is_missing(toy):
    toy = toy(signed=("E0",))
    rng = np.random.default_rng(1)
    drawn = []
    for _ in range(150):
        one = toy.drawn(rng)
        drawn.append(scores(one.calibrated(), (*one.effects, *one.perturbations), {}).z)
    drawn = np.array(drawn)
    assert stats.kstest(drawn.ravel(), "norm").pvalue > 0.01
    np.testing.assert_allclose(drawn.mean(axis=0), 0.0, atol=4 / np.sqrt(150))
    np.testing.assert_allclose(drawn.std(axis=0), 1.0, atol=4 / np.sqrt(300))
    fit = one.calibrated()
    found = scores(fit, (*one.effects, *one.perturbations), {})
    np.testing.assert_allclose(np.cov(many(one, fit, found, 20000, 3)), found.unit.T @ found.unit, atol=0.04)


def test_one_step_is_a_refit_in_a_linear_model(toy):
    toy = toy(signed=("E2",)).drawn(np.random.default_rng(2), {"E0": 1.2, "E2": -0.9})
    fit = toy.calibrated()
    found = scores(fit, toy.effects, {})
    flat = tuple(replace(e, magnitude=replace(e.magnitude, lower=-1e3, upper=1e3, prior_sd=1e5)) for e in toy.effects)
    toy = replace(toy, effects=flat)  # neither limits nor a prior
    for k, name in enumerate(found.owners):
        there = toy.calibrated(name)
        assert there.values[name] == pytest.approx(found.z[k] / found.size[k], abs=0.05 / found.size[k])
        assert fit.misfit - there.misfit == pytest.approx(found.z[k] ** 2, abs=6e-3)
        assert np.sqrt(there.covariance[-1, -1]) == pytest.approx(1 / found.size[k], rel=1e-6)
    assert np.argmax(np.abs(found.z)) in (0, 2) and found.z[2] < 0 and found.magnitude[2] == -found.z[2]


def test_the_unabsorbed_fraction_is_that_after_projection(toy):
    toy = toy(effects=3, parameters=1, reach=1e4)
    along = toy.columns["P0"] / np.linalg.norm(toy.columns["P0"])
    across = toy.columns["E2"] - along * (along @ toy.columns["E2"])
    across /= np.linalg.norm(across)
    columns = {**toy.columns, "E0": 5 * along, "E1": 3 * along + 4 * across, "E2": 7 * across}
    toy = replace(toy, columns=columns).drawn(np.random.default_rng(3))
    found = scores(toy.calibrated(), toy.effects, {})
    np.testing.assert_allclose(found.unabsorbed, [1e-4, 0.8, 1.0], atol=1e-4)
    np.testing.assert_allclose(found.size[1:], [4.0, 7.0], rtol=1e-6)
    assert correlation(found, (1, 2))[0, 1] == pytest.approx(1.0)


def test_a_fully_absorbed_effect_has_no_score(toy):
    toy = toy(effects=2, reach=1e8)
    toy = replace(toy, columns={**toy.columns, "E0": toy.columns["P1"] * 1e-8}).drawn(np.random.default_rng(3))
    found = scores(toy.calibrated(), toy.effects, {})
    assert found.size[0] == found.z[0] == found.unabsorbed[0] == 0.0 < found.size[1]
    assert not found.unit[:, 0].any()
    alone = scores(toy.calibrated(), toy.effects[:1], {})
    assert family_p(alone, toy, seed=1) == 1.0
    none = scores(toy.calibrated(), (), {})
    assert none.owners == () and family_p(none, toy, seed=1) == 1.0


def test_rounding_errors_are_no_signature(toy):
    """Such as a sensor's rotation towards an axis along which nothing moves."""
    toy = toy(effects=3)
    least = 1e-4 / (toy.effects[0].plausible * np.linalg.norm(toy.columns["E0"]))
    columns = {**toy.columns, "E0": 0.9 * least * toy.columns["E0"]}
    toy = replace(toy, columns=columns).drawn(np.random.default_rng(5))
    found = scores(toy.calibrated(), toy.effects, {})
    assert found.size[0] == found.z[0] == 0 and (found.size[1:] > 0).all()
    larger = replace(toy, columns={**columns, "E0": columns["E0"] / 0.81})
    assert scores(larger.calibrated(), larger.effects, {}).size[0] > 0


def test_a_tight_prior_counts_like_a_covariance_of_the_data(toy):
    """Scores and evidence are those of the model without that parameter and with ``I + s^2 c c^T`` for the data."""
    toy = toy()
    tight = replace(toy.base["P3"], prior_sd=0.2)
    others = tuple(p for p in toy.base.parameters if p.name != "P3")
    toy = replace(toy, base=replace(toy.base, parameters=(*others, tight))).drawn(np.random.default_rng(2), {"E1": 0.5})
    fit = toy.calibrated()
    found = scores(fit, toy.effects, {})
    held = 0.2 * toy.columns["P3"]
    covariance = np.eye(len(held)) + np.outer(held, held)
    white = np.linalg.inv(np.linalg.cholesky(covariance))
    slope = np.column_stack([toy.columns[p.name] * p.prior_width for p in others])
    basis = np.linalg.qr(np.vstack([white @ slope, np.eye(len(others))]))[0]

    def absorbed(rows):
        wide = np.concatenate([white @ rows, np.zeros(len(others))])
        return wide - basis @ (basis.T @ wide)

    left = absorbed(toy.data)
    for name, z in zip(found.owners, found.z, strict=True):
        g = absorbed(toy.columns[name])
        assert z == pytest.approx(g @ left / np.linalg.norm(g), rel=1e-6)
    information = np.eye(len(others)) + slope.T @ np.linalg.solve(covariance, slope)
    told = -0.5 * (left @ left + np.linalg.slogdet(covariance)[1] + np.linalg.slogdet(information)[1])
    assert ln_evidence(fit, ()) == pytest.approx(told, abs=1e-3)


def test_a_column_by_difference_is_the_derivative_of_a_linear_effect(toy, make_effect):
    toy = toy(effects=2).drawn(np.random.default_rng(4), {"E0": 0.5})
    fit = toy.calibrated()
    gridded = make_effect("E0", grid=({"E0": 0.3}, {"E0": 4.0}))
    found = scores(fit, (gridded, toy.effects[1]), {"E0": toy.fit_problem(("E0",))})
    plain = scores(fit, toy.effects, {})
    assert found.owners == ("E1", "E0", "E0") and found.points == ({}, {"E0": 0.3}, {"E0": 4.0})
    for k in (1, 2):
        np.testing.assert_allclose(found.raw[:, k], plain.raw[:, 0], atol=1e-9)
        assert found.z[k] == pytest.approx(plain.z[0]) and found.unabsorbed[k] == pytest.approx(plain.unabsorbed[0])
    assert found.best("E1") == 0 and found.best("E0") in (1, 2)
    turned = scores(fit, (make_effect("E0", grid=({"E0": 4.0}, {"E0": 0.3})),), {"E0": toy.fit_problem(("E0",))})
    assert turned.steps("E0", 1) == [1]  # the scores are equal, but a magnitude of 4 is far too large


def test_the_best_grid_point_is_near_the_nuisance_parameter(toy):
    toy = toy(bump=True, effects=1).drawn(np.random.default_rng(5), {"hung": 1.5, "at": 5.0})
    fit = toy.calibrated()
    found = scores(fit, toy.effects, {"hung": toy.fit_problem(("hung",))})
    assert found.owners == ("E0", *["hung"] * 8)
    assert found.points[found.best("hung")]["at"] == 5.0
    first, second = found.steps("hung", 2)
    assert first == found.best("hung") and found.points[second]["at"] in (4.0, 6.0)
    drops = [2 * found.z[k] * found.size[k] - found.size[k] ** 2 for k in range(1, 9)]  # at magnitude 1
    assert [first, second] == [1 + k for k in np.argsort(drops)[:-3:-1]]
    for k in (first, second):  # the predicted decrease is that of the model at that point, its parameters refitted
        there = toy.fit_problem(("hung",)).residual({**fit.values, **found.points[k]})
        assert fit.misfit - fit.relinearised({}, there).misfit == pytest.approx(drops[k - 1], abs=4e-3)


def test_points_that_cannot_be_solved_are_left_out(toy):
    toy = toy(bump=True, effects=2).drawn(np.random.default_rng(6))
    bad = replace(toy, fails=lambda values: values.get("at", 0.0) > 4.5 and values.get("hung", 0.0) > 0)
    found = scores(bad.calibrated(), bad.effects, {"hung": bad.fit_problem(("hung",))})
    assert [p["at"] for p in found.points if p] == [0.0, 1.0, 2.0, 3.0, 4.0]
    worse = replace(toy, fails=lambda values: values.get("hung", 0.0) > 0)
    assert scores(worse.calibrated(), worse.effects, {"hung": worse.fit_problem(("hung",))}).owners == ("E0", "E1")


@pytest.mark.parametrize("z", [0.5, 1.7, 2.6])
@pytest.mark.parametrize("signed", [False, True])
def test_a_single_candidate_has_the_normal_tail(toy, z, signed):
    toy = toy(effects=1, signed=("E0",) if signed else ()).drawn(np.random.default_rng(7))
    found = scores(toy.calibrated(), toy.effects, {})
    exact = stats.norm.sf(z) * (2 if signed else 1)
    for sign in (1, -1) if signed else (1,):
        p = family_p(replace(found, z=np.array([sign * z])), toy, seed=1)
        assert p == pytest.approx(exact, abs=4 * np.sqrt(exact / 8000))
    if not signed:
        assert family_p(replace(found, z=np.array([-z])), toy, seed=1) == pytest.approx(1 - exact, abs=0.02)


def test_duplicate_and_absorbed_candidates_do_not_change_the_p_value(toy):
    toy = toy(effects=3, reach=1e8, signed=("E0", "E1", "E2"))
    more = {**toy.columns, "E1": -2.0 * toy.columns["E0"], "E2": toy.columns["P0"] * 1e-7}
    toy = replace(toy, columns=more).drawn(np.random.default_rng(8))
    fit = toy.calibrated()
    for z in (1.0, 2.0, 2.8):
        p = []
        for effects in (toy.effects[:1], toy.effects):
            found = scores(fit, effects, {})
            p.append(family_p(replace(found, z=np.full(len(effects), z)), toy, seed=1))
        assert p[1] == pytest.approx(p[0], abs=4 * np.sqrt(2 * p[0] / 8000))


def test_independent_candidates_multiply(toy):
    toy = toy(effects=6, parameters=1, reach=1e-3)
    turned, _ = np.linalg.qr(np.column_stack([toy.columns[f"E{k}"] for k in range(6)]))
    toy = replace(toy, columns={**toy.columns, **{f"E{k}": turned[:, k] for k in range(6)}})
    found = scores(toy.calibrated(), toy.effects, {})
    exact = 1 - stats.norm.cdf(2.2) ** 6
    p = family_p(replace(found, z=np.array([2.2, 0, -9.0, 0, 0, 1])), toy, seed=1)
    assert p == pytest.approx(exact, abs=4 * np.sqrt(exact / 8000))


@pytest.mark.parametrize("bump", [False, True])
def test_the_family_keeps_its_level(toy, bump):
    toy = toy(bump=bump, effects=4, signed=("E1",), modes=5, sensors=4).drawn(np.random.default_rng(9))
    fit = toy.calibrated()
    fit_problems = {"hung": toy.fit_problem(("hung",))} if bump else {}
    found = scores(fit, toy.effects, fit_problems)
    z = many(toy, fit, found, 20000, 10)
    largest = np.where(found.signed[:, None], np.abs(z), z).max(axis=0)
    for level in (0.02, 0.05, 0.3):
        share = np.mean(largest > critical(found, toy, level))
        assert share == pytest.approx(level, abs=4 * np.sqrt(level * (1 / 8000 + 1 / 20000)))


@pytest.mark.parametrize("dof", [{}, {"frequency": 12, "shape": 40}])
def test_samples_are_spared_only_where_none_would_reach_the_score(toy, monkeypatch, dof):
    """The least p-value is that of samples without one above the score; below it they are drawn as ever."""
    toy = toy(effects=4, signed=("E1",)).drawn(np.random.default_rng(9))
    found, labelled = scores(toy.calibrated(), toy.effects, {}), RowLabels(toy.rows, {}, dof)
    with_score = [replace(found, z=np.full(len(found.z), z)) for z in (2.0, 3.0, 4.0, 7.0, 40.0)]
    told = [family_p(one, labelled, seed=1) for one in with_score]
    monkeypatch.setattr("calib.missing.score._NEVER", 0.0)
    assert told == [family_p(one, labelled, seed=1) for one in with_score] and told[-1] == 1 / 8001
    kinds = np.array(list(dof.values()) or [np.inf])
    drawn = 8000 * np.array([_reached(z, len(found.z), kinds) for z in (2.0, 3.0, 4.0)])
    assert all(drawn > 8000 * np.array(told[:3]) - 1 - 4 * np.sqrt(8000 * np.array(told[:3])))


@pytest.mark.medium
def test_p_values_of_simulated_data_are_uniform(toy, fewer_samples):
    """The whole chain: simulate, calibrate, score, test."""
    toy = toy(effects=3, perturbations=0, modes=4, sensors=4, parameters=2)
    rng = np.random.default_rng(11)
    p = []
    for _ in range(150):
        one = toy.drawn(rng)
        p.append(family_p(scores(one.calibrated(), one.effects, {}), one, seed=1))
    assert stats.kstest(p, "uniform").pvalue > 0.01


def test_few_repeats_need_the_correction_by_students_t(toy):
    toy = toy(modes=0, sensors=30, effects=3, signed=("E0", "E1", "E2"), reach=30.0)
    fit = toy.calibrated()
    found = scores(fit, toy.effects, {})
    dof, draws = 4, 20000
    scale = np.sqrt(np.random.default_rng(12).chisquare(dof, draws) / dof)
    largest = np.abs(many(toy, fit, found, draws, 13, scale)).max(axis=0)
    right = np.mean(largest > critical(found, toy, 0.05, {"response": dof}))
    assert right == pytest.approx(0.05, abs=0.013)
    assert np.mean(largest > critical(found, toy, 0.05)) > 0.12


def test_every_kind_has_its_own_degrees_of_freedom(toy):
    """A direction within one kind of few repeats follows Student's t; one within another kind is normal."""
    toy = toy(effects=2, reach=1e-6)
    kinds = np.array([row.kind for row in toy.rows])
    columns = {"E0": toy.columns["E0"] * (kinds == "frequency"), "E1": toy.columns["E1"] * (kinds == "shape")}
    toy = replace(toy, columns={**toy.columns, **columns})
    dof = {"frequency": 3.0, "damping": 2.0, "shape": np.inf}
    fit = toy.calibrated()
    for name, exact in (("E0", stats.t.sf(2.5, 3)), ("E1", stats.norm.sf(2.5))):
        found = replace(scores(fit, [e for e in toy.effects if e.name == name], {}), z=np.array([2.5]))
        p = family_p(found, RowLabels(toy.rows, {}, dof), seed=1)
        assert p == pytest.approx(exact, abs=4 * np.sqrt(exact / 8000))


def test_the_same_seed_gives_the_same_p_value(toy):
    toy = toy().drawn(np.random.default_rng(14))
    found = scores(toy.calibrated(), toy.effects, {})
    first = family_p(found, RowLabels(toy.rows, {}, {"shape": 9.0}), seed=1)
    assert first == family_p(found, RowLabels(toy.rows, {}, {"shape": 9.0}), seed=1)
    assert first != family_p(found, RowLabels(toy.rows, {}, {"shape": 9.0}), seed=2)


def test_the_p_value_is_that_of_any_machine(toy, monkeypatch):
    """Machines choose the signs of eigenvectors differently; samples must not follow them."""
    toy = toy().drawn(np.random.default_rng(14))
    found, few = scores(toy.calibrated(), toy.effects, {}), RowLabels(toy.rows, {}, {"shape": 9.0})
    asked, eigh = family_p(found, few, seed=1), score.la.eigh
    assert 0.01 < asked < 0.99
    monkeypatch.setattr(score.la, "eigh", lambda matrix: (eigh(matrix)[0], eigh(matrix)[1] * [1, -1, 1, -1, -1]))
    assert family_p(found, few, seed=1) == asked


def test_noise_alone_exceeds_the_limit_as_often_as_stated():
    scores = np.random.default_rng(1).standard_normal((20000, 40))
    exceeded = (np.abs(scores).max(axis=1) > noise_limit(scores[0])).mean()
    assert exceeded == pytest.approx(RULES.noise_level, abs=0.0025)
    known = np.append(scores[0], np.nan)
    assert noise_limit(known) == noise_limit(scores[0]) < noise_limit(scores[:2].ravel())
