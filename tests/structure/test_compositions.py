"""What is composed of a model: mounts in series, supports, joints, groups of parts and symmetric places."""

import os
import subprocess
import sys
from dataclasses import dataclass, replace

import numpy as np
import pytest
import scipy.sparse as sp

from calib.errors.errors import InputError
from calib.measurement.modal import Sensor
from calib.structure.affine import Monomial
from calib.structure.effects.attach import joined_nodes, mounted_dampers, part_of, relative_rotation
from calib.structure.effects.composition import Names, dynamic_factor
from calib.structure.effects.extend import extend
from calib.structure.effects.part_compositions import _alike, of_joints, of_mounts, of_supports
from calib.structure.effects.point_compositions import _pairs, further_spots, mirrored, of_sensors
from calib.structure.elongations import elongations
from calib.structure.rules import RULES
from models.railway.rig import bogie_on_rig

MIDDLE = 15.0


@pytest.fixture(scope="module")
def bogie():
    return bogie_on_rig(element_size=0.3)


@pytest.fixture(scope="module")
def sensors():
    corners = [(x, 0.62, z) for x in (1.115, -1.115) for z in (1.05, -1.05)]
    return [Sensor(k, "y", point, "frame") for k, point in enumerate(corners, 1)]


@dataclass(frozen=True)
class Named:
    name: str


@pytest.mark.medium
def test_the_dynamic_stiffness_of_mounted_dampers_is_that_of_maxwell_elements(bogie):
    """With the damping constant c and the lag t it is ``c l/(1 + c/k l)`` along each damper, ``t = c/k``."""
    parts, lag = ("primary damper front left", "primary damper rear right"), 7e-3
    addition, values = mounted_dampers(bogie, parts, "t"), {"c_primary": 2.3e4, "t": lag}
    rows = [row for name in parts for row in elongations(part_of(bogie, "damping", name)).toarray()]
    assert addition.n_added == len(rows) == 2 and not addition.mass
    n = bogie.n_dof
    both = (addition.stiffness, addition.damping)
    k, c = (sum(t.coefficient(values) * t.matrix.toarray() for t in terms) for terms in both)
    for lam in (3j, -2 + 60j, 700j):
        z = lam * c + k
        condensed = z[:n, :n] - z[:n, n:] @ np.linalg.solve(z[n:, n:], z[n:, :n])
        with_it = condensed + sum(values["c_primary"] * lam * np.outer(b, b) for b in rows)
        exact = values["c_primary"] * lam / (1 + lag * lam)
        np.testing.assert_allclose(with_it, sum(exact * np.outer(b, b) for b in rows), rtol=1e-9, atol=1e-6)


@pytest.mark.medium
def test_a_damper_that_feeds_energy_in_has_no_mount(bogie):
    own = part_of(bogie, "damping", "primary damper front left")
    bent = sp.csr_array(sp.diags_array(np.eye(bogie.n_dof)[own.matrix.indices[0]]))
    for wrong in (
        replace(own, matrix=-own.matrix),
        replace(own, coefficient=replace(own.coefficient, factor=-1.0)),
        replace(own, matrix=own.matrix - 0.1 * bent),
    ):
        model = replace(bogie, parts=(wrong,))
        with pytest.raises(InputError, match="part 'primary damper front left': its damping is negative"):
            mounted_dampers(model, (own.name,), "t")
        assert not list(of_mounts(model, Names(()), MIDDLE))


@pytest.mark.medium
def test_mounts_are_composed_of_each_damper_and_of_those_of_one_kind(bogie):
    found = list(of_mounts(bogie, Names(()), MIDDLE))
    assert [c.count for c in found] == [1] * 4 + [2] * 4 + [4]
    (every,) = [c for c in found if c.count == 4]
    assert len(set(every.places)) == 4 and every.place == pytest.approx((0.0, 0.43, 0.0), abs=0.01)
    model, name = extend(bogie, [every.effect]), every.effect.name
    low, high = (model.modes({name: lag}, 12) for lag in (every.effect.magnitude.lower, 20.0))
    rigid = bogie.modes({}, 12)
    np.testing.assert_allclose(low.natural_freq, rigid.natural_freq, rtol=1e-3)
    assert high.damping_ratio[:6].sum() < 0.8 * rigid.damping_ratio[:6].sum()


def test_a_flexibility_in_series_with_a_support_is_that_of_springs_in_series(bogie):
    found = {c.at: c for c in of_supports(bogie, Names(()))}
    assert set(found) == {"support left", "support right", "support left and support right"}
    effect = found["support left"].effect
    (term,) = effect.build(bogie).selected
    (own,) = (t for t in bogie.stiffness.selected if t.name == "support_left")
    assert isinstance(own.coefficient, Monomial)
    k = own.coefficient({})
    assert k + term.coefficient({effect.name: 3 / k}) == pytest.approx(k / 4)
    (x, _, z) = found["support left"].place
    assert z == pytest.approx(1.17, abs=0.2) and abs(x) < 0.4


def test_springs_join_two_bodies_or_one_to_the_ground(bogie):
    upper, contact = (part_of(bogie, "stiffness", n) for n in ("upper rod front left", "wheel-rail contact front left"))
    assert len(joined_nodes(bogie, upper)) == 2 and len(joined_nodes(bogie, contact)) == 1
    assert joined_nodes(bogie, part_of(bogie, "stiffness", "girder left")) == {}
    row = relative_rotation(bogie, upper, 5)
    assert row is not None
    turned = np.where((bogie.dofs.direction == 5), 1.0, 0.0)
    assert abs(row @ turned) < 1e-9  # both bodies turn alike


def test_a_joint_turns_about_each_axis_and_several_springs_are_one_joint(bogie):
    found = list(of_joints(bogie, bogie.space.values, Names(()), MIDDLE))
    single = [c.at for c in found if c.count == 1 and "front left" in c.at and c.at.endswith("about z")]
    assert len(single) == len(set(single)) and 1 <= len(single) <= 3
    assert {c.kind for c in found} == {"rotational spring"} and found[0].effect.name.startswith("rotation_x_")
    assert all(c.effect.title.startswith(f"Rotational spring at {c.at}") for c in found)
    stiffer = extend(bogie, [c.effect for c in found[:1]]).modes({found[0].effect.name: 1e7}, 12)
    rise = stiffer.natural_freq / bogie.modes({}, 12).natural_freq - 1
    assert rise.min() > -1e-4 and rise.max() > 0.02  # damping lets some fall a little


def test_parts_are_grouped_by_words_of_position():
    names = ["girder left", "girder end front left", "girder end rear left", "girder right", "rod, x", "rod, z"]
    groups = {frozenset(p.name for p in group) for group in _alike([Named(n) for n in names])}
    assert frozenset({"girder left", "girder end front left", "girder end rear left"}) in groups
    assert frozenset({"girder end front left", "girder end rear left"}) in groups
    assert frozenset({"rod, x", "rod, z"}) in groups
    assert not any({"rod, x", "girder left"} <= group for group in groups)


def test_places_mirror_each_other_at_a_middle_plane_only(bogie):
    points = [(1.0, 0.5, 1.05), (1.0, 0.5, -1.05), (-1.0, 0.5, 1.05), (0.3, 0.5, -1.05)]
    assert set(mirrored(bogie, [(p,) for p in points])) == {(0, 1), (0, 2)}
    assert set(mirrored(bogie, [(p,) for p in points], ["x", "y", "x", "x"])) == {(0, 2)}


def test_both_places_of_a_symmetric_pair_have_the_same(bogie, sensors):
    found = [c for c in of_sensors(bogie, sensors, bogie.space.values, Names(()), MIDDLE) if c.count == 2]
    pair = next(c for c in found if c.kind == "spring to ground" and c.at == "sensors 1y and 2y")
    assert set(pair.places) == {sensors[0].point, sensors[1].point}
    alone = [bogie.sensor_rows([s])[0] for s in sensors[:2]]
    (term,) = pair.effect.build(bogie).stiffness
    np.testing.assert_allclose(term.matrix.toarray(), sum(np.outer(b, b) for b in alone), atol=1e-12)
    assert {c.kind for c in found} >= {"added mass", "damper to ground", "spring between", "damper between"}


def test_springs_and_dampers_are_sized_by_the_flexibility_at_their_ends(bogie, sensors):
    made = of_sensors(bogie, sensors, bogie.space.values, Names(()), MIDDLE)
    found = {(c.kind, c.at): c.effect.plausible for c in made}
    factor, (a, b, c) = dynamic_factor(bogie, bogie.space.values, MIDDLE), bogie.sensor_rows(sensors[:3])
    for kind, at, rows in (
        ("to ground", "sensor 1y", [a]), ("to ground", "sensors 1y and 2y", [a, b]),
        ("between", "sensors 1y and 3y", [a - c]),
    ):  # fmt: skip
        size = RULES.local / min(row @ factor.solve(row) for row in rows)
        assert found[f"spring {kind}", at] == pytest.approx(size, rel=1e-9)
        assert found[f"damper {kind}", at] == pytest.approx(size / (2 * np.pi * MIDDLE), rel=1e-9)


def test_crossing_connections_of_corners_have_their_common_middle_once(bogie, sensors):
    """Each of its places is a row of the table of places, which may not be there twice."""
    found = list(of_sensors(bogie, sensors, bogie.space.values, Names(()), MIDDLE))
    crossing = [c for c in found if c.at == "sensors 1y and 4y and between sensors 2y and 3y"]
    assert [c.kind for c in crossing] == ["spring between", "damper between"]
    for composed in crossing:
        assert composed.count == 2 and composed.places == ((0.0, 0.62, 0.0),)
    assert all(len(set(c.places)) == len(c.places) for c in found)


def test_further_places_lie_on_the_model_and_apart(bogie, sensors):
    spots = further_spots(bogie, sensors)
    points = np.array([s.point for s in (*sensors, *spots)])
    assert 3 < len(spots) <= 12 and len({s.label for s in spots}) == len(spots)
    far = np.linalg.norm(points[:, None] - points[None], axis=2)
    assert far[~np.eye(len(points), dtype=bool)].min() > 0.1 * np.ptp(bogie.mesh.points, axis=0).max() - 1e-3
    near = np.linalg.norm(bogie.mesh.points[:, None] - points[len(sensors) :], axis=2).min(axis=0)
    assert near.max() < 1e-3


@pytest.mark.slow
def test_compositions_come_in_one_order_whatever_the_seed_of_hashes():
    names = [f"rod {a} {b} {c}" for a in ("upper", "lower") for b in ("front", "rear") for c in ("left", "x")]
    words = (
        "from calib.structure.effects.part_compositions import _alike\nfrom types import SimpleNamespace as N\n"
        f"print([[p.name for p in group] for group in _alike([N(name=n) for n in {names}])])"
    )
    out = {
        subprocess.run(
            [sys.executable, "-c", words], env={**os.environ, "PYTHONHASHSEED": seed}, capture_output=True, check=True
        ).stdout
        for seed in ("1", "2", "3")
    }
    assert len(out) == 1 and len(out.pop()) > 100


def test_a_spring_joins_a_sensor_to_what_faces_it_beyond_nearer_ones_on_its_own_column():
    apart = 4.5  # farther than four sensors of the same column
    pairs = _pairs([Sensor(n, "x", (x, 0.0, float(n % 6))) for n, x in enumerate([0.0] * 6 + [apart] * 6)])
    assert {(n, n + 6) for n in range(6)} <= set(pairs)
    across = [(k, j) for k, j in pairs if k // 6 != j // 6]
    assert across == [(n, n + 6) for n in range(6)], "a diagonal of a rectangle has its corners on the sphere"
    assert (0, 3) in pairs, "the nearest count, whatever lies between"
