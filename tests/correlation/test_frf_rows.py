"""Turned axes, wrong places and cross-talk as parameters of a test of FRFs: which motions its transducers have."""

from dataclasses import replace

import numpy as np
import pytest

import calib
from calib.correlation.basis import BasisRequirements
from calib.correlation.frf.cross_talk import CrossTalkError
from calib.correlation.frf.nuisance import AccelerometerMass, ChannelError, belonging_to
from calib.correlation.frf.places import PlaceError
from calib.correlation.frf.problem import FRFProblem
from calib.correlation.frf.residual import FRFResidual
from calib.correlation.frf.rotation import RotationError
from calib.errors.errors import InputError
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.modal import Sensor
from calib.structure.model import StructuralModel
from models.railway import bogie_on_rig

FREQ = np.linspace(7.3, 31.0, 8)
GIRDER, BOX = Sensor(1, "y", (-1.3, 0.62, 1.05), "frame"), Sensor(2, "x", (1.45, 0.43, 1.05), "box_front_left")
RESPONSES, REFERENCES = (GIRDER, BOX), (GIRDER, Sensor(4, "x", (1.45, 0.43, -1.05), "box_front_right"))
EVERY = (
    PlaceError(GIRDER, "x", 3.0), PlaceError(BOX, "z", 3.0), RotationError(BOX, "y", 2.0), RotationError(BOX, "z", 2.0),
    RotationError(REFERENCES[1], "y", 2.0, "reference"), CrossTalkError(GIRDER, BOX, 0.05),
    CrossTalkError(BOX, GIRDER, 0.05),
)  # fmt: skip
AT = {
    "place_x_1y": 40.0, "place_z_2x": -20.0, "rotation_2x_y": 12.0, "rotation_2x_z": -7.0, "rotation_force_4x_y": 9.0,
    "cross_talk_2x_1y": 0.15, "cross_talk_1y_2x": -0.1,
}  # fmt: skip


@pytest.fixture(scope="module")
def bogie():
    return bogie_on_rig(element_size=0.3)


def empty():
    shape = (len(FREQ), len(RESPONSES), len(REFERENCES))
    return MeasuredFRFs(FREQ, RESPONSES, REFERENCES, "accelerance", np.ones(shape) + 0j, np.full(shape, 1e-5), 1)


def along(model, direction, side):
    """FRFs where the last transducer of one side acts along another axis."""
    data, sensors = empty(), {"responses": RESPONSES, "references": REFERENCES}[side]
    turned = (*sensors[:-1], replace(sensors[-1], direction=direction))
    return FRFProblem(model, replace(data, **{side: turned})).functions({})


@pytest.mark.medium
def test_parameters_are_named_after_transducers_and_axes(bogie):
    space = FRFProblem(bogie, empty(), EVERY).space
    assert set(AT) == set(space.names) - set(bogie.space.names)
    sd = {p.name: (p.value, p.lower, p.upper, p.prior_sd, p.unit) for p in space.parameters}
    assert sd["rotation_2x_y"] == (0.0, -20.0, 20.0, 2.0, "deg")
    assert sd["cross_talk_2x_1y"] == (0.0, -0.5, 0.5, 0.05, "-")
    wide = RotationError(BOX, "y", 15.0).parameter, CrossTalkError(BOX, GIRDER, 0.2).parameter
    assert [(p.lower, p.upper) for p in wide] == [(-120.0, 120.0), (-1.0, 1.0)]
    assert all(e.parameter.name.endswith(" in test A") for e in belonging_to("A", EVERY))


@pytest.mark.medium
def test_a_turned_sensor_or_force_acts_along_both_axes(bogie):
    """By the functions of a transducer along each axis; only its own side of its own name is turned."""
    plain = FRFProblem(bogie, empty()).functions({})
    cosine, sine = np.cos(np.radians(12.0)), np.sin(np.radians(12.0))
    for side, name, index in (
        ("responses", "rotation_2x_y", (slice(None), 1)),
        ("references", "rotation_force_4x_y", (slice(None), slice(None), 1)),
    ):
        found = FRFProblem(bogie, empty(), EVERY).functions({name: 12.0})
        expected = plain.copy()
        expected[index] = cosine * plain[index] + sine * along(bogie, "y", side)[index]
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12 * np.abs(plain).max())


def test_axes_of_accelerometer_and_force_at_one_point_are_turned_each_for_itself():
    """Two directions of one mass on springs by hand."""
    model = StructuralModel.from_matrices(
        np.diag([1e4, 2e4]), np.eye(2), 5 * np.eye(2), dofs=[(1, "x"), (1, "y")]
    )  # fmt: skip
    sensor, ones = Sensor(1, "x"), np.ones((len(FREQ), 1, 1))
    data = MeasuredFRFs(FREQ, (sensor,), (sensor,), "receptance", ones + 0j, ones)
    errors = RotationError(sensor, "y", 5.0), RotationError(sensor, "y", 5.0, "reference")
    problem, omega = FRFProblem(model, data, errors), 2 * np.pi * FREQ
    a, b = np.radians(20.0), np.radians(-10.0)
    along_x, along_y = (1 / (k + 5j * omega - omega**2) for k in (1e4, 2e4))
    found = problem.functions({"rotation_1x_y": 20.0, "rotation_force_1x_y": -10.0})[:, 0, 0]
    np.testing.assert_allclose(found, np.cos(a) * np.cos(b) * along_x + np.sin(a) * np.sin(b) * along_y, rtol=1e-10)
    (alone,) = FRFProblem(model, data, errors[:1]).functions({"rotation_1x_y": 20.0}).T
    np.testing.assert_allclose(alone[0], np.cos(a) * along_x, rtol=1e-10)


@pytest.mark.medium
def test_cross_talk_adds_a_share_to_a_response_alone(bogie):
    plain = FRFProblem(bogie, empty()).functions({})
    found = FRFProblem(bogie, empty(), EVERY).functions({"cross_talk_2x_1y": 0.15})
    expected = plain.copy()
    expected[:, 0] += 0.15 * plain[:, 1]
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12 * np.abs(plain).max())


def test_errors_of_one_sensor_add_up(bogie):
    problem = FRFProblem(bogie, empty(), EVERY)
    plain, own = problem.functions({}), [n for n in AT if n in ("rotation_2x_y", "rotation_2x_z", "cross_talk_1y_2x")]
    parts = sum(problem.functions({name: AT[name]}) - plain for name in own)
    np.testing.assert_allclose(
        problem.functions({name: AT[name] for name in own}), plain + parts, rtol=1e-9, atol=1e-12 * np.abs(plain).max()
    )


@pytest.mark.medium
@pytest.mark.parametrize("part", [0.0, 1.0])
def test_derivatives_are_those_of_differences(bogie, part):
    """At value 0 and away from it, beside those of the model and of a channel, in any order."""
    nuisances = (ChannelError("gain", "2x"), *EVERY)
    problem = FRFProblem(bogie, empty(), nuisances)
    sizes = {"K_primary": 600.0, "gain_2x": 2.0, **AT}
    at = {name: size * (part if name in AT else 1.0) for name, size in sizes.items()}
    names = tuple(reversed(at))
    exact = problem.slopes(at, names)
    for slope, name in zip(exact, names, strict=True):
        step = 1e-3 * abs(sizes[name])
        up, down = (problem.functions({**at, name: at[name] + s * step}) for s in (1, -1))
        numeric = (up - down) / (2 * step)
        assert np.abs(numeric).max() > 0, name
        np.testing.assert_allclose(slope, numeric, rtol=1e-5, atol=1e-6 * np.abs(numeric).max(), err_msg=name)
    (alone,) = problem.slopes(at, ("rotation_2x_y",))
    np.testing.assert_allclose(alone, exact[names.index("rotation_2x_y")], atol=1e-9 * np.abs(alone).max())


def test_without_errors_nothing_changes(bogie):
    plain, freed = (FRFResidual(FRFProblem(bogie, empty(), some)) for some in ((), EVERY))
    np.testing.assert_array_equal(freed.residual({}), plain.residual({}))
    np.testing.assert_array_equal(freed.jacobian({}, ("K_primary",)), plain.jacobian({}, ("K_primary",)))


def test_each_error_makes_another_problem(bogie):
    other = (
        CrossTalkError(BOX, REFERENCES[1], 0.05),
        CrossTalkError(GIRDER, REFERENCES[1], 0.05),
        RotationError(REFERENCES[1], "z", 2.0, "reference"),
    )
    each = [(), *((n,) for n in (*EVERY, *other)), EVERY]
    assert len({FRFProblem(bogie, empty(), some).fingerprint for some in each}) == len(each)
    assert FRFProblem(bogie, empty(), EVERY).fingerprint == FRFProblem(bogie, empty(), EVERY).fingerprint


@pytest.mark.medium
def test_suspects_change_no_target_of_a_basis_but_fitted_errors_do(bogie):
    """A fitted place or direction of a force gives the basis a force more, a suspected one does not."""
    fitted = (EVERY[0], EVERY[4])
    for nuisances, forces in (((), 0), (fitted, 2), ((EVERY[1], EVERY[5]), 0)):
        plain = FRFResidual(FRFProblem(bogie, empty(), nuisances))
        suspected = plain.suspected()
        targets = [pair.problem.basis_target(1e-5) for pair in (plain, suspected)]
        assert [len(target.moved) for target in targets] == [forces, forces]
        assert targets[0].request == targets[1].request and len(suspected.faults) > 10
        assert plain.problem.basis_names == suspected.problem.basis_names
        # A richer effect is added to the basis by the problem with suspects.
        one, other = (
            BasisRequirements.of(pair.problem, 1e-5, 1).key(bogie, bogie.space) for pair in (plain, suspected)
        )
        assert one == other
    mass = AccelerometerMass(GIRDER, 0.1)
    loaded = FRFProblem(bogie, empty(), (mass,), suspects=(mass,))
    assert mass.parameter.name in loaded.space and loaded.basis_names == bogie.space.names
    assert not loaded.basis_target(1e-5).loads
    free = FRFProblem(bogie, empty(), fitted).basis_target(1e-5)
    (row,) = bogie.sensor_rows([replace(REFERENCES[1], direction="y")])
    np.testing.assert_array_equal(free.moved[1], row)


def test_a_place_at_the_end_of_a_member_is_that_on_its_one_side(bogie):
    """Half a way beyond its end a transducer is off the model."""
    end = replace(GIRDER, point=(-1.98, 0.62, 1.05))
    with pytest.raises(InputError, match="off the model"):
        bogie.sensor_rows([replace(end, point=(-2.08, 0.62, 1.05))])
    here, inside = bogie.sensor_rows([end, replace(end, point=(-1.88, 0.62, 1.05))])
    np.testing.assert_allclose(PlaceError(end, "x", 100.0).other(bogie), (inside - here) / 0.1)


def test_a_test_accepts_them_and_keeps_a_held_out_source(bogie):
    test = calib.FRFTest(empty(), held_out=["1y"], nuisances=EVERY)
    names = calib.Problem(bogie, test).space.names
    assert {"cross_talk_1y_2x", "rotation_2x_y", "rotation_force_4x_y"} <= set(names)
    assert "cross_talk_2x_1y" not in names


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: RotationError(BOX, "x", 1.0), "'x' is turned towards 'x'"),
        (lambda: RotationError(BOX, "rx", 1.0), "towards 'rx'"),
        (lambda: RotationError(Sensor(1, "rx"), "x", 1.0), "'rx' is turned"),
        (lambda: RotationError(BOX, "y", 1.0, "sensor"), "of a 'sensor'"),
        (lambda: RotationError(BOX, "y", 0.0), "is 0"),
        (lambda: CrossTalkError(BOX, BOX, 0.1), "same sensor"),
        (lambda: CrossTalkError(BOX, GIRDER, -0.1), "is -0.1"),
    ],
)
def test_impossible_errors_are_refused(make, words):
    with pytest.raises(InputError, match=words):
        make()


def test_errors_of_other_transducers_or_motions_are_refused(bogie):
    with pytest.raises(InputError, match="reference '2x' was not measured"):
        FRFProblem(bogie, empty(), (RotationError(BOX, "y", 1.0, "reference"),))
    with pytest.raises(InputError, match="'4x' was not measured"):
        FRFProblem(bogie, empty(), (CrossTalkError(REFERENCES[1], BOX, 0.1),))
    chain = StructuralModel.from_matrices(np.diag([1e4, 2e4]), np.eye(2), np.eye(2), dofs=[(1, "x"), (2, "x")])
    sensor, ones = Sensor(1, "x"), np.ones((len(FREQ), 1, 1))
    data = MeasuredFRFs(FREQ, (sensor,), (sensor,), "receptance", ones + 0j, ones)
    with pytest.raises(InputError, match="rotation of 1x: along y the model suppresses"):
        FRFProblem(chain, data, (RotationError(sensor, "y", 1.0),))
