"""Model updating by cross-model equations: exact recovery without noise, and what is refused."""

from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import scipy.linalg as la

from calib.errors.errors import EvaluationError, InputError
from calib.inference.cmcf import cmcf
from calib.inference.cmcf_equations import Change, CmcfSettings, InitialModel, MeasuredReceptance, Reduced
from calib.study.loading import module_of
from models.solar_panel import GROUPS

CASES = module_of(Path(__file__).parents[1] / "template/updated.py")


@pytest.fixture(scope="module")
def array():
    return CASES.Array()


@pytest.mark.mostly_slow(2)
@pytest.mark.parametrize("alpha", [CASES.SYMMETRIC, CASES.ASYMMETRIC], ids=["symmetric", "asymmetric"])
@pytest.mark.parametrize("offset", [1e-3, 0.02, 0.1])
def test_with_all_degrees_of_freedom_one_step_is_exact(array, alpha, offset):
    freq = array.freq(alpha) * (1 + offset)
    measured = MeasuredReceptance(freq, array.receptance(alpha, freq), np.arange(90))
    found = cmcf(array.whole, measured, CmcfSettings(offset=offset, steps=1))
    np.testing.assert_allclose(found.changes[1], alpha, atol=1e-9)


def test_linked_elements_change_together(array):
    """The two panels as one group, and the two halves of the yoke."""
    linked = tuple(
        Change(name, "stiffness", array.changes[i].matrix + array.changes[j].matrix)
        for name, i, j in (("panels", 0, 1), ("yoke", 4, 5))
    )
    model = replace(array.initial, changes=(*linked, *array.changes[2:4]))
    measured = array.consistent(np.array([0.2, 0.2, 0.3, 0.05, 0.5, 0.5]), 0.02)
    found = cmcf(model, measured, CASES.ALL_STEPS)
    assert found.names == ("panels", "yoke", *GROUPS[2:4])
    np.testing.assert_allclose(found.changes[-1], [0.2, 0.5, 0.3, 0.05], atol=1e-8)
    assert found.values["yoke"] == found.changes[-1][1]


@pytest.mark.medium
@pytest.mark.mostly_slow(1)
@pytest.mark.parametrize("alpha", [CASES.SYMMETRIC, CASES.ASYMMETRIC], ids=["symmetric", "asymmetric"])
@pytest.mark.parametrize("weighting", ["block", "white"])
def test_without_noise_every_iteration_tends_to_the_truth(array, alpha, weighting):
    measured, firsts = array.consistent(alpha, 0.02), []
    for iteration in ("proposed", "traditional", "traditional_total"):
        found = cmcf(array.initial, measured, replace(CASES.ALL_STEPS, weighting=weighting, iteration=iteration))
        errors = np.abs(found.changes[1:] - alpha).max(axis=1)
        assert errors[-1] < 1e-8 and len(errors) == 15
        large = errors[:-1] > 1e-8
        assert np.all(errors[1:][large] < 0.35 * errors[:-1][large])
        firsts.append(found.changes[1])
        assert found.builds == (1 if iteration == "proposed" else 15)
    np.testing.assert_allclose(firsts[1], firsts[0], rtol=1e-12)
    np.testing.assert_allclose(firsts[2], firsts[0], rtol=1e-12)


def test_a_model_that_is_right_is_left_alone(array):
    found = cmcf(array.initial, array.consistent(np.zeros(6), -0.05), CASES.ALL_STEPS)
    assert np.abs(found.changes[-1]).max() < 1e-8
    assert cmcf(array.initial, array.consistent(np.zeros(6), -0.05)).converged


@pytest.mark.parametrize(("offset", "most"), [(1e-3, 1e-4), (0.02, 2e-3)])
def test_a_measured_receptance_holds_modes_beyond_the_masters(array, offset, most):
    found = cmcf(array.initial, array.measured(CASES.SYMMETRIC, offset), replace(CASES.ALL_STEPS, offset=offset))
    error = np.abs(found.changes[-1] - CASES.SYMMETRIC).max()
    assert 1e-7 < error < most
    np.testing.assert_allclose(array.freq(found.changes[-1]), array.freq(CASES.SYMMETRIC), rtol=2e-4)


@pytest.mark.medium
def test_units_and_the_order_of_masters_do_not_matter(array):
    measured = array.measured(CASES.ASYMMETRIC, 0.02)
    own = cmcf(array.initial, measured, CASES.ALL_STEPS).changes[-1]
    larger = [Change(c.name, c.kind, 1e3 * c.matrix) for c in array.changes]
    scaled = InitialModel(1e3 * array.k, 1e3 * array.m, tuple(larger), array.masters, array.reduce)
    lighter = replace(measured, receptance=measured.receptance / 1e3)
    np.testing.assert_allclose(cmcf(scaled, lighter, CASES.ALL_STEPS).changes[-1], own, atol=1e-8)
    order = np.random.default_rng(2).permutation(12)
    turned = InitialModel(
        array.k,
        array.m,
        array.changes,
        array.masters[order],
        partial(CASES.transformation, array.masters[order], CASES.LEVEL),
    )
    moved = replace(measured, receptance=measured.receptance[:, order][:, :, order])
    np.testing.assert_allclose(cmcf(turned, moved, CASES.ALL_STEPS).changes[-1], own, atol=1e-8)


def test_one_reference_is_enough_without_noise(array):
    whole = array.consistent(CASES.ASYMMETRIC, 0.02)
    one = MeasuredReceptance(whole.freq, whole.receptance[:, :, [3]], np.array([3]))
    assert np.abs(cmcf(array.initial, one, CASES.ALL_STEPS).changes[-1] - CASES.ASYMMETRIC).max() < 1e-5


# -- refused -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("offset", [0.0, 1e-8, -1e-6, "next"])
def test_a_receptance_at_a_resonance_of_the_model_is_refused(array, offset):
    own = Reduced.of(array.initial, np.zeros(6)).freq(8)
    given = own[4] / own[3] - 1 if offset == "next" else offset  # the offset leads from one resonance to the next
    with pytest.raises(EvaluationError, match="offset"):
        cmcf(array.initial, array.measured(CASES.SYMMETRIC, 0.02), CmcfSettings(offset=given))


def test_a_receptance_beside_a_resonance_is_not_refused(array):
    found = cmcf(array.initial, array.measured(CASES.SYMMETRIC, 1e-3), CmcfSettings(offset=1e-3))
    assert np.all(np.isfinite(found.changes)) and found.converged


def test_too_few_or_dependent_equations_are_refused(array):
    whole = array.measured(CASES.SYMMETRIC, 0.02)
    model, measured, _ = CASES.damped("mass")
    few = MeasuredReceptance(measured.freq[:1], measured.receptance[:1, :, :1], np.array([0]))
    with pytest.raises(InputError, match="5 independent equations do not determine 6"):
        cmcf(model, few)
    twice = replace(array.initial, changes=(*array.changes, replace(array.changes[0], name="again")))
    with pytest.raises(InputError, match="determine 6 of 7"):
        cmcf(twice, whole)
    nothing = replace(array.initial, changes=(*array.changes, Change("none", "stiffness", 0 * array.k)))
    with pytest.raises(InputError, match="1 of the changes"):
        cmcf(nothing, whole)


def test_a_factor_that_would_not_stay_positive_is_refused():
    model, _, _ = CASES.damped("structural")
    softer = -la.inv(model.stiffness.toarray())[None]
    measured = MeasuredReceptance(np.array([1e-6]), softer, np.arange(5))
    stiff = tuple(c for c in model.changes if c.kind == "stiffness")
    with pytest.raises(EvaluationError, match=r"the factor of k\d becomes -1"):
        cmcf(replace(model, changes=stiff), measured, CmcfSettings(orders=4))


@pytest.mark.parametrize("fault", ["nan", "shape"])
def test_a_receptance_that_is_none_is_refused(array, fault):
    good = array.measured(CASES.SYMMETRIC, 0.02)
    bad = good.receptance.copy()
    bad[0, 0, 0] = np.nan
    with pytest.raises(InputError, match="lines, masters, references"):
        MeasuredReceptance(good.freq, bad if fault == "nan" else good.receptance[:2], good.references)


def test_places_without_a_reduction_and_nothing_to_change_are_refused(array):
    with pytest.raises(InputError, match="reduction"):
        InitialModel(array.k, array.m, array.changes, array.masters)
    with pytest.raises(InputError, match="parameter"):
        InitialModel(array.k, array.m, (), array.masters, array.reduce)
