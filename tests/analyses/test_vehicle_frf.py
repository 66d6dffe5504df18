"""The vehicle under two exciters, at full order: the measured functions are those of the true values."""

import json
from pathlib import Path

import numpy as np
import pytest

from calib.study.study import LoadedStudy

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.slow  # two solutions of 33 lines at 9732 degrees of freedom
@pytest.mark.whole
def test_the_functions_of_the_coarse_mesh_at_the_true_values_are_measured():
    problem = LoadedStudy.load(ROOT / "studies/vehicle_frf").problem
    measured = problem.measured.values

    def error(values):
        """Root mean square, over the measured one; 1 % of noise, 0.4 % in the mean of five repeats, is in it."""
        return np.sqrt(np.mean(np.abs(problem.functions(values) - measured) ** 2) / np.mean(np.abs(measured) ** 2))

    true = json.loads((ROOT / "tests/truth/vehicle.json").read_text("utf-8"))["parameters"]
    found = error(true), error(problem.space.values)
    assert found[0] < 0.01 < 0.2 < found[1], found
