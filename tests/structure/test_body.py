"""Rigid bodies of unknown mass against closed forms and against an assembly mount by mount."""

import numpy as np
import pytest
import scipy.linalg as la

from calib.errors.errors import InputError
from calib.structure.body import fixed_body, mounted_body, mounted_mass
from calib.structure.effects.attach import hung_masses

MASS, FREQ, SIDE, LOWER, RADIUS, RATIO = 90.0, 14.0, 1.7, 0.12, 0.18, 0.03
MOUNTS = np.array([(x, 0.05, z) for x in (0.12, -0.12) for z in (0.2, -0.2)])
VALUES = {"m": MASS, "f": FREQ, "s": SIDE, "d": LOWER, "r": RADIUS, "z": RATIO}


def matrices(addition, values=VALUES):
    kinds = (addition.stiffness, addition.damping, addition.mass)
    n = next(t.matrix.shape[0] for terms in kinds for t in terms)
    return [sum((t.matrix.toarray() * t.coefficient(values) for t in terms), np.zeros((n, n))) for terms in kinds]


def at_carrier(parts, lam, carrier=6):
    """Dynamic stiffness at the carrier, with the body's own motions condensed."""
    k, c, m = parts
    z = k + lam * c + lam**2 * m
    return z[:carrier, :carrier] - z[:carrier, carrier:] @ np.linalg.solve(z[carrier:, carrier:], z[carrier:, :carrier])


def shift(place):
    """Translation of a place by the six motions of a rigid body."""
    x, y, z = place
    return np.array([[1, 0, 0, 0, z, -y], [0, 1, 0, -z, 0, x], [0, 0, 1, y, -x, 0]], dtype=float)


def mount_by_mount(mass):
    """Stiffness, damping and mass over the carrier's six motions and those of the body's centre."""
    omega = 2 * np.pi * FREQ
    k = mass * omega**2 / len(MOUNTS)
    stiffness, inertia = np.zeros((12, 12)), np.zeros((12, 12))
    for place in MOUNTS:
        gap = np.hstack([-shift(place), shift(np.add(place, (0, LOWER, 0)))])
        stiffness += gap.T @ np.diag([SIDE**2 * k, k, SIDE**2 * k]) @ gap
    inertia[6:, 6:] = mass * np.diag([1, 1, 1, *[RADIUS**2] * 3])
    return stiffness, 2 * RATIO / omega * stiffness, inertia


def mounted(carrier=None):
    return mounted_body(np.eye(6) if carrier is None else carrier, 1, MOUNTS, "m", "f", "s", "d", "r", "z")


@pytest.mark.parametrize("lam", [0.3j, 70j - 3, 300j])
def test_a_body_on_mounts_loads_its_carrier_as_mount_by_mount(lam):
    expected = at_carrier(mount_by_mount(MASS), lam)
    np.testing.assert_allclose(
        at_carrier(matrices(mounted()), lam), expected, rtol=1e-9, atol=1e-9 * abs(expected).max()
    )


def test_without_mass_the_carrier_feels_nothing_and_the_eigenproblem_stays_regular():
    k, c, m = matrices(mounted(), {**VALUES, "m": 0.0})
    for one in (k, c, m):
        assert not one[:6].any()
    assert la.eigvalsh(k[6:, 6:], m[6:, 6:]).min() > 0


def test_a_body_on_a_rigid_base_has_its_upright_frequency_and_rocks():
    k, _, m = matrices(mounted())
    found = np.sqrt(la.eigvalsh(k[6:, 6:], m[6:, 6:])) / (2 * np.pi)
    assert np.isclose(found, FREQ, rtol=1e-10).sum() == 1
    yaw = FREQ * SIDE * np.hypot(0.12, 0.2) / RADIUS
    assert np.isclose(found, yaw, rtol=1e-10).sum() == 1


@pytest.mark.parametrize("lam", [0.3j, 70j - 3, 300j])
def test_mounts_in_three_directions_are_a_hung_mass_in_each(lam):
    rows, zero = np.eye(3), {**VALUES}
    mine = at_carrier(matrices(mounted_mass(rows, 1, "m", "f", "s", "z"), zero), lam, 3)
    for direction, factor in ((0, SIDE), (1, 1.0), (2, SIDE)):
        ratio = RATIO * factor  # damping is proportional to stiffness
        own = matrices(hung_masses([rows[direction]], "m", "f", ratio), {"m": MASS, "f": FREQ * factor})
        assert np.isclose(mine[direction, direction], at_carrier(own, lam, 3)[direction, direction], rtol=1e-12)
    assert abs(mine - np.diag(np.diag(mine))).max() == 0


def test_a_fixed_body_has_the_inertia_of_an_eccentric_mass():
    (_, _, m) = matrices(fixed_body(np.eye(6), 1, "m", "d", "r"))
    low = shift((0.0, -LOWER, 0.0))
    expected = MASS * (low.T @ low) + np.diag([0, 0, 0, *[MASS * RADIUS**2] * 3])
    np.testing.assert_allclose(m, expected, rtol=1e-12, atol=1e-12)


def test_stiff_mounts_make_the_fixed_body():
    stiff = {**VALUES, "f": 1e4}
    loose, fixed = matrices(mounted(), stiff), matrices(fixed_body(np.eye(6), 1, "m", "d", "r"))
    expected = (60j) ** 2 * fixed[2]
    np.testing.assert_allclose(at_carrier(loose, 60j), expected, rtol=1e-3, atol=1e-4 * abs(expected).max())


def test_derivatives_follow_from_the_terms():
    for addition in (
        mounted(),
        fixed_body(np.eye(6), 1, "m", "d", "r"),
        mounted_mass(np.eye(3), 1, "m", "f", "s", "z"),
    ):
        for term in (*addition.stiffness, *addition.damping, *addition.mass):
            for name in term.coefficient.names:
                step = 1e-6 * VALUES[name]
                high, low = (term.coefficient({**VALUES, name: VALUES[name] + s}) for s in (step, -step))
                assert np.isclose(term.coefficient.derivative(VALUES, name), (high - low) / (2 * step), rtol=1e-6)


def test_mounts_on_a_line_are_refused():
    with pytest.raises(InputError, match="on one line"):
        mounted_body(np.eye(6), 1, MOUNTS[:2], "m", "f", "s", "d", "r", "z")
