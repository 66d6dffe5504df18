"""Richer members of the vehicle's effects: sound at every magnitude, and the listed ones within them."""

import numpy as np
import pytest
import scipy.sparse as sp

from calib import ParameterSpace
from calib.structure import extend
from models.railway import vehicle_effects
from models.railway.vehicle_effects_equipment import SEAT_RATIO

SIMPLE = {e.name: e for e in vehicle_effects()}
RICHER = {one.name: one for e in vehicle_effects() for one in e.family[1:]}
LISTED = {
    "uneven_converter": "hung_converter",
    "uneven_roof_unit": "hung_roof_unit",
    "surging_air_spring": "air_spring",
    "swaying_seats": "soft_seats",
}


@pytest.fixture(scope="module")
def alone(effect_checks, rigid_car):
    return effect_checks.Alone(rigid_car, {**SIMPLE, **RICHER})


def condensed(alone, name, values, lam, carrier):
    """Change of the dynamic stiffness between the carrier's motions, with the effect's own degrees of freedom in it."""
    k, c, m = alone.change(name, values)
    n = alone.base.n_dof
    z = sp.csc_array(k + lam * c + lam**2 * m)
    own, beside = z[n:, n:].toarray(), z[n:, :n] @ carrier
    return carrier.T @ (z[:n, :n] @ carrier) - beside.T @ np.linalg.solve(own, beside)


def test_four_effects_have_families():
    families = {one.name: e.name for e in vehicle_effects() for one in e.family[1:]}
    assert families == LISTED
    for e in RICHER.values():
        assert e.title and e.lacks.endswith(".") and e.look_for.endswith(".") and e.magnitude.description
        assert all(p.description for p in e.nuisance)
        assert e.magnitude.unit == SIMPLE[LISTED[e.name]].magnitude.unit  # from whose magnitude its fit starts
    every = {p.name for e in (*SIMPLE.values(), *RICHER.values()) for p in e.parameters}
    assert not every & {"sag", "lower", "sideways", "ratio"}


@pytest.mark.parametrize("name", ["uneven_converter", "uneven_roof_unit"])
@pytest.mark.parametrize("sag", [0.01, 0.4, 3.0, 16.0])
def test_even_mounts_of_a_uniform_box_are_the_listed_ones(alone, name, sag):
    listed, drop = LISTED[name], {f"{LISTED[name]}_drop": 0.2, f"{LISTED[name]}_sideways": 0.5}
    for own, other in zip(
        alone.change(name, {name: sag, **drop}), alone.change(listed, {listed: sag, **drop}), strict=True
    ):
        assert abs(own - other).max() <= 1e-12 * abs(other).max()


def test_air_that_does_not_surge_is_the_listed_spring(alone):
    values = {"surging_air_spring": 200.0, "air_spring_freq": 1.1}
    light = alone.change("surging_air_spring", {**values, "surging_air_spring_surge": 1e9})
    listed = alone.change("air_spring", {"air_spring": 200.0, "air_spring_freq": 1.1})
    for own, other in zip(light, listed, strict=True):
        assert abs(own - other).max() <= 1e-12 * max(abs(other).max(), 1.0)


def test_a_surging_branch_has_the_dynamic_stiffness_of_pipe_and_orifice(alone, rigid_car):
    """``k (l/w + l^2/s^2)/(1 + l/w + l^2/s^2)``: softer than the orifice below the surge, negative above it."""
    values = {"surging_air_spring": 300.0, "air_spring_freq": 2.0, "surging_air_spring_surge": 5.0}
    listed = alone.change("air_spring", {"air_spring": 300.0, "air_spring_freq": 2.0})[0]
    n = rigid_car.n_dof
    carrier = np.random.default_rng(1).standard_normal((n, 2))
    springs = carrier.T @ (listed[:n, :n] @ carrier)
    for lam in (3j, 40j - 2, 15.0 + 0j):
        along = lam / (2 * np.pi * 2.0) + (lam / (2 * np.pi * 5.0)) ** 2 / (1 + (1 / 300) ** 2)
        found = condensed(alone, "surging_air_spring", values, lam, carrier)
        np.testing.assert_allclose(found, springs * along / (1 + along), rtol=1e-7)


@pytest.mark.slow
@pytest.mark.parametrize("stiffness", [0.0, pytest.param(1e-3, marks=pytest.mark.slow)])
def test_without_stiffness_the_air_leaves_no_mode(rigid_car, stiffness):
    model = extend(rigid_car, [RICHER["surging_air_spring"]])
    values = {"surging_air_spring": stiffness, "air_spring_freq": 10.0, "surging_air_spring_surge": 4.0}
    found = model.modes(values, 15).natural_freq
    np.testing.assert_allclose(found, rigid_car.modes({}, 15).natural_freq, rtol=1e-6)


@pytest.mark.medium
def test_seats_that_are_stiff_sideways_are_the_listed_ones(alone, rigid_car):
    carrier = np.random.default_rng(1).standard_normal((rigid_car.n_dof, 2))
    for sag, lam in ((0.3, 20j), (2.0, 60j - 4)):
        stiff = {"swaying_seats": sag, "swaying_seats_sideways": 1e7, "swaying_seats_ratio": SEAT_RATIO}
        found = condensed(alone, "swaying_seats", stiff, lam, carrier)
        listed = condensed(alone, "soft_seats", {"soft_seats": sag}, lam, carrier)
        np.testing.assert_allclose(found, listed, rtol=1e-8)
        soft = condensed(alone, "swaying_seats", {**stiff, "swaying_seats_sideways": 0.8}, lam, carrier)
        assert abs(soft - listed).max() > 1e-3 * abs(listed).max()


@pytest.mark.parametrize("name", RICHER)
def test_magnitude_zero_leaves_the_base_model(alone, name, rigid_car):
    n, effect = rigid_car.n_dof, RICHER[name]
    for own in ("lower", "upper"):
        values = {q.name: getattr(q, own) for q in effect.nuisance}
        for change, bare in zip(alone.change(name, {**values, name: 0.0}), rigid_car.matrices({}), strict=True):
            assert abs(change[:n, :n]).max() <= 1e-12 * abs(bare).max() and change[:n, n:].count_nonzero() == 0


@pytest.mark.parametrize("name", RICHER)
def test_no_change_of_stiffness_or_damping_is_negative_and_no_body_either(alone, name, rigid_car):
    """At all limits: springs and dampers store and dissipate; of the mass the body's own share, its carrier's added."""
    effect, n = RICHER[name], rigid_car.n_dof
    base = rigid_car.matrices({})[2]
    for nuisance in ("value", "lower", "upper"):
        values = {q.name: getattr(q, nuisance) for q in effect.nuisance}
        k, c, m = alone.change(name, {**values, name: effect.magnitude.upper})
        seen = np.unique(np.concatenate([a.nonzero()[0] for a in (k, c, m)]))
        wide = sp.csr_array(sp.block_diag([base, sp.csr_array((k.shape[0] - n,) * 2)]))
        for matrix in (k, c, m + wide):
            part = sp.csr_array(matrix)[seen][:, seen].toarray()
            size = 1 / np.sqrt(np.maximum(np.diag(part), 1e-12 * np.diag(part).max()))
            assert np.linalg.eigvalsh(size[:, None] * part * size).min() > -1e-6


@pytest.mark.parametrize("name", RICHER)
def test_derivatives_agree_with_differences(alone, name, rigid_car):
    effect = RICHER[name]
    space = ParameterSpace(rigid_car.space.parameters + effect.parameters)
    point = space.complete({p: 0.9 * v + 0.01 for p, v in effect.grid[0].items()})
    addition = alone.addition(name)
    for moving in effect.names:
        step, total = 1e-6 * max(abs(point[moving]), 1e-2), 0.0
        for term in (*addition.stiffness, *addition.damping, *addition.mass):
            up, down = (term.coefficient(space.si({**point, moving: point[moving] + s * step})) for s in (1, -1))
            slope = term.coefficient.derivative(space.si(point), moving) * space[moving].si_factor
            assert slope == pytest.approx((up - down) / (2 * step), rel=1e-5, abs=1e-9 * abs(up) / step + 1e-15)
            total += abs(slope)
        assert total > 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "values", "changed"),
    [
        ("uneven_converter", {"uneven_converter": 3.0}, {"uneven_converter_uneven": 0.5}),
        ("uneven_converter", {"uneven_converter": 3.0}, {"uneven_converter_inertia": 0.5}),
        ("swaying_seats", {"swaying_seats": 3.0}, {"swaying_seats_sideways": 0.4}),
        ("surging_air_spring", {"surging_air_spring": 400.0}, {"surging_air_spring_surge": 3.0}),
    ],
)
def test_what_a_richer_member_adds_changes_modes(rigid_car, name, values, changed):
    model = extend(rigid_car, [RICHER[name]])
    still, moved = (model.modes({**values, **more}, 15).natural_freq for more in ({}, changed))
    assert abs(moved / still - 1).max() > 0.002
