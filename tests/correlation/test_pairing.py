import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from calib.correlation.modal.pairing import pair_by_order, pair_by_shape
from calib.errors.errors import InputError
from calib.measurement.mac import mac

seeds = st.integers(0, 2**32 - 1)


def pair(emac, **options):
    emac = np.asarray(emac, dtype=float)
    return pair_by_shape(emac, emac, [f"M{i}" for i in range(len(emac))], **options)


@given(seeds, st.integers(1, 4), st.integers(1, 4))
def test_no_other_one_to_one_choice_above_the_threshold_is_better(seed, n, m):
    emac = np.random.default_rng(seed).uniform(size=(n, m))
    found = pair(emac)
    best = 0.0
    for choice in itertools.product(range(-1, m), repeat=n):
        used = [j for j in choice if j >= 0]
        if len(set(used)) == len(used) and all(j < 0 or emac[i, j] >= 0.3 for i, j in enumerate(choice)):
            best = max(best, sum(emac[i, j] for i, j in enumerate(choice) if j >= 0))
    assert np.nansum(found.emac) == pytest.approx(best)
    used = found.model_index[found.model_index >= 0]
    assert len(set(used)) == len(used) and np.all(found.emac[found.paired] >= 0.3)


def test_a_pair_below_the_threshold_cannot_take_a_partner_away():
    # The largest unrestricted sum is 0.29 + 0.29 > 0.5, which would leave nobody paired.
    found = pair([[0.50, 0.29], [0.29, 0.0]])
    assert found.model_index.tolist() == [0, -1]
    assert found.unpaired_measured.tolist() == [1]
    assert np.isnan(found.mac[1]) and np.isnan(found.emac[1]) and np.isnan(found.margin[1])


def test_margin_is_the_distance_to_the_next_best_model_mode():
    found = pair([[0.9, 0.6, 0.1], [0.8, 0.7, 0.0]])
    assert found.model_index.tolist() == [0, 1]
    np.testing.assert_allclose(found.margin, [0.3, -0.1])
    assert pair([[0.7]]).margin[0] == pytest.approx(0.7)


def test_without_energy_nothing_is_paired_even_at_threshold_zero():
    assert pair([[0.0, 0.0]], threshold=0.0).model_index.tolist() == [-1]


def test_more_measured_than_model_modes_and_ties_are_accepted():
    assert sorted(pair(np.full((3, 2), 0.5)).model_index.tolist()) == [-1, 0, 1]
    assert pair(np.full((2, 2), 0.5)).margin.tolist() == [0.0, 0.0]
    assert pair(np.zeros((2, 0))).model_index.tolist() == [-1, -1]


@given(seeds)
def test_pairs_follow_the_modes_through_order_sign_scale_and_phase(seed):
    rng = np.random.default_rng(seed)
    model = rng.standard_normal((8, 5)) + 1j * rng.standard_normal((8, 5))
    measured = model[:, [3, 0, 4]] + 0.1 * rng.standard_normal((8, 3))
    order, shuffle = rng.permutation(5), rng.permutation(3)
    names = ["a", "b", "c"]
    criterion = mac(measured, model)
    factors = rng.uniform(0.1, 10, 5) * np.exp(2j * np.pi * rng.uniform(size=5))
    other = mac((measured * [-1, 1j, 7])[:, shuffle], (model * factors)[:, order])
    first = pair_by_shape(criterion, criterion, names)
    second = pair_by_shape(other, other, names)
    assert first.model_index.tolist() == [3, 0, 4]
    assert order[second.model_index].tolist() == first.model_index[shuffle].tolist()
    np.testing.assert_allclose(second.margin, first.margin[shuffle], atol=1e-10)


def test_repeated_eigenvalues_with_any_mixture_of_their_shapes_pair_without_a_crash():
    t = np.radians(45)
    mixed = np.array([[np.cos(t), -np.sin(t)], [np.sin(t), np.cos(t)]])
    found = pair(mac(np.eye(2), mixed))
    assert sorted(found.model_index.tolist()) == [0, 1]
    assert np.max(np.abs(found.margin)) < 1e-12  # the margin shows that the choice is arbitrary


def test_the_users_choice_comes_first():
    found = pair([[0.9, 0.1, 0.4], [0.8, 0.2, 0.0]], override={"M1": 1})
    assert found.model_index.tolist() == [2, 0]
    assert found.emac.tolist() == [0.4, 0.8]
    assert found.margin[0] == pytest.approx(0.4 - 0.9)
    assert pair([[0.9, 0.1]], override={"M0": 2}).model_index.tolist() == [1]  # even below the threshold


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ({"M0": 0}, "from 1 to 2"),
        ({"M0": 3}, "from 1 to 2"),
        ({"M0": 1.5}, "from 1 to 2"),
        ({"M0": 1, "M1": 1}, "chosen for two"),
        ({"X": 1}, "the measured modes are M0, M1"),
    ],
)
def test_an_impossible_choice_is_refused(override, words):
    with pytest.raises(InputError, match=words):
        pair(np.full((2, 2), 0.5), override=override)


def test_only_candidates_are_paired_and_count_for_the_margin():
    found = pair([[0.9, 0.6, 0.5]], candidates=np.array([False, True, True]))
    assert found.model_index.tolist() == [1] and found.margin[0] == pytest.approx(0.1)


def test_order_pairs_ascending_frequencies_inside_the_window():
    measured, model = np.array([12.0, 3.0, 7.0]), np.array([0.1, 3.2, 6.0, 11.0, 30.0])
    names = ["c", "a", "b"]

    def pairs(**options):
        return pair_by_order(measured, model, names, **options)[0]

    assert pairs().model_index.tolist() == [3, 1, 2] and np.all(np.isnan(pairs().emac))
    assert pairs(window=(5.0, 20.0)).model_index.tolist() == [3, -1, 2]
    assert pairs(override={"a": 3}).model_index.tolist()[1] == 2
    assert pairs(followed={0: 4, 1: -1}).model_index.tolist() == [4, -1, 2]
    assert pairs(followed={0: 2}, override={"a": 3}).model_index.tolist()[:2] == [-1, 2]


def test_a_pair_of_far_frequencies_gives_way_to_a_nearer_one():
    """With few sensors a mode a hundred times higher may have the same shape there."""
    emac = np.array([[0.90, 0.99, 0.1], [0.1, 0.0, 0.8]])
    far = np.log([[1.1, 200.0, 4.0], [0.3, 50.0, 1.0]])
    assert pair(emac).model_index.tolist() == [1, 2]
    assert pair(emac, log_ratio=far).model_index.tolist() == [0, 2]
    assert pair(emac[:, 1:], log_ratio=far[:, 1:]).model_index.tolist() == [-1, 1]


@given(seeds)
def test_frequencies_within_a_factor_of_two_change_no_pair(seed):
    rng = np.random.default_rng(seed)
    emac = rng.uniform(size=(4, 6))
    near = rng.uniform(-np.log(2), np.log(2), (4, 6))
    assert pair(emac, log_ratio=near).model_index.tolist() == pair(emac).model_index.tolist()


def test_a_factor_common_to_all_pairs_does_not_exclude_them():
    """Frequencies in rad/s, or of a model in other units."""
    ratio = np.log(np.outer(1 / np.array([3.0, 5.0, 8.0]), 2 * np.pi * np.array([3.1, 4.9, 8.1])))
    emac = 0.9 * np.eye(3) + 0.35 * np.eye(3, k=1)
    assert pair(emac, log_ratio=ratio).model_index.tolist() == [0, 1, 2]
