"""The reconstructed solar array: its elements, its frequencies, and the mechanisms that hinges would leave."""

import math

import numpy as np
import pytest
import scipy.linalg as la

from calib import InputError
from models.fem import beam, thin_plate
from models.solar_panel import BEAM, BEAMS, E_BEAM, E_PLATE, GROUPS, MASTERS, solar_panel

# Frequencies of this geometry, Hz, and errors of the initial model by the article's factors, %, from an independent
# assembly with the same elements.
FREQ = (0.303, 2.404, 3.961, 9.209, 13.002, 18.721, 49.70, 57.73)
ERROR = (-17.21, -12.83, -16.22, -13.25, -12.02, -12.47)


@pytest.fixture(scope="module")
def panel():
    return solar_panel()


# -- the plate element -------------------------------------------------------------------------------------------------


def nodal(w, dx, dy, a, b):
    """Nodal motions of a deflection field, (12,)."""
    return np.array([(w(x, y), dy(x, y), -dx(x, y)) for x, y in ((0, 0), (a, 0), (a, b), (0, b))]).ravel()


def test_a_plate_has_three_rigid_motions_and_no_mechanism():
    k = thin_plate.stiffness(0.3, 0.2, 6e-3, 0.3)
    values = la.eigvalsh(k)
    assert np.all(np.abs(values[:3]) < 1e-12 * values[-1]) and values[3] > 1e-6 * values[-1]
    np.testing.assert_allclose(k, k.T, atol=1e-15 * values[-1])


def test_a_plate_bends_exactly_where_its_curvature_is_constant():
    a, b, t, nu = 0.3, 0.2, 6e-3, 0.3
    k = thin_plate.stiffness(a, b, t, nu)
    rigidity = t**3 / 12 / (1 - nu**2)
    bent = nodal(lambda x, y: x**2 / 2, lambda x, y: x, lambda x, y: 0, a, b)
    twisted = nodal(lambda x, y: x * y, lambda x, y: y, lambda x, y: x, a, b)
    dished = nodal(lambda x, y: (x**2 + y**2) / 2, lambda x, y: x, lambda x, y: y, a, b)
    assert bent @ k @ bent == pytest.approx(rigidity * a * b)
    assert twisted @ k @ twisted == pytest.approx(2 * (1 - nu) * rigidity * a * b)
    assert dished @ k @ dished == pytest.approx(2 * (1 + nu) * rigidity * a * b)


def test_a_plate_has_its_mass_and_its_moments_of_inertia():
    a, b = 0.3, 0.2
    m = thin_plate.mass(a, b, 40.0)
    lifted = nodal(lambda x, y: 1, lambda x, y: 0, lambda x, y: 0, a, b)
    tilted = nodal(lambda x, y: x, lambda x, y: 1, lambda x, y: 0, a, b)
    assert lifted @ m @ lifted == pytest.approx(40.0 * a * b)
    assert tilted @ m @ tilted == pytest.approx(40.0 * a**3 * b / 3)


def simply_supported(cells):
    """First frequency of a simply supported square plate of 1 m over the Kirchhoff one."""
    nodes, h = cells + 1, 1.0 / cells
    k, m = np.zeros((2, 3 * nodes**2, 3 * nodes**2))
    own = thin_plate.stiffness(h, h, 0.01, 0.3), thin_plate.mass(h, h, 1.0)
    for i, j in np.ndindex(cells, cells):
        corners = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
        dofs = np.ravel([3 * (p * nodes + q) + np.arange(3) for p, q in corners])
        k[np.ix_(dofs, dofs)] += own[0]
        m[np.ix_(dofs, dofs)] += own[1]
    held = set()
    for i, j in np.ndindex(nodes, nodes):
        node = 3 * (i * nodes + j)
        if i in (0, cells) or j in (0, cells):
            held.add(node)
        if i in (0, cells):
            held.add(node + 1)  # no slope along the edge x = const
        if j in (0, cells):
            held.add(node + 2)
    free = np.setdiff1d(np.arange(len(k)), sorted(held))
    lowest = la.eigh(k[np.ix_(free, free)], m[np.ix_(free, free)], eigvals_only=True)[0]
    rigidity = 0.01**3 / 12 / (1 - 0.3**2)
    return math.sqrt(lowest / rigidity) / (2 * math.pi**2)


def test_plates_converge_to_kirchhoffs_at_second_order():
    errors = [abs(simply_supported(cells) - 1) for cells in (4, 8, 16)]
    assert errors[0] < 0.03
    assert 1.8 < math.log2(errors[0] / errors[1]) < 2.2 and 1.8 < math.log2(errors[1] / errors[2]) < 2.2


# -- the array ---------------------------------------------------------------------------------------------------------


def test_size_and_matrices_are_those_of_the_article(panel):
    k, _, m = panel.matrices({})
    assert panel.n_dof == 90 and len(panel.mesh.points) == 31 and len(panel.mesh.faces) == 16
    assert len(MASTERS) == 12 and len(BEAMS) == 4
    for matrix in (k, m):
        dense = matrix.toarray()
        np.testing.assert_allclose(dense, dense.T, atol=1e-12 * np.abs(dense).max())
        assert la.eigvalsh(dense)[0] > 0
    lifted = (panel.dofs.direction == 2).astype(float)
    per_beam = 1e-4 * 2700
    # Of a beam clamped at one end, 13/35 move with a lifted other end that does not turn.
    by_hand = 2 * 0.8 * 0.4 * 6e-3 * 8000 + per_beam * (2 * 0.4 + 13 / 35 * 2 * math.hypot(0.4, 0.2))
    assert lifted @ m @ lifted == pytest.approx(by_hand, rel=1e-5)  # rotary inertia of the beams beside it


def test_frequencies_before_and_after_the_articles_change(panel):
    before = panel.modes({}, 8).natural_freq
    np.testing.assert_allclose(before, FREQ, rtol=2e-3)
    factor = {
        "E_panel_1": 1.2,
        "E_panel_2": 1.2,
        "E_beam_17": 1.3,
        "E_beam_18": 1.3,
        "E_beam_19": 1.5,
        "E_beam_20": 1.5,
    }
    values = {name: f * panel.space[name].value for name, f in factor.items()}
    after = panel.modes(values, 6).natural_freq
    np.testing.assert_allclose(100 * (before[:6] / after - 1), ERROR, atol=0.006)


def test_parts_add_up_to_the_matrices(panel):
    k, _, m = panel.matrices({})
    own = {kind: 0 for kind in ("stiffness", "mass")}
    for part in panel.parts:
        modulus = 1e9 * (E_PLATE if part.name.startswith("plate") else E_BEAM)
        own[part.kind] = own[part.kind] + part.matrix * (modulus if part.kind == "stiffness" else 1.0)
    assert abs(own["stiffness"] - k).max() < 1e-12 * abs(k).max()
    assert abs(own["mass"] - m).max() < 1e-12 * abs(m).max()
    assert panel.space.names == GROUPS


@pytest.mark.medium
def test_a_finer_mesh_is_softer_and_keeps_the_places(panel):
    fine = solar_panel(2)
    freq = [model.modes({}, 6).natural_freq for model in (panel, fine, solar_panel(4))]
    assert np.all(freq[0] > freq[1]) and np.all(freq[1] > freq[2])
    assert np.all(freq[0] / freq[1] - 1 < 0.03)
    np.testing.assert_allclose(fine.mesh.points[:31], panel.mesh.points)


def test_beams_on_hinges_leave_mechanisms(panel):
    """The article's articulated beams cannot be hinged at both ends: they would carry no panel."""
    k = panel.matrices({})[0].toarray()
    motions = np.array([2, 3, 4, 8, 9, 10])
    hinged = k.copy()
    for part in panel.parts:
        if part.kind == "stiffness" and part.name.startswith("beam"):
            hinged -= 1e9 * E_BEAM * part.matrix.toarray()
    places = zip(panel.dofs.node, panel.dofs.direction, strict=True)
    label = {(int(node) + 1, int(d)): k for k, (node, d) in enumerate(places)}
    for first, last in BEAMS.values():
        start, end = panel.mesh.points[[first - 1]], panel.mesh.points[[last - 1]]
        length, rotation = beam.axes(start, end, np.array([[0.0, 0.0, 1.0]]))
        released = np.zeros(12, dtype=bool)
        released[[5, 11]] = True  # local bending in the vertical plane
        local, _ = beam.release(beam.stiffness(BEAM, length), beam.mass(BEAM, length), released)
        block = 1e9 * E_BEAM * beam.to_global(local, rotation, np.zeros((1, 2, 3)))[0][np.ix_(motions, motions)]
        dofs = [label.get((node, d)) for node in (first, last) for d in (2, 3, 4)]
        keep = [i for i, dof in enumerate(dofs) if dof is not None]
        rows = [dofs[i] for i in keep]
        hinged[np.ix_(rows, rows)] += block[np.ix_(keep, keep)]
    m = panel.matrices({})[2].toarray()
    values = la.eigh(hinged, m, eigvals_only=True)
    assert np.count_nonzero(np.abs(values) < 1e-6) >= 2 and la.eigh(k, m, eigvals_only=True)[0] > 1


def test_damping_gives_every_nominal_mode_the_same_ratio_and_no_other_frequency(panel):
    damped = solar_panel(damping_ratio=0.005)
    assert damped.space.names == (*GROUPS, "damping_ratio") and not panel.damping.terms
    modes, scaled = damped.modes({}, 8), damped.modes({"damping_ratio": 0.02}, 8)
    np.testing.assert_allclose(modes.damping_ratio, 0.005, rtol=1e-6)
    np.testing.assert_allclose(scaled.damping_ratio, 0.02, rtol=1e-6)
    np.testing.assert_allclose(scaled.natural_freq, panel.modes({}, 8).natural_freq, rtol=1e-8)
    stiffer = {f"E_panel_{k}": 4 * E_PLATE for k in (1, 2)} | {f"E_beam_{k}": 4 * E_BEAM for k in BEAMS}
    np.testing.assert_allclose(damped.modes(stiffer, 8).damping_ratio, 0.0025, rtol=1e-6)  # viscous: C stays


@pytest.mark.parametrize("given", [{"density": 0}, {"gap": 0.0}, {"yoke": -0.1}, {"damping_ratio": -0.01}])
def test_impossible_dimensions_are_refused(given):
    with pytest.raises(InputError):
        solar_panel(**given)
