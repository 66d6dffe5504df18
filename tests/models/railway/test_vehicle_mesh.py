"""Halving every edge of the vehicle moves no mode by more than the measurement's noise."""

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from calib.structure.eigenproblem.solve import solve_modes
from models.railway import vehicle

pytestmark = pytest.mark.slow


def test_halving_every_edge(car, undamped, damped, name_modes):
    fine = vehicle(2)
    k, c, m = fine.matrices({})
    turning = fine.dofs.direction >= 3
    for own, theirs in (
        (undamped, solve_modes(k, None, m, 18, turning)),
        (damped, solve_modes(k, c, m, 18, turning)),
    ):
        here, there = name_modes(car, own.shapes), name_modes(fine, theirs.shapes)
        mac = np.abs(here.motion.conj().T @ there.motion) ** 2
        mac /= np.outer(np.sum(np.abs(here.motion) ** 2, axis=0), np.sum(np.abs(there.motion) ** 2, axis=0))
        columns = linear_sum_assignment(-mac)[1]
        for name, mode in here.index.items():
            other = columns[mode]
            change = abs(theirs.natural_freq[other] / own.natural_freq[mode] - 1)
            allowed = 5e-3 if name in ("4C", "5C", "6C") else 1e-3
            assert change < allowed, name
            repeated = name.startswith("3B") and not own.is_complex  # two single bogies: any mixture is a pair of modes
            assert repeated or mac[mode, other] > 0.99, name  # bending lies next to pitching
        assert not np.any(own.natural_freq[:15] < 0.5)
