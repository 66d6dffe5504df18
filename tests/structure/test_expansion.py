"""Expansion from sensors: exact in the span, least strain energy, condensed mass, and what cannot be expanded."""

import numpy as np
import pytest
import scipy.linalg as la
import scipy.sparse as sp

from calib.errors.errors import EvaluationError, InputError
from calib.structure.expansion import serep_expansion, static_expansion
from calib.structure.reduction.static_reduction import serep, static_reduction

N = 9


@pytest.fixture(scope="module")
def chain():
    """Stiffness and mass of masses of 1 to 5 kg in a row, the first on the ground, and their mass-normalised modes."""
    k = 3e3 * (2 * np.eye(N) - np.eye(N, k=1) - np.eye(N, k=-1))
    k[-1, -1] = 3e3
    m = np.diag(np.linspace(1.0, 5.0, N))
    return sp.csc_array(k), sp.csc_array(m), la.eigh(k, m)[1]


@pytest.fixture
def oblique():
    """Four sensors that see several degrees of freedom each, as oblique ones and ones between nodes do."""
    rows = np.zeros((4, N))
    rows[0, [0, 1]] = 0.8, 0.6
    rows[1, [2, 3]] = 0.3, 0.7
    rows[2, [3, 4, 5]] = 0.2, 0.5, -0.3
    rows[3, 8] = -1.0
    return rows


@pytest.mark.parametrize("count", [1, 3, 4])
def test_a_shape_in_the_span_of_the_modes_is_recovered(chain, oblique, count):
    basis = chain[2][:, :count]
    rng = np.random.default_rng(3)
    whole = basis @ (rng.standard_normal((count, 5)) + 1j * rng.standard_normal((count, 5)))
    found = serep_expansion(oblique, basis)
    np.testing.assert_allclose(found.expand(oblique @ whole), whole, atol=1e-12)
    np.testing.assert_allclose(found.residual(oblique @ whole), 0.0, atol=1e-12)
    own = serep_expansion(oblique, whole[:, :1])  # a complex basis recovers its own complex shape
    np.testing.assert_allclose(own.expand(oblique @ whole[:, :1]), whole[:, :1], atol=1e-12)


def test_what_the_modes_cannot_explain_is_the_residual(chain, oblique):
    basis = chain[2][:, :2]
    seen = oblique @ basis
    beside = la.null_space(seen.T)[:, :1]
    y = seen @ [[1.0], [2.0]]
    y /= np.linalg.norm(y)
    found = serep_expansion(oblique, basis)
    np.testing.assert_allclose(found.expand(y + 0.75 * beside), found.expand(y), atol=1e-12)
    np.testing.assert_allclose(found.residual(np.hstack([y + 0.75 * beside, beside, 0 * y])), [0.6, 1.0, 0.0])


def test_the_scale_of_the_modes_does_not_matter(chain, oblique):
    basis = chain[2][:, :3]
    a, b = serep_expansion(oblique, basis), serep_expansion(oblique, basis * [1e-9, -3.0, 1e7])
    np.testing.assert_allclose(b.transformation, a.transformation, rtol=1e-9)


def test_the_mass_of_serep_at_the_sensors_keeps_the_modes_orthonormal(chain, oblique):
    k, m, modes = chain
    tam = serep_expansion(oblique, modes[:, :3]).mass(m)
    seen = oblique @ modes[:, :3]
    np.testing.assert_allclose(seen.T @ tam @ seen, np.eye(3), atol=1e-12)
    masters = [1, 4, 7]
    same = serep(k, m, masters, modes[:, :3])
    np.testing.assert_allclose(serep_expansion(np.eye(N)[masters], modes[:, :3]).mass(m), same.mass, rtol=1e-9)


def test_of_degrees_of_freedom_the_static_expansion_is_guyan_s_and_its_mass_the_condensed_one(chain):
    k, m, _ = chain
    masters = [7, 1, 4]
    found, guyan = static_expansion(k, m, np.eye(N)[masters]), static_reduction(k, m, masters)
    np.testing.assert_allclose(found.transformation, guyan.transformation, atol=1e-14)
    np.testing.assert_allclose(found.mass(m), guyan.mass, rtol=1e-12)
    slaves = np.setdiff1d(np.arange(N), masters)
    dense, mass = k.toarray(), m.toarray()
    t = -la.solve(dense[np.ix_(slaves, slaves)], dense[np.ix_(slaves, masters)])
    condensed = mass[np.ix_(masters, masters)] + t.T @ mass[np.ix_(slaves, slaves)] @ t
    np.testing.assert_allclose(found.mass(m), condensed, rtol=1e-12)


@pytest.mark.parametrize("grounded", [True, False])
def test_the_static_expansion_has_the_least_strain_energy_for_the_motion_of_the_sensors(chain, oblique, grounded):
    """Oracle: the stationary point with a Lagrange multiplier for every sensor."""
    k, m, _ = chain
    dense = k.toarray()
    if not grounded:
        dense[0, 0] = 3e3
    found = static_expansion(sp.csc_array(dense), m, oblique)
    saddle = np.block([[dense, 3e3 * oblique.T], [3e3 * oblique, np.zeros((4, 4))]])
    expected = la.solve(saddle, np.vstack([np.zeros((N, 4)), 3e3 * np.eye(4)]))[:N]
    np.testing.assert_allclose(found.transformation, expected, atol=1e-10)
    np.testing.assert_allclose(oblique @ found.transformation, np.eye(4), atol=1e-13)


def test_sensors_on_every_degree_of_freedom_only_turn_the_coordinates(chain):
    k, m, _ = chain
    rows = np.linalg.qr(np.random.default_rng(1).standard_normal((N, N)))[0]
    np.testing.assert_allclose(static_expansion(k, m, rows).transformation, rows.T, atol=1e-12)


@pytest.mark.parametrize("count", [0, 5])
def test_modes_must_be_at_most_as_many_as_sensors(chain, oblique, count):
    with pytest.raises(InputError, match=rf"^expansion: {count} modes are to be fitted to 4 sensors; [^.]*\.$"):
        serep_expansion(oblique, chain[2][:, :count])


def test_modes_that_look_alike_at_the_sensors_are_refused(chain):
    rows, modes = np.eye(N)[[0, 4]], chain[2][:, :2].copy()
    modes[4] = 2.0 * modes[0]  # the second mode only scales the first one's picture
    with pytest.raises(InputError, match=r"2 sensors tell 1 of 2 modes apart; .*more sensors\.$"):
        serep_expansion(rows, modes)
    still = chain[2][:, :2] * np.array([[1.0, 0.0]] * 5 + [[1.0, 1.0]] * 4)
    with pytest.raises(InputError, match="tell 1 of 2"):
        serep_expansion(rows, still)  # the second mode moves no sensor


def test_a_sensor_that_repeats_others_is_named(chain):
    k, m, _ = chain
    rows = np.vstack([np.eye(N)[[2, 5]], np.eye(N)[[2]]])
    with pytest.raises(InputError, match=r"the motion of (3x|7x) follows from that of the other sensors; "):
        static_expansion(k, m, rows, ["3x", "6x", "7x"])
    found = serep_expansion(rows, chain[2][:, :2])  # by modes both have their say
    np.testing.assert_allclose(found.transformation[:, 0], found.transformation[:, 2], atol=1e-12)


def test_a_part_without_a_sensor_that_is_free_is_refused(chain):
    k = sp.csc_array(sp.block_diag([chain[0], 1e3 * np.array([[1.0, -1.0], [-1.0, 1.0]])]))
    with pytest.raises(EvaluationError, match=rf"free, with degree of freedom ({N}|{N + 1}) "):
        static_expansion(k, sp.csc_array(np.eye(N + 2)), np.eye(N + 2)[[0, 3]])
