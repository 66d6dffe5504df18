"""Assembly of the vehicle: geometry at every density, rigid motions, masses by hand, terms against values."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import scipy.sparse as sp

from calib import InputError
from calib.structure.eigenproblem.solve import solve_modes
from models.fem.discrete import mass_matrix, spring_matrix
from models.fem.structure import Structure
from models.railway.bolsters import K_LATERAL, K_PAD, K_TRACTION
from models.railway.car_body import SECTIONS, car_body
from models.railway.car_lines import BASE_Z, COVER, PILLARS, WALL
from models.railway.equipment import ON_ROOF, UNDER_FLOOR
from models.railway.vehicle import assembly


@pytest.fixture(scope="module")
def whole():
    return assembly()


@pytest.fixture(scope="module")
def fine():
    return assembly(2)


def rigid_motions(points, about=(0.0, 0.0, 0.0)):
    """Three shifts and three turns of all nodes, (6 n, 6)."""
    p = points - np.asarray(about)
    out = np.zeros((6 * len(p), 6))
    for d in range(3):
        out[d::6, d] = out[3 + d :: 6, 3 + d] = 1.0
    out[1::6, 3], out[2::6, 3] = -p[:, 2], p[:, 1]
    out[0::6, 4], out[2::6, 4] = p[:, 2], -p[:, 0]
    out[0::6, 5], out[1::6, 5] = -p[:, 1], p[:, 0]
    return out


@pytest.mark.medium
def test_spring_dampers_are_as_many_as_in_the_case_study(whole):
    # A spring with its lateral part counts once, and so does a damper beside a spring.
    count = {name: len(springs) for name, springs in whole.springs.items()}
    guidance = sum(s.name.find("guidance") >= 0 for s in whole.springs["suspension_fixed"])
    assert count["suspension_fixed"] == guidance + 2 * count["K_primary"]
    together = sum(count.values()) - 2 * count["K_primary"]
    assert together + len(whole.dampers["c_primary"]) + len(whole.dampers["c_yaw"]) == 148


@pytest.mark.medium
def test_attachments_openings_and_edges_stay_where_they_are(whole, fine):
    assert whole.structure.rbe3s == fine.structure.rbe3s
    for own, other in ((whole.springs, fine.springs), (whole.dampers, fine.dampers)):
        assert own == other
    assert whole.masses == fine.masses

    def places(structure):
        return {tuple(np.round(p, 6)) for b, p in zip(structure.bodies, structure.points, strict=True) if b == "car"}

    coarse, finer = places(whole.structure), places(fine.structure)
    assert coarse <= finer
    for structure in (whole.structure, fine.structure):
        assert structure.area(("walls",)) == pytest.approx(whole.structure.area(("walls",)), rel=1e-9)


@pytest.mark.medium
def test_heavy_attachments_stand_on_nodes_at_every_density(whole, fine):
    for structure in (whole.structure, fine.structure):
        nodes = structure.points[[b == "car" for b in structure.bodies]]
        for rbe3 in structure.rbe3s:
            assert len(rbe3.feet) >= 4
            if "seat" in rbe3.name:
                continue
            for foot in rbe3.feet:
                assert np.linalg.norm(nodes - foot, axis=1).min() < 1e-9, rbe3.name


@pytest.mark.medium
def test_twice_as_fine_means_a_quarter_of_every_shell(whole, fine):
    assert len(fine.structure.corners) == 4 * len(whole.structure.corners)
    frames = [np.array([m.body == "car" for m in s.members])[s.member_of] for s in (whole.structure, fine.structure)]
    assert frames[1].sum() == 2 * frames[0].sum()


@pytest.mark.slow
def test_a_rigid_motion_of_the_whole_strains_nothing_but_the_rails(whole):
    structure = whole.structure
    stiffness = structure.beams()[0] + structure.shells().stiffness
    loose = {name: springs for name, springs in whole.springs.items() if name != "K_rail"}
    matrices = [stiffness, *(spring_matrix(structure, s) for s in loose.values())]
    matrices += [spring_matrix(structure, s) for s in whole.dampers.values()]
    rigid = rigid_motions(structure.points)
    for matrix in matrices:
        # The forces for a motion of every node by itself give the scale.
        size = abs(matrix) @ np.abs(rigid)
        assert np.all(np.abs(matrix @ rigid) <= 1e-9 * size.max(axis=0))
    rails = spring_matrix(structure, whole.springs["K_rail"])
    energy = np.einsum("ij,ij->j", rigid, rails @ rigid)
    assert np.all(energy[[1, 3, 5]] > 1) and np.all(energy[[0, 2, 4]] < 1e-9)


@pytest.mark.slow
def test_a_free_car_body_has_six_rigid_motions_and_no_mechanism():
    body = car_body()
    structure = Structure(body.members, panels=body.panels)
    shells, (stiff, heavy) = structure.shells(), structure.beams()
    k = sp.csc_array(stiff + shells.stiffness)
    m = sp.csc_array(heavy + shells.mass + shells.rotary)
    modes = solve_modes(k, None, m, 2, np.tile(np.arange(6) >= 3, len(structure.points)))
    assert len(modes.excluded) == 6
    assert modes.natural_freq[0] > 5


def polygon(points):
    return sum(np.hypot(*np.subtract(b, a)) for a, b in pairwise(points))


@pytest.mark.medium
def test_car_body_weighs_what_its_drawing_says(whole):
    length = 25.9
    y = [p[0] for p in WALL]
    window = polygon([p for p in WALL if 1.80 <= p[0] <= 2.75]) * (PILLARS[-1] - PILLARS[0])
    door = polygon(WALL) * 1.0
    areas = {
        "base": length * (BASE_Z[-1] - BASE_Z[0]),
        "walls": 2 * (polygon(WALL) * length - window - 2 * door),
        "cover": length * polygon(COVER),
    }
    structure = whole.structure
    for group, area in areas.items():
        assert structure.area((group,)) == pytest.approx(area, rel=1e-9)
    z, height = np.array([p[1] for p in WALL]), np.array(y)
    section = np.sum((z[1:] + z[:-1]) * np.diff(height))
    cover_y, cover_z = np.array(COVER).T
    section += abs(np.sum((cover_y[1:] + cover_y[:-1]) / 2 * np.diff(cover_z))) - 2 * 3.05 * 1.27
    gangway = structure.area(("ends",)) / 2
    assert 0.7 * section < gangway < section  # the rest is the opening
    frames = sum(
        m.section.area * float(np.linalg.norm(np.subtract(m.end, m.start))) for m in structure.members
        if m.group in SECTIONS
    )  # fmt: skip
    thickness = {"base": 10.2e-3, "walls": 10.3e-3, "cover": 8.8e-3}
    metal = 2700 * (frames + sum(thickness[g] * a for g, a in areas.items()) + 10.3e-3 * structure.area(("ends",)))
    shells, (_, heavy) = structure.shells(), structure.beams(SECTIONS)
    up = rigid_motions(structure.points)[:, 1]
    assert up @ (shells.mass + heavy) @ up == pytest.approx(metal, rel=1e-9)


@pytest.mark.slow
def test_body_is_balanced_and_its_inertias_are_those_of_a_hollow_box(whole):
    structure = whole.structure
    fitted = [m for m in whole.masses if m.at[0] in {i.name for i in (*UNDER_FLOOR, *ON_ROOF)}]
    shells = structure.shells()
    m = structure.beams(SECTIONS)[1] + shells.mass + shells.rotary + mass_matrix(structure, fitted)
    for group, share in (("base", 0.7), ("walls", 0.2), ("cover", 0.1)):
        m = m + structure.area_mass((group,)) * (share * 12_000 / structure.area((group,)))
    about_origin = rigid_motions(structure.points).T @ m @ rigid_motions(structure.points)
    mass = about_origin[0, 0]
    centre = np.array([about_origin[1, 5], about_origin[2, 3], about_origin[0, 4]]) / mass
    assert abs(centre[0]) < 0.1 and abs(centre[2]) < 1e-9
    assert 1.4 < centre[1] < 1.8
    moved = rigid_motions(structure.points, centre)
    roll, *slewing = np.sqrt(np.diag(moved.T @ m @ moved)[3:] / mass)
    assert 1.2 < roll < 1.5
    # A uniform bar of its length has 25.9/sqrt(12) = 7.48 m; equipment stands nearer to the middle.
    assert all(0.85 * 7.48 < radius < 7.48 for radius in slewing)


@pytest.mark.slow
def test_terms_make_the_matrices_of_any_values(car, whole):
    values = {
        "E_aluminium": 73.0, "rho_aluminium": 2650.0, "RMI_base": 130.0, "RMI_walls": 40.0, "RMI_cover": 410.0,
        "t_base": 11.0, "t_walls": 9.5, "t_cover": 8.1, "m_base": 55.0, "m_walls": 30.0, "m_cover": 5.0,
        "K_secondary_front": 270.0, "K_secondary_rear": 245.0, "K_rod_tilting": 9_000.0, "c_secondary": 30.0,
        "c_yaw": 350.0, "K_primary": 640.0, "c_primary": 16.0, "K_rod_upper": 5.5, "K_rod_lower": 28.0,
        "K_rail": 1500.0, "m_girder_centre": 20.0, "m_girder_ends": 50.0, "m_crossbar": 150.0, "m_axle": 300.0,
    }  # fmt: skip
    assert set(values) == set(car.space.names)
    wall = {"base": "base", "walls": "walls", "cover": "cover", "ends": "walls"}
    sheets = {
        group: {"thickness": values[f"t_{p}"] / 1e3, "rmi": values[f"RMI_{p}"], "young_modulus": 73e9,
                "density": 2650.0} for group, p in wall.items()
    }  # fmt: skip

    def member(m):
        if m.group == "pillar_wall":
            scale = (40 / 90) * (9.5 / 10.3) ** 3
            scaled = {name: scale * getattr(m.section, name) for name in ("area", "i_y", "i_z", "torsion")}
            return replace(m, section=replace(m.section, young_modulus=73e9, **scaled))
        if m.group in SECTIONS:
            return replace(m, section=replace(m.section, young_modulus=73e9, density=2650.0))
        return m

    old = whole.structure
    structure = replace(
        old,
        members=tuple(member(m) for m in old.members),
        panels=tuple(replace(p, sheet=replace(p.sheet, **sheets[p.group])) for p in old.panels),
    )
    si = car.space.si(car.space.complete(values))
    constant = {"suspension_fixed": 1.0, "floor_fixed": 1.0}
    shells, (stiff, heavy) = structure.shells(), structure.beams()
    k = stiff + shells.stiffness
    for name, springs in whole.springs.items():
        k = k + spring_matrix(structure, springs) * (si | constant | {"seats": 670e3})[name]
    c = sp.csr_array(k.shape)
    for name, dampers in whole.dampers.items():
        c = c + spring_matrix(structure, dampers) * (si | {"seats": 700.0})[name]
    m = heavy + shells.mass + shells.rotary + mass_matrix(structure, whole.masses)
    for group, share in (("base", 0.55), ("walls", 0.30), ("cover", 0.05)):
        m = m + structure.area_mass((group,)) * (share * 12_000 / structure.area((group,)))
    for name, group in (("m_girder_centre", "girder_centre"), ("m_girder_ends", "girder_end"),
                        ("m_crossbar", "crossbar"), ("m_axle", "axle")):  # fmt: skip
        m = m + structure.added_mass((f"front_{group}", f"rear_{group}"), False) * values[name]
    t = car.dofs.expansion
    for full, matrix, allowed in zip((k, c, m), car.matrices(values), (1e-12, 1e-12, 1e-12), strict=True):
        direct = sp.csc_array(t.T @ full @ t)
        assert abs(direct - matrix).max() <= allowed * abs(direct).max()


def test_floor_links_are_the_stiff_ones(whole):
    weights = sorted({s.weight for s in whole.springs["floor_fixed"]})
    assert weights == [K_PAD, K_LATERAL, K_TRACTION]


@pytest.mark.medium
def test_rigid_seats_weigh_the_same_and_ride_on_the_floor(whole):
    rigid = assembly(seats="rigid")
    sprung, fixed = ([m for m in a.masses if m.name.startswith("seats")] for a in (whole, rigid))
    assert sum(m.mass for m in fixed) == sum(m.mass for m in sprung) == 60 * 35.0
    assert "seats" not in rigid.springs and "seats" not in rigid.dampers and not rigid.structure.particles
    rise = rigid_motions(rigid.structure.points)
    matrix = mass_matrix(rigid.structure, fixed)
    assert [d @ matrix @ d for d in rise.T[:3]] == pytest.approx(3 * [60 * 35.0])
    # Every seat is lifted by its own patch of floor alone.
    one = mass_matrix(rigid.structure, fixed[:1])
    touched = rigid.structure.points[np.unique(one.nonzero()[0] // 6)]
    assert np.abs(touched - fixed[0].at[1]).max() < 0.6


def test_couplers_sit_at_the_ends_of_the_car(whole):
    structure = whole.structure
    for name, end in (("coupler_front", 12.95), ("coupler_rear", -12.95)):
        rows, _ = structure.motion((end, 1.0, 0.0), name)
        moved = rows @ rigid_motions(structure.points)
        np.testing.assert_allclose(moved[:3, :3], np.eye(3), atol=1e-9)
        assert moved[1, 5] == pytest.approx(end)


def test_unknown_mounting_of_seats_is_refused():
    with pytest.raises(InputError, match="sprung"):
        assembly(seats="soft")
