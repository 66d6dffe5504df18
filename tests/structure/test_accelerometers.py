"""Masses of accelerometers: what they weigh on, and when a shift of all frequencies is theirs."""

import numpy as np
import pandas as pd
import pytest

from calib.measurement.modal import Sensor
from calib.problem.space import Parameter
from calib.structure.effects.extend import extend
from calib.structure.effects.perturbations import accelerometers
from calib.structure.model import StructuralModel

K = np.array([[3.2e4, -2e4, 0], [-2e4, 4e4, -2e4], [0, -2e4, 2e4]])


@pytest.fixture
def chain():
    return StructuralModel.from_matrices(
        {"k": K}, np.eye(3), dofs=pd.DataFrame({"node": [1, 2, 3], "direction": "x"}),
        parameters=[Parameter("k", 1.0, 0.5, 2.0)],
    )  # fmt: skip


def test_the_mass_is_added_once_at_every_node(chain):
    sensors = [Sensor(1, "x", (1.0, 0.0, 0.0)), Sensor(3, "x", (3.0, 0.0, 0.0)), Sensor(3, "x", (3.0, 0.0, 0.0))]
    (fault,) = accelerometers(chain, sensors, {})
    name = fault.effect.name
    wider = extend(chain, [fault.effect])
    added = (wider.matrices({name: 0.02})[2] - chain.matrices({})[2]).toarray()
    np.testing.assert_allclose(added, np.diag([0.02, 0.0, 0.02]))
    assert fault.effect.of_measurement and not fault.effect.signed
    assert fault.effect.plausible == pytest.approx(0.01 * 3.0 / 2)


def test_rotations_alone_carry_no_accelerometer(chain):
    assert accelerometers(chain, [Sensor(1, "rx", (1.0, 0.0, 0.0))], {}) == ()
