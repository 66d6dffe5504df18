"""Profiles: geometry against circle and netting theory, and what is refused."""

import numpy as np
import pytest

from calib import InputError
from models.tire.profile import Profile, netting_profile

REACH = np.radians(130)


def arc(n):
    """A circular section of 90 mm about a radius of 0.3 m."""
    phi = np.linspace(-REACH, REACH, n)
    return 0.3 + 0.09 * np.cos(phi), 0.09 * np.sin(phi)


def test_curvatures_of_a_circular_section_converge():
    errors = []
    for n in (21, 41, 81):
        profile = Profile.from_points(*arc(n))
        s = np.linspace(0.05, 0.95, 200) * profile.length
        phi = (s / profile.length - 0.5) * 2 * REACH
        errors.append(np.abs(profile.k1(s) * 0.09 - 1).max())
        assert profile.k2(s) == pytest.approx(np.cos(phi) / profile.r(s), abs=2e-3)
        assert profile.length == pytest.approx(2 * REACH * 0.09, rel=1e-4)
    assert np.log2(errors[0] / errors[1]) > 1.8 and np.log2(errors[1] / errors[2]) > 1.8


def test_the_tangent_is_a_unit_vector_and_the_normal_points_outward_whatever_the_order_of_points():
    r, z = arc(41)
    for profile in (Profile.from_points(r, z), Profile.from_points(r[::-1], z[::-1])):
        s = np.linspace(0, profile.length, 100)
        assert np.hypot(profile.dr(s), profile.dz(s)) == pytest.approx(np.ones(100), abs=1e-12)
        assert profile.dz(profile.length / 2) == pytest.approx(1.0, abs=1e-6)
        assert profile.k1(profile.length / 2) > 0


@pytest.mark.parametrize(("degrees", "curvature"), [(38.0, 11.19), (89.9, 15.87)])
def test_a_netting_profile_has_the_crowns_curvature_of_equilibrium(degrees, curvature):
    profile = netting_profile(0.35, 0.28, 0.22, np.radians(degrees))
    assert profile.k1(profile.length / 2) == pytest.approx(curvature, abs=5e-3)
    assert profile.codazzi_defect() < 1e-5


def test_netting_cords_carry_the_pressure_everywhere():
    r0, rm, angle = 0.35, 0.28, np.radians(38)
    profile = netting_profile(r0, rm, 0.22, angle)
    s = np.linspace(0.03, 0.97, 50) * profile.length
    r = profile.r(s)
    alpha = np.arccos(r * np.cos(angle) / r0)
    meridian = (r0**2 - rm**2) / (2 * r) * np.sin(angle) / np.sin(alpha)
    hoop = meridian / np.tan(alpha) ** 2
    assert meridian * profile.k1(s) + hoop * profile.k2(s) == pytest.approx(np.ones(50), abs=2e-4)


def test_rough_points_are_refused():
    profile = netting_profile(0.33, 0.265, 0.215, np.radians(38))
    s = np.linspace(0, profile.length, 61)
    noise = np.random.default_rng(0).normal(0, 5e-4, (2, 61))
    with pytest.raises(InputError, match="Codazzi"):
        Profile.from_points(profile.r(s) + noise[0], profile.z(s) + noise[1])
    assert Profile.from_points(profile.r(s), profile.z(s)).k1(profile.length / 2) == pytest.approx(12.1, rel=1e-3)


def test_points_that_are_no_profile_are_refused():
    r, z = arc(41)
    turn = np.linspace(0, 4 * np.pi, 60)  # two turns that meet their own line
    loop = 0.3 + 0.05 * np.cos(turn) + 0.01 * turn / np.pi, 0.05 * np.sin(turn)
    for points, words in [
        ((r[:5], z[:5]), "coarse"),
        ((np.where(np.arange(41) == 7, np.nan, r), z), "point 8"),
        ((np.repeat(r, 2), np.repeat(z, 2)), "same"),
        (loop, "crosses itself"),
        ((r[:25], z[:25]), "both beads"),
    ]:
        with pytest.raises(InputError, match=words):
            Profile.from_points(*points)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ((0.33, 0.265, 0.19, 0.66), "bead"),
        ((0.33, 0.20, 0.215, 0.66), "ascend"),
        ((0.33, 0.265, 0.215, 1.7), "degrees"),
    ],
)
def test_impossible_netting_profiles_are_refused(given, words):
    with pytest.raises(InputError, match=words):
        netting_profile(*given)
