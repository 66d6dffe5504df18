"""Standard deviations of measured modes, and the assumptions reported with them."""

from dataclasses import replace

import numpy as np
import pytest

from calib.correlation.standard_deviations import Floors, assumed_deviations, dof_behind, std_for
from calib.measurement.accuracy import Accuracy
from calib.measurement.alignment import mean_and_std
from calib.measurement.files.read import read_modes
from calib.problem.degrees_of_freedom import p_value

MODES = "mode,freq,freq_kind,repeat\n" + "".join(
    f"{mode},{value + step},natural,{k}\n"
    for k, step in ((1, 0.0), (2, 0.2), (3, 0.1))
    for mode, value in (("a", 10), ("b", 20), ("c", 30))
    if mode != "c" or k == 1
)


def test_the_reported_standard_deviation_of_a_mode_is_the_one_used(tmp_path):
    """One mode is in one of three repeats: it takes the standard deviation of a single repeat, not that of a mean."""
    file = tmp_path / "modes.csv"
    file.write_text(MODES)
    measured = read_modes([file])
    assert np.isnan(measured.freq_std).tolist() == [False, False, True]
    taken = std_for(measured).freq
    assert taken[2] > 1.5 * np.sqrt(np.mean(taken[:2] ** 2))
    (assumption,) = [a for a in assumed_deviations(measured) if "frequenc" in a.item]
    assert float(assumption.value) == pytest.approx(100 * taken[2], rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("claimed", [True, pytest.param(False, marks=pytest.mark.slow)], ids=["accuracy", "floor"])
def test_few_repeats_beside_a_known_error_reject_as_often_as_the_level_says(tmp_path, claimed):
    """Two repeats with a standard deviation of 0.2 % and an error of 1 % common to all repeats."""
    path = tmp_path / "modes.csv"
    path.write_text("mode,freq,freq_kind,repeat\n" + "".join(
        f"m{i},{10 + i + k / 100},natural,{k}\n" for k in range(2) for i in range(6)
    ))  # fmt: skip
    read = read_modes([path])
    assert read.n_repeats == 2 and read.n_modes == 6
    floors = Floors(freq=0.0 if claimed else 0.01, damping=0.0, shape=0.0)
    rng, truth, p, alone, missed = np.random.default_rng(3), np.linspace(5, 50, 6), [], [], []
    for _ in range(1000):
        shared = 1 + 0.01 * rng.standard_normal(6)
        mean, std = mean_and_std(truth * shared * (1 + 0.002 * rng.standard_normal((2, 6))))
        measured = replace(read, natural_freq=mean, damped_freq=mean, freq_std=std)
        measured = replace(measured, accuracy=Accuracy.of({"freq": "1 %"} if claimed else None))
        behind, taken = dof_behind(measured, "frequency", 6, floors), std_for(measured, floors).freq
        p.append(float(p_value(np.sum((np.log(mean / truth) / taken) ** 2), 6, behind)))
        wrong = np.sum((np.log(mean / (0.97 * truth)) / taken) ** 2)  # three times the error
        missed.append(float(p_value(wrong, 6, behind)) > 0.01)
        alone.append(float(p_value(wrong, 6, 6.0)) > 0.01)
    for level in (0.01, 0.05, 0.5):
        assert np.mean(np.array(p) < level) == pytest.approx(level, abs=4 * np.sqrt(level * (1 - level) / len(p)))
    # With the degrees of freedom of the repeats alone many of these would be accepted.
    assert np.mean(missed) < 0.02 and np.mean(alone) > 0.2


@pytest.mark.parametrize(
    ("repeats", "modes"), [pytest.param(*case, marks=pytest.mark.slow) for case in ((10, 60), (20, 12))]
)
def test_a_correct_model_of_many_repeats_is_rejected_as_often_as_the_level_says(tmp_path, repeats, modes):
    """Each frequency keeps the standard deviation of its own repeats, however different from the others."""
    path = tmp_path / "modes.csv"
    path.write_text("mode,freq,freq_kind,repeat\n" + "".join(
        f"m{i},{10 + i + k / 100},natural,{k}\n" for k in range(repeats) for i in range(modes)
    ))  # fmt: skip
    read = read_modes([path])
    assert (read.n_repeats, read.n_modes) == (repeats, modes)
    none, rng, truth = Floors(freq=0.0, damping=0.0, shape=0.0), np.random.default_rng(8), np.linspace(5, 50, modes)
    spread, p, known = np.geomspace(1e-4, 1e-2, modes), [], []
    for _ in range(2000):
        mean, std = mean_and_std(truth * (1 + spread * rng.standard_normal((repeats, modes))))
        measured = replace(read, natural_freq=mean, damped_freq=mean, freq_std=std)
        off = mean / truth - 1
        behind = dof_behind(measured, "frequency", modes, none)
        p.append(float(p_value(np.sum((off / std_for(measured, none).freq) ** 2), modes, behind)))
        known.append(float(p_value(np.sum((off / (std / mean)) ** 2), modes, modes * (repeats - 1.0))))
    for level in (0.01, 0.05):
        found = np.mean(np.array(p) < level)
        assert level / 5 < found < level + 3 * np.sqrt(level * (1 - level) / len(p))
        # treated as pooled they would count as too well known
        assert np.mean(np.array(known) < level) > 1.5 * level


@pytest.mark.medium
@pytest.mark.parametrize("held", [*(pytest.param(k, marks=pytest.mark.slow) for k in (2, 4)), 3])
def test_a_mode_in_few_of_many_repeats_takes_the_pooled_standard_deviation(tmp_path, held):
    """Mode m0 is in a few of twelve repeats: two or three say almost nothing about its own standard deviation."""
    path, rng, off = tmp_path / "modes.csv", np.random.default_rng(0), []
    none, places = Floors(freq=0.0, damping=0.0, shape=0.0), [(i, k) for i in range(5) for k in range(12)]
    for _ in range(60):
        path.write_text("mode,freq,freq_kind,repeat\n" + "".join(
            f"m{i},{(10 + 10 * i) * (1 + 0.002 * rng.standard_normal())},natural,{k}\n"
            for i, k in places if i or k < held
        ))  # fmt: skip
        measured = read_modes([path])
        off.append((measured.natural_freq[0] / 10 - 1) / std_for(measured, none).freq[0])
    assert 0.75 < np.sqrt(np.mean(np.square(off))) < 1.3
    assert np.abs(off).max() < 5
