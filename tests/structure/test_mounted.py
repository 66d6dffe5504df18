"""A rigid body on elastic mounts against closed forms and against an assembly mount by mount."""

import numpy as np
import pytest
import scipy.linalg as la
import scipy.sparse as sp

from calib.errors.errors import InputError
from calib.structure.affine import Grown, Monomial
from calib.structure.effects.attach import GRAVITY, loosened_masses
from calib.structure.mounted import GROWN_SAG, MountedBody, mount_stiffness

MASS, RATIO = 2600.0, 0.04
HALF, ASIDE, HIGH = 1.0, 0.7, 0.4
MOUNTS = np.array([(x, HIGH, z) for x in (HALF, -HALF) for z in (ASIDE, -ASIDE)])
GYRATION = (0.3, 0.8, 0.5)
BODY = MountedBody(MASS, MOUNTS, 1, GYRATION)


def added(body, values, carrier=None):
    """Stiffness, damping and mass over the carrier's six motions and the body's own six."""
    addition = body.let_go(np.eye(6) if carrier is None else carrier, "sag", "lower", "sideways", "ratio")
    kinds = (addition.stiffness, addition.damping, addition.mass)
    return [sum(t.matrix.toarray() * t.coefficient(values) for t in terms) for terms in kinds]


def values(sag, lower=0.0, sideways=0.7):
    return {"sag": sag, "lower": lower, "sideways": sideways, "ratio": RATIO}


def dynamic_stiffness(matrices, lam):
    """Dynamic stiffness at the carrier, with the body's own motions condensed."""
    k, c, m = matrices
    z = k + lam * c + lam**2 * m
    return z[:6, :6] - z[:6, 6:] @ np.linalg.solve(z[6:, 6:], z[6:, :6])


def mount_by_mount(sag, lower, sideways, share=1.0, uneven=0.0, inertia=1.0):
    """Stiffness, damping and mass over the carrier's six motions and the body's six, for the full size of the body."""
    k, omega = MASS * GRAVITY / (4 * sag), np.sqrt(GRAVITY / sag)

    def shift(place):
        x, y, z = place
        return np.array([[1, 0, 0, 0, z, -y], [0, 1, 0, -z, 0, x], [0, 0, 1, y, -x, 0]], dtype=float)

    stiffness, mass = np.zeros((12, 12)), np.zeros((12, 12))
    for place in MOUNTS:
        gap = np.hstack([-shift(place), shift(np.add(place, (0, share * lower, 0)))])
        stiffness += (1 + np.sign(place[0]) * uneven) * gap.T @ np.diag([sideways * k, k, sideways * k]) @ gap
    mass[6:, 6:] = MASS * np.diag([1, 1, 1, *(share**2 * inertia * np.array(GYRATION))])
    return stiffness, 2 * RATIO / omega * stiffness, mass


def test_a_body_on_a_rigid_base_has_its_six_natural_frequencies():
    """Vertical and yaw uncoupled; lateral translations each coupled with a rotation by the height of the mounts."""
    sag, rho, lower = 2e-3, 0.6, 0.15
    k, _, m = added(BODY, values(sag, lower, rho))
    found = np.sort(la.eigvalsh(k[6:, 6:], m[6:, 6:]))
    a = sag**2 / (sag**2 + GROWN_SAG**2)
    h, (gx, gy, gz) = HIGH + a * lower, a**2 * np.array(GYRATION)
    expected = [1.0, rho * (HALF**2 + ASIDE**2) / gy]
    for arm, g in ((ASIDE, gx), (HALF, gz)):
        expected += la.eigvalsh([[rho, rho * h], [rho * h, rho * h**2 + arm**2]], np.diag([1.0, g])).tolist()
    np.testing.assert_allclose(found, np.sort(expected) * GRAVITY / sag, rtol=1e-10)


@pytest.mark.parametrize("sag", [1e-6, 5e-5, 1.3e-3, 0.15])
@pytest.mark.parametrize("lower", [-0.2, 0.0, 0.25])
def test_the_dynamic_stiffness_at_the_carrier_is_that_mount_by_mount(sag, lower):
    own = np.zeros((12, 12))
    own[:3, :3] = MASS * np.eye(3)  # the point mass of the base model
    share = sag**2 / (sag**2 + GROWN_SAG**2)
    k, c, m = added(BODY, values(sag, lower))
    for lam in (0.3j, 40j - 3, 90j):
        told = dynamic_stiffness((k, c, m + own), lam)
        expected = dynamic_stiffness(mount_by_mount(sag, lower, 0.7, share), lam)
        np.testing.assert_allclose(told, expected, rtol=1e-5, atol=1e-7 * abs(expected).max())


@pytest.mark.parametrize(
    ("along", "gains"),
    [
        ((1.0, 1.0, -1.0, -1.0), (1.0, 1.0, -1.0, -1.0)),
        ((1.0, 1.0, 1e-16, -1e-16, -1.0, -1.0), (1.0, 1.0, 0.0, 0.0, -1.0, -1.0)),
        ((1.0, 0.7, 0.4, -1.0), (1 / 3, 1 / 3, 1 / 3, -1.0)),
        ((1.0, 0.0, -0.5, -1.0), (1.0, 0.2, -0.6, -0.6)),
        ((1.0, 2.0, 1.0), (0.0, 0.0, 0.0)),
    ],
)
def test_uneven_mounts_keep_their_mean_stiffness(along, gains):
    mounts = np.array([(x, HIGH, (-1) ** k * ASIDE) for k, x in enumerate(along)])
    blocks = {name: block for name, block, *_ in mount_stiffness(mounts, 1, "lower", "sideways", "uneven")}
    each = [dict((n, b) for n, b, *_ in _of_one(place)) for place in mounts]
    for name in ("upright", "sideways"):
        expected = sum(gain * own[name] for gain, own in zip(gains, each, strict=True)) / len(mounts)
        np.testing.assert_allclose(blocks[f"{name}, uneven"], expected, atol=1e-14)
        np.testing.assert_allclose(blocks[f"{name}, uneven"][:3, :3], 0.0, atol=1e-14)


def _of_one(place):
    return mount_stiffness(place[None], 1, "lower", "sideways")


def test_uneven_mounts_and_another_inertia_are_those_mount_by_mount():
    own = np.zeros((12, 12))
    own[:3, :3] = MASS * np.eye(3)
    addition = BODY.let_go(np.eye(6), "sag", "lower", "sideways", "ratio", "inertia", "uneven")
    for sag, lower, uneven, inertia in ((1e-3, 0.1, 0.6, 1.0), (4e-3, -0.2, -0.4, 0.5), (9e-3, 0.0, 0.0, 2.5)):
        point = {**values(sag, lower), "inertia": inertia, "uneven": uneven}
        k, c, m = (
            sum(t.matrix.toarray() * t.coefficient(point) for t in terms)
            for terms in (addition.stiffness, addition.damping, addition.mass)
        )
        share = sag**2 / (sag**2 + GROWN_SAG**2)
        for lam in (0.3j, 40j - 3, 90j):
            told = dynamic_stiffness((k, c, m + own), lam)
            expected = dynamic_stiffness(mount_by_mount(sag, lower, 0.7, share, uneven, inertia), lam)
            np.testing.assert_allclose(told, expected, rtol=1e-5, atol=1e-7 * abs(expected).max())


def test_no_sag_is_the_point_mass():
    k, c, m = added(BODY, values(0.0, 0.3, 1.2))
    assert not (k[:6].any() or c.any() or m.any())
    assert la.eigvalsh(k[6:, 6:]).min() > 0


def test_equal_mounts_at_the_level_of_the_centre_act_as_springs():
    level = MountedBody(MASS, MOUNTS * [1, 0, 1], 1, (0.0, 0.0, 0.0))
    shifts = loosened_masses(list(np.sqrt(MASS) * np.eye(6)[:3]), "sag", RATIO)
    kinds = (shifts.stiffness, shifts.damping, shifts.mass)
    for sag in (1e-4, 3e-3):
        point = values(sag, 0.0, 1.0)
        other = [sum(t.matrix.toarray() * t.coefficient(point) for t in terms) for terms in kinds]
        expected = dynamic_stiffness(other, 50j - 2)
        np.testing.assert_allclose(
            dynamic_stiffness(added(level, point), 50j - 2), expected, atol=1e-9 * abs(expected).max()
        )


@pytest.mark.parametrize("lower", [-0.3, 0.0, 0.3])
@pytest.mark.parametrize("sag", [1e-6, 1e-4, 5e-3])
def test_the_mass_is_nowhere_negative(sag, lower):
    k, _, m = added(BODY, values(sag, lower))
    m[:3, :3] += MASS * np.eye(3)
    for matrix in (k, m):
        assert la.eigvalsh(matrix).min() > -1e-9 * abs(matrix).max()


def test_derivatives_agree_with_differences():
    carrier = np.random.default_rng(2).standard_normal((6, 9))
    addition, point = BODY.let_go(carrier, "sag", "lower", "sideways", "ratio"), values(3e-4, 0.2, 0.8)
    for terms in (addition.stiffness, addition.damping, addition.mass):
        for name in point:
            step = 1e-5 * point[name]
            up, down = ({**point, name: point[name] + s * step} for s in (1, -1))
            slope, difference = (
                sum(t.matrix * w for t, w in zip(terms, weights, strict=True))
                for weights in (
                    [t.coefficient.derivative(point, name) for t in terms],
                    [(t.coefficient(up) - t.coefficient(down)) / (2 * step) for t in terms],
                )
            )
            assert abs(sp.csr_array(slope - difference)).max() <= 1e-7 * max(abs(sp.csr_array(slope)).max(), 1e-12)


def test_what_has_grown_is_a_half_at_its_half():
    grown = Grown(Monomial(3.0, (("y", 2.0),)), "x", 0.2, 2)
    assert grown({"x": 0.2, "y": 2.0}) == pytest.approx(12 / 4)
    assert grown({"x": 0.0, "y": 2.0}) == 0 and grown({"x": 2e4, "y": 2.0}) == pytest.approx(12)
    assert grown.names == {"x", "y"}


def test_mounts_on_one_line_are_refused():
    with pytest.raises(InputError, match="one line"):
        MountedBody(MASS, MOUNTS[:2], 1, GYRATION)
    with pytest.raises(InputError, match="one line"):
        MountedBody(MASS, MOUNTS * [1, 1, 0], 1, GYRATION)
