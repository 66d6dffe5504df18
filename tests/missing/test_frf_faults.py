"""Faults of channels of FRFs among the candidates of an explanation."""

import numpy as np
import pandas as pd
import pytest

from calib.analyses.hypotheses import ModelHypotheses
from calib.correlation.frf_faults import frf_faults
from calib.correlation.frf_nuisance import ChannelError
from calib.correlation.frf_residual import FRFProblem, FRFResidual
from calib.effect import Effect
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.modal import Sensor
from calib.missing.explain import explain
from calib.space import Parameter
from calib.structure.affine import parameter as proportional
from calib.structure.attach import outer_term
from calib.structure.extend import Addition
from calib.structure.model import StructuralModel
from calib.structure.variants import Variants

FREQ = np.linspace(2.0, 30.0, 40)
K = np.array([[3.2e4, -2e4, 0], [-2e4, 4e4, -2e4], [0, -2e4, 2e4]])
C, STD = 8.0 * np.eye(3), 3e-3
RESPONSES, REFERENCES = tuple(Sensor(k, "x") for k in (1, 2, 3)), (Sensor(1, "x"),)


def truth(ground=0.0):
    """Accelerances of three masses in a row by hand, under a force at the first one."""
    stiff = K + np.diag([0.0, ground, 0.0])
    omega = 2 * np.pi * FREQ
    return np.array([-(w**2) * np.linalg.inv(stiff + 1j * w * C - w**2 * np.eye(3))[:, [0]] for w in omega])


def hypotheses(values, seed=1):
    rng = np.random.default_rng(seed)
    noise = STD * (rng.standard_normal(values.shape) + 1j * rng.standard_normal(values.shape))
    data = MeasuredFRFs(
        FREQ, RESPONSES, REFERENCES, "accelerance", values + noise, np.full(values.shape, STD), 1
    )  # fmt: skip
    parameter = Parameter("k", 1.2e4, 6e3, 2.4e4, "N/m", prior_sd=1e3)
    chain = StructuralModel.from_matrices(
        {"k": np.diag([1.0, 0, 0]), "rest": K - np.diag([1.2e4, 0, 0])}, np.eye(3), C,
        dofs=pd.DataFrame({"node": [1, 2, 3], "direction": "x"}), parameters=[parameter],
    )  # fmt: skip
    magnitude = Parameter("rope", 0.0, 0.0, 1e5, "N/m", prior_sd=3e3)

    def build(model):
        return Addition(stiffness=(outer_term("rope", [np.eye(3)[1]], proportional("rope"), model.n_dof - 3),))

    rope = Effect("rope", "Rope", "None.", "A rope.", magnitude, build)
    pair = FRFResidual(FRFProblem(chain, data)).suspected()
    return ModelHypotheses(pair, Variants(chain, (rope,), ()), chain.space)


def test_faults_at_zero_change_nothing():
    asked = hypotheses(truth())
    pair = asked.pair
    plain = FRFResidual(FRFProblem(pair.problem.model, pair.problem.measured))
    np.testing.assert_array_equal(asked.fit_problem(()).residual({"k": 1.25e4}), plain.residual({"k": 1.25e4}))
    assert set(asked.fit_problem(()).space.names) == {"k"}
    assert {f.kind for f in pair.faults} == {"gain", "phase", "delay"} and len(pair.faults) == 3 * 4


def test_an_error_that_is_fitted_is_no_fault():
    data = hypotheses(truth()).pair.problem.measured
    known = (ChannelError("gain", "1x"), ChannelError("delay", "1x", "reference", 1e-4))
    names = {f.name for f in frf_faults(data, known)}
    assert len(names) == 10 and not names & {"gain_1x", "delay_force_1x"}


@pytest.mark.mostly_slow(1)
@pytest.mark.parametrize(
    ("channel", "factor", "name", "value", "words"),
    [
        (2, 0.9, "gain_3x", -10.0, "sensor 3x reads 10 % low"),
        (1, -1.0, "gain_2x", -200.0, "sensor 2x has the wrong sign"),
        (1, np.exp(-2j * np.pi * FREQ * 5e-4)[:, None], "delay_2x", 5e-4, "sensor 2x is late by 0.5 ms"),
    ],
)
def test_a_planted_fault_is_named(channel, factor, name, value, words):
    values = truth()
    values[:, channel] = values[:, channel] * factor
    found = explain(hypotheses(values))
    assert found.verdict == "measurement" and found.credible == ()
    assert name in [t.names[0] for t in found.blamed]
    fitted, std = found.fault.magnitude(name)
    assert abs(fitted - value) < 4 * std
    (effect,) = found.fault.effects
    assert effect.told(value) == words


def test_a_missing_effect_is_named_and_sound_data_are_silent():
    assert explain(hypotheses(truth())).verdict == "nothing_detectable"
    found = explain(hypotheses(truth(ground=3e3)))
    assert found.fault is None or found.verdict != "measurement"
    assert found.verdict in ("effect", "unconfirmed") and found.chosen.names == ("rope",)
