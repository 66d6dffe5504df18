"""Metamodels of optimal prognosis against functions whose shares are known, and against what has none."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from calib.errors.errors import InputError
from calib.problem.space import LinearConstraint, Parameter, ParameterSpace
from calib.sensitivity import gaussian_process
from calib.sensitivity import prognosis as module
from calib.sensitivity.polynomials import KINDS, PolynomialTerms, fitted_polynomial, of_inputs
from tests.sensitivity.known_functions import KNOWN, ishigami

prognosis = module.prognosis


def metamodel(name, seed=0, count=200):
    known = KNOWN[name]
    return known, prognosis(known.space, *known.designs(count, seed), seed)["y"]


def off(known, found):
    """Difference of the CoP of every input from its true share times the prognosis."""
    return found.shares["cop"].to_numpy() - found.cop * known.total


# -- known shares ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["Ishigami", "Ishigami, 10 inputs", "coupled quadratic"])
def test_inputs_have_their_true_share_of_the_prognosis_and_others_are_left_out(name):
    known, found = metamodel(name)
    assert found.cop > 0.98 and found.lower <= found.cop <= found.upper
    assert abs(off(known, found)).max() < 0.03
    assert set(found.inputs) == {f"x{i}" for i in np.flatnonzero(known.total)}
    target = found.cop * known.total
    assert (found.shares["lower"] <= target + 1e-9).all() and (target <= found.shares["upper"] + 1e-9).all()
    assert found.kind == ("quadratic" if "quadratic" in name else "polynomial chaos")


@pytest.mark.slow
@pytest.mark.parametrize("name", list(KNOWN))
def test_shares_hold_and_inputs_are_filtered_over_seeds(name):
    near, held, filtered = [], [], []
    for seed in range(20):
        known, found = metamodel(name, seed)
        near.append(abs(off(known, found)).max())
        target = found.cop * known.total
        held.append((found.shares["lower"] - 1e-9 <= target) & (target <= found.shares["upper"] + 1e-9))
        filtered.append(all(known.total[int(i[1:])] > 0 for i in found.inputs))
    assert np.median(near) < 0.03 and np.mean(filtered) >= 0.9 and np.mean(held) >= 0.9


def test_the_prognosis_is_that_of_points_it_has_not_seen():
    known = KNOWN["smooth g"]
    found = prognosis(known.space, *known.designs(200, 3))["y"]
    fresh, response = known.designs(2000, 99)
    true = response["y"].to_numpy()
    reached = 1.0 - ((found(fresh.to_numpy()) - true) ** 2).mean() / true.var()
    assert found.lower - 0.02 <= reached and abs(reached - found.cop) < 0.08
    assert found.error == pytest.approx(np.sqrt(((found.true - found.predicted) ** 2).mean()))


def test_noise_alone_is_not_predicted():
    known = KNOWN["Ishigami, 10 inputs"]
    points, _ = known.designs(100, 1)
    noise = pd.DataFrame({"y": np.random.default_rng(0).normal(size=100)})
    found = prognosis(known.space, points, noise)["y"]
    assert found.cop < 0.1 and found.inputs == () and (found.shares["cop"] < 0.1).all()


@pytest.mark.medium
def test_noise_bounds_the_prognosis_of_a_known_part():
    known = KNOWN["coupled quadratic"]
    points, response = known.designs(300, 2)
    noise = np.random.default_rng(0).normal(size=300) * response["y"].std()
    found = prognosis(known.space, points, response + noise[:, None])["y"]
    assert found.lower < 0.5 < found.upper


# -- constraints and integers ------------------------------------------------------------------------------------------


def test_a_constraint_leaves_each_of_two_bound_inputs_what_it_moves_alone():
    free = tuple(Parameter(name, 0.5, 0.0, 1.0) for name in "abc")
    width = 0.25
    total = LinearConstraint("sum", (("a", 1.0), ("b", 1.0)), 1.0 - width, 1.0 + width)
    space = ParameterSpace(free, (total,))
    points = pd.DataFrame(module.sample(space, 300, 1).points, columns=list("abc"))
    found = prognosis(space, points, pd.DataFrame({"y": 3.0 * points["a"] + points["c"]}))["y"]
    # The variance of a over what the sum leaves it, with b given: E[width(b)^2] / 12.
    b = points["b"].to_numpy()
    span = np.minimum(1.0, 1.0 + width - b) - np.maximum(0.0, 1.0 - width - b)
    whole = 9.0 * points["a"].var() + points["c"].var()
    assert found.shares["cop"]["a"] == pytest.approx(9.0 * (span**2).mean() / 12.0 / whole, abs=0.03)
    assert found.shares["cop"]["b"] == 0.0 and found.inputs == ("a", "c")


def test_an_equality_leaves_its_inputs_nothing_of_their_own():
    free = tuple(Parameter(name, 0.5, 0.0, 1.0) for name in "abc")
    space = ParameterSpace(free, (LinearConstraint("sum", (("a", 1.0), ("b", 1.0)), 1.0, 1.0),))
    points = pd.DataFrame(module.sample(space, 100, 1).points, columns=list("abc"))
    found = prognosis(space, points, pd.DataFrame({"y": points["a"] + points["c"]}))["y"]
    assert found.cop > 0.99 and found.shares["cop"][["a", "b"]].max() < 1e-6 and found.shares["cop"]["c"] > 0.4


def test_integers_count_by_their_values():
    space = ParameterSpace((Parameter("n", 1.0, 0.0, 2.0, integer=True), Parameter("x", 0.0, -1.0, 1.0)))
    points = pd.DataFrame(module.sample(space, 200, 1).points, columns=["n", "x"])
    found = prognosis(space, points, pd.DataFrame({"y": points["n"] + points["x"]}))["y"]
    assert found.shares["cop"]["n"] == pytest.approx((2.0 / 3.0) / (2.0 / 3.0 + 1.0 / 3.0), abs=0.03)


# -- what has no metamodel ---------------------------------------------------------------------------------------------


def test_constant_and_rare_responses_and_failed_rows_have_their_sentence():
    known = KNOWN["coupled quadratic"]
    points, response = known.designs(180, 0)
    y = response["y"].to_numpy()
    failed = np.where(np.arange(180) % 3 == 0, np.nan, y)
    rare = np.where(np.arange(180) < 160, np.nan, y)
    rare[-3:] = np.nan
    table = pd.DataFrame({"y": y, "failed": failed, "still": np.full(180, 4.0), "rare": rare})
    found = prognosis(known.space, points, table)
    kinds = found.table.set_index("response")
    assert kinds["model"].to_dict() == {
        "y": "quadratic", "failed": "quadratic", "still": "constant", "rare": "none",
    }  # fmt: skip
    assert kinds["designs"].to_dict() == {"y": 180, "failed": 120, "still": 180, "rare": 17}
    assert kinds.loc["failed", "cop"] > 0.99 and kinds.loc[["still", "rare"], "cop"].isna().all()
    words = " ".join(found.sentences)
    assert all(name in words for name in ("still", "rare", "20 designs"))
    assert found["still"](points.to_numpy()[:2]).tolist() == [4.0, 4.0]
    assert len(found.inputs) == 4 * 20
    with pytest.raises(InputError, match="no response 'nix'"):
        found["nix"]


def test_rows_that_do_not_belong_together_are_refused():
    known = KNOWN["Ishigami"]
    points, response = known.designs(30, 0)
    with pytest.raises(InputError):
        prognosis(known.space, points, response.iloc[:-1])


# -- candidates --------------------------------------------------------------------------------------------------------


def test_an_input_that_few_folds_have_is_left_out():
    z = np.random.default_rng(1).uniform(-1.0, 1.0, (60, 3))
    y = z @ [1.0, 0.3, 0.1]
    whole = of_inputs("linear", z, y, (0, 1, 2))
    some = [(0, 1, 2), (0, 1, 2), (0, 1, 2), (0, 1), (0,)]  # the second has four of five folds, the third has three
    parts = [of_inputs("linear", z, y, inputs) for inputs in some]
    tried = module._Tried(whole, parts, y)
    assert whole.inputs == (0, 1, 2)
    kept = module._stable(tried, z, y)
    assert kept.model.inputs == (0, 1) and kept.parts is tried.parts
    np.testing.assert_allclose(kept.model(z), of_inputs("linear", z, y, (0, 1))(z))
    assert module._stable(replace(tried, parts=[whole] * 5), z, y).model is whole
    assert of_inputs("linear", z, y, ())(z).tolist() == [y.mean()] * 60


@pytest.mark.slow
def test_an_input_that_does_nothing_is_left_out_though_its_terms_are_significant():
    known, found = metamodel("smooth g, 12 inputs", 0)
    assert {f"x{i}" for i in np.flatnonzero(known.total > 0.01)} <= set(found.inputs)
    assert not {f"x{i}" for i in np.flatnonzero(known.total == 0)} & set(found.inputs)


def test_terms_are_orthonormal_over_uniform_inputs():
    nodes, weights = np.polynomial.legendre.leggauss(16)
    z = np.stack([a.ravel() for a in np.meshgrid(nodes, nodes)], axis=1)
    w = np.outer(weights, weights).ravel() / 4.0
    for kind in KINDS:
        values = PolynomialTerms.of(kind, (0, 1)).values(z)
        np.testing.assert_allclose((values * w[:, None]).T @ values, np.eye(values.shape[1]), atol=1e-9)


def test_a_polynomial_of_its_own_kind_is_found_exactly():
    z = 2.0 * np.random.default_rng(1).random((60, 6)) - 1.0
    found = fitted_polynomial("quadratic", z, 2.0 + z[:, 1] - 0.5 * z[:, 2] * z[:, 4])
    assert found.inputs == (1, 2, 4)
    assert found(np.zeros((1, 6)))[0] == pytest.approx(2.0, abs=1e-9)


def test_many_inputs_stay_within_reason():
    """Products in pairs of hundreds of inputs are not tried; squares and lines are."""
    z = 2.0 * np.random.default_rng(1).random((150, 300)) - 1.0
    assert len(PolynomialTerms.of("quadratic", range(300)).inputs) == 600
    assert fitted_polynomial("quadratic", z, 3.0 * z[:, 7] + z[:, 250] ** 2).inputs == (7, 250)


def test_without_scikit_learn_polynomials_remain_and_it_is_said(monkeypatch):
    known = ishigami(3)
    points, response = known.designs(40, 0)  # too few for polynomials alone
    monkeypatch.setattr(module, "is_installed", lambda: False)
    found = prognosis(known.space, points, response)
    assert found["y"].kind in KINDS and found.untried == ("y",)
    assert any("metamodel" in words and "1 response" in words for words in found.sentences[1:])


def test_a_process_is_chosen_where_it_predicts_better():
    pytest.importorskip("sklearn")
    space = ParameterSpace(tuple(Parameter(f"x{i}", 0.0, -1.0, 1.0) for i in range(4)))
    z = module.sample(space, 60, 3).points
    y = np.abs(z[:, 0] - 0.3) + 0.6 * np.exp(-8.0 * (z[:, 1] + z[:, 0]) ** 2)
    found = prognosis(space, pd.DataFrame(z, columns=list(space.free_names)), pd.DataFrame({"y": y}))["y"]
    assert found.kind == "Gaussian process" and set(found.inputs) == {"x0", "x1"}
    rest = gaussian_process.fitted_process(z, y, (0, 1), [np.arange(0, 30), np.arange(30, 60)])
    np.testing.assert_allclose(rest[1][0](z[:30]), rest[2][:30], atol=1e-8)  # the fold's own process predicts it
    better = replace(module.PROGNOSIS, process_below=0.0)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "PROGNOSIS", better)
        alone = prognosis(space, pd.DataFrame(z, columns=list(space.free_names)), pd.DataFrame({"y": y}))["y"]
    assert alone.kind in KINDS and alone.cop < found.cop
