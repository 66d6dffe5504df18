"""The tire as a function of named values."""

import numpy as np
import pytest

from calib import InputError
from models.tire import base_tire
from models.tire.effects import tire_effects
from models.tire.harmonics import hoop_modes
from models.tire.inflated import inflate
from models.tire.model import parameters, tire_of, tire_on_ground

BASE = {p.name: p.value for p in parameters()}


@pytest.fixture(scope="module")
def even():
    tire = base_tire()
    return inflate(tire.wall(13, 20, 0.0), tire.wall(13, 1), 2e5)


def test_modes_by_hoop_order_are_those_of_the_whole_wall(even):
    """The Fourier transform only sorts them: waves around the hoop come in pairs, order 0 does not."""
    whole = even.modes(9)[0]
    modes = hoop_modes(even, np.arange(6), 2)
    sorted_out = sorted(np.concatenate([np.repeat(modes.frequencies[1:], 2), modes.frequencies[0]]))
    assert sorted_out[:9] == pytest.approx(whole, rel=1e-9)


def test_shapes_by_hoop_order_solve_the_problem_of_the_whole_wall(even):
    modes = hoop_modes(even, np.array([2]))
    grid, wave = even.wall.grid, np.exp(2j * np.pi * 2 * np.arange(20) / 20)
    ring = np.concatenate([number[number[:, 0] >= 0] for number in grid.numbers])
    q = np.zeros(grid.n_dof)
    q[ring] = (modes.shapes[0] * wave[None, :]).real
    force = even.stiffness.matrix() @ q
    inertia = (2 * np.pi * modes.frequencies[0, 0]) ** 2 * even.wall.mass * q
    assert np.abs(force - inertia).max() < 1e-9 * np.abs(inertia).max()


def test_hoop_orders_need_equal_cells_and_enough_of_them(even):
    graded = base_tire().inflate(2e5, 9, 8)
    with pytest.raises(InputError, match="grading"):
        hoop_modes(graded, np.array([1]))
    with pytest.raises(InputError, match="hoop cells"):
        hoop_modes(even, np.array([6]))


@pytest.mark.medium
def test_patch_and_load_change_continuously_with_the_deflection():
    """Nodes touch one by one; edges between them are interpolated."""
    deflections = tuple(np.round(np.arange(8.0, 12.0, 0.1), 6))
    out = tire_on_ground(15, 12, deflections, orders=(), derivatives=False).function(BASE)
    for name, jump in (("load", 0.03), ("patch_length", 0.05), ("patch_width", 0.05), ("bulge", 0.05)):
        values = np.array([out[f"{name}_{d:g}"] for d in deflections])
        assert (np.diff(values) > -1e-3 * values[0]).all(), name
        assert np.abs(np.diff(values)).max() < jump * values.max(), name


def test_the_loaded_radius_carries_the_load():
    out = tire_on_ground(15, 12, (10.0,), (600.0, 900.0), (), derivatives=False).function(BASE)
    deflection = out["radius_inflated"] - out["radius_at_600"]
    again = tire_on_ground(15, 12, (deflection,), orders=(), derivatives=False).function(BASE)
    assert again[f"load_{deflection:g}"] == pytest.approx(600.0, rel=1e-6)
    assert out["radius_at_900"] < out["radius_at_600"] < out["radius_inflated"]


def test_the_largest_pressure_is_a_response_with_a_tread_only():
    one = tire_on_ground(15, 12, (10.0,), orders=(), derivatives=False).function
    assert "peak_10" not in one(BASE) and "peak_10" in one(BASE | {"tread_compliance": 1.0})


@pytest.mark.mostly_slow(3)
@pytest.mark.parametrize(
    ("effect", "response", "sign"),
    [
        ({"belt": 0.4, "belt_angle": 20.0}, "growth_crown", -1),
        ({"tread_layer": 6.0}, "load_10", 1),
        ({"tread_compliance": 1.0}, "load_10", -1),
        ({"soft_bead": 0.5}, "load_10", -1),
        ({"thin_sidewall": 0.2}, "load_10", -1),
        ({"halpin_tsai": 0.5}, "load_10", 1),
        ({"crown_mass": 5.0}, "freq_1", -1),
        ({"uncoupled": 0.5}, "load_10", 1),
        ({"dead_pressure": 0.5}, "freq_1", 1),
    ],
)
def test_effects_change_the_tire_as_an_engineer_expects(effect, response, sign):
    solve = tire_on_ground(15, 12, (10.0,), orders=(1,), derivatives=False).function
    assert sign * (solve(BASE | effect)[response] / solve(BASE)[response] - 1) > 0.005


def test_an_effect_of_magnitude_zero_changes_nothing():
    none = {effect.name: 0.0 for effect in tire_effects()}
    s = np.linspace(0.01, 0.3, 9)
    assert np.array_equal(tire_of(BASE | none).stiffness(s), tire_of(BASE).stiffness(s))
    assert np.array_equal(tire_of(BASE | none).areal_density(s), tire_of(BASE).areal_density(s))


def test_a_pressure_that_does_not_follow_at_all_is_a_dead_load():
    plain, dead = (tire_of(BASE | given).wall(11, 8) for given in ({}, {"dead_pressure": 1.0}))
    q = 1e-3 * np.random.default_rng(0).standard_normal(plain.grid.n_dof)
    np.testing.assert_array_equal(dead.push(q), plain.push(0 * q))
    assert dead.energy(q, 2e5) - dead.energy(q, 0.0) == pytest.approx(-2e5 * plain.volume.load @ q, rel=1e-9)
    assert not np.allclose(plain.push(q), plain.push(0 * q), rtol=1e-4)


def test_deflections_must_ascend():
    with pytest.raises(InputError, match="ascend"):
        tire_on_ground(15, 12, (10.0, 5.0))
