"""Every effect that the vehicle may lack against closed forms and independent calculations."""

import numpy as np
import pytest
import scipy.linalg as la
import scipy.sparse as sp

from calib.structure import GRAVITY, loosened_masses, motion
from calib.structure.eigenproblem.solve import solve_modes
from models.railway import vehicle_effects
from models.railway.equipment import passenger_seats
from models.railway.vehicle_effects_equipment import SEAT_RATIO

EFFECTS = {e.name: e for e in vehicle_effects()}


@pytest.fixture(scope="module")
def alone(effect_checks, rigid_car):
    return effect_checks.Alone(rigid_car, EFFECTS)


@pytest.fixture(scope="module")
def energy(effect_checks):
    return effect_checks.energy


# -- the body ----------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", list(EFFECTS))
def test_a_rise_of_the_whole_works_against_nothing_but_what_stands_on_the_ground(alone, energy, name):
    effect = EFFECTS[name]
    stiffness, damping, mass = alone.change(name, (effect.grid[0] if effect.grid else {name: effect.plausible}))
    rise = alone.rigid(1)
    held = {"neighbour_coupling": 150e3, "track_compliance": -8 * 1.2e9 * (1 - 1 / (1 + 1.2e9 * 8e-9))}
    assert energy(stiffness, rise) == pytest.approx(held.get(name, 0.0), abs=1e-3)
    assert energy(damping, rise) == pytest.approx(0.0, abs=1e-6 * max(abs(damping).max(), 1.0))
    assert energy(mass, rise) == pytest.approx(200.0 if name == "bolster_mass" else 0.0, abs=1e-6)


@pytest.mark.slow
def test_soft_floor_joint_gives_its_share_of_a_strip_that_bends_evenly(alone, energy):
    # Turned by kappa (|z| - 1.1) beyond the cross-beams' inner ends: energy lost is share EI kappa^2 width.
    share, kappa = 0.4, 1e-3

    def turned(x, y, z):
        beyond = kappa * np.maximum(np.abs(z) - 1.1, 0)
        return 0, -(beyond**2) / (2 * kappa), 0, np.sign(z) * beyond, 0, 0

    bent = alone.field(turned, {"car"})
    plate = 25.9 * 225 * 70e9 * 10.2e-3**3 / 12
    beams = 70e9 * (12 * 3e-5 + 2 * 4e-5)
    lost = energy(alone.change("floor_joint", {"floor_joint": share})[0], bent)
    assert lost == pytest.approx(-share * 2 * (plate + beams) * kappa**2 * 0.3, rel=1e-6)


@pytest.mark.slow
def test_soft_window_corners_give_their_share_of_pillars_that_bend_evenly(alone, energy):
    share, kappa = 0.5, 1e-3
    bent = alone.field(lambda x, y, z: (-kappa * (y - 1.8) ** 2 / 2, 0, 0, 0, 0, kappa * (y - 1.8)))
    lost = energy(alone.change("window_corners", {"window_corners": share})[0], bent)
    # The walls lean a little, so that height is gained more slowly than along the pillars.
    rigidity = 70e9 * 2 * (8 * 8e-5 + 2 * 1e-5)
    assert lost == pytest.approx(-share * rigidity * kappa**2 * (2.75 - 1.80), rel=0.02)


@pytest.mark.medium
def test_panes_resist_shear_of_their_openings_alone(alone, energy):
    stiffness = alone.change("window_glass", {"window_glass": 8.0})[0]
    lengthwise = energy(stiffness, alone.field(lambda x, y, z: (1e-3 * y, 0, 0, 0, 0, 0)))
    upright = energy(stiffness, alone.field(lambda x, y, z: (0, 1e-3 * x, 0, 0, 0, 0)))
    height = np.hypot(2.275 - 1.8, 0.02) + np.hypot(2.75 - 2.275, 0.06)
    assert lengthwise == pytest.approx(18 * 8e6 * 2.0 * height * 1e-6, rel=0.02)
    assert upright == pytest.approx(lengthwise, rel=0.02)
    turned = energy(stiffness, alone.field(lambda x, y, z: (-1e-3 * y, 1e-3 * x, 0, 0, 0, 0)))
    stretched = energy(stiffness, alone.field(lambda x, y, z: (1e-3 * x, 1e-3 * y, 0, 0, 0, 0)))
    assert max(turned, stretched) < 0.01 * lengthwise


@pytest.mark.medium
def test_a_free_body_in_bending_has_the_damping_ratio_that_is_asked_for(alone, rigid_car):
    # zeta = phi^T C phi/(2 omega) for phi of unit mass and omega^2 = phi^T K phi: any shape of the aluminium shows it.
    damping = alone.change("body_damping", {"body_damping": 2.0})[1]
    whole = rigid_car.stiffness
    si = rigid_car.space.si(rigid_car.space.complete({}))
    aluminium = sum(
        t.matrix * t.coefficient(si) for t in whole.terms if t.name.split(":")[0] in
        ("frames", "pillars", "base", "walls", "cover", "ends")
    )  # fmt: skip
    shape = np.random.default_rng(1).standard_normal(rigid_car.n_dof)
    mass = (shape @ aluminium @ shape) / (2 * np.pi * 10.0) ** 2  # such that its frequency is 10 Hz
    assert shape @ damping @ shape / (2 * mass * 2 * np.pi * 10.0) == pytest.approx(0.02)


@pytest.mark.medium
def test_neighbour_holds_the_rear_end_against_rising_and_lengthwise(alone, energy):
    stiffness = alone.change("neighbour_coupling", {"neighbour_coupling": 400.0})[0]
    assert energy(stiffness, alone.rigid(0, {"car"})) == pytest.approx(400e3)
    pitch = alone.rigid(5, {"car"}, (0.0, 1.0, 0.0))
    assert energy(stiffness, pitch) == pytest.approx(400e3 * 12.95**2)


def test_weight_tips_a_body_that_rolls_and_no_other(alone, energy):
    stiffness = alone.change("tipping", {"tipping": 180.0})[0]
    assert energy(stiffness, alone.rigid(3, {"car"}, (0.0, 1.0, 0.0))) == pytest.approx(-180e3)
    assert energy(stiffness, alone.rigid(1, {"car"})) == pytest.approx(0.0, abs=1e-6)
    assert energy(stiffness, alone.rigid(3, {"front_frame", "front_load_bolster"})) == pytest.approx(0.0, abs=1e-6)


# -- equipment ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "item", "mass", "centre", "feet"),
    [
        ("hung_converter", "traction converter", 2600.0, (-4.0, 0.75, 0.0), (1.15, 0.70)),
        ("hung_roof_unit", "front roof unit", 600.0, (4.0, 3.6, 0.0), (3.44, 0.76)),
    ],
)
def test_a_hung_unit_is_a_rigid_body_on_its_feet(alone, rigid_car, name, item, mass, centre, feet):
    # Assembled foot by foot over the six motions of what carries it and of the unit about its own, lower centre.
    sag, lower, rho, zeta, root, n = 2e-3, 0.1, 0.6, 0.04, 40j - 3, rigid_car.n_dof
    values = {name: 1e3 * sag, f"{name}_drop": lower, f"{name}_sideways": rho, f"{name}_damping": zeta}
    k, c, m = alone.change(name, values)
    z = sp.csc_array(k + root * c + root**2 * m)
    carrier = np.array([motion(rigid_car, (item, centre), d) for d in range(6)])
    plane = np.linalg.solve(carrier @ carrier.T, carrier)  # one motion of the vehicle for each motion of the carrier
    inner, coupling = z[n:, n:].toarray(), z[n:, :n] @ plane.T
    felt = plane @ (z[:n, :n] @ plane.T) - coupling.T @ np.linalg.solve(inner, coupling)

    share = sag**2 / (sag**2 + 1e-8)  # of its size that a unit has whose mounts give by so much
    box = np.array([2.4, 0.7 if mass > 1000 else 0.3, 1.8])
    whole = np.zeros((12, 12), dtype=complex)
    whole[6:, 6:] = root**2 * mass * np.diag([1, 1, 1, *(share**2 * (box @ box - box**2) / 12)])
    mount = mass / 4 * (GRAVITY / sag + 2 * zeta * np.sqrt(GRAVITY / sag) * root) * np.diag([rho, 1, rho])
    for x, y, s in ((a, feet[0] - centre[1], b * feet[1]) for a in (1, -1) for b in (1, -1)):
        gap = np.hstack([-np.eye(3), np.cross((x, y, s), np.eye(3)).T, np.eye(3), np.zeros((3, 3))])
        gap[:, 9:] = -np.cross((x, y + share * lower, s), np.eye(3)).T
        whole += gap.T @ mount @ gap
    expected = whole[:6, :6] - whole[:6, 6:] @ np.linalg.solve(whole[6:, 6:], whole[6:, :6])
    expected -= root**2 * mass * np.diag([1, 1, 1, 0, 0, 0])
    np.testing.assert_allclose(felt, expected, atol=1e-6 * np.abs(expected).max())


@pytest.mark.slow
def test_few_patterns_of_seats_do_what_sixty_seats_do(alone, rigid_car):
    # Sixty oscillators and ten, each with the lowest undamped modes of the car on rigid seats.
    masses = passenger_seats(sprung=False).masses
    rows = [np.sqrt(item.mass) * motion(rigid_car, item.at, 1) for item in masses]
    all_seats = loosened_masses(rows, "soft_seats", SEAT_RATIO)
    k, _, m = rigid_car.matrices({})
    modes = solve_modes(k, None, m, 30, rigid_car.dofs.direction >= 3)
    shapes = modes.shapes / np.sqrt(np.einsum("ij,ij->j", modes.shapes, m @ modes.shapes))
    for sag in (0.5, 2.0):
        found = []
        for added in (all_seats, alone.addition("soft_seats")):
            basis = la.block_diag(shapes, np.eye(added.n_added))
            si = {"soft_seats": sag * 1e-3}
            kk, mm = (
                sum(basis.T @ (t.matrix @ basis) * t.coefficient(si) for t in terms)
                for terms in (added.stiffness, added.mass)
            )
            size = len(shapes.T)
            kk[:size, :size] += shapes.T @ (k @ shapes)
            mm[:size, :size] += np.eye(size)
            values, vectors = la.eigh(kk, mm)
            floor = np.sum(vectors[:size] ** 2, axis=0)
            found.append(np.sqrt(values[floor > 0.3])[:12] / (2 * np.pi))
        np.testing.assert_allclose(found[1], found[0], rtol=2e-3)
        assert np.abs(found[0] / modes.natural_freq[:12] - 1).max() > 0.003


@pytest.mark.slow
def test_equipment_off_the_middle_turns_on_an_arm(alone):
    e, heavy = 0.1, 2600.0 + 2200.0 + 1600.0 + 900.0 + 800.0
    moment = sum(m * x for m, x in ((2600.0, -4.0), (2200.0, 6.0), (900.0, -2.0), (800.0, 2.0)))
    mass = alone.change("equipment_offset", {"equipment_offset": 100.0})[2]
    ahead, up, aside = (alone.rigid(d, {"car"}) for d in range(3))
    about_x, about_y = (alone.rigid(d, {"car"}, (0.0, 0.75, 0.0)) for d in (3, 4))
    for one, other, expected in (
        (about_x, about_x, heavy * e**2), (about_y, about_y, heavy * e**2),
        (up, about_x, -heavy * e), (ahead, about_y, heavy * e), (aside, aside, 0.0), (up, about_y, 0.0),
        (alone.rigid(5, {"car"}), about_x, -moment * e),
    ):  # fmt: skip
        assert one @ mass @ other == pytest.approx(expected, abs=1e-6 * heavy)


# -- suspension --------------------------------------------------------------------------------------------------------


def test_anti_roll_bar_resists_a_bolster_that_rolls_on_its_frame(alone, energy):
    stiffness = alone.change("anti_roll_bar", {"anti_roll_bar": 0.3})[0]
    rolled = alone.rigid(3, {"front_load_bolster"}, (9.5, 0.86, 0.0))
    assert energy(stiffness, rolled) == pytest.approx(0.3e6)
    both = alone.rigid(3, {"front_load_bolster", "front_frame"}, (9.5, 0.86, 0.0))
    assert energy(stiffness, both) == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize(
    ("name", "kind", "one", "total"),
    [("damper_asymmetry", 1, 35e3, 8), ("secondary_asymmetry", 0, 256.4e3, 4)],
)
def test_asymmetry_couples_rising_and_rolling(alone, name, kind, one, total):
    matrix = alone.change(name, {name: 0.2})[kind]
    bolsters = {"front_load_bolster", "rear_load_bolster"}
    up, roll = alone.rigid(1, bolsters), alone.rigid(3, bolsters)
    assert up @ matrix @ up == pytest.approx(0.0, abs=1e-3) and roll @ matrix @ roll == pytest.approx(0.0, abs=1e-3)
    assert up @ matrix @ roll == pytest.approx(-total * 0.2 * one * 1.17)


def test_air_spring_is_a_spring_with_a_damper_in_series(alone, rigid_car):
    k2, corner, root, n = 200e3, 1.5, 7j - 2, rigid_car.n_dof
    k, c, _ = alone.change("air_spring", {"air_spring": 200.0, "air_spring_freq": corner})
    z = sp.csc_array(k + root * c)
    raised = alone.rigid(1, {"rear_load_bolster"})
    pull = z[n:, :n] @ raised
    seen = raised @ z[:n, :n] @ raised - pull @ np.linalg.solve(z[n:, n:].toarray(), pull)
    branch = k2 * (root / (2 * np.pi * corner)) / (1 + root / (2 * np.pi * corner))
    assert seen == pytest.approx(2 * branch)


def test_soft_mounts_are_in_series_with_the_yaw_dampers(alone, rigid_car):
    c, s, root, n = 400e3, 60e-9, 80j - 5, rigid_car.n_dof
    k, damping, _ = alone.change("yaw_damper_mount", {"yaw_damper_mount": 60.0})
    z = sp.csc_array(k + root * damping)[:, n:]
    pull = sp.csr_array(z[:n])
    added = -(pull @ sp.csr_array(np.linalg.inv(z[n:].toarray())) @ pull.T)
    (dampers,) = (t.matrix for t in rigid_car.damping.terms if t.name == "c_yaw")
    expected = (c * root / (1 + root * c * s) - c * root) * dampers
    assert abs(added - expected).max() <= 1e-9 * abs(expected).max()


def test_pads_on_the_left_soften_and_all_dissipate(alone):
    stiffness, damping = (
        alone.change("soft_pads", {"soft_pads": 0.3})[0],
        alone.change("pad_damping", {"pad_damping": 4.0})[1],
    )
    up, roll = alone.rigid(1, {"car"}), alone.rigid(3, {"car"})
    assert up @ stiffness @ up == pytest.approx(-0.3 * 4 * 2e6)
    assert up @ stiffness @ roll == pytest.approx(0.3 * 4 * 2e6 * 0.9)
    assert up @ damping @ up == pytest.approx(8 * 4e3) and roll @ damping @ roll == pytest.approx(8 * 4e3 * 0.9**2)


# -- bogies and track --------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_soft_track_is_a_softer_contact(alone, rigid_car):
    lost = alone.change("track_compliance", {"track_compliance": 10.0})[0]
    softer = 1 / (1 / 1200e6 + 10e-9) / 1e6
    expected = rigid_car.matrices({"K_rail": softer})[0] - rigid_car.matrices({})[0]
    assert abs(lost - expected).max() <= 1e-9 * abs(expected).max()


@pytest.mark.slow
def test_soft_bushes_are_softer_rods_of_the_front_bogie(alone, rigid_car):
    lost = alone.change("rod_bushes", {"rod_bushes": 40.0})[0]
    softer = {"K_rod_upper": 6.5, "K_rod_lower": 25.0}
    softer = {name: 1 / (1 / (k * 1e6) + 40e-9) / 1e6 for name, k in softer.items()}
    expected = rigid_car.matrices(softer)[0] - rigid_car.matrices({})[0]
    front = rigid_car.mesh.points[rigid_car.dofs.node][:, 0] > 0
    chosen = sp.diags_array(front.astype(float))
    expected = chosen @ expected @ chosen
    assert abs(lost - expected).max() <= 1e-9 * abs(expected).max()


def test_soft_bush_of_a_tilting_rod_acts_there_alone(alone):
    lost = alone.change("tilting_rod_bush", {"tilting_rod_bush": 50.0})[0]
    up, roll = alone.rigid(1, {"front_tilting_bolster"}), alone.rigid(3, {"front_tilting_bolster"})
    assert up @ lost @ up == pytest.approx(1 / (1 / 20e6 + 50e-9) - 20e6)
    assert up @ lost @ roll == pytest.approx(-0.35 * (up @ lost @ up))


def test_mass_on_a_bolster_weighs_there_alone(alone):
    mass = alone.change("bolster_mass", {"bolster_mass": 150.0})[2]
    up, roll = (alone.rigid(d, {"front_load_bolster"}) for d in (1, 3))
    assert up @ mass @ up == pytest.approx(150.0) and roll @ mass @ roll == pytest.approx(0.0, abs=1e-9)


def test_pivots_resist_a_car_that_yaws(alone, energy):
    stiffness = alone.change("pivot_yaw", {"pivot_yaw": 0.5})[0]
    assert energy(stiffness, alone.rigid(4, {"car"})) == pytest.approx(2 * 0.5e6)
    assert energy(stiffness, alone.rigid(0, {"car"})) == pytest.approx(0.0, abs=1e-6)
