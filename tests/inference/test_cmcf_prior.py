"""Cross-model equations with priors, and with parameters that enter several matrices."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg as la
import scipy.sparse as sp

from calib.errors.errors import EvaluationError, InputError
from calib.inference.cmcf import cmcf
from calib.inference.cmcf_equations import Change, CmcfSettings, Equations, MeasuredReceptance, Reduced
from calib.study.loading import module_of

CASES = module_of(Path(__file__).parents[1] / "template/updated.py")
ONE_STEP = CmcfSettings(orders=4, steps=1)


def test_a_prior_is_weighed_by_its_variance():
    """With every degree of freedom measured the equations are linear: one step is the least-squares solution."""
    model, measured, truth = CASES.damped("structural")
    rng = np.random.default_rng(4)
    noisy = replace(measured, receptance=measured.receptance * (1 + 0.02 * rng.uniform(-1, 1, (4, 5, 5))))
    sd, mean = rng.uniform(0.05, 0.5, len(truth)), rng.normal(0, 0.1, len(truth))
    alone = cmcf(model, noisy, ONE_STEP).changes[1]
    inverse = Equations.at(Reduced.of(model, 0 * truth), noisy, ONE_STEP).inverse
    precision, prior = la.inv(inverse @ inverse.T), np.diag(1 / sd**2)
    expected = la.solve(precision + prior, precision @ alone + prior @ mean)
    assert np.abs(expected - alone).max() > 0.01
    found = cmcf(model, noisy, replace(ONE_STEP, steps=2, tolerance=0.0), sd, mean).changes
    np.testing.assert_allclose(found[1], expected, atol=1e-9)
    np.testing.assert_allclose(found[2], expected, atol=1e-9)


def test_what_the_equations_do_not_see_stays_at_its_prior_mean():
    model, measured, truth = CASES.damped("mass")
    unseen = replace(model, changes=(*model.changes, Change("none", "stiffness", 0 * model.stiffness)))
    mean = np.append(np.zeros(len(truth)), 0.3)
    found = cmcf(unseen, measured, ONE_STEP, np.full(len(mean), 1e6), mean).changes[1]
    np.testing.assert_allclose(found, [*truth, 0.3], atol=1e-8)
    few = MeasuredReceptance(measured.freq[:1], measured.receptance[:1, :, :1], np.array([0]))
    assert len(cmcf(model, few, ONE_STEP, np.ones(len(truth))).changes) == 2


@pytest.mark.parametrize("weighting", ["block", "none"])
def test_a_prior_needs_equations_with_errors_of_known_size(weighting):
    model, measured, truth = CASES.damped("mass")
    with pytest.raises(InputError, match="white"):
        cmcf(model, measured, replace(ONE_STEP, weighting=weighting), np.ones(len(truth)))


def test_one_parameter_in_stiffness_damping_and_mass_is_one_unknown():
    model, _, _ = CASES.damped("structural")
    k, m = model.stiffness.toarray(), model.mass.toarray()
    first, last = model.changes[0].matrix, sp.csc_array(np.diag([0.0, 0, 0, 0, 1]))
    more = (("mass", last), ("viscous", 1e-3 * first))
    other = Change("k2", "stiffness", model.changes[2].matrix)
    linked = replace(model, changes=(Change("both", "stiffness", first, more), other))
    both, single = 0.25, -0.1
    freq = np.array([2.0, 5.0, 11.0])
    receptance = [
        la.inv(
            k + both * first + single * other.matrix + 1j * w * both * 1e-3 * first - w**2 * (m + both * last.toarray())
        )
        for w in 2 * np.pi * freq
    ]
    found = cmcf(linked, MeasuredReceptance(freq, np.array(receptance), np.arange(5)), ONE_STEP)
    np.testing.assert_allclose(found.changes[1], [both, single], atol=1e-9)


def test_the_reduction_is_that_of_all_changed_matrices():
    array = CASES.Array()
    beam, panel = array.changes[2].matrix, sp.diags_array((np.arange(90) < 45).astype(float))
    added = sp.csc_array(panel @ array.m @ panel)
    model = replace(array.initial, changes=(Change("both", "stiffness", beam, (("mass", added),)),))
    k, m = array.k + 0.3 * beam, array.m + 0.3 * added
    t = array.reduce(sp.csc_array(k), sp.csc_array(m))
    found = Reduced.of(model, np.array([0.3]))
    for own, matrix in (("stiffness", k), ("mass", m)):
        expected = t.T @ matrix @ t
        np.testing.assert_allclose(found.total(own), expected, atol=1e-9 * np.abs(expected).max())


def test_only_factors_must_stay_positive():
    """A change by 1.5 times the first spring in the other direction: no factor, but a stiffness that still holds."""
    model, _, _ = CASES.damped("structural")
    spring = model.changes[0].matrix
    weaker = model.stiffness.toarray() - 0.75 * spring.toarray()
    freq = np.array([2.0, 5.0])
    receptance = np.array([la.inv(weaker - (2 * np.pi * f) ** 2 * model.mass.toarray()) for f in freq])
    measured = MeasuredReceptance(freq, receptance, np.arange(5))
    half = Change("half", "stiffness", 0.5 * spring)
    with pytest.raises(EvaluationError, match="the factor of half"):
        cmcf(replace(model, changes=(half,)), measured, ONE_STEP)
    found = cmcf(replace(model, changes=(replace(half, is_factor=False),)), measured, ONE_STEP)
    assert found.values["half"] == pytest.approx(-1.5)
