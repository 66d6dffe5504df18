"""Derivatives hold on the reduced basis too: against differences there, and against full order on the bogie."""

from pathlib import Path

import numpy as np
import pytest

from calib.correlation.modal.residual import ModalResidual
from calib.structure.reduction.training import train_basis
from calib.study.study import LoadedStudy

STUDY = Path(__file__).resolve().parents[2] / "studies/bogie"


@pytest.fixture(scope="module")
def pair():
    study = LoadedStudy.load(STUDY)
    names = tuple(p.name for p in study.search_space.free if not p.integer)
    basis = train_basis(study.model, study.search_space, study.problem.mode_count, seed=3, freq_max=50.0)
    return study, names, ModalResidual(study.problem), ModalResidual(study.problem.reduced(basis))


@pytest.mark.slow
def test_residual_and_jacobian_agree_with_full_order(pair):
    _, names, full, reduced = pair
    values = {"K_primary": 700.0, "pos_long_left": 6.0}
    assert np.abs(full.residual(values) - reduced.residual(values)).max() < 0.05  # in standard deviations
    exact, near = full.jacobian(values, names), reduced.jacobian(values, names)
    assert np.all(np.linalg.norm(exact - near, axis=0) < 5e-3 * np.linalg.norm(exact, axis=0))


@pytest.mark.slow
def test_frequency_derivatives_on_the_basis_are_those_of_its_own_frequencies(pair):
    study, names, _, reduced = pair
    values = study.model.space.values
    _, _, slope = reduced.frequencies(values, names, reduced.solve)
    for k, name in enumerate(names):
        step = 1e-4 * (study.search_space[name].upper - study.search_space[name].lower)
        ends = ({**values, name: values[name] + s * step} for s in (1, -1))
        up, down = (reduced.solve(end).modes.natural_freq for end in ends)
        difference = np.log(up / down) / (2 * step)
        assert np.allclose(slope[:, k], difference, rtol=1e-4, atol=1e-6 * np.abs(slope).max())
