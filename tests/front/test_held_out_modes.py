"""Held-out modes of a test in memory are verified with as many model modes as they need."""

from pathlib import Path

import calib
from models.four_storey_rig import four_storey_rig

MEASURED = Path(__file__).resolve().parents[2] / "studies/four_storey_rig/measured.csv"


def test_a_held_out_mode_beyond_the_requested_ones_is_solved_for_its_verification():
    modes, model = calib.read_modes(MEASURED, repeats=100, std_of="repeat"), four_storey_rig()
    test = calib.ModalTest(modes, held_out=modes.names[-1:], mode_count=3, override={modes.names[-1]: 4})
    assert test.problem(model).mode_count == 3 and test.problem(model).override == {}
    whole = test.whole_problem(model)
    assert whole.mode_count == 4 and whole.override == test.override and whole.measured.names == modes.names
    errors = calib.Problem(model, test).calibrate(["k1", "k2"]).errors.set_index("group")
    assert errors.loc["held_out_modes", "rows"] >= 1 and errors.loc["held_out_modes", "unpaired"] == 0
    assert calib.ModalTest(modes, mode_count=4).whole_problem(model) is None
