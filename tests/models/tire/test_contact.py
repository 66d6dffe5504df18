"""Inflation and contact: forces of a bias tire, energy balance, complementarity, limits."""

from dataclasses import replace

import numpy as np
import pytest

from calib import EvaluationError, InputError
from models.tire import base_tire
from models.tire.contact import Ground
from models.tire.load_curve import RotationWarning, load_curve, press_to_load

DEFLECTION = np.array([12.5e-3])


@pytest.fixture(scope="module")
def ground():
    return base_tire().on_ground(2e5, 29, 16)


@pytest.fixture(scope="module")
def pressed(ground):
    return load_curve(ground, DEFLECTION).complete().last


@pytest.mark.medium
@pytest.mark.mostly_slow(1)
@pytest.mark.parametrize(("pressure", "force"), [(1e5, 806), (2e5, 1303), (3e5, 1763)])
def test_forces_at_three_pressures(pressure, force):
    """Regression against an independent prototype; a wall without memory of its stress would carry 350 N at all."""
    ground = base_tire().on_ground(pressure)
    step = load_curve(ground, DEFLECTION).complete().last
    assert step.load == pytest.approx(force, rel=0.02)
    centre = step.pressure[np.argmax(ground.rest)]
    assert centre / pressure == pytest.approx(1.0, abs=0.06)


@pytest.mark.medium
def test_the_load_is_the_derivative_of_the_energy_by_the_deflection(ground, pressed):
    h = 1e-5
    low, high = (load_curve(ground, DEFLECTION + x).last for x in (-h, h))
    assert (high.energy - low.energy) / (2 * h) == pytest.approx(pressed.load, rel=1e-5)
    assert (high.load - low.load) / (2 * h) == pytest.approx(pressed.stiffness, rel=1e-2)


def test_the_way_to_a_deflection_does_not_matter(ground, pressed):
    steps = load_curve(ground, np.linspace(0, DEFLECTION[0], 5)[1:]).complete()
    assert steps.last.load == pytest.approx(pressed.load, rel=1e-8)
    assert (np.diff(steps.loads) > 0).all()


@pytest.mark.parametrize("compliance", [0.0, 1e-9])
def test_ground_pushes_where_it_touches_and_nowhere_else(ground, compliance):
    step = load_curve(replace(ground, compliance=compliance), DEFLECTION).complete().last
    indented = step.gap + compliance * step.pressure
    assert (step.force >= 0).all() and step.force.any() and (step.force == 0).any()
    assert indented.min() > -1e-9
    assert np.abs(step.force * indented).max() < 1e-9 * step.load


def test_a_compliant_tread_lowers_the_largest_pressure_which_alone_may_converge(ground, pressed):
    soft = load_curve(replace(ground, compliance=8e-3 / 7.5e6), DEFLECTION).complete().last
    assert soft.largest_pressure < pressed.largest_pressure
    assert soft.largest_pressure_converges and not pressed.largest_pressure_converges


def test_a_wanted_load_is_reached(ground, pressed):
    found = press_to_load(ground, pressed.load)
    assert found.deflection == pytest.approx(DEFLECTION[0], rel=1e-6)
    assert found.loaded_radius == pytest.approx(ground.inflated.radius - found.deflection)


def test_the_tire_deforms_the_same_on_both_sides_of_the_patch_and_bulges_beside_it(ground):
    """Extension-twist coupling turns a bias tire's patch, but two half turns about the vertical map it onto itself."""
    step = load_curve(ground, DEFLECTION).complete().last
    wall, grid = ground.inflated.wall, ground.inflated.wall.grid
    _, _, w = grid.fields(step.displacement)
    turned = np.roll(w[::-1, ::-1], 1, axis=1)
    assert w == pytest.approx(turned, abs=1e-9)
    crown = grid.n_meridian // 2
    inflated = (wall.height @ ground.inflated.displacement).reshape(-1, grid.n_hoop)
    lowered = (wall.height @ step.displacement).reshape(-1, grid.n_hoop) - inflated
    assert lowered[crown, 0] < -0.9 * DEFLECTION[0]
    side = (wall.axial @ (step.displacement - ground.inflated.displacement)).reshape(-1, grid.n_hoop)[:, 0]
    assert side[: crown - 2].min() < -1e-3 and side[crown + 3 :].max() > 1e-3


def test_pressure_raises_radius_and_frequencies():
    tire = base_tire()
    states = [tire.inflate(p, 29, 24) for p in (1e5, 2e5, 3e5)]
    assert (np.diff([s.radius for s in states]) > 0).all() and states[0].growth > 0
    lowest = [s.modes(3)[0][0] for s in states]
    assert lowest == pytest.approx([43.5, 54.4, 62.6], rel=0.05)


def test_belt_and_tread_carry_more():
    tire = base_tire()
    plain = load_curve(tire.on_ground(2e5, 29, 16), DEFLECTION).last.load
    for other in (
        replace(tire, belt_thickness=0.5e-3),
        replace(tire, tread_thickness=8e-3),
        replace(tire, plies=replace(tire.plies, cord_modulus=3e9)),
    ):
        assert 1.05 * plain < load_curve(other.on_ground(2e5, 29, 16), DEFLECTION).last.load < 1.6 * plain


@pytest.mark.medium
def test_deflections_beyond_the_theory_are_warned_of_and_end_the_curve_with_its_good_steps(ground):
    with pytest.warns(RotationWarning):
        curve = load_curve(ground, np.linspace(5e-3, 40e-3, 8))
    if curve.failure is not None:
        assert 0 < len(curve.steps) < 8
        with pytest.raises(EvaluationError):
            curve.complete()
    with pytest.raises(InputError, match="half the section"):
        load_curve(ground, np.array([80e-3]))


def test_impossible_questions_are_refused(ground):
    tire = base_tire()
    for ask in (
        lambda: load_curve(ground, np.array([-1e-3])),
        lambda: load_curve(ground, np.array([2e-3, 1e-3])),
        lambda: press_to_load(ground, -5.0),
        lambda: Ground(ground.inflated, -1.0),
        lambda: Ground(tire.inflate(2e5, 12, 4)),
        lambda: tire.inflate(-1.0),
        lambda: tire.wall(3, 12),
        lambda: replace(tire, n_plies=3),
        lambda: replace(tire, belt_thickness=-1e-3),
    ):
        with pytest.raises(InputError):
            ask()
