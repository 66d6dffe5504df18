"""Faults of pairs of channels or modes, thousands of them, are a family of their own among the candidates."""

from dataclasses import replace

import numpy as np
import pytest

from calib.missing.adequacy import adequacy_of, beside
from calib.missing.decision import decide
from calib.missing.refits import Refits
from calib.missing.rules import RULES
from calib.missing.score import scores
from calib.missing.screened import screened_candidates, screened_p
from calib.missing.settings import DEFAULT
from calib.missing.tables import faults_table
from tests.missing.verdict_cases import text_of

pytestmark = pytest.mark.usefixtures("fewer_samples")
PAIRS = 400


def with_pairs(made, number=PAIRS, whole=False):
    """The toy with faults of pairs X0.. of random directions in a third of its rows each."""
    rng = np.random.default_rng(11)
    columns, faults = {}, []
    for k in range(number):
        column = rng.standard_normal(len(made.rows)) * (rng.random(len(made.rows)) < 0.3)
        columns[f"X{k}"] = 8.0 * column / np.linalg.norm(column)
        p = replace(made.faults[0].magnitude, name=f"X{k}")
        one = replace(made.faults[0], name=f"X{k}", title=f"X{k}", magnitude=p)
        for name, value in {"of_measurement": True, "of_pair": True, "whole": whole, "kind": "exchange"}.items():
            object.__setattr__(one, name, value)
        faults.append(one)
    return replace(made, columns={**made.columns, **columns}, faults=(*made.faults, *faults))


def refits(made):
    return Refits(made, DEFAULT, 1.0, lambda *told: None)


def adequacy(made):
    fits = refits(made)
    base = fits.candidate_fit((), made.base.values)
    return adequacy_of(fits, base, beside(fits, base, made.effects))


def test_screened_scores_are_those_of_all_candidates(faulty):
    made = with_pairs(faulty()).drawn(np.random.default_rng(1), {"X7": 1.0})
    base = refits(made).candidate_fit((), made.base.values)
    pairs = [e for e in made.faults if e.of_pair]
    found, every = screened_candidates(base.fit, pairs, ("X399",)), scores(base.fit, pairs, {})
    order = np.argsort(-every.magnitude, kind="stable")
    assert found.number == PAIRS and found.tests == 2 * PAIRS
    assert found.scores.owners[:-1] == tuple(every.owners[k] for k in order[: RULES.screened])
    assert found.scores.owners[0] == "X7" and found.scores.owners[-1] == "X399"
    np.testing.assert_allclose(found.scores.z[:-1], every.z[order[: RULES.screened]])


@pytest.mark.medium
def test_the_p_value_of_many_is_one(faulty):
    """With standard deviations from few repeats too: all candidates share their error."""
    made, small = with_pairs(faulty()), 0
    for few in (np.inf, 6.0):
        own = replace(made, std_dof={row.kind: few for row in made.rows})
        for seed in range(30):
            rng = np.random.default_rng(seed)
            factor = np.sqrt(few / rng.chisquare(few)) if np.isfinite(few) else 1.0
            one = own.drawn(rng, noise=factor)
            base = refits(one).candidate_fit((), one.base.values)
            small += screened_p(screened_candidates(base.fit, [e for e in one.faults if e.of_pair]), one, seed) <= 0.1
    assert 1 <= small <= 6 + 3 * np.sqrt(6)  # of 60; the bound is on the safe side


@pytest.mark.medium
def test_tests_of_effects_and_of_single_faults_are_the_same(faulty):
    made, many = faulty(), with_pairs(faulty())
    for seed in range(4):
        before, tests = (adequacy(one.drawn(np.random.default_rng(seed))) for one in (made, many))
        assert tests.p_named == before.p_named and tests.p_perturbations == before.p_perturbations
        assert before.p_faults <= tests.p_faults <= before.p_faults / (1 - RULES.pairs_share)
        assert tests.p_family <= min(1.0, before.p_family / (1 - RULES.pairs_share))


@pytest.mark.slow
def test_limits_of_effects_and_of_single_faults_do_not_rise(faulty):
    """Of 20 of each near the limit as many are named beside 400 faults of pairs as without them."""
    made = faulty()
    many, named = with_pairs(made), {}
    for name, one in (("without", made), ("with", many)):
        rng = np.random.default_rng(5)
        drawn = [one.drawn(rng, {cause: 0.62}) for cause in ("E1", "F2") for _ in range(20)]
        found = [decide(case) for case in drawn]
        named[name] = [(f.verdict, f.credible, f.blamed[0].names if f.blamed else ()) for f in found]
    same = sum(a == b for a, b in zip(named["without"], named["with"], strict=True))
    right = {name: sum(c == ("E1",) or b == ("F2",) for _, c, b in told) for name, told in named.items()}
    assert 10 <= right["without"] <= 36 and abs(right["with"] - right["without"]) <= 1 and same >= 37


@pytest.mark.medium
def test_a_fault_of_a_pair_is_told_alone_and_beside_an_effect(faulty):
    made = with_pairs(faulty())
    alone = decide(made.drawn(np.random.default_rng(1), {"X7": 1.5}))
    assert alone.verdict == "measurement" and alone.blamed[0].names == ("X7",) and not alone.remains
    assert f"{PAIRS} more of pairs of channels or modes" in text_of(alone)
    both = decide(made.drawn(np.random.default_rng(1), {"E1": 1.5, "X7": 1.5}))
    assert both.verdict == "effect" and both.credible == ("E1",) and [f.name for f, _ in both.faulty] == ["X7"]
    two = decide(made.drawn(np.random.default_rng(1), {"F2": 2.0, "X7": 1.5}))
    assert two.verdict == "measurement" and {f.name for f, _ in two.faulty} == {"F2", "X7"}


def test_a_pair_pays_for_their_number(faulty):
    made = with_pairs(faulty())
    fits = refits(made)
    rarer = np.log((1 - RULES.pairs_share) / RULES.pairs_share * PAIRS / 6)
    assert fits.family.price(("X7",)) == pytest.approx(rarer) and fits.family.price(("F2",)) == 0.0
    fit = fits.candidate_fit(("X7",), made.base.values)
    free = replace(fits, hypotheses=replace(made, faults=tuple(e for e in made.faults if e.name in ("F0", "X7"))))
    alone = np.log((1 - RULES.pairs_share) / RULES.pairs_share)  # one pair beside one single fault
    known = free.candidate_fit(("X7",), made.base.values).ln_evidence
    assert fit.ln_evidence == pytest.approx(known - rarer + alone)


@pytest.mark.medium
def test_a_part_of_an_exchange_is_none(faulty):
    made = with_pairs(faulty(), whole=True)
    whole, part = (decide(made.drawn(np.random.default_rng(2), {"X7": size})) for size in (1.0, 2.5))
    assert whole.verdict == "measurement" and whole.blamed[0].names == ("X7",)
    assert part.faulty == () and part.verdict != "measurement"


def test_the_table_lists_the_largest_of_pairs_with_their_limit(faulty):
    made = with_pairs(faulty())
    found = decide(made.drawn(np.random.default_rng(1), {"X7": 1.5}))
    nowhere = ("exchange", (np.nan,) * 3, "")
    table = faults_table(found, {e.name: nowhere for e in made.faults}, {e.name: e for e in made.faults})
    assert len(table) == 6 + RULES.screened and table["fault"][0] == "X7" and table["blamed"][0]
    limits = table.set_index("fault")["limit"]
    assert limits["F0"] == pytest.approx(3.14, abs=0.01) and limits["X7"] == pytest.approx(4.21, abs=0.02)
