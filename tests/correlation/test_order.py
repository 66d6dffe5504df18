"""Pairing without shapes, by the order of frequencies."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib.correlation.modal.order import Costs, align_in_order
from calib.correlation.rules import RULES

seeds = st.integers(0, 2**32 - 1)

TRUE = np.array([4.1, 6.3, 9.7, 11.2, 15.8, 21.0, 23.5])


def partners(measured, model):
    return align_in_order(np.asarray(measured), np.asarray(model)).partners.tolist()


@pytest.mark.parametrize("factor", [1.0, 0.9, 1.15, 2 * np.pi, 1e3])
def test_a_factor_common_to_all_modes_shifts_none(factor):
    noise = 1 + 0.01 * np.random.default_rng(0).standard_normal(len(TRUE))
    assert partners(TRUE, TRUE * factor * noise) == list(range(7))


@pytest.mark.parametrize("missed", range(7))
def test_a_mode_that_the_test_missed_shifts_no_other(missed):
    measured = np.delete(TRUE, missed)
    assert partners(measured, TRUE * 1.01) == [k for k in range(7) if k != missed]


@pytest.mark.parametrize("extra", range(7))
def test_a_mode_that_the_model_lacks_shifts_no_other(extra):
    model = np.delete(TRUE, extra) * 1.01
    found = partners(TRUE, model)
    assert found == [*range(extra), -1, *range(extra, 6)]


def test_rigid_body_modes_near_zero_are_not_paired():
    for few in (1, 2, 7):
        rigid = [1e-5, 2e-4, 1e-3, 2e-3, 0.3, 0.6]
        assert partners(TRUE[:few], [*rigid, *(1.05 * TRUE)]) == list(range(6, 6 + few))


def test_one_mode_with_a_large_error_keeps_its_place():
    model = TRUE.copy()
    model[2] *= 1.13
    assert partners(TRUE, model) == list(range(7))
    assert partners([10.0], [14.0]) == [0]


def test_empty_lists_are_accepted():
    assert partners([], TRUE) == [] and partners(TRUE, []) == [-1] * 7
    assert partners([3.0], [0.0, 3.1]) == [1]


@given(seeds, st.integers(1, 4), st.integers(1, 4))
@settings(max_examples=40)
def test_no_other_ascending_choice_costs_less(seed, n, m):
    rng = np.random.default_rng(seed)
    measured, model = np.sort(rng.uniform(2, 30, n)), np.sort(rng.uniform(2, 30, m))
    costs = Costs(rng.uniform(-0.2, 0.2), rng.choice(RULES.order_scales))

    def cost(choice):
        paired = [j for j in choice if j >= 0]
        d = np.array([np.log(model[j] / measured[i]) for i, j in enumerate(choice) if j >= 0])
        out = np.sum(np.log(2 * costs.scale) + np.abs(d - costs.common) / costs.scale)
        out += RULES.skip_measured * (n - len(paired))
        counted = np.log(model / measured[0]) - costs.common > -np.log(RULES.near_zero)
        last = -1
        for j in paired:
            run = np.sum(counted[:j]) if last < 0 else j - last - 1
            out += (RULES.skip_model + RULES.skip_model_more * (run - 1)) if run else 0.0
            last = j
        return out

    ascending = [
        choice
        for choice in itertools.product(range(-1, m), repeat=n)
        if all(a < b for a, b in itertools.pairwise([j for j in choice if j >= 0]))
    ]
    found = align_in_order(measured, model, costs).partners.tolist()
    assert cost(found) == pytest.approx(min(map(cost, ascending)))
