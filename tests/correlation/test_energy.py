import numpy as np
import pytest
import scipy.sparse as sp
from hypothesis import given
from hypothesis import strategies as st

from calib.correlation.energy import emac, strain_energy_shares
from calib.errors import InputError

seeds = st.integers(0, 2**32 - 1)


def random_case(seed: int, n: int = 9, m: int = 3) -> tuple[sp.csc_array, np.ndarray, dict[str, np.ndarray]]:
    rng = np.random.default_rng(seed)
    half = rng.standard_normal((n, n))
    shapes = rng.standard_normal((n, m)) + 1j * rng.standard_normal((n, m))
    order = rng.permutation(n)
    return sp.csc_array(half @ half.T), shapes, {"a": order[:2], "b": order[2:5], "c": order[5:]}


@given(seeds)
def test_shares_of_a_partition_add_up_to_one_whatever_scale_and_phase(seed):
    stiffness, shapes, clusters = random_case(seed)
    shares, total = strain_energy_shares(stiffness, shapes, clusters)
    assert shares.shape == (3, 3)
    np.testing.assert_allclose(shares.sum(axis=0), 1.0)
    np.testing.assert_allclose(total, 0.5 * np.einsum("ij,ij->j", shapes.conj(), stiffness @ shapes).real)
    turned, _ = strain_energy_shares(stiffness, shapes * [1j, 3.0, -2 + 1j], clusters)
    np.testing.assert_allclose(turned, shares, atol=1e-10)


@given(seeds)
def test_real_shapes_follow_the_published_blockwise_formula(seed):
    stiffness, shapes, clusters = random_case(seed)
    phi, k = shapes.real, stiffness.toarray()
    shares, _ = strain_energy_shares(stiffness, phi, clusters)
    for row, own in enumerate(clusters.values()):
        for j in range(3):
            part = sum(phi[own, j] @ k[np.ix_(own, other)] @ phi[other, j] for other in clusters.values())
            assert shares[row, j] == pytest.approx(part / (phi[:, j] @ k @ phi[:, j]), abs=1e-10)


def test_two_springs_in_series_keep_energy_in_proportion():
    # ground -k1- 1 -k2- 2; the clusters are degrees of freedom, so the second holds phi_2 k2 (phi_2 - phi_1).
    k1, k2 = 3.0, 5.0
    stiffness = sp.csc_array(np.array([[k1 + k2, -k2], [-k2, k2]]))
    shape = np.array([[1.0], [2.0]])
    shares, total = strain_energy_shares(stiffness, shape, {"second": np.array([1])})
    assert total[0] == pytest.approx(0.5 * (k1 * 1 + k2 * 1))
    assert shares[0, 0] == pytest.approx(2 * k2 / (k1 + k2))


def test_vanishing_damping_reaches_the_undamped_shares(build):
    damped, free = build(), build(damped=False)
    stiffness = free.matrices({})[0]
    real = free.modes({}, 4)
    barely = damped.modes({"c_end": 1e-7}, 4)
    assert barely.is_complex and not real.is_complex
    a, _ = strain_energy_shares(stiffness, real.shapes, free.clusters)
    b, _ = strain_energy_shares(stiffness, barely.shapes, free.clusters)
    np.testing.assert_allclose(a, b, atol=1e-8)
    assert np.max(a) > 0.9  # the clusters do tell the modes apart
    strongly, _ = strain_energy_shares(stiffness, damped.modes({"c_end": 190.0}, 4).shapes, free.clusters)
    assert np.max(np.abs(strongly - a)) > 1e-4


def test_a_mode_without_strain_has_no_share(build):
    model = build(grounded=False)
    stiffness = model.matrices({})[0]
    rigid = np.zeros((model.n_dof, 3))
    # The whole chain moves along, to within the rounding of an eigensolver.
    rigid[::2, 0] = np.linalg.eigh(stiffness.toarray()[::2, ::2])[1][:, 0]
    assert rigid[:, 0] @ stiffness @ rigid[:, 0] != 0
    rigid[0, 1] = 1.0
    shares, total = strain_energy_shares(stiffness, rigid, model.clusters)
    assert shares[:, 0].tolist() == [0.0, 0.0] and total[0] == 0.0
    assert shares[:, 1].sum() == pytest.approx(1.0)
    assert shares[:, 2].tolist() == [0.0, 0.0]


def test_clusters_outside_the_model_are_refused():
    with pytest.raises(InputError, match=r"cluster 'far' names a degree of freedom outside 0\.\.1"):
        strain_energy_shares(sp.csc_array(np.eye(2)), np.ones((2, 1)), {"far": np.array([2])})


def test_emac_clips_the_share():
    found = emac(np.full((2, 3), 0.8), np.array([[0.5, 1.2, -0.3], [1.0, 0.0, 0.25]]))
    np.testing.assert_allclose(found, [[0.4, 0.8, 0.0], [0.8, 0.0, 0.2]])
