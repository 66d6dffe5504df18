"""The bogie on its rig: modes, the parameters that govern them, symmetry, mesh and actuator places."""

import itertools

import numpy as np
import pytest

from calib import InputError, Sensor
from calib.structure.eigenproblem import solve
from calib.structure.eigenproblem.solve import solve_modes
from models.railway import bogie_on_rig

NAMES = ("1BT", "2BT", "3BT", "4BT", "5BT", "6BT", "7BT", "8BT")
DAMPED = (10.1, 14.0, 14.9, 18.5, 20.4, 23.1, 32.3, 34.6)
RATIO = (0.383, 0.125, 0.108, 0.251)
POSITIONS = ("pos_long_left", "pos_long_right", "pos_lat_left", "pos_lat_right")


@pytest.fixture(scope="module")
def rig():
    return bogie_on_rig()


@pytest.fixture(scope="module")
def nominal(rig):
    return rig.modes({}, 10)


@pytest.fixture(scope="module")
def steps(rig, nominal):
    """Change of the damped frequencies in % for +10 % of one parameter."""

    def change(name):
        modes = rig.modes({name: 1.1 * rig.space[name].value}, 8)
        return dict(zip(NAMES, 100 * (modes.damped_freq / nominal.damped_freq[:8] - 1), strict=True))

    return {name: change(name) for name in rig.space.names if name not in POSITIONS}


def girder_motion(rig, shapes):
    """Vertical motion along both girders, and their coordinates."""
    points = [(x, 0.62, z) for z in (1.05, -1.05) for x in (-2.005, -1.115, 0.0, 1.115, 2.005)]
    rows = np.array([rig.locator.row(p, 1, "frame")[0] for p in points])
    return rows @ shapes, np.array(points)


def mac(a, b):
    return abs(np.vdot(a, b)) ** 2 / (np.vdot(a, a).real * np.vdot(b, b).real)


@pytest.mark.medium
def test_size_is_that_of_the_case_study_prototype(rig):
    assert len(rig.mesh.points) == pytest.approx(340, rel=0.1)
    assert 6 * len(rig.mesh.points) == pytest.approx(2000, rel=0.1)
    assert rig.n_dof == rig.dofs.expansion.shape[1] == len(rig.dofs.node) == len(rig.dofs.direction)


@pytest.mark.medium
def test_eight_modes_lie_where_they_should(nominal):
    np.testing.assert_allclose(nominal.damped_freq[:8], DAMPED, rtol=0.01)
    np.testing.assert_allclose(nominal.damping_ratio[:4], RATIO, rtol=0.02)
    assert np.all(nominal.damping_ratio[4:8] < 0.01)
    assert nominal.damped_freq[7] < 36 and nominal.damped_freq[8] > 40
    assert not nominal.excluded
    np.testing.assert_allclose(
        nominal.damped_freq, nominal.natural_freq * np.sqrt(1 - nominal.damping_ratio**2), rtol=1e-10
    )


@pytest.mark.medium
def test_first_four_modes_have_the_described_shapes(rig, nominal):
    motion, points = girder_motion(rig, nominal.shapes)
    x, z = points[:, 0], points[:, 2]
    for mode, shape in enumerate((x, np.ones(len(x)), z, x * z)):  # pitching, bouncing, rolling, warping
        assert mac(shape, motion[:, mode]) > 0.9
        for other in range(4):
            assert other == mode or mac(shape, motion[:, other]) < 0.1


def test_wheelset_modes_have_the_described_shapes(rig, nominal):
    m = rig.matrices({})[2]
    bodies = np.array(rig.locator.frame.bodies)[rig.dofs.node]
    for mode, (end, yaw) in enumerate((("front", False), ("rear", False), ("front", True), ("rear", True)), start=4):
        shape = nominal.shapes[:, mode]
        part = np.where(
            np.char.endswith(bodies.astype(str), end) | np.char.startswith(bodies.astype(str), f"box_{end}"), shape, 0
        )
        total = np.vdot(shape, m @ shape).real
        assert np.vdot(part, m @ part).real > 0.8 * total
        sides = [rig.locator.row((1.45 if end == "front" else -1.45, 0.43, z), 0, f"axle_{end}")[0] @ shape
                 for z in (0.87, -0.87)]  # fmt: skip
        assert (sides[0] / sides[1]).real == pytest.approx(-1.0 if yaw else 1.0, abs=0.05)


@pytest.mark.medium
def test_primary_suspension_governs_1bt_and_4bt(steps):
    for mode in ("1BT", "4BT"):
        mine = steps["K_primary"][mode]
        assert mine > 1.0
        others = [abs(change[mode]) for name, change in steps.items() if name != "K_primary"]
        assert mine > 1.2 * max(others)


@pytest.mark.medium
def test_elastic_blocks_govern_2bt_and_3bt_alone(steps):
    for mode in ("2BT", "3BT"):
        mine = steps["K_block"][mode]
        assert mine > 3.0
        assert mine > 3 * max(abs(change[mode]) for name, change in steps.items() if name != "K_block")
    for mode in ("1BT", "4BT"):
        assert abs(steps["K_block"][mode]) < 0.1 * steps["K_block"]["2BT"]
    for mode in NAMES[4:]:
        assert abs(steps["K_block"][mode]) < 0.01


@pytest.mark.medium
def test_rods_govern_the_wheelset_modes(steps):
    for mode in NAMES[4:]:
        assert steps["K_rod_upper"][mode] > 1.5
        assert steps["K_rod_lower"][mode] > 0.5
    for mode in NAMES[:4]:
        assert abs(steps["K_rod_upper"][mode]) < 0.15 and abs(steps["K_rod_lower"][mode]) < 0.15


def test_mass_lowers_and_stiffness_raises_undamped_frequencies(rig):
    # Rayleigh: an undamped frequency never falls with stiffness and never rises with mass.
    def freq(values):
        k, _, m = rig.matrices(values)
        return solve_modes(k, None, m, 8).natural_freq

    base = freq({})
    for name in rig.space.names:
        if name in POSITIONS or name == "c_primary":
            continue
        change = freq({name: 1.1 * rig.space[name].value}) / base - 1
        sign = -1.0 if name.startswith("m_") else 1.0
        assert np.all(sign * change > -1e-9) and np.any(sign * change > 1e-8), name


def test_damper_acts_on_damping(rig, nominal):
    modes = rig.modes({"c_primary": 0.9 * rig.space["c_primary"].value}, 4)
    ratio = modes.damping_ratio / nominal.damping_ratio[:4]
    np.testing.assert_allclose(ratio, 0.9, atol=0.03)
    _, c, _ = rig.matrices({"c_primary": 0.0})
    assert not np.any(rig.modes({"c_primary": 0.0}, 4).damping_ratio)
    assert abs(c).max() == 0 and not rig.damping.is_zero


@pytest.mark.parametrize("mode", [1, 2])
def test_actuator_places_change_shapes(rig, nominal, mode):
    base, _ = girder_motion(rig, nominal.shapes)
    moved, _ = girder_motion(rig, rig.modes({"pos_long_left": 8}, 8).shapes)
    assert mac(base[:, mode], moved[:, mode]) < 0.8
    assert max(mac(base[:, k], moved[:, k]) for k in (4, 5, 6, 7)) > 0.99
    aside, _ = girder_motion(rig, rig.modes({"pos_lat_left": 1, "pos_lat_right": 1}, 8).shapes)
    assert mac(base[:, mode], aside[:, mode]) < 0.95


@pytest.mark.medium
@pytest.mark.parametrize("side", ["left", pytest.param("right", marks=pytest.mark.slow)])
def test_every_actuator_place_is_valid_and_different(rig, side):
    found = []
    for long, lateral in itertools.product(range(2, 9), (-1, 0, 1)):
        modes = rig.modes({f"pos_long_{side}": long, f"pos_lat_{side}": lateral}, 8)
        assert modes.n_modes == 8 and np.all(np.isfinite(modes.natural_freq))
        assert modes.natural_freq[7] < 36
        found.append(modes.natural_freq)
    assert len({tuple(np.round(f, 7)) for f in found}) == 21
    for beyond in ({f"pos_long_{side}": 9}, {f"pos_long_{side}": 1}, {f"pos_lat_{side}": 2}):
        with pytest.raises(InputError, match=f"support_{side} has no position"):
            rig.modes(beyond, 1)


@pytest.mark.parametrize(("left", "right"), [((2, 0), (5, 0)), ((8, 1), (3, 1)), ((4, -1), (7, 0))])
def test_swapping_sides_mirrors_the_bogie(rig, left, right):
    # The mirror z -> -z exchanges the sides; positions across are counted towards +z on both of them.
    def modes(left, right):
        values = dict(zip(POSITIONS, (left[0], right[0], left[1], right[1]), strict=True))
        return rig.modes(values, 8)

    one, other = modes(left, right), modes((right[0], -right[1]), (left[0], -left[1]))
    np.testing.assert_allclose(one.natural_freq, other.natural_freq, rtol=1e-9)
    np.testing.assert_allclose(one.damping_ratio, other.damping_ratio, atol=1e-9)
    a, points = girder_motion(rig, one.shapes)
    b, _ = girder_motion(rig, other.shapes)
    mirrored = [int(np.flatnonzero(np.all(np.isclose(points, p * [1, 1, -1]), axis=1))[0]) for p in points]
    for mode in range(4):
        assert mac(a[:, mode], b[mirrored, mode]) == pytest.approx(1.0, abs=1e-6)


@pytest.mark.medium
def test_halving_the_elements_moves_no_mode_by_more_than_a_twentieth_of_a_percent(nominal):
    fine = bogie_on_rig(element_size=0.0375)
    modes = fine.modes({}, 8)
    np.testing.assert_allclose(modes.natural_freq, nominal.natural_freq[:8], rtol=5e-4)
    np.testing.assert_allclose(modes.damping_ratio[:4], nominal.damping_ratio[:4], rtol=1e-3)


@pytest.mark.medium
def test_distributed_masses_are_a_small_change_but_one(nominal):
    modes = bogie_on_rig(distributed=True).modes({}, 8)
    change = np.abs(modes.natural_freq / nominal.natural_freq[:8] - 1)
    assert 1e-5 < change.max() < 0.01


@pytest.mark.slow
def test_iteration_finds_what_lapack_finds(monkeypatch):
    # Massless arms, stiff rail springs and dampers, on the coarsest mesh there is.
    coarse = bogie_on_rig(element_size=5.0)
    count = 10
    found = []
    for limit in (80, 10_000):
        monkeypatch.setattr(solve, "DENSE_LIMIT", limit)
        found.append(coarse.modes({}, count))
    one, other = found
    assert one.n_modes == other.n_modes == count
    np.testing.assert_allclose(one.natural_freq, other.natural_freq, rtol=1e-7)
    np.testing.assert_allclose(one.damping_ratio, other.damping_ratio, atol=1e-7)


def test_clusters_share_out_every_degree_of_freedom(rig):
    together = np.concatenate(list(rig.clusters.values()))
    assert np.array_equal(np.sort(together), np.arange(rig.n_dof))
    for name, index in rig.clusters.items():
        part, direction = name.split(".")
        assert part in ("girder", "crossbar", "axle", "box", "block")
        wanted = {"x": {0}, "y": {1}, "z": {2}, "r": {3, 4, 5}}[direction]
        assert set(rig.dofs.direction[index]) <= wanted
    assert "girder.x" not in rig.clusters and "girder.z" not in rig.clusters  # suppressed


def test_sensors_of_the_case_study_find_their_places(rig):
    girders = [(x, 0.62, z, "y") for z in (1.05, -1.05) for x in (-2.005, -1.115, 0.0, 1.115, 2.005)]
    tips = [(x, 0.62, z, "y") for x in (-1.115, 1.115) for z in (-1.315, 1.315)]
    wheels = [(x, 0.43, z, "x") for x in (-1.45, 1.45) for z in (-0.87, 0.87)]
    blocks = [(x, 1.05, z, "y") for x in (-0.28, 0.28) for z in (-1.17, 1.17)]
    sensors = [Sensor(i, d, (x, y, z)) for i, (x, y, z, d) in enumerate(girders + tips + wheels + blocks, start=1)]
    boxes = [
        Sensor(90, "x", (1.45, 0.43, 1.05), "box_front_left"),
        Sensor(91, "x", (-1.45, 0.43, -1.05), "box_rear_right"),
    ]
    rows = rig.sensor_rows(sensors + boxes)
    assert rows.shape == (24, rig.n_dof)
    np.testing.assert_allclose(np.abs(rows).max(axis=1), 1.0)
    with pytest.raises(InputError, match="suppresses"):
        rig.sensor_rows([Sensor(1, "z", (0.0, 0.62, 1.05))])
    with pytest.raises(InputError, match="off the model"):
        rig.sensor_rows([Sensor(1, "y", (0.0, 0.62, 0.0))])


def test_suppressed_and_shared_motions(rig):
    frame = rig.locator.frame
    for x in (-2.005, 0.0, 2.005):
        rows = frame.motion((x, 0.62, 1.05), "frame")[0] @ rig.dofs.expansion
        assert [bool(np.any(np.abs(r) > 1e-12)) for r in rows] == [False, True, False, True, False, True]
    for end, s in (("front", 1), ("rear", -1)):
        axle = frame.node(f"axle_{end}", (1.45 * s, 0.43, 0.0))
        assert not rig.dofs.expansion[[6 * axle + 2, 6 * axle + 5]].toarray().any()
        a, b = (frame.node(name, (1.45 * s, 0.43, 1.05)) for name in (f"axle_{end}", f"box_{end}_left"))
        both = rig.dofs.expansion[[6 * n + d for n in (a, b) for d in range(6)]].toarray()
        assert np.array_equal(both[:5], both[6:11]) and both[5] @ both[11] == 0


@pytest.mark.slow
def test_builds_are_equal_and_fingerprints_tell_meshes_apart(rig):
    assert bogie_on_rig().fingerprint == rig.fingerprint
    assert bogie_on_rig(element_size=0.06).fingerprint != rig.fingerprint
    assert bogie_on_rig(distributed=True).fingerprint != rig.fingerprint
    one, other = rig.modes({}, 8), rig.modes({}, 8)
    assert np.array_equal(one.shapes, other.shapes)


@pytest.mark.slow
def test_matrices_are_symmetric_and_stiffness_is_definite(rig):
    k, c, m = rig.matrices({})
    for matrix in (k, c, m):
        assert abs(matrix - matrix.T).max() <= 1e-9 * abs(matrix).max()
    scale = 1 / np.sqrt(k.diagonal())
    assert np.linalg.eigvalsh(k.toarray() * np.outer(scale, scale)).min() > 1e-12
    for matrix in (c, m):
        assert np.linalg.eigvalsh(matrix.toarray()).min() > -1e-9 * abs(matrix).max()


def test_the_axes_are_what_the_names_of_its_springs_say(rig):
    meant = {"front": (0, 1), "rear": (0, -1), "left": (2, 1), "right": (2, -1)}
    springs = [p for p in rig.places if p.name.startswith("primary springs")]
    told = [(word, sign * p.place[axis]) for p in springs for word, (axis, sign) in meant.items() if word in p.name]
    assert {word for word, _ in told} == meant.keys() and all(place > 0 for _, place in told)
    assert rig.mesh.axes == "x to the front, y up, z to the left"
