"""Masses and springs of the test itself on a model, at full order and on a reduced basis."""

import numpy as np
import pytest

from calib.errors.errors import InputError
from calib.problem.space import Parameter
from calib.structure.effects.loaded import Load, with_loads
from calib.structure.reduction.reduced import ReducedModel
from calib.structure.reduction.training import train_basis
from models.solar_panel import solar_panel

ROWS = np.random.default_rng(1).standard_normal((2, 90))
MASS = Load(Parameter("sensor", 0.005, 0.0, 0.02, "kg"), "mass", ROWS)
SPRING = Load(Parameter("stinger", 1.0, 0.0, 10.0, "kN/m"), "stiffness", ROWS[:1])
LOADS = (MASS, SPRING)


@pytest.fixture(scope="module")
def panel():
    return solar_panel()


def added(model, values):
    """What loads add to stiffness, damping and mass at full order."""
    base = model.matrices({n: v for n, v in values.items() if n in model.space})
    return [(whole - own).toarray() for whole, own in zip(with_loads(model, LOADS).matrices(values), base, strict=True)]


def test_a_mass_and_a_spring_act_on_their_motions_each_in_its_matrix(panel):
    stiffness, damping, mass = added(panel, {"sensor": 0.01, "stinger": 2.0, "E_panel_1": 150.0})
    np.testing.assert_allclose(stiffness, 2e3 * np.outer(ROWS[0], ROWS[0]), atol=1e-6)
    np.testing.assert_allclose(mass, 0.01 * ROWS.T @ ROWS, atol=1e-12)
    assert not damping.any() and with_loads(panel, LOADS).space.names == (*panel.space.names, "sensor", "stinger")


def test_a_reduced_model_keeps_its_vectors_and_knows_the_new_parameters(panel):
    space = panel.space.keep(panel.space.names[:1])
    small = with_loads(ReducedModel(panel, train_basis(panel, space, 4, seed=1)), LOADS)
    values = {"sensor": 0.01, "stinger": 2.0}
    vectors = small.basis.vectors
    for own, whole in zip(small.matrices(values), with_loads(panel, LOADS).matrices(values), strict=True):
        np.testing.assert_allclose(own, vectors.T @ whole @ vectors, rtol=1e-9, atol=1e-9 * abs(whole).max())
    assert small.basis.names == small.space.names


def test_a_load_needs_a_name_of_its_own(panel):
    twice = Load(Parameter("E_panel_1", 1.0, 0.0, 2.0), "mass", ROWS)
    with pytest.raises(InputError, match="'E_panel_1' already"):
        with_loads(panel, [twice])
    assert with_loads(panel, []) is panel
