"""The cross-model equations are those of one test of FRFs: several tests are refused."""

from pathlib import Path

import pytest

import calib
from calib.errors.errors import InputError
from calib.study.loading import module_of

WORLD = module_of(Path(__file__).parents[1] / "template/frf_chain.py")


def two_tests():
    frfs = WORLD.measured(3, share=0.1, floor=0.02)
    tests = [calib.FRFTest(frfs, name="shaken"), calib.ModalTest(WORLD.modes(5), name="tapped")]
    return calib.Problem(WORLD.chain(), tests)


def test_several_tests_are_not_solved_by_least_squares_in_their_place():
    with pytest.raises(InputError, match="one FRF test; there are 2 tests") as refused:
        two_tests().calibrate(method="cmcf", progress=False)
    assert "gauss-newton" in str(refused.value)
