"""Model updating by cross-model equations: mass and damping, and what is complex."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg as la
import scipy.sparse as sp

from calib.inference.cmcf import cmcf
from calib.inference.cmcf_equations import Change, CmcfSettings, Equations, MeasuredReceptance, Reduced
from calib.study.loading import module_of

CASES = module_of(Path(__file__).parents[1] / "template/updated.py")


@pytest.fixture(scope="module")
def array():
    return CASES.Array()


@pytest.mark.parametrize("kind", ["mass", "structural", "viscous"])
def test_mass_and_damping_are_recovered_in_one_step_even_at_resonance(kind):
    model, measured, truth = CASES.damped(kind)
    found = cmcf(model, measured, CmcfSettings(orders=4, steps=1))
    np.testing.assert_allclose(found.changes[1], truth, atol=1e-9)


def test_a_damped_initial_model_is_updated_from_its_real_changes():
    """The left factors and slopes of a stiffness are real; with damping in the model the equations are not."""
    model, measured, truth = CASES.damped("structural")
    loss, stiff = truth[5:], tuple(c for c in model.changes if c.kind == "stiffness")
    losses = sum(x * c.matrix for x, c in zip(loss, (c for c in model.changes if c.kind == "structural"), strict=True))
    known = replace(model, changes=stiff, structural=sp.csc_array(losses))
    found = cmcf(known, measured, CmcfSettings(orders=4, steps=1))
    np.testing.assert_allclose(found.changes[1], truth[:5], atol=1e-9)
    viscous, measured, truth = CASES.damped("viscous")
    known = replace(viscous, changes=viscous.changes[:5], viscous=sp.csc_array(truth[5] * viscous.changes[5].matrix))
    found = cmcf(known, measured, CmcfSettings(orders=4, steps=1))
    np.testing.assert_allclose(found.changes[1], truth[:5], atol=1e-9)


def test_real_data_update_a_damped_model():
    """A is real then and the imbalance is not: its imaginary part is that of a damping that nothing may change."""
    model, _, truth = CASES.damped("structural")
    stiff = tuple(c for c in model.changes if c.kind == "stiffness")
    changed = model.stiffness.toarray() + sum(a * c.matrix.toarray() for a, c in zip(truth[:5], stiff, strict=True))
    omega = 2 * np.pi * np.array([3.0, 9.0])
    receptance = np.array([la.inv(changed - w**2 * model.mass.toarray()) for w in omega])
    lossy = replace(model, changes=stiff, structural=sp.csc_array(0.02 * stiff[0].matrix))
    found = cmcf(lossy, MeasuredReceptance(omega / (2 * np.pi), receptance, np.arange(5)), CmcfSettings(orders=4))
    np.testing.assert_allclose(found.changes[-1], truth[:5], atol=1e-9)


def test_real_and_imaginary_parts_are_equations_of_their_own():
    """With damping in the model, among its changes or in the receptance, of which real data may need none."""
    model, measured, _ = CASES.damped("structural")
    stiff = tuple(c for c in model.changes if c.kind == "stiffness")
    real = replace(measured, receptance=np.abs(measured.receptance))
    lossy = sp.csc_array(0.02 * stiff[0].matrix)
    rows = {}
    for name, changes, loss, data in (
        ("none", stiff, None, real), ("model", stiff, lossy, real), ("change", model.changes, None, real),
        ("data", stiff, None, measured),
    ):  # fmt: skip
        reduced = Reduced.of(replace(model, changes=changes, structural=loss), np.zeros(len(changes)))
        rows[name] = Equations.at(reduced, data, CmcfSettings(orders=4)).inverse.shape[1]
    assert rows == {"none": 400, "model": 800, "change": 800, "data": 800}


def test_the_loss_of_a_model_is_removed_by_undamped_data():
    model, _, _ = CASES.damped("structural")
    omega = 2 * np.pi * np.array([3.0, 9.0])
    receptance = np.array([la.inv(model.stiffness.toarray() - w**2 * model.mass.toarray()) for w in omega])
    lossy = replace(model, structural=sp.csc_array(0.02 * model.changes[5].matrix))
    found = cmcf(lossy, MeasuredReceptance(omega / (2 * np.pi), receptance, np.arange(5)), CmcfSettings(orders=4))
    np.testing.assert_allclose(found.changes[-1], [0, 0, 0, 0, 0, -0.02, 0], atol=1e-9)


def test_damping_of_the_array_is_recovered_in_one_step_at_its_resonances(array):
    """All degrees of freedom, loss factors of 1 to 3 %, real unknowns from complex equations, 12 references."""
    loss = np.array([0.01, 0.02, 0.03, 0.01, 0.02, 0.03])
    lossy = [c.matrix * (1 + a) * e for c, a, e in zip(array.changes, CASES.ASYMMETRIC, loss, strict=True)]
    k, m = array.stiffness(CASES.ASYMMETRIC) + 1j * sum(lossy), array.m.toarray()
    freq = array.freq(CASES.ASYMMETRIC)
    receptance = np.array([la.inv(k.toarray() - (2 * np.pi * f) ** 2 * m)[:, array.masters] for f in freq])
    changes = (*array.changes, *(Change(f"loss of {c.name}", "structural", c.matrix) for c in array.changes))
    measured = MeasuredReceptance(freq, receptance, array.masters)
    found = cmcf(replace(array.whole, changes=changes), measured, CmcfSettings(steps=1)).changes[1]
    np.testing.assert_allclose(found[:6], CASES.ASYMMETRIC, atol=1e-9)
    np.testing.assert_allclose(found[6:] / (1 + found[:6]), loss, atol=1e-9)
