"""Residues, refined poles and shapes of modal models, against eigenvectors and differences."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.modal_analysis import model as subject
from calib.modal_analysis.model import fit_residues, most_likely_model, rank_one
from calib.study.loading import module_of

ROOT = Path(__file__).resolve().parents[2]
WORLDS = module_of(ROOT / "tests/template/modal_worlds.py")
PAIR = WORLDS.heavy_pair(0.1)
TRUE, SHAPES = WORLDS.roots(*PAIR)


def test_residues_at_the_true_poles_are_those_of_the_eigenvectors():
    frfs, _ = WORLDS.pair_test(0.1, 0.0)
    found = fit_residues(frfs, TRUE)
    expected = WORLDS.residues(*PAIR)[:, :, :2]
    np.testing.assert_allclose(found.residues, expected, atol=2e-3 * np.abs(expected).max())
    np.testing.assert_allclose(found.synthesised, frfs.values, atol=1e-3 * np.abs(frfs.values).max())


def test_refined_poles_are_unbiased_where_those_of_the_start_are_not():
    frfs, _ = WORLDS.pair_test(0.1, 0.03, seed=4)
    size, ratio = np.abs(TRUE) * np.array([1.01, 0.99, 1.001]), -TRUE.real / np.abs(TRUE) * np.array([0.8, 1.3, 0.9])
    found = most_likely_model(frfs, size * (-ratio + 1j * np.sqrt(1 - ratio**2)))
    assert len(found.poles) == 5
    np.testing.assert_allclose(found.poles[:3], TRUE, rtol=2e-3)
    ends = np.abs(found.poles[3:]) / (2 * np.pi)
    assert ends[0] <= frfs.freq[0] and ends[1] >= frfs.freq[-1]


def test_the_gradient_of_the_squares_is_that_of_differences():
    frfs, _ = WORLDS.pair_test(0.1, 0.02)
    weighed = subject.weighed(frfs)
    x = np.concatenate([np.log(np.abs(TRUE) * 1.01), np.log(-TRUE.real / np.abs(TRUE) * 0.9)])
    residual, jacobian = subject.projected(frfs, subject.poles_of(x), weighed)
    step = 1e-5

    def squares(at):
        return float(np.sum(subject.projected(frfs, subject.poles_of(at), weighed)[0] ** 2))

    for k, along in enumerate(step * np.eye(len(x))):
        sums = squares(x + along), squares(x - along)
        assert 2 * residual @ jacobian[:, k] == pytest.approx((sums[0] - sums[1]) / (2 * step), rel=1e-4)


def test_noisy_functions_weigh_little():
    clean, _ = WORLDS.pair_test(0.1, 0.0)
    std = np.full(clean.values.shape, 1e-3)
    std[:, 2] = 10.0
    values = clean.values.copy()
    values[:, 2] *= 1.5
    found = most_likely_model(replace(clean, values=values, std=std), TRUE * 1.003).poles[:3]
    np.testing.assert_allclose(found, TRUE, rtol=1e-3)


def test_one_shape_describes_the_residues_of_one_mode_and_not_those_of_two():
    rng = np.random.default_rng(0)
    a, b = rng.standard_normal((2, 5)) + 1j * rng.standard_normal((2, 5))
    part = rng.standard_normal((2, 3)) + 1j * rng.standard_normal((2, 3))
    one = np.outer(a, part[0])
    one[1, 2] = one[4, 0] = np.nan  # not measured
    shape, participation, share = rank_one(one)
    assert share == pytest.approx(1.0, abs=1e-12)
    np.testing.assert_allclose(np.outer(shape, participation), np.outer(a, part[0]), rtol=1e-6)
    two = np.outer(a, part[0]) + np.outer(b, part[1])
    first = np.linalg.svd(two, compute_uv=False) ** 2
    assert rank_one(two)[2] == pytest.approx(first[0] / first.sum(), abs=1e-6)
