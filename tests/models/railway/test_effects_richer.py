"""Richer members of the bogie's effects: sound at every magnitude, and their simpler members in the limit."""

from functools import cache

import numpy as np
import pytest
import scipy.linalg as la

from calib.structure import extend
from models.railway import bogie_effects, bogie_on_rig
from models.railway.bogie import AXLE_X, AXLE_Y
from models.railway.bogie import bogie as railway_bogie
from models.railway.effects_frame import BRAKE_UNIT_RATIO
from models.railway.effects_suspension import GEAR_CASE_OFF

SIMPLE = {e.name: e for e in bogie_effects()}
RICHER = {one.name: one for e in bogie_effects() for one in e.family[1:]}


@cache
def base():
    return bogie_on_rig(element_size=0.3)


@cache
def with_effect(name):
    return extend(base(), [{**SIMPLE, **RICHER}[name]])


def test_three_effects_have_families():
    families = {e.name: [one.name for one in e.family[1:]] for e in bogie_effects() if e.richer is not None}
    assert families == {
        "crossbar_mass": ["crossbar_body"], "brake_unit": ["brake_unit_mounts", "brake_unit_body"],
        "gear_case_offset": ["gear_case_body"],
    }  # fmt: skip
    for e in RICHER.values():
        assert e.title and e.lacks.endswith(".") and e.look_for.endswith(".") and e.magnitude.description
        assert all(p.description for p in e.nuisance)


@pytest.mark.medium
@pytest.mark.parametrize("name", RICHER)
def test_magnitude_zero_leaves_the_base_model(name):
    n = base().n_dof
    for own, bare in zip(with_effect(name).matrices({name: 0.0}), base().matrices({}), strict=True):
        assert abs(own[:n, :n] - bare).max() <= 1e-12 * abs(bare).max()
        assert own[:n, n:].count_nonzero() == 0


@pytest.mark.medium
@pytest.mark.parametrize("name", RICHER)
def test_no_matrix_is_negative_anywhere(name):
    """Not even at both ends of all limits; scaled by the diagonal, as small terms are negative by rounding only."""
    model, effect = with_effect(name), RICHER[name]
    nuisance = [
        dict(effect.grid[0]),
        *({q.name: getattr(q, end) for q in effect.nuisance} for end in ("lower", "upper")),
    ]
    for matrix in (m for own in nuisance for m in model.matrices({**own, name: effect.magnitude.upper})):
        full = matrix.toarray()
        size = 1 / np.sqrt(np.maximum(np.diag(full), 1e-12 * full.max()))
        assert la.eigvalsh(size[:, None] * full * size).min() > -1e-6


@pytest.mark.medium
def test_a_small_body_on_the_axis_is_the_point_mass():
    values = {"crossbar_body": 150.0, "crossbar_body_lower": 0.0, "crossbar_body_radius": 0.015}
    found = with_effect("crossbar_body").modes(values, 10).natural_freq
    np.testing.assert_allclose(
        found, with_effect("crossbar_mass").modes({"crossbar_mass": 150.0}, 10).natural_freq, rtol=2e-4
    )
    moved = with_effect("crossbar_body").modes({**values, "crossbar_body_lower": 0.4}, 10).natural_freq
    assert abs(moved / found - 1).max() > 0.004


def test_where_the_crossbar_moves_upright_only_mounts_give_as_the_listed_unit_does():
    unit = {"brake_unit_freq": 22.0}
    listed = with_effect("brake_unit").modes({"brake_unit": 120.0, **unit}, 12)
    mounts = {"brake_unit_mounts": 120.0, "brake_unit_sideways": 30.0, "brake_unit_ratio": BRAKE_UNIT_RATIO, **unit}
    richer = with_effect("brake_unit_mounts").modes(mounts, 12)
    np.testing.assert_allclose(richer.natural_freq, listed.natural_freq, rtol=2e-3)
    np.testing.assert_allclose(richer.damping_ratio, listed.damping_ratio, rtol=0.05, atol=2e-4)
    lossy = with_effect("brake_unit_mounts").modes({**mounts, "brake_unit_ratio": 0.2}, 12)
    assert (lossy.damping_ratio > 3 * listed.damping_ratio).any()


def test_a_small_body_rocks_above_everything_and_is_the_unit_on_its_mounts():
    shared = {"brake_unit_freq": 22.0, "brake_unit_sideways": 2.0, "brake_unit_ratio": 0.03}
    mounts = with_effect("brake_unit_mounts").modes({"brake_unit_mounts": 120.0, **shared}, 12)
    body = {"brake_unit_body": 120.0, "brake_unit_body_lower": 0.0, "brake_unit_body_radius": 0.012, **shared}
    found = with_effect("brake_unit_body").modes(body, 12)
    np.testing.assert_allclose(found.natural_freq, mounts.natural_freq, rtol=2e-3)
    rocking = with_effect("brake_unit_body").modes({**body, "brake_unit_body_radius": 0.3}, 12)
    assert abs(rocking.natural_freq / found.natural_freq - 1).max() > 0.02


# -- the gear case -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("offset", [-430.0, -3.0, 0.0, 60.0, 200.0, 550.0])
def test_a_gear_case_on_its_axle_is_the_listed_one(offset):
    listed = with_effect("gear_case_offset").matrices({"gear_case_offset": offset})
    for own, other in zip(with_effect("gear_case_body").matrices({"gear_case_body": offset}), listed, strict=True):
        assert abs(own - other).max() <= 1e-12 * abs(other).max()


@pytest.mark.slow
@pytest.mark.parametrize("distributed", [False, True])
def test_a_gear_case_ahead_of_its_axle_has_the_energy_of_a_body_there(effect_checks, distributed):
    """Every piece moves with ``v + w x arm`` on a rigid axle, where that is free (in the middle it cannot spin)."""
    bogie, where = bogie_on_rig(element_size=0.3, distributed=distributed), 0.45
    motion = np.random.default_rng(2).standard_normal(6)
    rigid = motion @ [
        effect_checks.rigid(bogie, direction, {"axle_front"}, (AXLE_X, AXLE_Y, 0.0)) for direction in range(6)
    ]
    richer = extend(bogie, [RICHER["gear_case_body"]])
    listed, ahead = ({"gear_case_body": 1e3 * where, "gear_case_ahead": d} for d in (0.0, 0.2))
    mass = richer.matrices(ahead)[2] - richer.matrices(listed)[2]
    (case,) = (m for m in railway_bogie(1.0, distributed).masses if m.name == "gear case")

    def energy(*arm):
        pieces = [motion[:3] + np.cross(motion[3:], np.add(arm, piece)) for piece in case.spread]
        return case.mass * np.mean([v @ v for v in pieces])

    d = 0.2 * where**2 / (where**2 + GEAR_CASE_OFF**2)
    assert rigid @ mass @ rigid == pytest.approx(energy(d, 0.0, where) - energy(0.0, 0.0, where), rel=1e-9)


def test_the_distance_ahead_changes_modes():
    still = with_effect("gear_case_body").modes({"gear_case_body": 200.0}, 12).natural_freq
    moved = with_effect("gear_case_body").modes({"gear_case_body": 200.0, "gear_case_ahead": 0.3}, 12).natural_freq
    assert abs(moved / still - 1).max() > 0.003
