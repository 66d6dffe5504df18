"""Transducers that do not sit where they are said to: the distances as parameters of a test of FRFs."""

from dataclasses import replace

import numpy as np
import pandas as pd
import pytest

import calib
from calib.correlation.frf.nuisance import ChannelError, concerned
from calib.correlation.frf.places import PlaceError, place_nuisances
from calib.correlation.frf.problem import FRFProblem
from calib.correlation.frf.residual import FRFResidual
from calib.errors.errors import InputError
from calib.inference.gauss_newton import fit
from calib.measurement.frf import MeasuredFRFs
from calib.measurement.modal import Sensor
from calib.problem.problem import PairProblem
from calib.structure.model import StructuralModel
from calib.structure.reduction.reduced import ReducedModel
from calib.structure.reduction.training import train
from models.railway import bogie_on_rig

FREQ = np.linspace(7.3, 31.0, 12)
GIRDER, BOX = Sensor(1, "y", (-1.3, 0.62, 1.05), "frame"), Sensor(2, "x", (1.45, 0.43, 1.05), "box_front_left")
CROSSBAR = Sensor(3, "y", (1.115, 0.62, 1.2), "crossbar")
RESPONSES, REFERENCES = (GIRDER, BOX, CROSSBAR), (GIRDER, Sensor(4, "x", (1.45, 0.43, -1.05), "box_front_right"))
SD = 3.0


def shifted(sensor, **distances):
    """A sensor elsewhere, by distances in mm along each axis."""
    return replace(sensor, point=tuple(c + 1e-3 * distances.get(a, 0.0) for a, c in zip("xyz", sensor.point)))  # noqa: B905


@pytest.fixture(scope="module")
def bogie():
    return bogie_on_rig(element_size=0.3)


def empty(std=1e-5):
    shape = (len(FREQ), len(RESPONSES), len(REFERENCES))
    return MeasuredFRFs(FREQ, RESPONSES, REFERENCES, "accelerance", np.ones(shape) + 0j, np.full(shape, std), 1)


def elsewhere(model, responses, references, values=None):
    """FRFs of a model whose transducers sit elsewhere."""
    data = replace(empty(), responses=responses, references=references)
    return FRFProblem(model, data).functions(values or {})


@pytest.mark.medium
def test_every_axis_that_matters_has_a_parameter(bogie):
    """Beams: a vertical sensor on a girder along x feels its slope; across it, the arm to its axis turns with it."""
    found = place_nuisances(empty(), SD, bogie)
    assert len({e.parameter.name for e in found}) == len(found)
    names = {e.parameter.name for e in found}
    assert {"place_x_1y", "place_z_1y", "place_y_2x", "place_z_2x", "place_x_3y", "place_z_3y"} <= names
    assert "place_y_1y" not in names and "place_y_3y" not in names  # above or below its axis a beam moves alike
    assert all((p.unit, p.value, p.prior_sd) == ("mm", 0.0, SD) for p in (e.parameter for e in found))


@pytest.mark.medium
@pytest.mark.parametrize("name", ["place_x_1y", "place_z_2x", "place_y_4x", "place_x_3y"])
def test_a_place_is_that_of_a_transducer_there(bogie, name):
    """Force and sensor of one name move together; what is left is of second order."""
    problem = FRFProblem(bogie, empty(), place_nuisances(empty(), SD, bogie))
    nominal = problem.functions({})
    left = []
    for distance in (1.0, 2.0):
        moved = [
            [shifted(s, **{name[6]: distance}) if s.name == name[8:] else s for s in sensors]
            for sensors in (RESPONSES, REFERENCES)
        ]
        true = elsewhere(bogie, *(tuple(sensors) for sensors in moved))
        change = np.abs(true - nominal).max()
        left.append(np.abs(problem.functions({name: distance}) - true).max())
        assert change > 0 and left[-1] < 0.03 * change
        assert (np.abs(true - nominal).max(axis=(0, 2)) > 0).sum() == (3 if name[8:] in ("1y", "4x") else 1)


@pytest.mark.medium
def test_derivatives_are_those_of_differences(bogie):
    """Beside those of the model and of a channel, in any order."""
    nuisances = (ChannelError("gain", "2x"), *place_nuisances(empty(), SD, bogie))
    residual = FRFResidual(FRFProblem(bogie, empty(), nuisances))
    names = ("place_z_1y", "K_primary", "place_y_4x", "gain_2x", "place_x_1y", "place_z_2x")
    at = {
        "K_primary": 600.0,
        "gain_2x": 2.0,
        "place_x_1y": 4.0,
        "place_z_1y": -3.0,
        "place_y_4x": 5.0,
        "place_z_2x": 2.0,
    }
    exact = residual.jacobian(at, names)
    for column, name in zip(exact.T, names, strict=True):
        step = 1e-4 * abs(at[name])
        up, down = (residual.residual({**at, name: at[name] + s * step}) for s in (1, -1))
        np.testing.assert_allclose(column, (up - down) / (2 * step), rtol=1e-4, atol=1e-4 * np.abs(column).max())


def test_stated_places_change_nothing(bogie):
    plain = FRFResidual(FRFProblem(bogie, empty()))
    freed = FRFResidual(FRFProblem(bogie, empty(), place_nuisances(empty(), SD, bogie)))
    np.testing.assert_array_equal(freed.residual({}), plain.residual({}))
    assert freed.fingerprint != plain.fingerprint and freed.rows == plain.rows


@pytest.mark.medium
def test_distances_are_found_and_a_parameter_is_no_longer_pulled(bogie):
    """Sensors 4 mm off by simulation: without their places the fit is contradicted, and a stiffness goes wrong."""
    rng = np.random.default_rng(4)
    true = {"place_x_1y": 4.0, "place_z_2x": -4.0, "place_z_3y": 3.0, "place_x_3y": -3.0}
    responses = (shifted(GIRDER, x=4.0), shifted(BOX, z=-4.0), shifted(CROSSBAR, z=3.0, x=-3.0))
    references = (shifted(GIRDER, x=4.0), REFERENCES[1])
    exact = elsewhere(bogie, responses, references, {"K_primary": 590.0})
    std = 1e-3 * np.abs(exact) + 1e-9
    noise = std * (rng.standard_normal(exact.shape) + 1j * rng.standard_normal(exact.shape))
    data = replace(empty(), values=exact + noise, std=std)
    misfit = {}
    for label, nuisances in (("places", place_nuisances(data, SD, bogie)), ("none", ())):
        residual = FRFResidual(FRFProblem(bogie, data, nuisances))
        space = residual.space.keep([*(n.parameter.name for n in nuisances), "K_primary"])
        found = fit(PairProblem(residual, space), space)
        misfit[label] = float(found.residual @ found.residual) / len(found.residual)
        if nuisances:
            assert found.values["K_primary"] == pytest.approx(590.0, abs=0.5)
            for name, distance in true.items():
                assert found.values[name] == pytest.approx(distance, abs=0.6)
    assert misfit["places"] < 1.3 and misfit["none"] > 5


@pytest.mark.medium
def test_a_basis_serves_displaced_transducers(bogie):
    """It holds the moments of displaced forces: the drive point is as accurate as it is at its stated place."""
    data = empty(std=2e-6)
    problem = FRFProblem(bogie, data, place_nuisances(data, SD, bogie))
    space = bogie.space.keep(["K_primary"])
    reduced = ReducedModel(bogie, train(bogie, space, problem.basis_target(1e-5), seed=1))
    small = FRFResidual(problem.reduced(reduced.basis))
    for values in ({}, {"place_x_1y": 10.0, "place_z_1y": -10.0, "place_y_4x": 10.0}):
        assert np.abs(small.residual(values) - FRFResidual(problem).residual(values)).max() < 0.05


def test_places_of_held_out_transducers_are_not_fitted_but_blur_their_prediction(bogie):
    every = place_nuisances(empty(), SD, bogie)
    test = calib.FRFTest(empty(), held_out=["3y"], nuisances=every)
    assert not any("3y" in name for name in calib.Problem(bogie, test).space.names)
    unfitted = test.unseen["held_out_sensors"].unfitted({})
    assert unfitted["place_x_3y"] == SD and unfitted["place_x_1y"] == SD
    assert len(concerned(every, empty().without(("3y",)))) == len(every) - 2


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: PlaceError(GIRDER, "rx", 1.0), "along 'rx'"),
        (lambda: PlaceError(Sensor(1, "y"), "x", 1.0), "table of sensors"),
        (lambda: PlaceError(GIRDER, "x", 0.0), "is 0"),
    ],
)
def test_impossible_places_are_refused(make, words):
    with pytest.raises(InputError, match=words):
        make()


def test_places_that_were_not_measured_or_have_no_effect_are_refused(bogie):
    with pytest.raises(InputError, match="'9y' was not measured"):
        FRFProblem(bogie, empty(), (PlaceError(replace(GIRDER, node=9), "x", 1.0),))
    chain = StructuralModel.from_matrices(np.diag([1e4, 2e4]), np.eye(2), np.eye(2), dofs=[(1, "x"), (2, "x")])
    sensor = Sensor(1, "x")
    ones = np.ones((len(FREQ), 1, 1))
    data = MeasuredFRFs(FREQ, (sensor,), (sensor,), "receptance", ones + 0j, ones)
    with pytest.raises(InputError, match="table of sensors"):
        place_nuisances(data, 1.0, chain)


@pytest.mark.parametrize("spacing", [0.05, 0.19, 0.3])
def test_of_a_model_that_finds_nodes_only_the_motion_changes_as_between_them(spacing):
    """A chain along x with a linear motion: whatever its spacing and the prior, the slope is that of the motion."""
    count = 5
    nodes = np.arange(1, count + 1)
    dofs = pd.DataFrame({"node": nodes, "direction": "y", "x": spacing * (nodes - 1), "y": 0.0, "z": 0.0})
    lines = [(k, k + 1) for k in range(1, count)]
    model = StructuralModel.from_matrices(1e4 * np.eye(count), np.eye(count), np.eye(count), dofs=dofs, lines=lines)
    shape = spacing * np.arange(count)
    for node in (1, 3, 5):
        error = PlaceError(Sensor(node, "y", (spacing * (node - 1), 0.0, 0.0)), "x", 20.0)
        assert error.other(model) @ shape == pytest.approx(1.0)
        assert not replace(error, along="z").other(model).any()
