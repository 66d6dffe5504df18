"""Frequencies of the rows of a residual, by which a search hangs masses: of modes, of lines, of responses, of all."""

import numpy as np
import pytest

import calib
from calib.analyses.hypotheses_of_study import adapters_for
from calib.api.pairs import library_of
from calib.missing.joint import JointHypotheses
from calib.study.loading import module_of

CHAIN = module_of(__file__.rsplit("/", 2)[0] + "/template/frf_chain.py")


def hypotheses_of(test):
    problem = calib.Problem(CHAIN.chain(), test)
    (adapter,) = adapters_for(problem.study(effects=library_of(problem, CHAIN.effects()))).values()
    return adapter.hypotheses


@pytest.fixture(scope="module")
def parts():
    modes, frfs = CHAIN.modes(1), CHAIN.measured(1)
    tests = {
        "modes": calib.ModalTest(modes), "frfs": calib.FRFTest(frfs, held_out=["3x"]),
        "responses": calib.ResponseTest({"freq_1": (5.0, 0.1), "freq_2": (12.0, 0.1)}),
    }  # fmt: skip
    return {name: hypotheses_of(test) for name, test in tests.items()}


def test_a_row_of_a_mode_has_its_measured_frequency(parts):
    found, modes = parts["modes"], CHAIN.modes(1)
    freqs = dict(zip(modes.names, modes.natural_freq, strict=True))
    assert {row.kind for row in found.rows} == {"frequency", "damping", "shape"}
    assert found.row_freqs.tolist() == [freqs[row.mode] for row in found.rows]


def test_a_row_of_an_frf_has_its_line(parts):
    np.testing.assert_array_equal(parts["frfs"].row_freqs, np.tile(CHAIN.FREQ, 2 * 4))  # two parts, four functions


def test_a_row_of_a_response_has_none(parts):
    assert np.isnan(parts["responses"].row_freqs).tolist() == [True, True]


def test_several_tests_have_those_of_each_in_turn(parts):
    joint = JointHypotheses(parts)
    assert len(joint.row_freqs) == len(joint.rows)
    of_test = np.array([row.test for row in joint.rows])
    for name, part in parts.items():
        np.testing.assert_array_equal(joint.row_freqs[of_test == name], part.row_freqs)
