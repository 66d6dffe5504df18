"""What to measure next of FRFs: promised gains are those of the tests that are then made; synthetic measurements."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib
from calib.hypotheses.design.imagined_frfs import _noise
from calib.study.loading import module_of

WORLD = module_of(Path(__file__).parents[1] / "template/frf_chain.py")


def test_the_noise_of_a_test_is_a_share_and_a_floor():
    frfs = made(1).used
    size = np.abs(frfs.values)
    known = replace(frfs, std=np.hypot(0.03 * size, 0.004))
    assert _noise(known) == pytest.approx((0.03, 0.004), rel=1e-6)
    assert _noise(replace(frfs, std=0.03 * size)) == pytest.approx((0.03, 0.0), abs=1e-6)


def made(seed, references=(1,), responses=(1, 3, 4), repeats=4, **given):
    frfs = WORLD.measured(
        seed, repeats=repeats, references=references, responses=responses, share=0.05, floor=0.02, ground=WORLD.HIDDEN
    )
    return calib.FRFTest(frfs, **given)


def explained(test):
    return calib.Problem(WORLD.chain(), test).explain(WORLD.effects(), progress=False)


@pytest.fixture(scope="module")
def held_out():
    """Named with one force and without sensor 3x and a band."""
    return explained(made(1, references=(1, 4), held_out=["3x"], held_out_references=["4x"],
                             held_out_bands=[(20.0, 26.0)]))  # fmt: skip


@pytest.fixture
def gains(held_out):
    table = held_out.explanation.tables["next_measurement"]
    return table[table["effect"] == "ground_2"].set_index("measurement")


def std_of(test):
    """Standard deviation of the hidden spring's stiffness, for the standard deviations as they are."""
    problem = calib.Problem(WORLD.chain(), test).with_effects(WORLD.effects()[:1])
    fit = problem.calibrate(starts=1, progress=False)
    return fit.parameters.loc["ground_2", "std"] / fit.statistics.birge


PARTS = {"held_out": ["3x"], "held_out_references": ["4x"], "held_out_bands": [(20.0, 26.0)]}
USED_TOO = {
    "sensor 3x, validation data so far": "held_out",
    "force at 4x, validation data so far": "held_out_references",
    "the 10 lines from 20.03 to 25.83 Hz, validation data so far": "held_out_bands",
}


@pytest.mark.slow
@pytest.mark.parametrize("measurement", USED_TOO)
def test_held_out_data_give_what_they_promise(gains, measurement):
    """The score of an effect rises as its standard deviation falls; noise of the data themselves is in the latter."""
    left = {part: given for part, given in PARTS.items() if part != USED_TOO[measurement]}
    achieved = std_of(made(1, (1, 4), **PARTS)) / std_of(made(1, (1, 4), **left))
    assert gains.loc[measurement, "gain"] == pytest.approx(achieved, rel=0.1)
    assert gains.loc[measurement, "kind"] == "held out" and achieved > 1.02


@pytest.mark.slow
def test_a_further_force_and_a_further_sensor_give_what_they_promise():
    found = explained(made(2, responses=(1, 4)))
    table = found.explanation.tables["next_measurement"]
    gain = table[table["effect"] == "ground_2"].set_index("measurement")["gain"]
    before = std_of(made(2, responses=(1, 4)))
    assert gain["a force at 4x too"] == pytest.approx(before / std_of(made(2, (1, 4), (1, 4))), rel=0.1)
    (there,) = (name for name in gain.index if name.startswith("all directions where ground_2 acts"))
    assert gain[there] == pytest.approx(before / std_of(made(2, (1,), (1, 2, 4))), rel=0.1)
    assert "next" in found.lines["Next"] or "narrow" in found.lines["Next"]


@pytest.mark.slow
def test_repeats_narrow_the_repeatability_but_not_a_claimed_accuracy(gains):
    assert gains.loc["twice the repeats", "gain"] == pytest.approx(np.sqrt(2), rel=0.02)
    claimed = explained(made(1, references=(1, 4), accuracy="50 %")).explanation.tables["next_measurement"]
    own = claimed[(claimed["effect"] == "ground_2") & (claimed["measurement"] == "twice the repeats")]
    assert own["gain"].iloc[0] < 1.1


@pytest.mark.slow
def test_the_same_seed_gives_the_same_table(held_out):
    again = explained(made(1, (1, 4), **PARTS))
    one, other = (x.explanation.tables["next_measurement"] for x in (held_out, again))
    assert one.equals(other)
