"""Errors of channels, masses of accelerometers and stingers as parameters of a test of FRFs."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

from calib.correlation.frf.nuisance import AccelerometerMass, ChannelError, Stinger, concerned
from calib.correlation.frf.problem import FRFProblem
from calib.correlation.frf.residual import FRFResidual
from calib.errors.errors import InputError
from calib.inference.gauss_newton import fit
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.modal import Sensor
from calib.problem.effect import Effect
from calib.problem.problem import PairProblem
from calib.problem.space import Parameter
from calib.structure.effects.attach import hung_masses, motion
from calib.structure.effects.extend import extend
from calib.structure.model import StructuralModel
from calib.structure.reduction.reduced import ReducedModel
from calib.structure.reduction.training import train_basis
from models.solar_panel import GROUPS, solar_panel

FREQ = np.linspace(2.0, 30.0, 40)
K = np.array([[3.2e4, -2e4, 0], [-2e4, 4e4, -2e4], [0, -2e4, 2e4]])
C = 8.0 * np.eye(3)
RESPONSES, REFERENCES = (Sensor(1, "x"), Sensor(3, "x")), (Sensor(1, "x"), Sensor(2, "x"))
STD = 3e-3


def truth(mass=(1.0, 1.0, 1.0), ground=(0.0, 0.0, 0.0), k=1.2e4):
    """Accelerances of three masses in a row by hand, at nodes 1 and 3 under forces at nodes 1 and 2."""
    omega = 2 * np.pi * FREQ
    stiff = K + np.diag([k - 1.2e4, 0, 0]) + np.diag(ground)
    whole = [-(w**2) * np.linalg.inv(stiff + 1j * w * C - w**2 * np.diag(mass)) for w in omega]
    return np.array(whole)[:, [0, 2]][:, :, [0, 1]]


def measured(values, seed=None):
    rng = np.random.default_rng(seed)
    noise = rng.standard_normal(values.shape) + 1j * rng.standard_normal(values.shape)
    more = 0.0 if seed is None else STD * noise
    return MeasuredFRFs(FREQ, RESPONSES, REFERENCES, "accelerance", values + more, np.full(values.shape, STD), 1)


@pytest.fixture(scope="module")
def chain():
    return StructuralModel.from_matrices(
        {"k": np.diag([1.0, 0, 0]), "rest": K - np.diag([1.2e4, 0, 0])},
        np.eye(3),
        C,
        dofs=pd.DataFrame({"node": [1, 2, 3], "direction": "x"}),
        parameters=[Parameter("k", 1.2e4, 6e3, 2.4e4, "N/m")],
    )


EVERY = (
    ChannelError("gain", "1x"), ChannelError("phase", "3x"), ChannelError("delay", "1x", prior_sd=1e-4),
    ChannelError("gain", "1x", "reference"), ChannelError("phase", "2x", "reference"),
    ChannelError("delay", "2x", "reference", 1e-4), AccelerometerMass(RESPONSES[1], 0.05),
    Stinger(REFERENCES[1], 2e3, ("x",)),
)  # fmt: skip
AT = {
    "k": 1.3e4, "gain_1x": 2.0, "phase_3x": 3.0, "delay_1x": 2e-4, "gain_force_1x": -3.0, "phase_force_2x": -2.0,
    "delay_force_2x": -3e-4, "mass_3": 0.08, "stinger_2x": 900.0,
}  # fmt: skip


def test_parameters_follow_the_models_with_priors(chain):
    space = FRFResidual(FRFProblem(chain, measured(truth()), EVERY)).space
    assert set(space.names) == set(AT) and space.names[0] == "k"
    sd = {p.name: (p.value, p.prior_sd, p.unit) for p in space.parameters}
    assert sd["gain_1x"] == (0.0, 1.0, "%") and sd["phase_3x"] == (0.0, 0.5, "deg")
    assert sd["delay_1x"] == (0.0, 1e-4, "s") and sd["stinger_2x"] == (0.0, 2e3, "N/m")
    assert sd["mass_3"] == (0.05, pytest.approx(0.005), "kg")
    assert all(p.lower <= p.value <= p.upper for p in space.parameters) and space["mass_3"].lower == 0.0


def test_each_error_is_that_of_its_definition(chain):
    """By hand: channels of responses multiply, those of references divide, masses and springs are in the matrices."""
    problem = FRFProblem(chain, measured(truth()), EVERY)
    omega = 2 * np.pi * FREQ
    plain = truth(mass=(1.0, 1.0, 1.08), ground=(0.0, 900.0, 0.0), k=1.3e4)
    expected = plain.copy()
    expected[:, 0] *= (1.02 * np.exp(-1j * omega * 2e-4))[:, None]
    expected[:, 1] *= np.exp(1j * np.radians(3.0))
    expected[:, :, 0] /= 0.97
    expected[:, :, 1] /= (np.exp(1j * np.radians(-2.0)) * np.exp(1j * omega * 3e-4))[:, None]
    np.testing.assert_allclose(problem.functions(AT), expected, rtol=1e-10)


def test_derivatives_are_those_of_differences(chain):
    residual = FRFResidual(FRFProblem(chain, measured(truth()), EVERY))
    names = tuple(reversed(AT))
    exact = residual.jacobian(AT, names)
    for column, name in zip(exact.T, names, strict=True):
        step = 1e-5 * abs(AT[name])
        up, down = (residual.residual({**AT, name: AT[name] + s * step}) for s in (1, -1))
        np.testing.assert_allclose(column, (up - down) / (2 * step), rtol=1e-5, atol=1e-6 * np.abs(column).max())
    only = residual.jacobian(AT, ("gain_1x",))
    np.testing.assert_array_equal(only[:, 0], exact[:, names.index("gain_1x")])


def test_nuisances_at_zero_change_nothing(chain):
    data = measured(truth(), 1)
    plain = FRFResidual(FRFProblem(chain, data))
    massless = [n for n in EVERY if not isinstance(n, AccelerometerMass)] + [AccelerometerMass(RESPONSES[1], 0.0, 0.01)]
    loaded = FRFResidual(FRFProblem(chain, data, tuple(massless)))
    np.testing.assert_array_equal(loaded.residual({}), plain.residual({}))
    np.testing.assert_array_equal(loaded.jacobian({}, ("k",)), plain.jacobian({}, ("k",)))
    assert loaded.rows == plain.rows and plain.space == chain.space


def test_each_nuisance_makes_another_problem(chain):
    data = measured(truth(), 1)
    each = [
        (),
        *((n,) for n in EVERY),
        (AccelerometerMass(RESPONSES[0], 0.05),),
        (Stinger(REFERENCES[0], 2e3, ("x",)),),
    ]
    prints = {FRFProblem(chain, data, some).fingerprint for some in each}
    assert len(prints) == len(each)
    assert FRFProblem(chain, data, EVERY[1:2]).fingerprint in prints
    assert len({FRFResidual(FRFProblem(chain, data, some)).fingerprint for some in each}) == len(each)


@pytest.mark.mostly_slow(1)
@pytest.mark.parametrize(
    ("nuisance", "wrong", "expected"),
    [
        (ChannelError("gain", "3x"), {"gain": 1.01}, 1.0),
        (ChannelError("phase", "3x"), {"phase": np.radians(0.6)}, 0.6),
        (AccelerometerMass(Sensor(3, "x"), 0.0, 0.02), {"mass": 0.03}, 0.03),
        (Stinger(Sensor(2, "x"), 300.0, ("x",)), {"ground": 400.0}, 400.0),
    ],
    ids=["gain", "phase", "mass", "stinger"],
)
def test_an_error_is_found_and_shifts_the_parameter_where_it_is_not_free(chain, nuisance, wrong, expected):
    values = truth((1, 1, 1 + wrong.get("mass", 0.0)), (0, wrong.get("ground", 0.0), 0))
    values[:, 1] *= wrong.get("gain", 1.0) * np.exp(1j * wrong.get("phase", 0.0))
    pulls, misfits = [], []
    for seed in range(6):
        residual = FRFResidual(FRFProblem(chain, measured(values, seed), (nuisance,)))
        found = fit(PairProblem(residual, residual.space), residual.space)
        names = ("k", nuisance.parameter.name)
        slope = residual.jacobian(found.values, names)
        weights = np.diag([0.0, 1 / nuisance.parameter.prior_width**2])
        std = np.sqrt(np.diag(np.linalg.inv(slope.T @ slope + weights)))
        truths = {"k": 1.2e4, nuisance.parameter.name: expected}
        pulls.append([(found.values[n] - truths[n]) / s for n, s in zip(names, std, strict=True)])
        assert expected > 4 * std[1]  # the data see it
        misfits.append(np.sum(residual.residual(found.values) ** 2))
    assert np.abs(pulls).max() < 4 and np.sqrt(np.mean(np.square(pulls))) < 1.7
    rows = len(residual.rows)
    assert 0.85 * rows < np.mean(misfits) < 1.15 * rows
    blind = FRFResidual(FRFProblem(chain, measured(values, 0)))
    without = fit(PairProblem(blind, blind.space), blind.space)
    assert np.sum(blind.residual(without.values) ** 2) > misfits[0] + 16


def test_a_mass_moves_in_all_translations_that_the_model_has():
    """Of a mass on three springs, a load at a sensor in x lowers y too; the array of plates moves in z alone."""
    model = StructuralModel.from_matrices(
        np.diag([1e4, 2e4, 3e4]), np.eye(3), 5 * np.eye(3), dofs=[(1, "x"), (1, "y"), (1, "z")]
    )
    sensors = tuple(Sensor(1, d) for d in "xyz")
    ones = np.ones((40, 3, 3))
    data = MeasuredFRFs(FREQ, sensors, sensors, "receptance", ones + 0j, ones)
    heavy = FRFProblem(model, data, (AccelerometerMass(sensors[0], 0.5),)).functions({})
    omega = 2 * np.pi * FREQ
    for k, stiffness in enumerate((1e4, 2e4, 3e4)):
        np.testing.assert_allclose(heavy[:, k, k], 1 / (stiffness + 5j * omega - 1.5 * omega**2), rtol=1e-10)
    across = FRFProblem(model, data, (Stinger(sensors[0], 1e3),)).functions({"stinger_1x": 2e3})
    for k, stiffness in enumerate((1e4, 2.2e4, 3.2e4)):
        np.testing.assert_allclose(across[:, k, k], 1 / (stiffness + 5j * omega - omega**2), rtol=1e-10)
    panel = solar_panel()
    assert np.count_nonzero(np.abs(panel.translations(Sensor(1, "z", (0.0, -0.2, 0.0)))).sum(axis=1)) == 1


@pytest.mark.medium
def test_a_reduced_model_bears_loads_and_another_model_keeps_the_nuisances():
    panel = solar_panel()
    space = panel.space.keep(GROUPS[:2])
    reduced = ReducedModel(panel, train_basis(panel, space, 8, seed=1))
    sensor = Sensor(1, "z", (0.0, -0.2, 0.0))
    freq = np.linspace(1.0, 11.0, 8)
    ones = np.ones((8, 1, 1))
    data = MeasuredFRFs(freq, (sensor,), (sensor,), "receptance", ones + 0j, ones)
    nuisances = (AccelerometerMass(sensor, 0.2), ChannelError("gain", "1z"))
    small = FRFResidual(FRFProblem(reduced, data, nuisances))
    whole = small.with_model(panel)
    assert small.space.names == whole.space.names == (*GROUPS, "mass_1", "gain_1z")
    values = {"mass_1": 0.3, "gain_1z": 2.0, GROUPS[0]: 200.0}
    exact = whole.solve(values)
    np.testing.assert_allclose(small.solve(values), exact, rtol=0.02, atol=1e-3 * np.abs(exact).max())
    bare = FRFResidual(FRFProblem(panel, data)).solve({GROUPS[0]: 200.0})
    assert np.abs(exact / bare - 1.02).max() > 0.1


@pytest.mark.medium
def test_an_effect_with_its_own_motion_goes_with_nuisances_of_the_test():
    """A hung mass adds a degree of freedom and has a root of its mass: at mass 0 too its derivative is that nearby."""
    panel = solar_panel()
    effect = Effect(
        "hung", "Hung mass", "No mass hangs there.", "A unit on springs.",
        Parameter("hung", 0.0, 0.0, 3.0, "kg", prior_sd=0.5),
        lambda model: hung_masses([motion(model, (None, (0.4, 0.0, 0.0)), 2)], "hung", "f_hung", 0.02),
        (Parameter("f_hung", 8.0, 2.0, 20.0, "Hz"),), ({"hung": 0.5, "f_hung": 8.0},),
    )  # fmt: skip
    reduced = ReducedModel(panel, train_basis(panel, panel.space.keep(GROUPS[:2]), 8, seed=1))
    sensor = Sensor(1, "z", (0.0, -0.2, 0.0))
    ones = np.ones((8, 1, 1))
    data = MeasuredFRFs(np.linspace(1.0, 11.0, 8), (sensor,), (sensor,), "receptance", ones + 0j, ones)
    nuisances, names = (AccelerometerMass(sensor, 0.2), ChannelError("gain", "1z")), ("hung", "mass_1", "gain_1z")
    found = []
    for model in (extend(panel, [effect]), reduced.extended([effect])):
        residual = FRFResidual(FRFProblem(model, data, nuisances))
        assert residual.space.names[-4:] == ("hung", "f_hung", "mass_1", "gain_1z")
        values = {"hung": 0.7, "f_hung": 9.0, "mass_1": 0.3, "gain_1z": 2.0}
        found.append(residual.solve(values))
        for at in (values, {**values, "hung": 0.0}):
            for column, name in zip(residual.jacobian(at, names).T, names, strict=True):
                low = {**at, name: at[name] * (1 - 1e-5)}
                high = {**at, name: at[name] * (1 + 1e-5) if at[name] else 1e-4}
                slope = (residual.residual(high) - residual.residual(low)) / (high[name] - low[name])
                np.testing.assert_allclose(column, slope, rtol=2e-3, atol=1e-3 * np.abs(slope).max())
    np.testing.assert_allclose(found[1], found[0], atol=5e-3 * np.abs(found[0]).max())


def test_nuisances_of_data_in_use(chain):
    data = measured(truth())
    some = concerned(EVERY, data.without(responses=["1x"]))
    assert set(EVERY) - set(some) == {EVERY[0], EVERY[2]}  # the force's channel of that name is still in use
    assert set(EVERY) - set(concerned(EVERY, data.without(references=["2x"]))) == {EVERY[4], EVERY[5]}


def test_wrong_nuisances_are_refused(chain):
    data = measured(truth())
    for given, words in (
        ((ChannelError("gain", "2x"),), "response '2x' was not measured"),
        ((ChannelError("gain", "3x", "reference"),), "reference '3x' was not measured"),
        ((ChannelError("gain", "1x"), ChannelError("gain", "1x", prior_sd=2.0)), "'gain_1x' is a parameter twice"),
        ((AccelerometerMass(Sensor(9, "x"), 0.1),), "9x"),
        ((Stinger(REFERENCES[0], 1e3),), "suppresses y, z"),
    ):
        with pytest.raises(InputError, match=words):
            FRFProblem(chain, data, given)
    named = replace(chain, space=chain.space)
    with pytest.raises(InputError, match="parameter twice"):
        FRFProblem(
            StructuralModel.from_matrices(
                {"gain_1x": K}, np.eye(3), C, dofs=[(k, "x") for k in (1, 2, 3)],
                parameters=[Parameter("gain_1x", 1.0, 0.5, 2.0)],
            ),
            data, EVERY[:1],
        )  # fmt: skip
    assert FRFProblem(named, data, EVERY[:1]).space.names == ("k", "gain_1x")


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: ChannelError("delay", "1x"), "prior_sd in s"),
        (lambda: ChannelError("offset", "1x"), "'offset' of a 'response'"),
        (lambda: ChannelError("gain", "1x", "sensor"), "of a 'sensor'"),
        (lambda: ChannelError("gain", "1x", prior_sd=-1.0), "is -1"),
        (lambda: AccelerometerMass(RESPONSES[0], -0.1), "is -0.1 kg"),
        (lambda: AccelerometerMass(RESPONSES[0], 0.0), "mass or prior_sd"),
        (lambda: AccelerometerMass(RESPONSES[0], 0.1, 0.0), "is 0"),
        (lambda: Stinger(Sensor(1, "rx"), 1e3), "does not act along"),
        (lambda: Stinger(RESPONSES[0], 1e3, ("rx",)), "does not act along"),
        (lambda: Stinger(RESPONSES[0], float("nan")), "is nan"),
    ],
)
def test_impossible_nuisances_are_refused(make, words):
    with pytest.raises(InputError, match=words):
        make()
