"""Linearised fits against closed forms."""

from dataclasses import replace

import numpy as np
import pytest

from calib.errors.errors import EvaluationError
from calib.missing.linearised_fit import least_squares_fit, neighbouring_integers
from calib.missing.nearest_integers import nearest_whole


def matrix(toy, names):
    return np.column_stack([toy.columns[n] for n in names])


def optimum(a, y, s):
    information = a.T @ a + np.diag(1 / s**2)
    return np.linalg.solve(information, a.T @ y), np.linalg.inv(information)


def spread(toy, units):
    """The toy with every parameter in another unit."""
    own = tuple(
        replace(p, lower=p.lower * u, upper=p.upper * u, prior_sd=p.prior_width * u)
        for p, u in zip(toy.base.parameters, units, strict=True)
    )
    columns = {**toy.columns, **{p.name: toy.columns[p.name] / u for p, u in zip(own, units, strict=True)}}
    return replace(toy, base=replace(toy.base, parameters=own), columns=columns)


UNITS = np.array([1e7, 1.0, 1e-9, 30.0])


@pytest.mark.parametrize("added", [(), ("E1",), ("E3", "A2")])
def test_a_linear_fit_is_the_exact_optimum(toy, added):
    rng = np.random.default_rng(1)
    toy = spread(toy(signed=("E1", "E3"), prior=0.7), UNITS).drawn(rng, {"E1": 1.3})
    fit = toy.calibrated(*added)
    assert fit.names == ("P0", "P1", "P2", "P3", *added) and fit.effects == added
    a, s = matrix(toy, fit.names), np.array([toy.fit_problem(added).space[n].prior_width for n in fit.names])
    best, covariance = optimum(a, toy.data, s)
    std = np.sqrt(np.diag(covariance))
    found = np.array([fit.values[n] for n in fit.names])
    np.testing.assert_allclose((found - best) / std, 0.0, atol=0.02)
    np.testing.assert_allclose(fit.covariance / np.outer(std, std), covariance / np.outer(std, std), rtol=1e-9)
    np.testing.assert_allclose(fit.slope, a)
    np.testing.assert_allclose(fit.shift, found / s)
    lowest = np.sum((toy.data - a @ best) ** 2) + np.sum((best / s) ** 2)
    assert lowest <= fit.misfit < lowest + 2e-3
    assert fit.misfit == pytest.approx(np.sum(fit.augmented**2))


def test_projection_removes_what_parameters_absorb(toy):
    toy = spread(toy(reach=1e5), UNITS).drawn(np.random.default_rng(2))
    fit = toy.calibrated()
    rng = np.random.default_rng(3)
    inside = (fit.slope * UNITS) @ rng.standard_normal((4, 3))
    # A wide prior hardly resists.
    assert np.linalg.norm(fit.project_out(inside)) < 1e-4 * np.linalg.norm(inside)
    other = rng.standard_normal((len(toy.rows), 5))
    rest = fit.project_out(other)
    augmented = np.vstack([fit.slope, np.diag(1 / fit.prior_sd)])
    np.testing.assert_allclose((augmented * UNITS).T @ rest / np.linalg.norm(augmented * UNITS), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.vstack([other, np.zeros((4, 5))]).T @ rest, rest.T @ rest, atol=1e-9)


def test_a_firm_prior_absorbs_nothing(toy):
    toy = toy(reach=1e-4).drawn(np.random.default_rng(2))
    other = np.random.default_rng(3).standard_normal((len(toy.rows), 2))
    np.testing.assert_allclose(toy.calibrated().project_out(other)[:-4], other, atol=1e-6)


def test_the_update_for_changed_data_equals_a_refit(toy):
    toy = spread(toy(), UNITS).drawn(np.random.default_rng(4))
    fit = toy.calibrated()
    change = 3 * np.random.default_rng(5).standard_normal(len(toy.rows))
    there = replace(toy, data=toy.data + change).calibrated()
    expected = fit.relinearised({}, fit.residual + change)
    assert expected.misfit == pytest.approx(there.misfit, abs=4e-3)
    moved = np.array([there.values[n] - fit.values[n] for n in fit.names])
    std = np.sqrt(np.diag(fit.covariance))
    np.testing.assert_allclose(fit.update(change) / std, moved / std, atol=0.05)
    np.testing.assert_allclose([expected.values[n] - fit.values[n] for n in fit.names] / std, moved / std, atol=0.05)
    np.testing.assert_allclose(expected.residual, there.residual, atol=0.05)
    np.testing.assert_allclose(expected.shift, there.shift, atol=0.05)


def test_first_order_fits_with_neighbouring_integers_equal_fits(toy):
    toy = toy(places=7).drawn(np.random.default_rng(6), {"place": 5})
    fit = toy.calibrated(whole=100)
    assert fit.values["place"] == 5
    near = neighbouring_integers(fit)
    assert [n.values["place"] for n in near] == [4.0, 6.0]
    for there in near:
        again = least_squares_fit(toy.fit_problem(()), (), there.values)
        assert again.values["place"] == there.values["place"]
        assert there.misfit == pytest.approx(again.misfit, abs=4e-3)  # the toy is linear


def test_at_a_limit_there_is_one_neighbour(toy):
    toy = toy(places=7).drawn(np.random.default_rng(6), {"place": 5})
    assert [n.values["place"] for n in neighbouring_integers(toy.calibrated(start={"place": 6}))] == [5.0]
    assert [n.values["place"] for n in neighbouring_integers(toy.calibrated(start={"place": 0}))] == [1.0]


def test_integers_move_to_their_true_values(toy):
    toy = toy(places=7).drawn(np.random.default_rng(6), {"place": 5})
    assert toy.calibrated().values["place"] == 0
    fit = toy.calibrated(whole=100)
    assert fit.values["place"] == 5 and "place" not in fit.names
    others = [toy.calibrated(start={"place": k}).misfit for k in range(7)]
    assert fit.misfit == pytest.approx(min(others), abs=4e-3) and int(np.argmin(others)) == 5
    assert toy.calibrated(start={"place": 4}, whole=1).values["place"] == 5
    assert toy.calibrated(start={"place": 0}, whole=1).values["place"] != 5  # no neighbouring column resembles it


def test_the_other_parameters_are_updated_before_an_integer_is_fitted(toy):
    """In a linear model they are then at their optimum: start and step, the other integer, its fit, the first again."""
    toy = toy(places=2).drawn(np.random.default_rng(11), {"place": 1})
    assert toy.calibrated(whole=1).values["place"] == 1 and toy.evaluations <= 5


def test_two_integers_move_together(toy):
    toy = toy(places=4)
    toy = numbered(toy, toy.columns["place"][:, ::-1] * 1.5 + np.roll(toy.columns["place"], 7, axis=0))
    for truth in ({"place": 2, "other": 3}, {"place": 1, "other": 2}, {"place": 3, "other": 0}):
        drawn = toy.drawn(np.random.default_rng(7), truth)
        found = drawn.calibrated(whole=100).values
        assert {n: found[n] for n in truth} == truth


def test_an_integer_that_cannot_be_evaluated_is_skipped(toy):
    toy = toy(places=4).drawn(np.random.default_rng(8), {"place": 2})
    fit = replace(toy, fails=lambda values: values["place"] == 2).calibrated(whole=100)
    assert fit.values["place"] != 2


def numbered(toy, other):
    """The toy with a second integer parameter."""
    own = (*toy.base.parameters, replace(toy.base["place"], name="other"))
    return replace(toy, base=replace(toy.base, parameters=own), columns={**toy.columns, "other": other})


def smooth(toy):
    """The toy with places whose signatures are the more similar the nearer they are."""
    count = toy.columns["place"].shape[1]
    near = np.exp(-0.5 * (np.subtract.outer(np.arange(count), np.arange(count)) / 1.5) ** 2)
    return replace(toy, columns={**toy.columns, "place": 4 * toy.columns["place"] @ near})


@pytest.mark.medium
def test_the_nearest_integers_are_those_of_the_lowest_sum_of_squares(toy):
    toy = smooth(toy(places=9, reach=40.0))
    toy = numbered(toy, np.roll(toy.columns["place"], 11, axis=0))
    for truth in ({"place": 7, "other": 2}, {"place": 0, "other": 8}, {"place": 3, "other": 3}):
        drawn = toy.drawn(np.random.default_rng(12), truth)
        found = nearest_whole(drawn.fit_problem(()), {**toy.base.values, "place": 4, "other": 4})
        assert {n: found[n] for n in truth} == truth
        assert {n: v for n, v in found.items() if n not in truth} == {f"P{k}": 0.0 for k in range(4)}
        there = {(a, b): drawn.calibrated(start={"place": a, "other": b}).misfit for a in range(9) for b in range(9)}
        assert min(there, key=there.__getitem__) == (truth["place"], truth["other"])


def test_two_integers_that_must_move_together_do(toy):
    """Two supports that must go together: a move of one alone fits worse."""
    toy = toy(places=5, effects=1)
    steps = np.arange(5.0)
    along, across = toy.columns["place"][:, :1] * 1.5, toy.columns["E0"][:, None] * 3.0
    toy = replace(toy, columns={**toy.columns, "place": along * steps + across * steps})
    toy = numbered(toy, along * steps - across * steps).drawn(np.random.default_rng(13), {"place": 4, "other": 4})
    found = nearest_whole(toy.fit_problem(()), toy.base.values)
    assert (found["place"], found["other"]) == (4, 4)


def test_integers_that_cannot_be_evaluated_are_not_chosen(toy):
    toy = smooth(toy(places=6)).drawn(np.random.default_rng(14), {"place": 5})
    bad = replace(toy, fails=lambda values: values["place"] == 4)
    assert nearest_whole(toy.fit_problem(()), {**toy.base.values, "place": 2})["place"] == 5
    assert nearest_whole(bad.fit_problem(()), {**toy.base.values, "place": 2})["place"] == 3
    plain = toy.fit_problem(()).space.freeze({"place": 1})
    assert nearest_whole(replace(toy.fit_problem(()), space=plain), {"P0": 0.3}) == plain.complete({"P0": 0.3})


def test_a_start_outside_the_limits_is_moved_in(toy):
    toy = toy().drawn(np.random.default_rng(9))
    far = toy.calibrated("E0", start={"P1": 400.0, "E0": -3.0})
    near = toy.calibrated("E0")
    assert far.misfit == pytest.approx(near.misfit, abs=4e-3)
    for p in far.fit_problem.space.parameters:
        assert p.lower <= far.values[p.name] <= p.upper


def test_a_start_that_cannot_be_evaluated_is_an_error(toy):
    toy = replace(toy(), fails=lambda values: True)
    with pytest.raises(EvaluationError, match="cannot start"):
        toy.calibrated()


def test_a_curved_model_is_followed_to_its_optimum(toy):
    toy = toy(curvature=0.05).drawn(np.random.default_rng(10))
    fit = toy.calibrated()
    gradient = (fit.slope * fit.prior_sd).T @ fit.residual - fit.shift
    step = np.linalg.solve(fit.scaled_information, gradient)
    assert gradient @ step < 2e-3
    assert fit.misfit < toy.calibrated(start={"P0": 2.0}).misfit + 4e-3
