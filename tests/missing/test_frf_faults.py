"""Faults of channels and transducers of FRFs among the candidates of an explanation."""

import re
from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from calib.correlation.frf.cross_talk import CrossTalkError
from calib.correlation.frf.faults import frf_faults
from calib.correlation.frf.nuisance import ChannelError
from calib.correlation.frf.places import PlaceError
from calib.correlation.frf.problem import FRFProblem
from calib.correlation.frf.residual import FRFResidual
from calib.correlation.frf.rotation import RotationError
from calib.hypotheses.hypotheses import ModelHypotheses
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.modal import Sensor
from calib.missing.decision import decide
from calib.missing.local import fault_words
from calib.problem.effect import Effect
from calib.problem.space import Parameter
from calib.structure.affine import parameter as proportional
from calib.structure.effects.attach import outer_term
from calib.structure.effects.extend import Addition
from calib.structure.effects.variants import Variants
from calib.structure.model import StructuralModel
from models.railway import bogie_on_rig

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
    # no mesh and one direction
    assert {f.kind for f in pair.faults} == {"gain", "phase", "delay", "cross-talk", "exchange"}
    assert sum(not f.of_pair for f in pair.faults) == 3 * 4 + 4 and sum(f.of_pair for f in pair.faults) == 3 + 2


@pytest.mark.medium
def test_an_error_that_is_fitted_is_no_fault(bogie):
    """Whatever its prior, or the name of its test."""
    pair = hypotheses(truth()).pair
    known = (
        ChannelError("gain", "1x"), ChannelError("delay", "1x", "reference", 1e-4),
        CrossTalkError(RESPONSES[1], RESPONSES[0], 0.02, test="A"),
    )  # fmt: skip
    names = {f.name for f in frf_faults(pair.problem.model, pair.problem.measured, known)}
    assert len(names) == 13 + 5 and not names & {"gain_1x", "delay_force_1x", "cross_talk_1x_2x"}
    fitted = (
        PlaceError(GIRDER, "x", 2.0), RotationError(BOX, "x", 1.0), RotationError(BOX_FORCE, "y", 1.0, "reference")
    )  # fmt: skip
    every, left = ({f.name for f in frf_faults(bogie, of_bogie(bogie), some)} for some in ((), fitted))
    assert every - left == {error.parameter.name for error in fitted}


def test_faults_of_a_test_among_several_bear_its_name():
    pair = hypotheses(truth()).pair
    found = frf_faults(pair.problem.model, pair.problem.measured, test="A")
    assert all(f.name == f.error.parameter.name and f.name.endswith(" in test A") for f in found)
    assert "gain of sensor 1x in test A" in [f.title for f in found]
    plain = FRFResidual(FRFProblem(pair.problem.model, pair.problem.measured))
    named = plain.suspected("A")
    assert [f.name for f in named.faults] == [f.name for f in found]
    assert set(named.space.names) == {"k", *(f.name for f in found)}


@pytest.mark.medium
def test_transducers_have_the_faults_of_a_modal_test(bogie):
    """A box is rigid and moves along all axes, the crossbar is a beam along z; every response has its neighbours."""
    found = {f.name: f for f in frf_faults(bogie, of_bogie(bogie))}
    own = {name for name, f in found.items() if f.kind not in ("gain", "phase", "delay") and not f.of_pair}
    pairs = {name for name, f in found.items() if f.of_pair}
    assert pairs == {"exchange_1y_2y", "exchange_1y_3y", "exchange_2y_3y", "cross_talk_1y_3y", "cross_talk_3y_1y"}
    assert {n for n in own if n.startswith("cross")} == {
        "cross_talk_2y_1y", "cross_talk_1y_2y", "cross_talk_3y_2y", "cross_talk_2y_3y"
    }  # fmt: skip
    assert {n for n in own if n.startswith("place")} == {"place_x_1y", "place_z_3y"}
    assert {n for n in own if n.startswith("rotation")} == {
        "rotation_2y_x", "rotation_2y_z", "rotation_3y_x", "rotation_3y_z", "rotation_force_4x_y", "rotation_force_4x_z"
    }  # fmt: skip
    sizes = {n: (found[n].magnitude.prior_sd, found[n].magnitude.lower, found[n].magnitude.upper) for n in own}
    assert sizes["place_x_1y"] == (100.0, -500.0, 500.0) and sizes["rotation_2y_x"] == (15.0, -120.0, 120.0)
    assert sizes["cross_talk_2y_1y"] == (0.1, -1.0, 1.0)
    assert found["rotation_force_4x_y"].told(12.0) == "force at 4x is turned by 12 deg towards y"
    assert found["place_x_1y"].title == "place of sensor and force at 1y along x"
    assert found["place_x_1y"].told(24.0) == "sensor and force at 1y sit 2.4 cm off along +x"
    assert found["place_x_1y"].place == GIRDER.point and found["place_z_3y"].title == "place of sensor 3y along z"


@pytest.mark.medium
def test_the_place_of_every_force_is_suspected(bogie):
    """A hammer that roves: one response and a force at two other points."""
    data = of_bogie(bogie)
    roving = MeasuredFRFs(
        data.freq, data.responses[:1], (data.responses[0], data.responses[2]), "accelerance",
        np.ones((len(data.freq), 1, 2)) + 0j, np.ones((len(data.freq), 1, 2)),
    )  # fmt: skip
    found = {f.name: f.title for f in frf_faults(bogie, roving) if f.kind == "place"}
    assert found["place_z_3y"] == "place of force at 3y along z"


def test_sensors_without_places_have_no_fault_of_a_place():
    """Here the model has two directions at a node, so that axes can be turned."""
    model = StructuralModel.from_matrices(np.diag([1e4, 2e4]), np.eye(2), np.eye(2), dofs=[(1, "x"), (1, "y")])
    ones = np.ones((len(FREQ), 1, 1))
    for sensor in (Sensor(1, "x"), Sensor(1, "x", (0.0, 0.0, 0.0))):  # the model has no places either
        found = frf_faults(model, MeasuredFRFs(FREQ, (sensor,), (sensor,), "receptance", ones + 0j, ones))
        assert [f.name for f in found if f.kind == "rotation"] == ["rotation_1x_y", "rotation_force_1x_y"]
        assert {f.kind for f in found} == {"gain", "phase", "delay", "rotation"}


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
    found = decide(hypotheses(values))
    assert found.verdict == "measurement" and found.credible == ()
    assert name in [t.names[0] for t in found.blamed]
    fitted, std = found.fault.magnitude(name)
    assert abs(fitted - value) < 4 * std
    (effect,) = found.fault.effects
    assert effect.told(effect.as_told(value)) == words
    ends = re.search(r"\(95 %: (\S+) to (\S+) ", fault_words(found.fault))
    percent = 100.0 if effect.magnitude.unit == "-" else 1.0
    stated = (
        percent * effect.as_told(fitted) * (-1 if " low" in words or " away" in words else 1)
    )  # the size, where words tell the sense
    assert float(ends[1]) < stated < float(ends[2])


@pytest.mark.medium
@pytest.mark.parametrize("ground", [0.0, 3e3])
def test_exchanged_responses_are_told_alone_and_beside_an_effect(ground):
    found = decide(hypotheses(truth(ground)[:, [2, 1, 0]]))
    ((fault, fit),) = found.faulty
    value, std = fit.magnitude(fault.name)
    assert fault.name == "exchange_1x_3x" and abs(value - 1.0) < 4 * std and not found.remains
    assert fault.told(value) == "sensors 1x and 3x are exchanged"
    assert found.verdict == ("effect" if ground else "measurement")
    assert found.credible == (("rope",) if ground else ())


def test_an_exchange_changes_both_rows_with_an_exact_derivative():
    pair = hypotheses(truth()).pair
    whole = pair.solve({"k": 1.2e4, "exchange_1x_3x": 1.0})
    np.testing.assert_allclose(whole, pair.solve({"k": 1.2e4})[:, [2, 1, 0]], rtol=1e-9)
    at = {"k": 1.2e4, "exchange_1x_3x": 0.3}
    half = 1e-4
    up, down = (pair.residual({**at, "exchange_1x_3x": 0.3 + s * half}) for s in (1, -1))
    np.testing.assert_allclose(
        pair.jacobian(at, ["exchange_1x_3x"])[:, 0], (up - down) / (2 * half), atol=1e-6 * np.abs(up).max() / half
    )


@pytest.mark.medium
def test_a_missing_effect_is_named_and_sound_data_are_silent():
    assert decide(hypotheses(truth())).verdict == "nothing_detectable"
    found = decide(hypotheses(truth(ground=3e3)))
    assert found.fault is None or found.verdict != "measurement"
    assert found.verdict in ("effect", "unconfirmed") and found.chosen.names == ("rope",)


GIRDER, BOX = Sensor(1, "y", (-1.3, 0.62, 1.05), "frame"), Sensor(2, "y", (1.45, 0.43, 1.05), "box_front_left")
CROSSBAR, BOX_FORCE = (
    Sensor(3, "y", (1.115, 0.62, 0.7), "crossbar"),
    Sensor(4, "x", (1.45, 0.43, -1.05), "box_front_right"),
)
LINES = np.linspace(6.0, 33.0, 24)


@pytest.fixture(scope="module")
def bogie():
    return bogie_on_rig(element_size=0.3)


def of_bogie(model, responses=(GIRDER, BOX, CROSSBAR), references=(GIRDER, BOX_FORCE)):
    """FRFs of a bogie with transducers that are where and as they are said to be."""
    shape = (len(LINES), len(responses), len(references))
    given = MeasuredFRFs(LINES, responses, references, "accelerance", np.ones(shape) + 0j, np.ones(shape), 1)
    return replace(given, values=FRFProblem(model, given).functions({"K_primary": 590.0}))


def sits_elsewhere(model):
    return of_bogie(model, (GIRDER, BOX, replace(CROSSBAR, point=(1.115, 0.62, 0.75)))).values


def turned(sound, other, angle):
    return np.cos(np.radians(angle)) * sound + np.sin(np.radians(angle)) * other


def turned_sensor(model):
    other = of_bogie(model, (GIRDER, replace(BOX, direction="x"), CROSSBAR)).values
    out = of_bogie(model).values
    out[:, 1] = turned(out[:, 1], other[:, 1], 12.0)
    return out


def turned_force(model):
    other = of_bogie(model, references=(GIRDER, replace(BOX_FORCE, direction="y"))).values
    out = of_bogie(model).values
    out[:, :, 1] = turned(out[:, :, 1], other[:, :, 1], -12.0)
    return out


def talks_across(model):
    out = of_bogie(model).values
    out[:, 1] += 0.15 * out[:, 2]
    return out


def reversed_force(model):
    out = of_bogie(model).values
    out[:, :, 1] *= -1.0
    return out


def light_force(model):
    out = of_bogie(model).values
    out[:, :, 1] *= 0.84
    return out


@pytest.mark.slow
@pytest.mark.mostly_slow(1)
@pytest.mark.parametrize(
    ("plant", "name", "value", "words"),
    [
        (light_force, "gain_force_4x", -16.0, "force at 4x reads 19 % high"),
        (reversed_force, "gain_force_4x", -200.0, "force at 4x has the wrong sign"),
        (sits_elsewhere, "place_z_3y", 50.0, "sensor 3y sits 5 cm off along +z"),
        (turned_sensor, "rotation_2y_x", 12.0, "sensor 2y is turned by 12 deg towards x"),
        (turned_force, "rotation_force_4x_y", -12.0, "force at 4x is turned by 12 deg away from y"),
        (talks_across, "cross_talk_3y_2y", 0.15, "sensor 2y reads 15 % of sensor 3y beside its own motion"),
    ],
)
def test_a_planted_fault_of_a_transducer_is_named(bogie, plant, name, value, words):
    rng = np.random.default_rng(5)
    values, sound = plant(bogie), of_bogie(bogie)
    std = 0.01 * np.abs(values) + 1e-4 * np.abs(values).max()
    noise = std * (rng.standard_normal(values.shape) + 1j * rng.standard_normal(values.shape))
    pair = FRFResidual(FRFProblem(bogie, replace(sound, values=values + noise, std=std))).suspected()
    space = bogie.space.keep(["K_primary"])
    found = decide(ModelHypotheses(pair, Variants(bogie, (), ()), space))
    assert found.verdict == "measurement" and [t.names[0] for t in found.blamed] == [name]
    fitted, spread = found.fault.magnitude(name)
    assert abs(fitted - value) < 4 * spread
    (effect,) = found.fault.effects
    assert effect.told(effect.as_told(value)) == words
    ends = re.search(r"\(95 %: (\S+) to (\S+) ", fault_words(found.fault))
    percent = 100.0 if effect.magnitude.unit == "-" else 1.0
    stated = (
        percent * effect.as_told(fitted) * (-1 if " low" in words or " away" in words else 1)
    )  # the size, where words tell the sense
    assert float(ends[1]) < stated < float(ends[2])
