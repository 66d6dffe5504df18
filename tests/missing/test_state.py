"""A fitted model in closed form, and what its parameters absorb."""

from dataclasses import replace

import numpy as np
import pytest

from calib.errors import EvaluationError
from calib.missing.state import fitted, nearest_whole, neighbours


def matrix(toy, names):
    return np.column_stack([toy.columns[n] for n in names])


def optimum(a, y, s):
    information = a.T @ a + np.diag(1 / s**2)
    return np.linalg.solve(information, a.T @ y), np.linalg.inv(information)


def spread(toy, units):
    """The same toy with every parameter in another unit."""
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
    state = toy.calibrated(*added)
    assert state.names == ("P0", "P1", "P2", "P3", *added) and state.effects == added
    a, s = matrix(toy, state.names), np.array([toy.question(added).space[n].prior_width for n in state.names])
    best, covariance = optimum(a, toy.data, s)
    std = np.sqrt(np.diag(covariance))
    found = np.array([state.values[n] for n in state.names])
    np.testing.assert_allclose((found - best) / std, 0.0, atol=0.02)
    np.testing.assert_allclose(state.covariance / np.outer(std, std), covariance / np.outer(std, std), rtol=1e-9)
    np.testing.assert_allclose(state.slope, a)
    np.testing.assert_allclose(state.shift, found / s)
    lowest = np.sum((toy.data - a @ best) ** 2) + np.sum((best / s) ** 2)
    assert lowest <= state.misfit < lowest + 2e-3
    assert state.misfit == pytest.approx(np.sum(state.augmented**2))


def test_what_parameters_absorb_is_gone_and_what_is_left_is_orthogonal_to_them(toy):
    toy = spread(toy(reach=1e5), UNITS).drawn(np.random.default_rng(2))
    state = toy.calibrated()
    rng = np.random.default_rng(3)
    inside = (state.slope * UNITS) @ rng.standard_normal((4, 3))
    # A vague prior resists by next to nothing.
    assert np.linalg.norm(state.outside(inside)) < 1e-4 * np.linalg.norm(inside)
    other = rng.standard_normal((len(toy.rows), 5))
    rest = state.outside(other)
    augmented = np.vstack([state.slope, np.diag(1 / state.prior_sd)])
    np.testing.assert_allclose((augmented * UNITS).T @ rest / np.linalg.norm(augmented * UNITS), 0.0, atol=1e-12)
    np.testing.assert_allclose(np.vstack([other, np.zeros((4, 5))]).T @ rest, rest.T @ rest, atol=1e-9)


def test_a_firm_prior_absorbs_nothing(toy):
    toy = toy(reach=1e-4).drawn(np.random.default_rng(2))
    other = np.random.default_rng(3).standard_normal((len(toy.rows), 2))
    np.testing.assert_allclose(toy.calibrated().outside(other)[:-4], other, atol=1e-6)


def test_changes_of_the_data_are_followed_as_a_refit_would(toy):
    toy = spread(toy(), UNITS).drawn(np.random.default_rng(4))
    state = toy.calibrated()
    change = 3 * np.random.default_rng(5).standard_normal(len(toy.rows))
    there = replace(toy, data=toy.data + change).calibrated()
    expected = state.elsewhere({}, state.residual + change)
    assert expected.misfit == pytest.approx(there.misfit, abs=4e-3)
    moved = np.array([there.values[n] - state.values[n] for n in state.names])
    std = np.sqrt(np.diag(state.covariance))
    np.testing.assert_allclose(state.follow(change) / std, moved / std, atol=0.05)
    np.testing.assert_allclose(
        [expected.values[n] - state.values[n] for n in state.names] / std, moved / std, atol=0.05
    )
    np.testing.assert_allclose(expected.residual, there.residual, atol=0.05)
    np.testing.assert_allclose(expected.shift, there.shift, atol=0.05)


def test_neighbouring_whole_numbers_are_expected_where_fits_end(toy):
    toy = toy(places=7).drawn(np.random.default_rng(6), {"place": 5})
    state = toy.calibrated(whole=100)
    assert state.values["place"] == 5
    near = neighbours(state)
    assert [n.values["place"] for n in near] == [4.0, 6.0]
    for there in near:
        fit = fitted(toy.question(()), (), there.values)
        assert fit.values["place"] == there.values["place"]
        assert there.misfit == pytest.approx(fit.misfit, abs=4e-3)  # the toy is linear


def test_at_a_limit_there_is_one_neighbour(toy):
    toy = toy(places=7).drawn(np.random.default_rng(6), {"place": 5})
    assert [n.values["place"] for n in neighbours(toy.calibrated(start={"place": 6}))] == [5.0]
    assert [n.values["place"] for n in neighbours(toy.calibrated(start={"place": 0}))] == [1.0]


def test_whole_numbers_move_to_the_right_place(toy):
    toy = toy(places=7).drawn(np.random.default_rng(6), {"place": 5})
    assert toy.calibrated().values["place"] == 0
    state = toy.calibrated(whole=100)
    assert state.values["place"] == 5 and "place" not in state.names
    others = [toy.calibrated(start={"place": k}).misfit for k in range(7)]
    assert state.misfit == pytest.approx(min(others), abs=4e-3) and int(np.argmin(others)) == 5
    assert toy.calibrated(start={"place": 4}, whole=1).values["place"] == 5
    assert toy.calibrated(start={"place": 0}, whole=1).values["place"] != 5  # no column on the way looks like it


def test_the_other_parameters_follow_a_whole_number_before_it_is_fitted(toy):
    """In a linear model they are then at their optimum: start and step, the other number, its fit, the first again."""
    toy = toy(places=2).drawn(np.random.default_rng(11), {"place": 1})
    assert toy.calibrated(whole=1).values["place"] == 1 and toy.evaluations <= 5


def test_two_whole_numbers_move_together(toy):
    toy = toy(places=4)
    toy = numbered(toy, toy.columns["place"][:, ::-1] * 1.5 + np.roll(toy.columns["place"], 7, axis=0))
    for truth in ({"place": 2, "other": 3}, {"place": 1, "other": 2}, {"place": 3, "other": 0}):
        drawn = toy.drawn(np.random.default_rng(7), truth)
        found = drawn.calibrated(whole=100).values
        assert {n: found[n] for n in truth} == truth


def test_a_whole_number_that_cannot_be_evaluated_is_passed_over(toy):
    toy = toy(places=4).drawn(np.random.default_rng(8), {"place": 2})
    state = replace(toy, fails=lambda values: values["place"] == 2).calibrated(whole=100)
    assert state.values["place"] != 2


def numbered(toy, other):
    """The toy with a second whole-number parameter."""
    own = (*toy.base.parameters, replace(toy.base["place"], name="other"))
    return replace(toy, base=replace(toy.base, parameters=own), columns={**toy.columns, "other": other})


def smooth(toy):
    """The toy with places that look the more alike the nearer they are."""
    count = toy.columns["place"].shape[1]
    near = np.exp(-0.5 * (np.subtract.outer(np.arange(count), np.arange(count)) / 1.5) ** 2)
    return replace(toy, columns={**toy.columns, "place": 4 * toy.columns["place"] @ near})


def test_the_nearest_whole_numbers_are_those_of_the_lowest_sum_of_squares(toy):
    toy = smooth(toy(places=9, reach=40.0))
    toy = numbered(toy, np.roll(toy.columns["place"], 11, axis=0))
    for truth in ({"place": 7, "other": 2}, {"place": 0, "other": 8}, {"place": 3, "other": 3}):
        drawn = toy.drawn(np.random.default_rng(12), truth)
        found = nearest_whole(drawn.question(()), {**toy.base.values, "place": 4, "other": 4})
        assert {n: found[n] for n in truth} == truth
        assert {n: v for n, v in found.items() if n not in truth} == {f"P{k}": 0.0 for k in range(4)}
        there = {(a, b): drawn.calibrated(start={"place": a, "other": b}).misfit for a in range(9) for b in range(9)}
        assert min(there, key=there.__getitem__) == (truth["place"], truth["other"])


def test_only_a_step_of_both_numbers_may_lead_on(toy):
    """Two supports that must go together: a move of one alone fits worse."""
    toy = toy(places=5, effects=1)
    steps = np.arange(5.0)
    along, across = toy.columns["place"][:, :1] * 1.5, toy.columns["E0"][:, None] * 3.0
    toy = replace(toy, columns={**toy.columns, "place": along * steps + across * steps})
    toy = numbered(toy, along * steps - across * steps).drawn(np.random.default_rng(13), {"place": 4, "other": 4})
    found = nearest_whole(toy.question(()), toy.base.values)
    assert (found["place"], found["other"]) == (4, 4)


def test_whole_numbers_that_cannot_be_evaluated_are_not_chosen(toy):
    toy = smooth(toy(places=6)).drawn(np.random.default_rng(14), {"place": 5})
    bad = replace(toy, fails=lambda values: values["place"] == 4)
    assert nearest_whole(toy.question(()), {**toy.base.values, "place": 2})["place"] == 5
    assert nearest_whole(bad.question(()), {**toy.base.values, "place": 2})["place"] == 3
    plain = toy.question(()).space.freeze({"place": 1})
    assert nearest_whole(replace(toy.question(()), space=plain), {"P0": 0.3}) == plain.complete({"P0": 0.3})


def test_a_start_outside_the_limits_is_moved_in(toy):
    toy = toy().drawn(np.random.default_rng(9))
    far = toy.calibrated("E0", start={"P1": 400.0, "E0": -3.0})
    near = toy.calibrated("E0")
    assert far.misfit == pytest.approx(near.misfit, abs=4e-3)
    for p in far.question.space.parameters:
        assert p.lower <= far.values[p.name] <= p.upper


def test_a_start_that_cannot_be_evaluated_is_said(toy):
    toy = replace(toy(), fails=lambda values: True)
    with pytest.raises(EvaluationError, match="cannot start"):
        toy.calibrated()


def test_a_curved_model_is_followed_to_its_optimum(toy):
    toy = toy(curvature=0.05).drawn(np.random.default_rng(10))
    state = toy.calibrated()
    gradient = (state.slope * state.prior_sd).T @ state.residual - state.shift
    step = np.linalg.solve(state.scaled_information, gradient)
    assert gradient @ step < 2e-3
    assert state.misfit < toy.calibrated(start={"P0": 2.0}).misfit + 4e-3
