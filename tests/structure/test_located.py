"""Tests of `calib.structure.located`: sensors of a test on the nodes of a model, whatever their numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from calib.errors.errors import InputError
from calib.measurement.modal import Sensor
from calib.problem.space import ParameterSpace
from calib.structure.located import sensor_partners
from calib.structure.modal_function import ModalFunctionModel
from calib.structure.model import StructuralModel

N = 9
SPACING = 0.25


@pytest.fixture(scope="module")
def chain() -> StructuralModel:
    """Nine masses in a row of 2 m, nodes 101 to 109, which move along it and across."""
    links = 2 * np.eye(N) - np.eye(N, k=1) - np.eye(N, k=-1)
    dofs = pd.DataFrame(
        [(101 + k, d, SPACING * k, 0.0, 0.0) for k in range(N) for d in "xz"], columns=["node", "direction", *"xyz"]
    )
    stiffness = 1e4 * np.kron(links, np.diag([1.0, 0.5]))
    return StructuralModel.from_matrices(stiffness, np.eye(2 * N), dofs=dofs, name="chain")


def test_sensors_move_as_the_node_at_their_place_and_not_as_that_of_their_number(chain):
    sensors = (Sensor(105, "z", (0.01, 0.0, 0.02)), Sensor(1, "x", (2.0, 0.03, 0.0)))
    rows = chain.sensor_rows(sensors)
    assert np.flatnonzero(rows[0]).tolist() == [1] and np.flatnonzero(rows[1]).tolist() == [2 * N - 2]
    found = sensor_partners(chain, sensors)
    assert found.of == {1: 109, 105: 101}
    assert found.table["distance"].to_numpy() == pytest.approx([0.03, np.hypot(0.01, 0.02)])


def test_a_sensor_beyond_the_limit_is_refused_with_its_node_and_a_stated_limit_lets_it_pass(chain):
    off = (Sensor(1, "x", (0.0, 0.0, 0.0)), Sensor(2, "x", (1.0, 0.2, 0.0)), Sensor(3, "x", (2.0, 0.14, 0.0)))
    with pytest.raises(InputError) as caught:
        chain.sensor_rows(off)
    assert "node 2 by 200 mm from node 105 (limit 125 mm)" in str(caught.value)
    assert "node 3 by 140 mm from node 109" in str(caught.value)
    assert caught.value.place == "sensor 2"
    assert replace(chain, sensor_tolerance=0.25).sensor_rows(off).any(axis=1).all()
    with pytest.raises(InputError, match="node 1 by"):
        replace(chain, sensor_tolerance=0.001).sensor_rows((Sensor(1, "x", (0.0, 0.002, 0.0)),))
    with pytest.raises(InputError, match="node_limit"):
        replace(chain, sensor_tolerance=-1.0).sensor_rows(off)


def test_of_two_places_of_one_node_each_counts(chain):
    inside, outside = Sensor(1, "x", (2.0, 0.0, 0.0)), Sensor(1, "x", (2.2, 0.0, 0.0))
    for pair in ((inside, outside), (outside, inside)):
        with pytest.raises(InputError, match="node 1 by 200 mm"):
            chain.sensor_rows(pair)


def test_places_in_millimetres_are_noticed(chain):
    sensors = tuple(Sensor(k, "x", (1e3 * SPACING * k, 0.0, 0.0)) for k in range(1, 5))
    with pytest.raises(InputError, match="measured places in mm"):
        chain.sensor_rows(sensors)


def test_numbers_count_where_a_side_has_no_places(chain):
    bare = StructuralModel.from_matrices(np.eye(2) * 1e4, np.eye(2), dofs=[(7, "x"), (8, "x")])
    assert sensor_partners(bare, (Sensor(8, "x", (0.0, 0.0, 0.0)),)) is None
    assert bare.sensor_rows((Sensor(8, "x", (5.0, 0.0, 0.0)),)).tolist() == [[0.0, 1.0]]
    assert sensor_partners(chain, (Sensor(101, "x"),)) is None
    assert chain.sensor_rows((Sensor(101, "x"),))[0, 0] == 1.0


def test_a_function_of_modes_gives_the_motion_of_the_declared_sensor_at_the_place():
    declared = (Sensor(1, "z", (0.0, 0.0, 0.0)), Sensor(2, "z", (1.0, 0.0, 0.0)), Sensor(3, "z", (2.0, 0.0, 0.0)))

    def modes(values):
        return {"natural_freq": [1.0], "shapes": np.ones((3, 1))}

    model = ModalFunctionModel("rod", ParameterSpace(()), modes, declared, 1)
    measured = (Sensor(41, "z", (2.0, 0.01, 0.0)), Sensor(3, "z", (0.01, 0.0, 0.0)))
    assert model.sensor_rows(measured).tolist() == [[0.0, 0.0, 1.0], [1.0, 0.0, 0.0]]
    assert sensor_partners(model, measured).of == {3: 1, 41: 3}
    assert model.sensor_rows((Sensor(2, "z"),)).tolist() == [[0.0, 1.0, 0.0]]
    with pytest.raises(InputError, match="node 3 by 700 mm"):
        model.sensor_rows((Sensor(3, "z", (0.0, 0.7, 0.0)),))
    with pytest.raises(InputError, match="gives no motion there"):
        model.sensor_rows((Sensor(41, "x", (2.0, 0.0, 0.0)),))
