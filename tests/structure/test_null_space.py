"""Rows and motions with neither stiffness nor mass: the frequencies of the rest, and what is told."""

import numpy as np
import pytest
import scipy.linalg as la
import scipy.sparse as sp

from calib.errors.errors import EvaluationError, InputError
from calib.measurement.modal import Sensor
from calib.problem.space import Parameter
from calib.structure.eigenproblem.solve import solve_modes
from calib.structure.model import StructuralModel
from calib.structure.null_space import common_null_space

E = Parameter("E", 1.0, 0.5, 2.0, "-")


def chain(n):
    stiffness = 1e6 * (2 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1))
    stiffness[-1, -1] = 1e6
    return stiffness, np.eye(n)


def padded(matrix, count):
    out = np.zeros((len(matrix) + count,) * 2)
    out[: len(matrix), : len(matrix)] = matrix
    return out


def model(stiffness, mass, damping=None):
    dofs = [(k // 3 + 1, "xyz"[k % 3]) for k in range(len(stiffness))]
    return StructuralModel.from_matrices(
        {"E": sp.csr_array(stiffness)}, sp.csr_array(mass), damping, dofs=dofs, parameters=[E]
    )


def wanted(stiffness, mass, count=4):
    return np.sqrt(la.eigvalsh(stiffness, mass))[:count] / (2 * np.pi)


@pytest.mark.parametrize("n", [12, 100])  # solved densely, and by iteration
@pytest.mark.parametrize("count", [1, 3])
def test_empty_rows_are_named_and_dropped(n, count):
    k, m = chain(n)
    found = model(padded(k, count), padded(m, count))
    np.testing.assert_allclose(found.modes({"E": 1.0}, 4).natural_freq, wanted(k, m), rtol=1e-9)
    (told,) = found.assumptions
    assert f"{count} empty row" in told.item and f"node {n // 3 + 1}, {'xyz'[n % 3]}" in told.item
    with pytest.raises(InputError, match="suppresses"):
        found.sensor_rows([Sensor(n // 3 + 1, "xyz"[n % 3])])
    assert found.sensor_rows([Sensor(1, "y")])[0, 1] == 1


@pytest.mark.parametrize("n", [12, 100])
@pytest.mark.parametrize("count", [1, 3])
@pytest.mark.parametrize("with_massless", [False, True])
def test_common_null_motions_leave_the_frequencies_as_they_are(n, count, with_massless):
    """The empty directions turned into the others: null to rounding, as hourglass motions are."""
    k, m = chain(n)
    if with_massless:
        m[2, 2] = 0.0
    turn = la.qr(np.random.default_rng(count).normal(size=(n + count,) * 2))[0]
    a, b = (turn @ padded(matrix, count) @ turn.T for matrix in (k, m))
    found = model((a + a.T) / 2, (b + b.T) / 2)
    inverse = la.eigvalsh(m, k)[::-1][:4]  # M may be singular
    for value in (1.0, 1.7):
        freq = found.modes({"E": value}, 4).natural_freq
        np.testing.assert_allclose(freq, np.sqrt(value / inverse) / (2 * np.pi), rtol=1e-7)
    (told,) = found.assumptions
    assert told.item == f"common null space: {count} motion{'s' * (count > 1)}" and "node" in told.value


def test_the_motions_are_those_without_stiffness_and_mass():
    k, m = chain(9)
    turn = la.qr(np.random.default_rng(5).normal(size=(11, 11)))[0]
    rows, motions = common_null_space(*(sp.csc_array(turn @ padded(a, 2) @ turn.T) for a in (k, m)))
    assert motions.shape == (11, 2)
    np.testing.assert_allclose(motions[rows], np.eye(2), atol=1e-12)
    null = turn[:, 9:]
    np.testing.assert_allclose(null @ (null.T @ motions), motions, atol=1e-10)


@pytest.mark.parametrize("rigid", [False, True])
def test_sound_models_lose_nothing(rigid):
    """A free structure, massless rows, and a soft static motion of them are no common null space."""
    k, m = chain(60)
    if rigid:
        k[0, 0] = 1e6
    m[10:40, 10:40] = 0.0  # a massless part of the chain
    found = model(k, m)
    assert found.n_dof == 60 and found.assumptions == ()
    beam = sp.diags_array([1.0, -4.0, 6.0, -4.0, 1.0], offsets=[-2, -1, 0, 1, 2], shape=(200, 200))
    ends = np.zeros(200)
    ends[[0, -1]] = 1.0
    assert len(common_null_space(sp.csc_array(beam), sp.csc_array(sp.diags_array(ends)))[0]) == 0


def test_a_damped_null_motion_and_a_model_without_rows_are_refused():
    k, m = chain(6)
    turn = la.qr(np.random.default_rng(3).normal(size=(7, 7)))[0]
    a, b = (turn @ padded(matrix, 1) @ turn.T for matrix in (k, m))
    with pytest.raises(InputError, match=r"common null space: 1 motion .* with damping"):
        model((a + a.T) / 2, (b + b.T) / 2, np.eye(7))
    with pytest.raises(InputError, match="no row has stiffness"):
        StructuralModel.from_matrices(np.zeros((2, 2)), np.zeros((2, 2)), dofs=[(1, "x"), (2, "x")])


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("damped", [False, True])
@pytest.mark.parametrize("n", [12, 100])
def test_a_solver_names_the_common_null_space(n, damped, seed):
    """Whatever rounding makes of the vanishing pivots: in some of these turns the factor is regular."""
    k, m = chain(n)
    turn = la.qr(np.random.default_rng(seed).normal(size=(n + 2,) * 2))[0]
    a, b = (sp.csc_array(turn @ padded(matrix, 2) @ turn.T) for matrix in (k, m))
    stiffness, mass = sp.csc_array((a + a.T) / 2), sp.csc_array((b + b.T) / 2)
    with pytest.raises(EvaluationError, match="common null space: 2 motions"):
        solve_modes(stiffness, 1e-4 * stiffness if damped else None, mass, 4)


@pytest.mark.parametrize("n", [12, 100])
def test_a_free_chain_has_its_modes(n):
    k, m = chain(n)
    k[0, 0] = -k[0, 1]  # nothing holds its ends
    k[-1, -1] = -k[-1, -2]
    found = solve_modes(sp.csc_array(k), None, sp.csc_array(m), 4)
    exact = np.sqrt(la.eigh(k, m, eigvals_only=True)[1:5]) / (2 * np.pi)
    assert found.natural_freq == pytest.approx(exact, rel=1e-8)
