"""A function that returns modes at sensors gives the same results as a model of matrices."""

import math

import numpy as np
import pandas as pd
import pytest

import calib
from calib.correlation.modal.problem import ModalProblem
from calib.correlation.modal.residual import ModalResidual
from calib.structure.modal_result import mode_numbers, modes_from, modes_from_result
from tests.api.cantilever import (
    ADOPTED,
    BEAM,
    SENSORS,
    TRUE,
    as_function,
    as_matrices,
    bends,
    measured,
    space,
)

COUNT = 14


@pytest.fixture(scope="module")
def modal_test():
    return calib.ModalTest(measured(), mode_count=COUNT)


@pytest.fixture(scope="module")
def fits(modal_test):
    return {make: calib.Problem(make(), modal_test).calibrate(starts=1) for make in (as_function, as_matrices)}


# -- the same answers as with matrices ---------------------------------------------------------------------------------


def test_the_comparison_is_that_of_the_matrices(modal_test):
    own, theirs = (calib.Problem(make(), modal_test).compare() for make in (as_function, as_matrices))
    pd.testing.assert_frame_equal(own.table, theirs.table, rtol=1e-6)
    mine, other = (c.by_test["test"].comparison.where_it_fails() for c in (own, theirs))
    pd.testing.assert_frame_equal(mine, other, rtol=1e-5)


@pytest.mark.medium
def test_fit_and_standard_deviations_are_those_of_the_matrices(fits):
    own, theirs = fits[as_function], fits[as_matrices]
    for name in ADOPTED:
        std = theirs.parameters.loc[name, "std"]
        assert own.values[name] == pytest.approx(theirs.values[name], abs=5e-3 * std)
        assert own.parameters.loc[name, "std"] == pytest.approx(std, rel=1e-3)
        assert abs(theirs.values[name] - TRUE[name]) < 5 * std
    assert own.statistics.criterion == pytest.approx(theirs.statistics.criterion, rel=1e-5)  # a fit ends there
    assert list(own.parameters["identified"]) == list(theirs.parameters["identified"])
    pd.testing.assert_frame_equal(own.errors, theirs.errors, rtol=1e-3)
    pd.testing.assert_frame_equal(own.statistics.predictions, theirs.statistics.predictions, rtol=1e-3)


@pytest.mark.medium
def test_held_out_modes_and_sensors_check_a_function_as_they_check_matrices():
    test = calib.ModalTest(measured(), held_out=["m7", "2y"], mode_count=COUNT)
    own, theirs = (
        calib.Problem(make(), test).calibrate(["EI_y", "EI_z"], starts=1).errors for make in (as_function, as_matrices)
    )
    assert {"held_out_modes", "held_out_sensors"} <= set(own["group"])
    pd.testing.assert_frame_equal(own, theirs, rtol=1e-3)


@pytest.mark.slow
def test_several_tests_each_under_its_condition_share_their_parameters():
    """Once with a known mass at the tip, once without any; the function and the matrices stand side by side."""
    tests = [
        calib.ModalTest(measured(m_tip=m, seed=k), name=name, condition={"m_tip": m}, mode_count=COUNT)
        for k, (name, m) in enumerate({"light": 0.3, "heavy": 2.5}.items())
    ]
    own, theirs = (calib.Problem(make(), tests).calibrate(starts=1) for make in (as_function, as_matrices))
    for name in ("EI_y", "EI_z", "k_root", "c_tip"):
        std = theirs.parameters.loc[name, "std"]
        assert own.values[name] == pytest.approx(theirs.values[name], abs=0.05 * std)  # a fit ends there
        assert own.parameters.loc[name, "std"] == pytest.approx(std, rel=1e-2)
        assert own.values[name] == pytest.approx(TRUE[name], rel=0.05)  # the mesh is coarser than what was measured
    assert list(own.errors["test"].unique()) == ["light", "heavy"]


@pytest.mark.medium
def test_no_point_is_evaluated_twice(modal_test):
    asked = []

    def counted(v):
        asked.append(tuple(v.values()))
        return bends(v)

    model = calib.ModalFunctionModel("cantilever", space(), counted, SENSORS, n_modes=14, damped=True)
    fit = calib.Problem(model, modal_test).calibrate(["EI_y", "m_tip"], starts=1)
    assert len(fit.errors) and len(fit.compare().table) == 8
    assert len(asked) == len(set(asked)) > 10


@pytest.mark.medium
def test_without_damping_and_in_another_scale_shapes_are_real(modal_test):
    """The undamped beam, its shapes in an arbitrary scale and sign at every call."""
    rng = np.random.default_rng(1)

    def real(v):
        freq, _, shapes = BEAM.modes({**v, "c_tip": 0.0}, 14)
        turned = np.real(shapes * np.exp(-1j * np.angle(shapes[np.argmax(np.abs(shapes), axis=0), range(14)])))
        return freq, turned * rng.uniform(0.1, 5.0, 14) * rng.choice([-1.0, 1.0], 14)

    model = calib.ModalFunctionModel("beam", space().without({"c_tip": 0.0}), real, SENSORS, n_modes=14)
    own, theirs = calib.Problem(model, modal_test), calib.Problem(as_matrices(damped=False), modal_test)
    assert not own.compare().by_test["test"].comparison.modes.is_complex
    assert {row.kind for row in own.fit_problem.rows} == {"frequency", "shape"}
    found, wanted = own.calibrate(starts=1), theirs.calibrate(starts=1)
    for name in ("EI_y", "EI_z", "m_tip", "k_root"):
        std = wanted.parameters.loc[name, "std"]
        assert found.values[name] == pytest.approx(wanted.values[name], abs=1e-2 * std)
        assert found.parameters.loc[name, "std"] == pytest.approx(std, rel=1e-3)


# -- modes are followed ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("ratio", [0.9, 0.9999, 1.0001, 1.1])
def test_derivatives_are_right_on_both_sides_of_a_crossing(ratio):
    """Bending in y and in z cross where their stiffnesses are equal; near it a difference reaches over the crossing."""
    values = {**ADOPTED, "EI_y": ratio * 7000.0, "EI_z": 7000.0}
    names = ["EI_y", "EI_z", "m_tip", "k_root"]
    slopes = []
    for model in (as_function(**values), as_matrices(**values)):
        residual = ModalResidual(ModalProblem(model, measured(), mode_count=14))
        slopes.append(residual.jacobian(values, names))
    size = np.abs(slopes[1]).max(axis=0)
    assert np.abs((slopes[0] - slopes[1]) / size).max() < 1e-3


def test_followed_by_their_places_alone_modes_would_be_wrong_there():
    """What the matching is for: at this step the modes at the ends stand in another order."""
    values = {**ADOPTED, "EI_y": 6999.3, "EI_z": 7000.0}
    model = as_function(**values)
    here, there = model.modes(values, 2), model.modes({**values, "EI_y": 6999.3 + 1.3}, 2)
    assert abs(np.vdot(here.shapes[:, 0], there.shapes[:, 0])) < 0.1 * abs(
        np.vdot(here.shapes[:, 0], there.shapes[:, 1])
    )


def test_without_measured_shapes_modes_are_followed_by_their_own():
    whole = measured()
    bare = calib.MeasuredModes(
        whole.names, whole.natural_freq, whole.damped_freq, whole.freq_std, whole.damping_ratio, whole.damping_std, (),
        np.zeros((0, 8), dtype=complex), np.zeros((0, 8)), n_repeats=6,
    )  # fmt: skip
    test = calib.ModalTest(bare, mode_count=COUNT)
    moved = {"EI_y": 11000.0, "EI_z": 6000.0}
    own, theirs = (calib.Problem(make(), test).compare(moved).table for make in (as_function, as_matrices))
    assert list(own["model_mode"]) == list(theirs["model_mode"]) != list(range(1, 9))


def test_a_mode_that_leaves_those_given_has_one_sided_differences():
    """Where one end of a difference lacks a mode, the other tells."""
    values = dict(ADOPTED)
    model = as_function()
    modes = model.modes(values, 14)

    def at(there):
        return model.modes(there, 12 if there["EI_y"] > values["EI_y"] else 14)

    rows = np.eye(len(SENSORS))
    with pytest.raises(calib.EvaluationError):
        model.derivatives(values, modes, ["EI_y"], range(14), rows, lambda there: model.modes(there, 2))
    own = model.derivatives(values, modes, ["EI_y"], [12], rows, at)
    whole = model.derivatives(values, modes, ["EI_y"], [12], rows)
    np.testing.assert_allclose(own.natural_freq, whole.natural_freq, rtol=1e-3)


# -- what a function gives is checked at the door ----------------------------------------------------------------------


def of(answer, damped=True):
    return modes_from_result(answer, SENSORS[:2], 3, damped)


GOOD = {
    "natural_freq": np.array([1.0, 2.0, 3.0]),
    "damping_ratio": np.array([0.01, 0.02, 0.03]),
    "shapes": np.array([[1.0, 2.0, 1.0], [1.0, -1.0, 0.5]]),
}


def changed(**parts):
    return {**GOOD, **parts}


@pytest.mark.parametrize(
    "answer",
    [
        changed(natural_freq=np.array([1.0, np.nan, 3.0])),
        changed(natural_freq=np.array([1.0, 3.0, 2.0])),
        changed(natural_freq=np.array([0.0, 2.0, 3.0])),
        changed(natural_freq=np.array([1.0, 2.0])),
        changed(natural_freq="fast"),
        changed(natural_freq=np.array([1.0, 2.0, 3.0 + 1j])),
        changed(natural_freq=None),
        changed(damping_ratio=None),
        changed(damping_ratio=np.array([0.1, 0.2])),
        changed(damping_ratio=np.array([0.1, 0.2, 1.2])),
        changed(damping_ratio=np.array([0.1, 0.2, np.inf])),
        changed(shapes=GOOD["shapes"].T),
        changed(shapes=GOOD["shapes"][:1]),
        changed(shapes=[[1.0, 2.0, 3.0], [1.0, 2.0]]),
        changed(shapes=GOOD["shapes"] * np.nan),
        changed(shapes=GOOD["shapes"] * np.array([1.0, 0.0, 1.0])),
        {"natural_freq": [1.0, 2.0], "damping_ratio": [0.1, 0.1], "shapes": [[1.0, 1.0], [1.0, 2.0]]},
        (1.0,),
        7.0,
        None,
        (GOOD["natural_freq"], GOOD["shapes"]),
    ],
)
def test_an_invalid_result_is_a_failed_point_with_one_sentence(answer):
    with pytest.raises(calib.EvaluationError) as fault:
        of(answer)
    assert "\n" not in str(fault.value) and len(str(fault.value)) < 160


def test_damping_that_was_not_declared_is_told():
    with pytest.raises(calib.EvaluationError, match="damped"):
        of(GOOD, damped=False)
    assert not of(changed(damping_ratio=np.zeros(3)), damped=False).damping_ratio.any()


@pytest.mark.parametrize("form", [dict, tuple, "object"])
def test_modes_come_as_mapping_tuple_or_object(form):
    given = GOOD if form is dict else tuple(GOOD.values()) if form is tuple else type("Answer", (), GOOD)()
    found = of(given)
    assert found.is_complex and list(found.natural_freq) == [1.0, 2.0, 3.0]
    assert found.damped_freq[2] == pytest.approx(3.0 * math.sqrt(1 - 0.03**2))


def test_of_more_modes_the_lowest_are_taken():
    assert modes_from_result(GOOD, SENSORS[:2], 2, True).n_modes == 2


@pytest.mark.parametrize("damped", [True, False])
def test_numbers_tell_the_modes_to_the_last_digit(damped):
    shapes = GOOD["shapes"] * (1 + 0.5j) if damped else GOOD["shapes"]
    modes = of(changed(shapes=shapes, damping_ratio=GOOD["damping_ratio"] if damped else None), damped)
    again = of(modes_from(mode_numbers(modes, SENSORS[:2]), SENSORS[:2], damped), damped)
    for part in ("natural_freq", "damped_freq", "damping_ratio", "shapes"):
        assert np.array_equal(getattr(modes, part), getattr(again, part))


def test_a_function_that_fails_is_a_failed_point(modal_test):
    def failing(v):
        raise ValueError("the solver\nhas no licence")

    model = calib.ModalFunctionModel("solver", space(), failing, SENSORS, n_modes=14, damped=True)
    with pytest.raises(calib.EvaluationError, match="licence"):
        calib.Problem(model, modal_test).compare()


@pytest.mark.medium
def test_a_function_that_fails_in_places_is_fitted_around_them(modal_test):
    def partly(v):
        if v["m_tip"] > 1.6:
            raise RuntimeError("no convergence")
        return bends(v)

    model = calib.ModalFunctionModel("solver", space(), partly, SENSORS, n_modes=14, damped=True)
    fit = calib.Problem(model, modal_test).calibrate(["EI_y", "EI_z", "m_tip"], starts=1)
    assert fit.values["m_tip"] < 1.6
    assert (
        fit.statistics.criterion
        < calib.Problem(model, modal_test).keep(["EI_y", "EI_z", "m_tip"]).statistics_at({}).statistics.criterion
    )


@pytest.mark.parametrize(
    "wrong",
    [
        {"sensors": []},
        {"sensors": "1z"},
        {"sensors": ["1z", "1z"]},
        {"sensors": ["1q"]},
        {"sensors": [(1, "z", 3)]},
        {"n_modes": 0},
        {"n_modes": 2.5},
        {"function": 3.0},
        {"space": {}},
        {"step": 0.0},
        {"step": "small"},
    ],
)
def test_a_model_that_cannot_be_is_refused(wrong):
    given = {"name": "m", "space": space(), "function": bends, "sensors": SENSORS, "n_modes": 14, **wrong}
    with pytest.raises(calib.InputError) as fault:
        calib.ModalFunctionModel(**given)
    assert fault.value.place is not None


def test_sensors_are_told_by_name_pair_or_place(modal_test):
    named = [s.name for s in SENSORS]
    pairs = [(s.node, s.direction) for s in SENSORS]
    placed = [calib.Sensor(100 + s.node, s.direction, s.point) for s in SENSORS]
    tables = []
    for sensors in (SENSORS, named, pairs, placed):
        model = calib.ModalFunctionModel("cantilever", space(), bends, sensors, n_modes=14, damped=True)
        tables.append(calib.Problem(model, modal_test).compare().table)
    assert all(table.equals(tables[0]) for table in tables)


def test_a_measured_sensor_that_the_function_lacks_is_told(modal_test):
    def fewer(v):
        freq, ratio, shapes = BEAM.modes(v, 14)
        return freq, ratio, shapes[:-1]

    model = calib.ModalFunctionModel("cantilever", space(), fewer, SENSORS[:-1], n_modes=14, damped=True)
    with pytest.raises(calib.InputError, match="8z"):
        calib.Problem(model, modal_test)


def test_clusters_need_energies():
    with pytest.raises(calib.InputError, match="cluster"):
        calib.Problem(as_function(), calib.ModalTest(measured(), clusters={"m1": ["y"]}))


def test_a_change_of_code_or_of_what_is_asked_changes_the_fingerprint():
    def other(v):
        return bends({**v, "m_tip": 2 * v["m_tip"]})

    makes = [
        as_function(),
        calib.ModalFunctionModel("cantilever", space(), other, SENSORS, n_modes=14, damped=True),
        calib.ModalFunctionModel("cantilever", space(), bends, SENSORS, n_modes=12, damped=True),
    ]
    assert len({m.fingerprint for m in makes}) == 3
    finer = calib.ModalFunctionModel("cantilever", space(), bends, SENSORS, n_modes=14, damped=True, step=1e-3)
    assert as_function().fingerprint == finer.fingerprint == makes[0].fingerprint  # of derivatives, not of the model
