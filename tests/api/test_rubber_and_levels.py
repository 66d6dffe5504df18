"""Rubber that is lossy or relaxes, and mounts that soften with the level: named, with an interval that holds the truth.

The measurements are synthetic: another mesh, other parameters, a law of the mounts that is not the effect's own, noise
and five repeats; see `mounted_beam`.
"""

import runpy
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.structure.amplitude import amplitude_dependence, level, with_level
from calib.structure.rubber import relaxing_rubber, structural_damping

BEAM = runpy.run_path(str(Path(__file__).with_name("mounted_beam.py")))
MOUNTS = ["k_left", "k_right"]
LEVEL = level(1.0)
LOSS = structural_damping("mount_loss", "the mounts", MOUNTS, band=(5.0, 100.0))
RELAXING = relaxing_rubber("relaxing", "the mounts", MOUNTS, corner=(2.0, 60.0))
SOFTENING = amplitude_dependence("softening", "the mounts", MOUNTS, LEVEL)
DAMPERS = amplitude_dependence("fading", "the mounts' dampers", ["c_mount"], LEVEL, "damping", 0.3)
LIBRARY = (*BEAM["library"](), LOSS, RELAXING)


def constant_loss(eta):
    """``(lambda/w)^a/cos(a pi/2)``: exactly one loss factor (Kjartansson 1979), which the effect approximates."""
    a, w = 2 / np.pi * np.arctan(eta), 2 * np.pi * np.sqrt(5.0 * 100.0)
    return lambda lam: (lam / w) ** a / np.cos(a * np.pi / 2)


def explained(folder, seed, law=lambda lam: 1.0):
    test = calib.ModalTest(BEAM["tested"](folder, seed, law))
    return calib.Problem(BEAM["model"](), test).explain(LIBRARY, progress=False)


def at_two_levels(folder, seed, low=lambda lam: 1.0, high=lambda lam: 1.0, **at_high):
    """Tests of one beam at levels 0 and 1."""
    slow = BEAM["tested"](folder / "low", seed, low)
    fast = BEAM["tested"](folder / "high", seed + 1, high, **at_high)
    tests = [
        calib.ModalTest(slow, name="low", condition={"level": 0.0}),
        calib.ModalTest(fast, name="high", condition={"level": 1.0}),
    ]
    return calib.Problem(with_level(BEAM["model"](), LEVEL), tests)


def interval(why, name):
    row = why.table.set_index("name").loc[name]
    return float(row["magnitude_low"]), float(row["magnitude_high"])


@pytest.mark.slow
@pytest.mark.parametrize("eta", [0.1, 0.2])
def test_a_constant_loss_factor_is_named_with_its_size(tmp_path, eta):
    why = explained(tmp_path, 4, constant_loss(eta))
    assert why.verdict == "effect" and [e.name for e in why.named] == ["mount_loss"]
    low, high = interval(why, "mount_loss")
    assert low < eta < high and high - low < 0.05
    assert "structural damping of the mounts" in str(why)


@pytest.mark.slow
def test_relaxing_rubber_is_named_with_its_size(tmp_path):
    why = explained(tmp_path, 3, lambda lam: 1 + 0.5 * lam / (lam + 2 * np.pi * 15.0))
    assert why.verdict == "effect" and [e.name for e in why.named] == ["relaxing"]
    low, high = interval(why, "relaxing")
    assert low < 0.5 < high and high - low < 0.1


@pytest.mark.slow
def test_mounts_of_springs_alone_are_left_alone(tmp_path):
    why = explained(tmp_path, 3)
    assert why.verdict == "nothing_detectable" and not why.named


@pytest.mark.slow
@pytest.mark.parametrize("share", [0.08, -0.05])
def test_mounts_that_change_with_the_level_are_named(tmp_path, share):
    problem = at_two_levels(tmp_path, 12, high=lambda lam: 1 - share)
    why = problem.explain((*LIBRARY, SOFTENING, DAMPERS), progress=False)
    assert why.verdict == "effect" and [e.name for e in why.named] == ["softening"]
    low, high = interval(why, "softening")
    assert low < share < high and high - low < 0.02


@pytest.mark.slow
def test_dampers_that_change_with_the_level_are_named(tmp_path):
    problem = at_two_levels(tmp_path, 21, c_mount=0.6 * BEAM["TRUE"]["c_mount"])
    why = problem.explain((*LIBRARY, SOFTENING, DAMPERS), progress=False)
    assert why.verdict == "effect" and [e.name for e in why.named] == ["fading"]
    low, high = interval(why, "fading")
    assert low < 0.4 < high


@pytest.mark.slow
def test_without_dependence_on_the_level_nothing_is_named(tmp_path):
    why = at_two_levels(tmp_path, 11).explain((*LIBRARY, SOFTENING, DAMPERS), progress=False)
    assert why.verdict == "nothing_detectable" and not why.named


@pytest.mark.medium
def test_the_level_of_two_tests_gives_the_share_that_is_lost(tmp_path):
    """A fit without a search; at one level the share is that of the mounts' own stiffness, and not identified."""
    problem = at_two_levels(tmp_path, 12, high=lambda lam: 1 - 0.08)
    assert "level" not in problem.space
    fit = problem.with_effects([SOFTENING]).calibrate(starts=1, progress=False)
    row = fit.parameters.loc["softening"]
    assert abs(row["value"] - 0.08) < 3 * row["std"] < 0.02 and row["identified"]
    alone = calib.Problem(problem.model, problem.tests[1]).with_effects([SOFTENING]).calibrate(starts=1, progress=False)
    assert alone.parameters.loc["softening", "std"] > 5 * row["std"]
