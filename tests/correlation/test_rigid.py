"""Detection of rigid-body shapes."""

import numpy as np
import pytest

from calib.correlation.modal.rigid import rigid_motions, rigid_share
from calib.measurement.modal import Sensor

PLACES = [(0.0, 0.0, 0.0), (2.0, 0.1, 0.0), (4.0, 0.0, 0.5), (1.0, 1.0, 1.0)]
SENSORS = tuple(Sensor(k + 1, d, p) for k, p in enumerate(PLACES) for d in ("x", "y", "z", "rz"))


def moved(translation, rotation):
    """Exact small motion of a rigid body at the sensors."""
    out = []
    for s in SENSORS:
        motion = np.asarray(translation) + np.cross(rotation, s.point)
        out.append(motion["xyz".index(s.direction)] if s.direction in "xyz" else rotation[2])
    return np.array(out)


@pytest.mark.parametrize("seed", range(5))
def test_any_rigid_body_motion_is_detected(seed):
    rng = np.random.default_rng(seed)
    shape = moved(rng.normal(size=3), rng.normal(size=3)) * np.exp(0.7j)
    share, looks = rigid_share(np.column_stack([shape, rng.normal(size=len(shape))]), SENSORS)
    np.testing.assert_allclose(share[0], 1.0, atol=1e-9)
    assert looks.tolist() == [True, False] and share[1] < 0.9


def test_sensors_without_coordinates_or_values_are_ignored():
    shape = moved([0, 1, 0], [0, 0, 0.3]).astype(complex)
    shape[3] = np.nan
    nowhere = (*SENSORS[:-1], Sensor(4, "rz"))
    share, looks = rigid_share(shape[:, None], nowhere)
    assert share[0] == pytest.approx(1.0) and looks[0]
    assert np.isnan(rigid_motions([Sensor(1, "x")])).all()
    assert np.isnan(rigid_share(np.ones((1, 1)), [Sensor(1, "x")])[0]).all()


def test_as_many_sensors_as_motions_give_no_detection():
    few = SENSORS[:6]
    share, looks = rigid_share(np.random.default_rng(0).normal(size=(6, 1)), few)
    assert share[0] == pytest.approx(1.0, abs=0.5) and not looks[0]
