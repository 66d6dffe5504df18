"""Model updating by cross-model equations under noise of receptance and frequencies."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from calib.inference.cmcf import cmcf
from calib.inference.cmcf_equations import CmcfSettings, Equations, Reduced
from calib.study.loading import module_of

CASES = module_of(Path(__file__).parents[1] / "template/updated.py")


@pytest.fixture(scope="module")
def array():
    return CASES.Array()


def iterated(array, seed, iteration):
    """Largest frequency error of six orders in %, its means, and steps until all errors stay within 0.1 %."""
    found = cmcf(array.initial, array.noisy(CASES.SYMMETRIC, seed), replace(CASES.ALL_STEPS, iteration=iteration))
    errors = np.array([100 * (array.freq(c, 6) / array.freq(CASES.SYMMETRIC, 6) - 1) for c in found.changes[1:]])
    settled = np.all(np.abs(errors - errors[-1]) < 0.1, axis=1)
    return np.abs(errors[-1]), 1 + max((k + 1 for k, near in enumerate(settled) if not near), default=0)


@pytest.mark.slow
@pytest.mark.parametrize("seeds", [4, pytest.param(20, marks=pytest.mark.slow)])
def test_noise_of_receptance_and_frequencies(array, seeds):
    """5 % noise of the receptance and 3 % of the frequencies; this geometry, offset and weighting."""
    errors, steps = zip(*(iterated(array, seed, "proposed") for seed in range(seeds)), strict=True)
    worst = np.max(errors, axis=1)
    assert worst.max() <= 4.5 and np.median(worst) <= 3.0 and np.median(steps) <= 3
    before = np.abs(100 * (array.freq(np.zeros(6), 6) / array.freq(CASES.SYMMETRIC, 6) - 1))
    assert np.all(np.mean(errors, axis=0) <= before / 4)


def test_white_weights_give_equal_noise_to_the_equations_of_all_lines(array):
    """Multiplicative noise of the receptance of a model that is right: the imbalance is noise alone."""
    reduced, true = Reduced.of(array.initial, np.zeros(6)), array.consistent(np.zeros(6), 0.02)
    spread = {}
    for weighting in ("white", "block", "none"):
        equations = Equations.at(reduced, true, CmcfSettings(weighting=weighting))
        squares = 0.0
        for seed in range(20):
            noise = 1 + 0.01 * np.random.default_rng(seed).uniform(-1, 1, true.receptance.shape)
            imbalance = reduced.imbalance(replace(true, receptance=true.receptance * noise))
            rows = np.einsum("ipm,jmq,ij->ijpq", equations.left, imbalance, equations.weight)
            squares = squares + np.sum(rows**2, axis=(2, 3))
        spread[weighting] = np.sqrt(squares.max() / squares.min())
    assert spread["white"] < 2 and spread["block"] > 5 and spread["none"] > 100


@pytest.mark.slow
def test_noise_shrinks_the_changes_unless_the_weights_are_white(array):
    """The receptance stands on both sides; block weights let its noise attenuate the changes."""
    true = array.freq(CASES.SYMMETRIC, 6)
    signed = {}
    for weighting in ("white", "block"):
        settings = replace(CASES.ALL_STEPS, weighting=weighting, steps=5)
        errors = [
            array.freq(cmcf(array.initial, array.noisy(CASES.SYMMETRIC, seed), settings).changes[-1], 6) / true - 1
            for seed in range(8)
        ]
        signed[weighting] = 100 * np.mean(errors, axis=0)
    assert np.all(np.abs(signed["white"]) < 2.0) and np.all(signed["block"] < -3.0)


@pytest.mark.slow
def test_the_traditional_iteration_settles_later_under_noise(array):
    """True of this configuration alone: without noise the order depends on the weighting."""
    steps = {
        iteration: np.median([iterated(array, seed, iteration)[1] for seed in range(20)])
        for iteration in ("proposed", "traditional")
    }
    assert steps["traditional"] >= 2 * steps["proposed"]
