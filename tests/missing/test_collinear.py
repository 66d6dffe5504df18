"""Grouping of collinear effects."""

from dataclasses import replace

import numpy as np
import pytest

from calib.missing.collinear import grouped
from calib.missing.score import scores


def found(toy):
    fit_problems = {e.name: toy.fit_problem((e.name,)) for e in toy.effects if e.grid}
    return scores(toy.calibrated(), toy.effects, fit_problems)


def mixed(toy, name, of, share, seed=1):
    """The toy with a column that correlates with another one by ``share``."""
    other = np.random.default_rng(seed).standard_normal(len(toy.rows))
    for known in [*(p.name for p in toy.base.parameters), of]:
        v = toy.columns[known]
        other -= v * (v @ other) / (v @ v)
    one = toy.columns[of]
    column = share * one + np.sqrt(1 - share**2) * np.linalg.norm(one) * other / np.linalg.norm(other)
    return replace(toy, columns={**toy.columns, name: 3.0 * column})


@pytest.fixture
def apart(toy):
    """Parameters orthogonal to all effects, so that what correlates before projection does after it."""
    one = toy(effects=4, parameters=2)
    names = ["P0", "P1", "E0", "E1", "E2", "E3"]
    q = np.linalg.qr(np.column_stack([one.columns[n] for n in names]))[0]
    return replace(one, columns={**one.columns, **{n: 8 * q[:, k] for k, n in enumerate(names)}})


def names(groups):
    return {g.effect.name: g.names[1:] for g in groups}


def test_effects_are_grouped_beyond_the_threshold(apart):
    for share, others in ((0.95, {}), (0.99, {"E0": ("E2",)})):
        toy = mixed(apart, "E2", "E0", share)
        assert {k: v for k, v in names(grouped(toy.effects, found(toy), 0.98)).items() if v} == others
    assert len(grouped(apart.effects, found(apart), 0.98)) == 4


def test_the_largest_score_leads_whatever_the_order(apart):
    toy = mixed(mixed(apart, "E3", "E1", 0.995), "E0", "E1", 0.995, seed=2)
    for largest in ("E0", "E1", "E3"):
        one = replace(toy, data=0.3 * toy.columns[largest])
        at = found(one)
        others = {"E0", "E1", "E3"} - {largest}
        for effects in (one.effects, one.effects[::-1]):
            groups = names(grouped(effects, at, 0.98))
            assert {k: set(v) for k, v in groups.items()} == {largest: others, "E2": set()}
    assert list(names(grouped(toy.effects, found(toy), 0.98))) == ["E0", "E2"]  # all scores are zero: by name


@pytest.mark.parametrize(("score", "joined"), [(0.0, True), (10.0, True), (13.0, False), (60.0, False)])
def test_a_strong_signal_tells_collinear_effects_apart(apart, score, joined):
    """Beyond an expected Bayes factor of 20:1: z sqrt(1 - 0.98) > sqrt(6), or z > 12.3 at a correlation of 0.98."""
    toy = mixed(apart, "E2", "E0", 0.9801)
    toy = replace(toy, data=score * toy.columns["E0"] / np.linalg.norm(toy.columns["E0"]))
    at = found(toy)
    assert abs(at.z[at.best("E0")]) == pytest.approx(score, rel=1e-6, abs=1e-9)
    assert (names(grouped(toy.effects, at, 0.98)).get("E0") == ("E2",)) == joined


def test_an_effect_collinear_with_two_joins_the_first(apart):
    both = np.column_stack([apart.columns["E0"], apart.columns["E1"]])
    turn = np.deg2rad([0.0, 40.0, 20.0])
    columns = {f"E{k}": both @ [np.cos(t), np.sin(t)] for k, t in enumerate(turn)}
    toy = replace(apart, columns={**apart.columns, **columns})
    assert names(grouped(toy.effects, found(toy), 0.9)) == {"E0": ("E2",), "E1": (), "E3": ()}


@pytest.mark.parametrize(("signed", "joined"), [((), False), (("E0",), False), (("E0", "E2"), True)])
def test_opposite_signatures_are_told_apart_by_their_sign(apart, make_effect, signed, joined):
    toy = mixed(apart, "E2", "E0", -0.999)
    toy = replace(toy, effects=tuple(make_effect(e.name, signed=e.name in signed) for e in toy.effects))
    assert (len(grouped(toy.effects, found(toy), 0.98)) == 3) == joined


def test_collinearity_is_that_after_projection(apart):
    """Two effects of different signatures whose difference a parameter absorbs."""
    toy = mixed(apart, "E2", "E0", 0.999)
    toy = replace(toy, columns={**toy.columns, "P0": 1e4 * toy.columns["P0"]})
    toy = replace(toy, columns={**toy.columns, "E2": toy.columns["E2"] + 0.01 * toy.columns["P0"]})
    a, b = toy.columns["E0"], toy.columns["E2"]
    assert abs(a @ b) / np.linalg.norm(a) / np.linalg.norm(b) < 0.5
    assert names(grouped(toy.effects, found(toy), 0.98))["E0"] == ("E2",)


def test_effects_with_a_nuisance_parameter_stay_by_themselves(toy):
    toy = toy(bump=True, effects=2)
    bump = toy.bumps["hung"]
    toy = replace(toy, columns={**toy.columns, "E1": bump.at({"at": 3.0})})
    toy = toy.drawn(np.random.default_rng(1), {"hung": 4.0, "at": 3.0})
    at = found(toy)
    assert at.unit[:, at.best("hung")] @ at.unit[:, at.best("E1")] > 0.99
    assert names(grouped(toy.effects, found(toy), 0.5))["hung"] == ()


def test_absorbed_effects_are_not_grouped(toy):
    toy = toy(effects=3, reach=1e8)
    columns = {**toy.columns, "E0": toy.columns["P0"] * 1e-8, "E1": toy.columns["P0"] * 1e-8}
    toy = replace(toy, columns=columns)
    assert len(grouped(toy.effects, found(toy), 0.98)) == 3


def test_a_score_of_an_impossible_sign_neither_leads_nor_joins(apart, make_effect):
    """E0 explains the data with an impossible sign; E2 is collinear with it and may have either."""
    toy = mixed(apart, "E2", "E0", 0.9999)
    toy = replace(toy, effects=tuple(make_effect(e.name, signed=e.name == "E2") for e in toy.effects))
    toy = replace(toy, data=-40.0 * toy.columns["E0"] / np.linalg.norm(toy.columns["E0"]))
    at = found(toy)
    assert at.z[at.best("E0")] < -35 and at.magnitude[at.best("E2")] > 35
    groups = names(grouped(toy.effects, at, 0.98))
    assert groups["E2"] == () and groups["E0"] == ()
    still = replace(toy, data=0.02 * toy.data)  # below one standard deviation the sign is not significant
    assert len(grouped(still.effects, found(still), 0.98)) == 3
