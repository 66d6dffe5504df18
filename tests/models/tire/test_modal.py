"""The inflated tire as a model of modes at sensors."""

import numpy as np
import pytest

from calib import InputError
from calib.measurement.mac import mac
from models.tire import base_tire
from models.tire.inflated import inflate
from models.tire.modal import tire_modes

NOMINAL = tire_modes(9).space.values


@pytest.fixture(scope="module")
def model():
    return tire_modes(21, (0, 1, 2), n_modes=5)


def test_modes_are_those_of_the_whole_wall_that_the_exciter_moves(model):
    """Of each pair the one whose crown moves radially at the exciter; both span the same plane in space."""
    tire = base_tire()
    whole = inflate(tire.wall(21, 24, 0.0), tire.wall(21, 1), 2e5)
    freq, vectors = whole.modes(8)
    found = model.modes(NOMINAL, 3)
    assert found.natural_freq == pytest.approx([freq[0], freq[1], freq[5]], rel=1e-2)
    assert found.natural_freq[:2] == pytest.approx(freq[:2], rel=1e-9)
    grid = whole.wall.grid
    crown = (whole.wall.height @ vectors[:, 1:3]).reshape(grid.n_meridian + 1, grid.n_hoop, 2)[10]
    stations = crown[::2]  # twelve stations of 24 hoop cells
    names = [sensor.name for sensor in model.sensors]
    own = {name: found.shapes[names.index(name), 1] for name in names}
    angle = 2 * np.pi * np.arange(12) / 12
    radial = np.array([own[f"{k + 1}x"] * np.sin(a) - own[f"{k + 1}z"] * np.cos(a) for k, a in enumerate(angle)])
    weights, *_ = np.linalg.lstsq(stations, radial, rcond=None)
    assert np.abs(stations @ weights - radial).max() < 0.05 * np.abs(radial).max()
    assert np.argmax(np.abs(radial)) in (0, 6) and radial == pytest.approx(
        radial[0] * np.cos(angle), abs=1e-9 * abs(radial[0])
    )


def test_shapes_of_two_meshes_agree(model):
    coarse, fine = model.modes(NOMINAL, 5), tire_modes(31, (0, 1, 2), n_modes=5).modes(NOMINAL, 5)
    assert np.diag(mac(coarse.shapes, fine.shapes)).min() > 0.99
    assert coarse.natural_freq == pytest.approx(fine.natural_freq, rel=0.03)


def test_a_heavier_crown_lowers_every_frequency(model):
    heavy = model.function(NOMINAL | {"crown_mass": 5.0})["natural_freq"]
    assert (heavy < 0.99 * model.modes(NOMINAL, 5).natural_freq).all()


def test_more_modes_than_are_solved_are_refused():
    with pytest.raises(InputError, match="8 modes"):
        tire_modes(21, (0, 1, 2))
