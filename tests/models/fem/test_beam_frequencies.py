"""Natural frequencies of beams against the exact Timoshenko theory, with the rate at which they converge."""

import numpy as np
import pytest

from models.fem.frame import Frame
from models.fem.member import Member, Suppression
from models.fem.section import Section

FIXED = tuple(range(6))
PLANE = {"y": (1, 5), "z": (2, 4)}
"""Motions of bending in the local x-y and x-z planes."""
FORCE = {"y": (7, 11), "z": (8, 10)}
ELEMENTS = np.array([2, 4, 8, 16])


def rate(errors, elements=ELEMENTS):
    return -np.polyfit(np.log(elements), np.log(np.abs(errors)), 1)[0]


def bending(exact, section, plane, start, end, length, high):
    """Exact bending frequencies in one plane."""
    (w, t), (q, m) = PLANE[plane], FORCE[plane]

    def zeros(motions):
        return (w if w in motions else q, t if t in motions else m)

    member = Member("beam", "line", section, (0.0, 0.0, 0.0), (length, 0.0, 0.0), 1.0)
    beam = exact(member, start_zero=zeros(start), end_zero=zeros(end), states=(w, t, q, m))
    return beam.frequencies(high / 1000, high, 400)


def supports(name, plane):
    w, t = PLANE[plane]
    return {"free": (), "clamped": (w, t), "pinned": (w,)}[name]


def pinned_shape(section, length, n):
    """Natural frequency in rad/s, wave number and rotation over deflection of mode ``n`` of a pinned beam.

    ``w = sin(n pi x / L)`` turns the theory into a quadratic in omega^2 (Timoshenko 1921), whose lower root bends.
    """
    rho, e = section.density, section.young_modulus
    shear = section.shear_coefficient * section.shear_modulus * section.area
    k = n * np.pi / length
    a = rho * section.area * rho * section.i_z
    b = -(rho * section.area * (e * section.i_z * k**2 + shear) + rho * section.i_z * shear * k**2)
    c = shear * e * section.i_z * k**4
    square = 2 * c / (-b + np.sqrt(b**2 - 4 * a * c))
    return np.sqrt(square), k, k - rho * section.area * square / (shear * k)


ENDS = [
    ("clamped", "free", 0),
    ("free", "free", 2),
    ("pinned", "pinned", 0),
    ("clamped", "clamped", 0),
    ("clamped", "pinned", 0),
]


@pytest.mark.parametrize(("start", "end", "rigid"), ENDS)
def test_slender_beams_converge_with_order_four(exact, line, natural_freq, start, end, rigid):
    side, length = 0.02, 6.0
    slender = Section(side**2, side**4 / 12, side**4 / 12, 0.14 * side**4)
    a, b = supports(start, "y"), supports(end, "y")
    truth = bending(exact, slender, "y", a, b, length, 25.0)[:2]
    meshes = [line(n, length, a, b, PLANE["y"], slender) for n in ELEMENTS]
    errors = np.array([natural_freq(mesh, rigid + 2)[rigid:] for mesh in meshes]) / truth - 1
    print(errors, "RATES", rate(errors[:, 0]), rate(errors[1:, 1], ELEMENTS[1:]))
    assert np.all(errors > 0)  # consistent mass: from above
    assert errors[-1, 0] < 1e-5
    # Two elements of a free beam are more accurate than the rate by chance: the rate is that of the finer three.
    assert rate(errors[1:, 0], ELEMENTS[1:]) == pytest.approx(4.0, abs=0.2)
    assert rate(errors[1:, 1], ELEMENTS[1:]) == pytest.approx(4.0, abs=0.4)


@pytest.mark.mostly_slow(2)
@pytest.mark.parametrize("plane", ["y", "z"])
@pytest.mark.parametrize(("start", "end", "rigid"), ENDS)
def test_stout_beams_converge_with_order_two(exact, section, line, natural_freq, plane, start, end, rigid):
    # The shape functions leave out shear of distributed inertia, whose energy falls with h^2 only (next test).
    length = 1.2
    a, b = supports(start, plane), supports(end, plane)
    truth = bending(exact, section, plane, a, b, length, 3500.0)[:2]
    assert len(truth) == 2
    sizes = np.array([8, 16, 32])
    meshes = [line(n, length, a, b, PLANE[plane]) for n in sizes]
    errors = np.array([natural_freq(mesh, rigid + 2)[rigid:] for mesh in meshes]) / truth - 1
    assert np.all(errors > 0)
    assert errors[-1].max() < 1e-3
    for mode in (0, 1):
        assert rate(errors[:, mode], sizes) == pytest.approx(2.0, abs=0.2)


@pytest.mark.parametrize("length", [0.8, 1.2, 6.0, 30.0])
@pytest.mark.parametrize("n", [16, 32])
def test_error_of_the_element_is_the_energy_its_shapes_leave_out(section, line, natural_freq, length, n):
    # Ritz: the error of omega^2 is the strain energy of elements with both ends held under the inertia forces
    # q = rho A omega^2 w and moments m = rho I omega^2 theta, over the modal mass:
    # q^2 h^5 / (720 E I) + q^2 h^3 / (12 k G A) + m^2 h / (k G A (1 + phi)).
    omega, _, tilt = pinned_shape(section, length, 1)
    h = length / n
    flexural = section.young_modulus * section.i_z
    shear = section.shear_coefficient * section.shear_modulus * section.area
    per_length, rotary = section.density * section.area, section.density * section.i_z
    force, moment = per_length * omega**2, rotary * omega**2 * tilt
    phi = 12 * flexural / (shear * h**2)
    energy = force**2 * (h**4 / (720 * flexural) + h**2 / (12 * shear)) + moment**2 / (shear * (1 + phi))
    expected = 0.5 * energy / (per_length + rotary * tilt**2) / omega**2
    found = natural_freq(line(n, length, (1,), (1,), (1, 5)), 1)[0] * 2 * np.pi / omega - 1
    assert found == pytest.approx(expected, rel=0.03)


def test_pinned_beam_meets_the_closed_form(exact, section, line, natural_freq):
    length = 1.2
    fine = natural_freq(line(100, length, (1,), (1,), (1, 5)), 3)
    transcendental = bending(exact, section, "y", (1,), (1,), length, 3500.0)
    assert len(transcendental) >= 3
    for n in (1, 2, 3):
        closed = pinned_shape(section, length, n)[0] / (2 * np.pi)
        assert transcendental[n - 1] == pytest.approx(closed, rel=1e-9)
        assert fine[n - 1] == pytest.approx(closed, rel=2e-4)


@pytest.mark.parametrize(
    ("start", "end", "rigid", "roots"),
    [
        ("clamped", "free", 0, (1.875104069, 4.694091133, 7.854757438)),
        ("free", "free", 2, (4.730040745, 7.853204624, 10.995607838)),
        ("clamped", "clamped", 0, (4.730040745, 7.853204624, 10.995607838)),
        ("pinned", "pinned", 0, (np.pi, 2 * np.pi, 3 * np.pi)),
    ],
)
def test_slender_beams_meet_euler_and_bernoulli(line, natural_freq, start, end, rigid, roots):
    side, length = 0.01, 10.0
    inertia = side**4 / 12
    slender = Section(side**2, inertia, inertia, 0.14 * side**4)
    a, b = supports(start, "y"), supports(end, "y")
    found = natural_freq(line(40, length, a, b, (1, 5), slender), rigid + 3)[rigid:]
    wave = np.sqrt(slender.young_modulus * inertia / (slender.density * slender.area))
    np.testing.assert_allclose(found, np.array(roots) ** 2 / length**2 * wave / (2 * np.pi), rtol=4e-5)


@pytest.mark.parametrize("motion", [0, 3])
def test_rods_and_shafts_converge_with_order_two(section, line, natural_freq, motion):
    length, density = 1.5, section.density
    speed = np.sqrt(section.young_modulus / density)
    if motion == 3:
        polar = section.i_y + section.i_z
        speed = np.sqrt(section.shear_modulus * section.torsion / (density * polar))
    truth = speed / (4 * length)
    errors = [natural_freq(line(n, length, (motion,), (), (motion,)), 1)[0] / truth - 1 for n in ELEMENTS]
    assert rate(errors) == pytest.approx(2.0, abs=0.05)
    assert 0 < errors[-1] < 1e-3


def frame_in_space(section, n, turn=None, reverse=False):
    corners = np.array([(0.0, 0.0, 0.0), (0.9, 0.2, -0.3), (1.1, 0.8, 0.4), (0.6, 1.5, 0.9)])
    ups = np.array([(0.3, 1.0, 0.2), (1.0, 0.1, 0.4), (0.2, 0.3, 1.0)])
    if turn is not None:
        corners, ups = corners @ turn.T, ups @ turn.T
    members = []
    for i in range(3):
        a, b = (corners[i + 1], corners[i]) if reverse else (corners[i], corners[i + 1])
        size = np.linalg.norm(b - a) / n
        members.append(Member("frame", "all", section, tuple(a), tuple(b), size * 1.0000001, up=tuple(ups[i])))
    return tuple(members), tuple(corners[0]), tuple(corners[-1])


def clamped(members, *ends):
    return Frame(members, (), tuple(Suppression(FIXED, body="frame", point=p) for p in ends))


@pytest.mark.slow
def test_space_frame_converges_to_the_exact_frequencies(exact, section, natural_freq):
    members, first, last = frame_in_space(section, 1)
    truth = exact(*members).frequencies(20.0, 700.0, 700)[:5]
    assert len(truth) == 5
    errors = []
    for n in (4, 8, 16):
        members, first, last = frame_in_space(section, n)
        errors.append(natural_freq(clamped(members, first, last), 5) / truth - 1)
    errors = np.array(errors)
    assert np.all(errors > 0)
    assert np.abs(errors[-1]).max() < 5e-4
    # Torsion, stretching and shear converge with order two, slender bending with four; a frame in space mixes them.
    assert np.all(np.log2(errors[:-1] / errors[1:]) > 1.8)


def test_frequencies_do_not_depend_on_place_or_direction_of_elements(section, natural_freq):
    base, first, last = frame_in_space(section, 3)
    truth = natural_freq(clamped(base, first, last), 12)
    for seed in range(3):
        turn = np.linalg.qr(np.random.default_rng(seed).standard_normal((3, 3)))[0]
        turn *= np.linalg.det(turn)
        members, a, b = frame_in_space(section, 3, turn)
        np.testing.assert_allclose(natural_freq(clamped(members, a, b), 12), truth, rtol=1e-8)
    members, a, b = frame_in_space(section, 3, reverse=True)
    np.testing.assert_allclose(natural_freq(clamped(members, a, b), 12), truth, rtol=1e-8)


def test_halves_of_a_symmetric_beam_mirror_each_other(line, natural_freq):
    left = natural_freq(line(6, 2.0, start=FIXED), 8)
    np.testing.assert_allclose(natural_freq(line(6, 2.0, end=FIXED), 8), left, rtol=1e-8)


@pytest.mark.medium
@pytest.mark.mostly_slow(1)
@pytest.mark.parametrize("motions", [(5,), (4,), (4, 5)])
def test_hinged_end_is_a_pinned_end(exact, section, natural_freq, motions):
    # A clamped node whose beam is hinged there is the same as a pinned node; the hinge condenses mass statically.
    length, n = 1.2, 64
    member = Member("beam", "line", section, (0.0, 0.0, 0.0), (length, 0.0, 0.0), length / n, released_end=motions)
    frame = Frame(
        (member,),
        (),
        (
            Suppression(FIXED, body="beam", point=(0.0, 0.0, 0.0)),
            Suppression(FIXED, body="beam", point=(length, 0.0, 0.0)),
            Suppression((0, 3), groups=("line",)),
        ),
    )
    truth = []
    for plane, (w, t) in PLANE.items():
        end = (w,) if t in motions else (w, t)
        truth += list(bending(exact, section, plane, (w, t), end, length, 3500.0))
    found = natural_freq(frame, 3)
    np.testing.assert_allclose(found, np.sort(truth)[:3], rtol=2e-4)


@pytest.mark.parametrize("n", [1, 8])
def test_hinges_at_both_ends_carry_no_moment(section, n):
    length = 1.2
    member = Member(
        "beam", "line", section, (0.0, 0.0, 0.0), (length, 0.0, 0.0), length / n,
        released_start=(4, 5), released_end=(3, 4, 5),
    )  # fmt: skip
    frame = Frame((member,))
    k, m = (matrix.toarray() for matrix in frame.beams())
    released = [4, 5, 6 * n + 3, 6 * n + 4, 6 * n + 5]
    scale = np.abs(k).max()
    np.testing.assert_allclose(k[released], 0.0, atol=1e-9 * scale)
    np.testing.assert_allclose(m[released], 0.0, atol=1e-12)
    lift = np.zeros(frame.n_full)
    lift[1::6] = 1.0
    assert lift @ m @ lift == pytest.approx(section.density * section.area * length, rel=1e-12)
    np.testing.assert_allclose(k @ lift, 0.0, atol=1e-9 * scale)
    # A strut between its hinges: stiff along its axis alone.
    free = [d for d in range(frame.n_full) if d not in released]
    squares = np.linalg.eigvalsh(k[np.ix_(free, free)])
    assert np.count_nonzero(squares < 1e-9 * scale) == 6
