"""Static reductions: closed forms, upper bounds, convergence by level, and what cannot be reduced."""

from itertools import islice

import numpy as np
import pytest
import scipy.linalg as la
import scipy.sparse as sp

from calib.errors.errors import EvaluationError, InputError
from calib.structure.reduction.static_reduction import reduction_levels, serep, static_reduction
from models.solar_panel import MASTERS, solar_panel


@pytest.fixture(scope="module")
def panel():
    """Stiffness, mass, masters and the frequencies of eight modes."""
    model = solar_panel()
    k, _, m = model.matrices({})
    places = zip(model.dofs.node, model.dofs.direction, strict=True)
    masters = [k for k, (node, d) in enumerate(places) if node + 1 in MASTERS and d == 2]
    return k, m, masters, model.modes({}, 12)


def chain(n, mass=1.0):
    """Springs of 1 N/m between n masses, the first on the ground."""
    k = 2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    k[-1, -1] = 1.0
    return sp.csc_array(k), sp.csc_array(mass * np.eye(n))


def test_guyan_and_irs_are_those_of_the_formulas():
    k, m = chain(6)
    masters, slaves = [1, 5], [0, 2, 3, 4]
    dense = k.toarray()
    guyan, irs = islice(reduction_levels(k, m, masters), 2)
    t = -la.solve(dense[np.ix_(slaves, slaves)], dense[np.ix_(slaves, masters)])
    np.testing.assert_allclose(guyan.transformation[slaves], t, atol=1e-14)
    np.testing.assert_array_equal(guyan.transformation[masters], np.eye(2))
    # O'Callahan 1989: T + S M T M_R^-1 K_R with the flexibility S of the slaves.
    flexibility = np.zeros((6, 6))
    flexibility[np.ix_(slaves, slaves)] = la.inv(dense[np.ix_(slaves, slaves)])
    expected = guyan.transformation + flexibility @ guyan.transformation @ la.solve(guyan.mass, guyan.stiffness)
    np.testing.assert_allclose(irs.transformation, expected, atol=1e-13)


def test_without_slaves_and_without_inertia_of_slaves_nothing_is_lost():
    k, m = chain(5)
    whole = static_reduction(k, m, [4, 3, 2, 1, 0])
    np.testing.assert_allclose(whole.stiffness, k.toarray()[::-1, ::-1])
    massless = sp.csc_array(np.diag([0.0, 1.0, 0.0, 1.0, 0.0]))
    exact = static_reduction(k, massless, [1, 3])
    condensed = la.inv(la.inv(k.toarray())[np.ix_([1, 3], [1, 3])])
    np.testing.assert_allclose(exact.natural_freq, np.sqrt(la.eigvalsh(condensed)) / (2 * np.pi), rtol=1e-12)


def test_errors_are_positive_and_fall_with_every_level(panel):
    k, m, masters, modes = panel
    errors = np.array(
        [r.natural_freq[:8] / modes.natural_freq[:8] - 1 for r in islice(reduction_levels(k, m, masters), 5)]
    )
    assert np.all(errors > -1e-9)  # rejects the levels with the matrices of Guyan throughout, which grow
    assert np.all(np.diff(errors, axis=0) < 1e-9)
    np.testing.assert_allclose(100 * errors[0, 3:], [0.593, 0.197, 2.387, 4.674, 4.918], atol=0.001)
    assert 100 * errors[1, 7] == pytest.approx(0.024, abs=0.001) and np.all(errors[4] < 1e-5)
    np.testing.assert_array_equal(
        static_reduction(k, m, masters, 3).natural_freq[:8] / modes.natural_freq[:8] - 1, errors[3]
    )


def test_serep_is_exact_for_its_modes_and_the_limit_of_the_levels():
    k, m = chain(8)
    eigenvalues, shapes = la.eigh(k.toarray(), m.toarray())
    masters = [1, 4, 7]
    exact = serep(k, m, masters, shapes[:, :3])
    np.testing.assert_allclose((2 * np.pi * exact.natural_freq) ** 2, eigenvalues[:3], rtol=1e-10)
    np.testing.assert_allclose(exact.expand(shapes[masters, :3]), shapes[:, :3], atol=1e-12)
    far = static_reduction(k, m, masters, 60)
    np.testing.assert_allclose(far.transformation, exact.transformation, atol=1e-8)


def test_serep_of_fewer_modes_than_masters_smooths_and_keeps_them(panel):
    k, m, masters, modes = panel
    some = serep(k, m, masters, modes.shapes[:, :5])
    np.testing.assert_allclose(some.natural_freq, modes.natural_freq[:5], rtol=1e-8)
    np.testing.assert_allclose(some.expand(modes.shapes[masters, :5]), modes.shapes[:, :5], atol=1e-10)


def test_masters_that_tell_too_few_shapes_apart_are_refused(panel):
    """The twelve masters of the array lie in six symmetric pairs: its first twelve modes look alike there."""
    k, m, masters, modes = panel
    with pytest.raises(EvaluationError, match="12 masters tell 11 of 12"):
        serep(k, m, masters, modes.shapes)


@pytest.mark.parametrize("masters", [[], [1, 1], [-1], [6]])
def test_wrong_masters_are_refused(masters):
    with pytest.raises(InputError, match="between 0 and 5"):
        static_reduction(*chain(6), masters)


def test_a_negative_level_is_refused():
    with pytest.raises(InputError, match="Guyan"):
        static_reduction(*chain(6), [0], -1)


def test_a_part_that_hangs_on_no_master_is_named():
    k = sp.csc_array(sp.block_diag([chain(3)[0], np.array([[1.0, -1.0], [-1.0, 1.0]])]))
    with pytest.raises(EvaluationError, match=r"free, with degree of freedom [34] "):
        static_reduction(k, sp.csc_array(np.eye(5)), [0])


def test_masters_without_mass_have_no_second_level():
    k, _ = chain(3)
    found = reduction_levels(k, sp.csc_array(np.diag([0.0, 0.0, 1.0])), [0, 1])
    next(found)
    with pytest.raises(EvaluationError, match="no mass"):
        next(found)
