"""A test in memory is treated as that of a study: what is held out, and what is claimed of its accuracy."""

from pathlib import Path

import pytest

import calib
from calib.analyses.uncertainty import accuracy_words
from calib.command.example import write_example
from calib.study.study import LoadedStudy
from models.four_storey_rig import four_storey_rig

MEASURED = Path(__file__).resolve().parents[2] / "studies/four_storey_rig/measured.csv"


@pytest.mark.medium
def test_a_held_out_mode_beyond_the_requested_ones_is_solved_for_its_verification():
    modes, model = calib.read_modes(MEASURED, repeats=100, std_of="repeat"), four_storey_rig()
    test = calib.ModalTest(modes, held_out=modes.names[-1:], mode_count=3, override={modes.names[-1]: 4})
    assert test.problem(model).mode_count == 3 and test.problem(model).override == {}
    whole = test.whole_problem(test.problem(model))
    assert whole.mode_count == 4 and whole.override == test.override and whole.measured.names == modes.names
    errors = calib.Problem(model, test).calibrate(["k1", "k2"], starts=1).errors.set_index("group")
    assert errors.loc["held_out_modes", "rows"] >= 1 and errors.loc["held_out_modes", "unpaired"] == 0
    assert calib.ModalTest(modes, mode_count=4).whole_problem(test.problem(model)) is None


@pytest.mark.parametrize("claimed", ["", 'accuracy = "1 %"', 'accuracy = { freq = "1 %", shape = 0.02 }'])
def test_a_claimed_accuracy_is_told_in_the_same_words(tmp_path, claimed):
    file = write_example(tmp_path / "mast") and tmp_path / "mast/study.toml"
    file.write_text(file.read_text().replace("[measurement]", f"[measurement]\n{claimed}", 1))
    study = LoadedStudy.load(file)
    assert study.experiment.claimed == accuracy_words(study) == study.measured.accuracy.words
    assert bool(claimed) is ("1 % of natural frequencies" in accuracy_words(study))
