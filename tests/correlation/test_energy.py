import numpy as np
import pytest

from calib.correlation.modal.pairing import emac
from calib.structure.energy import strain_energy_shares


def test_vanishing_damping_reaches_the_undamped_shares(build):
    damped, free = build(), build(damped=False)
    stiffness = free.matrices({})[0]
    real = free.modes({}, 4)
    barely = damped.modes({"c_end": 1e-7}, 4)
    assert barely.is_complex and not real.is_complex
    a, _ = strain_energy_shares(stiffness, real.shapes, free.clusters)
    b, _ = strain_energy_shares(stiffness, barely.shapes, free.clusters)
    np.testing.assert_allclose(a, b, atol=1e-8)
    assert np.max(a) > 0.9  # the clusters do distinguish the modes
    strongly, _ = strain_energy_shares(stiffness, damped.modes({"c_end": 190.0}, 4).shapes, free.clusters)
    assert np.max(np.abs(strongly - a)) > 1e-4


def test_a_mode_without_strain_has_no_share(build):
    model = build(grounded=False)
    stiffness = model.matrices({})[0]
    rigid = np.zeros((model.n_dof, 3))
    # The whole chain moves along, to within the rounding error of an eigensolver.
    rigid[::2, 0] = np.linalg.eigh(stiffness.toarray()[::2, ::2])[1][:, 0]
    assert rigid[:, 0] @ stiffness @ rigid[:, 0] != 0
    rigid[0, 1] = 1.0
    shares, total = strain_energy_shares(stiffness, rigid, model.clusters)
    assert shares[:, 0].tolist() == [0.0, 0.0] and total[0] == 0.0
    assert shares[:, 1].sum() == pytest.approx(1.0)
    assert shares[:, 2].tolist() == [0.0, 0.0]


def test_emac_clips_the_share():
    found = emac(np.full((2, 3), 0.8), np.array([[0.5, 1.2, -0.3], [1.0, 0.0, 0.25]]))
    np.testing.assert_allclose(found, [[0.4, 0.8, 0.0], [0.8, 0.0, 0.2]])
